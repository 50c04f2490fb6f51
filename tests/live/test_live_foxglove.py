"""The Foxglove server of a live robot, as a client of its protocol sees it."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from foxglove_client import FoxgloveClient
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from served_robot import LIVE_TOPICS, NotedControls, live_hub
from waiting import wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus

from slamsim.guard.errors import OutputRefused
from slamsim.live.hub import Hub
from slamsim.live.servers import front
from slamsim.live.servers.access import Access
from slamsim.live.servers.foxglove import FoxgloveServer

STORE = get_typestore(Stores.ROS2_HUMBLE)
TWIST, GOAL = "geometry_msgs/msg/Twist", "geometry_msgs/msg/PoseStamped"

FALSE, TRUE = b"\x00\x01\x00\x00\x00", b"\x00\x01\x00\x00\x01"
"""std_srvs/SetBool requests; a Trigger without a field is sent as the first, or as nothing."""

Served = tuple[Hub, NotedControls, FoxgloveServer]


@pytest.fixture
def served() -> Iterator[Served]:
    hub, controls = live_hub(), NotedControls()
    with FoxgloveServer(hub, controls, Access(), port=0) as server:
        yield hub, controls, server


def cdr_twist(speed: float, turn: float) -> bytes:
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    twist = STORE.types[TWIST](vector(speed, 0.0, 0.0), vector(0.0, 0.0, turn))
    return bytes(STORE.serialize_cdr(twist, TWIST))


def json_goal(x_m: float, y_m: float, yaw_rad: float | None, frame: str = "map") -> bytes:
    half = 0.0 if yaw_rad is None else 0.5 * yaw_rad
    turn = {} if yaw_rad is None else {"x": 0, "y": 0, "z": math.sin(half), "w": math.cos(half)}
    pose = {"position": {"x": x_m, "y": y_m, "z": 0}, "orientation": turn}
    return json.dumps({"header": {"frame_id": frame}, "pose": pose}).encode()


def is_served(client: FoxgloveClient) -> bool:
    """Whether the server's socket is open, whatever the client has not read."""
    connection = client.socket.socket
    mine, its = (f"{name[1]:04X}" for name in (connection.getsockname(), connection.getpeername()))
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, local, remote, state = line.split()[:4]
        if (local.rpartition(":")[2], remote.rpartition(":")[2]) == (its, mine):
            return state == "01"
    return False


def status_of(client: FoxgloveClient) -> str:
    return str(client.until("status")["message"])


def settled(client: FoxgloveClient) -> None:
    """All that was said so far has been heard."""
    client.say("getParameters", parameterNames=[], id="settled")
    while client.until("parameterValues").get("id") != "settled":
        pass


def test_topics_are_advertised_with_their_definitions(served: Served) -> None:
    with FoxgloveClient(served[2].address) as client:
        while set(client.channels) != set(LIVE_TOPICS):
            client.next()
    for topic, kind in LIVE_TOPICS.items():
        channel = client.channels[topic]
        assert (channel["schemaName"], channel["encoding"]) == (kind, "cdr")
        assert channel["schemaEncoding"] == "ros2msg"
    assert "float32[] ranges" in client.channels["/scan"]["schema"]


def test_messages_arrive_with_their_bytes_and_times(served: Served) -> None:
    hub, _, server = served
    with FoxgloveClient(server.address) as client:
        client.subscribe("/scan", "/clock")
        settled(client)
        hub.publish("/odom", 4, b"nobody asked for it")
        hub.publish("/scan", 5, b"a scan")
        hub.publish("/clock", 6, b"a time")
        found = client.rest()
    assert ("/scan", (5, b"a scan")) in found
    assert ("/clock", (6, b"a time")) in found
    assert ("time", 6) in found
    assert not [topic for topic, _ in found if topic == "/odom"]


def test_a_late_subscriber_gets_what_is_latched_once_and_others_do_not(served: Served) -> None:
    hub, _, server = served
    hub.publish("/map", 7, b"an old map")
    hub.publish("/map", 8, b"a map")
    hub.publish("/scan", 8, b"a scan")
    with FoxgloveClient(server.address) as first, FoxgloveClient(server.address) as second:
        for client, topics in ((first, ["/map", "/scan"]), (second, ["/map"])):
            client.subscribe(*topics)
            # Services may be advertised at any time.
            messages = [told for told in client.rest() if told[0] in ("/map", "/scan")]
            assert messages == [("/map", (8, b"a map"))]
        assert first.rest() == []


@pytest.mark.parametrize("kind", [TWIST, "geometry_msgs/Twist"])
def test_a_twist_drives(served: Served, kind: str) -> None:
    _, controls, server = served
    with FoxgloveClient(server.address) as client:
        client.advertise(1, "/cmd_vel", kind, "cdr")
        client.advertise(2, "/cmd_vel", kind, "json")
        client.publish(1, cdr_twist(0.3, -0.2))
        client.publish(2, json.dumps({"linear": {"x": 1}, "angular": {"z": 0.5}}).encode())
        client.publish(2, b"{}")
        settled(client)
    assert controls.asked == [("drive", 0.3, -0.2), ("drive", 1.0, 0.5), ("drive", 0.0, 0.0)]


def test_a_goal_is_driven_to(served: Served) -> None:
    _, controls, server = served
    with FoxgloveClient(server.address) as client:
        client.advertise(1, "/move_base_simple/goal", GOAL, "json")
        client.advertise(2, "/goal_pose", GOAL, "json")
        client.publish(1, json_goal(1.0, 2.0, -0.5))
        client.publish(2, json_goal(3.0, 4.0, None, frame=""))
        client.publish(2, json_goal(101.0, 0.0, 0.0))
        assert status_of(client) == "/goal_pose: no free path leads there"
    (_, x_m, y_m, yaw_rad), last = controls.asked
    assert (x_m, y_m, yaw_rad) == (1.0, 2.0, pytest.approx(-0.5))
    assert last == ("go_to", 3.0, 4.0, None)


@pytest.mark.parametrize(
    ("topic", "kind", "encoding", "data", "why"),
    [
        ("/cmd_vel", TWIST, "cdr", cdr_twist(math.nan, 0.0), "a twist"),
        ("/cmd_vel", TWIST, "cdr", b"\x00\x01\x00\x00short", f"this is no {TWIST}"),
        ("/cmd_vel", TWIST, "json", b'{"linear": {"x": Infinity}}', "a twist"),
        ("/cmd_vel", TWIST, "json", b'{"linear": {"x": true}}', "linear.x must be a number"),
        ("/cmd_vel", TWIST, "json", b'{"linear": 3}', "linear must hold fields"),
        ("/cmd_vel", TWIST, "json", b'{"linear": {"x": 1' + b"0" * 400 + b"}}", "too large"),
        ("/cmd_vel", TWIST, "json", b"[" * 100_000, "this is no JSON"),
        ("/cmd_vel", TWIST, "json", b"[]", "a message has fields"),
        ("/cmd_vel", GOAL, "json", b"", f"/cmd_vel takes {TWIST}"),
        ("/cmd_vel", TWIST, "protobuf", b"", "as json or cdr, not as 'protobuf'"),
        ("/elsewhere", TWIST, "json", b"", "no one listens to '/elsewhere'"),
        ("/goal_pose", GOAL, "json", json_goal(1.0, 2.0, 0.0, "odom"), "the frame map, not"),
    ],
)
def test_what_is_refused_is_told(
    served: Served, topic: str, kind: str, encoding: str, data: bytes, why: str
) -> None:
    _, controls, server = served
    with FoxgloveClient(server.address) as client:
        client.advertise(1, topic, kind, encoding)
        client.publish(1, data)
        assert why in status_of(client)
    assert controls.asked == []


def test_parameters_are_read_set_and_followed(served: Served) -> None:
    _, controls, server = served

    def values(told: dict[str, Any]) -> dict[str, object]:
        return {each["name"]: each.get("value") for each in told["parameters"]}

    with FoxgloveClient(server.address) as client, FoxgloveClient(server.address) as other:
        client.say("getParameters", parameterNames=[], id="all")
        known = {"/slamsim/rate": 1.0, "/slamsim/paused": False, "/slamsim/mode": "tour"}
        assert values(client.until("parameterValues")) == known
        other.say("subscribeParameterUpdates", parameterNames=list(known))
        settled(other)
        wanted = [{"name": "/slamsim/rate", "value": 2}, {"name": "/slamsim/paused", "value": True}]
        client.say("setParameters", parameters=wanted, id="set")
        changed = {"/slamsim/rate": 2.0, "/slamsim/paused": True}
        assert values(client.until("parameterValues")) == changed
        assert values(other.until("parameterValues")) == changed
        controls.set_mode("explore")
        while values(other.until("parameterValues")).get("/slamsim/mode") != "explore":
            pass
    assert controls.asked[:2] == [("set_rate", 2.0), ("pause", True)]


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("/slamsim/rate", -1.0, "a rate"),
        ("/slamsim/rate", "fast", "a rate is a number"),
        ("/slamsim/paused", 1, "true or false"),
        ("/slamsim/mode", "race", "one of tour, manual, explore"),
        ("/slamsim/mode", [1, 2], "one of tour, manual, explore"),
        ("/use_sim_time", True, "no parameter '/use_sim_time'; there are /slamsim/rate"),
    ],
)
def test_a_refused_parameter_stays_as_it_was(
    served: Served, name: str, value: object, why: str
) -> None:
    with FoxgloveClient(served[2].address) as client:
        client.say("setParameters", parameters=[{"name": name, "value": value}], id="set")
        assert why in status_of(client)
    assert served[1].asked == []


def test_services_answer(served: Served) -> None:
    _, controls, server = served
    with FoxgloveClient(server.address) as client:
        reset = client.call("/slamsim/reset", FALSE)
        record = client.call("/slamsim/record", TRUE)
        stopped = client.call("/slamsim/record", FALSE)
        step = client.call("/slamsim/step", FALSE)
        saved = client.call("/slamsim/save_map", b"")
        wrong = client.call("/slamsim/record", TRUE + b"\x01")
    assert (reset[4], record[4], stopped[4], step[4], saved[4], wrong[4]) == (1, 1, 1, 0, 0, 0)
    assert reset.endswith(b"the drive begins anew\0")
    assert record.endswith(b"recording into drive_1\0")
    assert stopped.endswith(b"the recording is in drive_1\0")
    assert b"a step is for a paused robot" in step
    assert saved.endswith(b"there is no map: SLAM is off\0")
    assert b"this is no std_srvs/srv/SetBool" in wrong
    assert controls.asked == [("reset",), ("record", Path("drive_1")), ("record", None)]
    response = client.services["/slamsim/record"]["response"]
    assert response["schema"] == "bool success\nstring message\n"


def test_viewers_forget_what_they_have_when_the_drive_begins_anew(served: Served) -> None:
    hub, _, server = served
    with FoxgloveClient(server.address) as client:
        hub.publish("/clock", 9, b"")
        hub.publish("/clock", 3, b"")
        assert client.until("serverInfo")["sessionId"] != client.server["sessionId"]


def test_a_page_elsewhere_is_refused(served: Served) -> None:
    with pytest.raises(InvalidStatus) as refused:
        FoxgloveClient(served[2].address, origin="https://elsewhere.example")
    response = refused.value.response
    assert response.status_code == 403
    assert response.body == b"pages from 'https://elsewhere.example' may not connect\n"


def test_beyond_this_machine_a_token_is_needed() -> None:
    access = Access("0.0.0.0", "secret-of-this-drive")
    with FoxgloveServer(live_hub(), NotedControls(), access, port=0) as server:
        assert server.address.endswith("/?token=secret-of-this-drive")
        address = server.address.replace("0.0.0.0", "127.0.0.1")
        with FoxgloveClient(address) as client:
            assert client.server["name"] == "slamsim"
        plain = address.partition("?")[0]
        bearer = {"Authorization": "Bearer secret-of-this-drive"}
        with FoxgloveClient(plain, additional_headers=bearer) as client:
            assert client.server["name"] == "slamsim"
        for wrong in (plain, f"{plain}?token=secret"):
            with pytest.raises(InvalidStatus, match="403"):
                FoxgloveClient(wrong)


def test_a_port_that_is_taken_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(OutputRefused, match=f"port {port} of 127.0.0.1 is already in use by"):
            FoxgloveServer(live_hub(), NotedControls(), Access(), port)
    with pytest.raises(OutputRefused, match=r"nothing can be served at 192\.0\.2\.1:0"):
        FoxgloveServer(live_hub(), NotedControls(), Access("192.0.2.1", "token"), 0)


def test_a_dead_front_is_begun_again(served: Served, caplog: pytest.LogCaptureFixture) -> None:
    address = served[2].address
    with FoxgloveClient(address) as client:
        os.kill(front_pid(), signal.SIGKILL)
        with pytest.raises(ConnectionClosed):
            while True:
                client.next()
    wait_for(lambda: "a new one does" in caplog.text)
    with FoxgloveClient(address) as client:
        assert client.server["name"] == "slamsim"


def front_pid() -> int:
    """Of the process that passes the bytes of this process' server on."""
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            ours = f"\nPPid:\t{os.getpid()}\n" in (entry / "status").read_text()
            if ours and b"front_worker" in (entry / "cmdline").read_bytes():
                return int(entry.name)
    raise AssertionError("there is none")


@pytest.fixture(scope="module")
def kept() -> Iterator[Served]:
    hub, controls = live_hub(), NotedControls()
    with FoxgloveServer(hub, controls, Access(), port=0) as server:
        yield hub, controls, server


OPS = ["subscribe", "unsubscribe", "advertise", "unadvertise", "getParameters", "setParameters"]
OPS += ["subscribeParameterUpdates", "subscribeConnectionGraph", "fetchAsset", "nothing"]
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)
KEYS = st.sampled_from(["subscriptions", "channels", "parameters", "parameterNames", "id"])


@pytest.mark.long
@given(
    frames=st.lists(
        st.binary(max_size=60)
        | st.builds(lambda op, data: bytes([op]) + data, st.integers(1, 2), st.binary(max_size=60))
        | st.builds(
            lambda op, fields: json.dumps({"op": op, **fields}),
            st.sampled_from(OPS),
            st.dictionaries(KEYS, VALUES),
        )
        | st.text(max_size=20),
        max_size=8,
    )
)
def test_random_frames_leave_the_server_up(kept: Served, frames: list[bytes | str]) -> None:
    hub, controls, server = kept
    with FoxgloveClient(server.address) as client:
        client.advertise(1, "/cmd_vel", TWIST, "json")
        try:
            for frame in frames:
                client.socket.send(frame)
        except ConnectionClosed:
            pass  # the server hung up on it
    with FoxgloveClient(server.address) as next_one:
        next_one.subscribe("/scan")
        settled(next_one)
        hub.publish("/scan", 1, b"a scan")
        assert next_one.until("/scan") == (1, b"a scan")
    assert {what for what, *_ in controls.asked} <= {"drive", "set_rate", "pause", "set_mode"}


def test_a_client_that_reads_nothing_is_cut_off_and_no_other_misses_anything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(front, "STALLED_S", 0.1)
    hub = live_hub()
    with (
        FoxgloveServer(hub, NotedControls(), Access(), port=0) as server,
        FoxgloveClient(server.address) as awake,
    ):
        awake.subscribe("/scan")
        settled(awake)
        with FoxgloveClient(server.address, max_queue=1, ping_interval=None) as asleep:
            asleep.subscribe("/map")
            settled(asleep)
            numbers = count()

            def cut_off() -> bool:
                """After one map more: how many the kernel's buffers take is its own affair."""
                number = next(numbers)
                hub.publish("/map", number, bytes(1_000_000))
                hub.publish("/scan", number, b"a scan")
                assert awake.until("/scan") == (number, b"a scan")
                return not is_served(asleep)

            wait_for(cut_off)
            with pytest.raises(ConnectionClosed):
                while True:
                    asleep.next()
