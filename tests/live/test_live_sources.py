"""Messages of robots that run elsewhere, over rosbridge and the Foxglove protocol."""

from __future__ import annotations

import base64
import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from types import SimpleNamespace
from typing import Any

import cbor2
import numpy as np
import pytest
from fake_robot import FakeRobot
from foxglove import messages
from hypothesis import given, settings
from hypothesis import strategies as st
from live_data import SCAN, grid, hub, scan
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbridge_robot import call, serving, subscribe, told
from served_robot import NotedControls
from waiting import TIMEOUT_S, first_of, wait_for
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from slamsim.guard.errors import InputRefused
from slamsim.io.bag2.writer import TopicKind, described
from slamsim.io.ros.values import WrongMessage, cdr_of, plain_values
from slamsim.live.hub import Message
from slamsim.live.servers.access import Access
from slamsim.live.servers.foxglove import FoxgloveServer
from slamsim.live.servers.rosbridge.server import RosbridgeServer
from slamsim.live.sources import source as sources
from slamsim.live.sources.clients import FoxgloveSource, RosbridgeSource, open_source
from slamsim.live.sources.source import LiveSource

STARTS: dict[str, Any] = {"rosbridge": RosbridgeServer, "foxglove": FoxgloveServer}


@pytest.fixture(autouse=True)
def quick_reconnects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "FIRST_WAIT_S", 0.05)


@pytest.mark.parametrize("protocol", ["rosbridge", "foxglove"])
def test_a_source_gives_the_messages_of_a_server(protocol: str) -> None:
    messages, notices = hub(), list[str]()
    with ExitStack() as opened:
        server = opened.enter_context(STARTS[protocol](messages, NotedControls(), Access(), port=0))
        with open_source(server.address, notices.append) as source:
            kinds = {"rosbridge": RosbridgeSource, "foxglove": FoxgloveSource}
            assert isinstance(source, kinds[protocol])
            assert {one.name for one in source.topics()} == set(messages.topics)
            source.subscribe(["/scan", "/map"])
            first = first_of(source.receive, lambda n: messages.publish("/scan", n, scan(n)))
            assert first.topic.name == "/scan" and first.topic.type_name == SCAN.type_name
            assert abs(first.log_ns - time.time_ns()) < TIMEOUT_S * 1e9
            number = plain_values(SCAN.type_name, first.data, ros1=False)["header"]["stamp"]
            assert first.data == scan(number["nanosec"] // 1_000_000)
            messages.publish("/map", 1, grid(700))
            while (message := source.receive(TIMEOUT_S)) is not None and message.topic != MAP_TOPIC:
                continue
            assert message is not None and message.data == grid(700)
            assert not notices and source.dropped == 0


MAP_TOPIC = TopicKind("/map", "nav_msgs/msg/OccupancyGrid")


def test_a_token_is_part_of_the_address() -> None:
    with RosbridgeServer(hub(), NotedControls(), Access(token="a/ b"), port=0) as server:
        with open_source(server.address, print) as source:
            assert len(source.topics()) == 4
        with pytest.raises(InputRefused, match="the token is missing or wrong"):
            open_source(f"ws://127.0.0.1:{server.port}", print)


@pytest.mark.parametrize("protocol", ["rosbridge", "foxglove"])
def test_a_source_comes_back_when_the_server_does(protocol: str) -> None:
    notices: list[str] = []
    messages = hub()
    with STARTS[protocol](messages, NotedControls(), Access(), port=0) as server:
        port = int(server.address.rpartition(":")[2])
        source = open_source(server.address, notices.append)
        source.__enter__()
        source.subscribe(["/scan"])
        first_of(source.receive, lambda n: messages.publish("/scan", n, scan(n)))
    try:
        wait_for(lambda: any("is tried again in" in text for text in notices))
        again = hub()
        with STARTS[protocol](again, NotedControls(), Access(), port=port):
            message = first_of(source.receive, lambda n: again.publish("/scan", n, scan(7)))
        assert message.topic.name == "/scan"
    finally:
        source.__exit__(None, None, None)


def test_what_is_published_reaches_the_clients_of_a_rosbridge_server() -> None:
    with serving() as robot, robot.connect() as client:
        with open_source(robot.server.address, print) as source:
            source.publish("/map_of_slam", MAP_TOPIC.type_name, grid(30))
            wait_for(lambda: "/map_of_slam" in call(client, "/rosapi/topics")["topics"])
            subscribe(client, "/map_of_slam")
            source.publish("/map_of_slam", MAP_TOPIC.type_name, grid(20))
            message = told(client)["msg"]
        assert cdr_of(MAP_TOPIC.type_name, message, 0) == grid(20)


def test_what_is_published_reaches_a_foxglove_server(tmp_path: Any) -> None:
    robot = FakeRobot(tmp_path)
    twist = cdr_of("geometry_msgs/msg/Twist", {"linear": {"x": 0.25}}, 0)
    notices: list[str] = []
    with ExitStack() as opened:
        server = opened.enter_context(FoxgloveServer(robot.hub, robot, Access(), port=0))
        with open_source(server.address, notices.append) as source:
            wait_for(lambda: bool(source._encoding))  # type: ignore[attr-defined]
            source.publish("/cmd_vel", "geometry_msgs/msg/Twist", twist)
            wait_for(lambda: bool(robot.calls))
            source.publish("/map", MAP_TOPIC.type_name, grid(20))
            wait_for(lambda: any("no one listens to '/map'" in text for text in notices))
    assert robot.calls[0][0] == "drive" and robot.calls[0][1][0] == 0.25


@contextmanager
def scripted(talk: Callable[[ServerConnection], None], *subprotocols: str) -> Iterator[str]:
    """A server that does as it is told; its address."""
    names = [Subprotocol(name) for name in subprotocols] or None
    with serve(talk, "127.0.0.1", 0, subprotocols=names, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join()


def test_a_bridge_of_ros_1_is_read_and_answered() -> None:
    """Its types and times have the names of ROS 1, and it knows neither PNG nor CBOR here."""
    heard: list[Any] = []

    def talk(connection: ServerConnection) -> None:
        for frame in connection:
            asked = json.loads(frame)
            heard.append(asked)
            if asked["op"] == "call_service":
                values = {"topics": ["/scan"], "types": ["sensor_msgs/LaserScan"]}
                answer = {"op": "service_response", "id": asked["id"], "values": values}
                connection.send(json.dumps(answer | {"result": True}))
            elif asked["op"] == "subscribe":
                header = {"seq": 3, "stamp": {"secs": 5, "nsecs": 7}, "frame_id": "laser"}
                msg = {"header": header, "ranges": [1.5, None], "angle_min": -1}
                text = json.dumps({"op": "publish", "topic": "/scan", "msg": msg})
                for number in (1, 0):
                    data = text[:40] if number == 0 else text[40:]
                    part = {"op": "fragment", "id": "x", "num": number, "total": 2, "data": data}
                    connection.send(json.dumps(part))

    with scripted(talk) as url, open_source(url, print) as source:
        assert source.topics() == [SCAN]
        source.subscribe(["/scan"])
        message = source.receive(TIMEOUT_S)
        assert message is not None
        values = plain_values(SCAN.type_name, message.data, ros1=False)
        assert values["header"]["stamp"] == {"sec": 5, "nanosec": 7}
        assert values["ranges"][0] == 1.5 and np.isnan(values["ranges"][1])
        source.publish("/goal", "geometry_msgs/msg/PoseStamped", cdr_of(POSE, {}, 1_000_000_002))
        wait_for(lambda: heard[-1]["op"] == "publish")
    assert heard[1]["type"] == "sensor_msgs/LaserScan"
    assert heard[-2]["type"] == "geometry_msgs/PoseStamped"
    stamp = {"secs": 1, "nsecs": 2}
    assert heard[-1]["msg"]["header"] == {"seq": 0, "stamp": stamp, "frame_id": ""}


POSE = "geometry_msgs/msg/PoseStamped"
ROS1 = get_typestore(Stores.ROS1_NOETIC)


def channel(number: int, topic: str, encoding: str, kind: str, schema: str) -> dict[str, Any]:
    names = {"id": number, "topic": topic, "encoding": encoding, "schemaName": kind}
    return {**names, "schema": schema}


def foxglove_talk(
    channels: list[dict[str, Any]], payloads: Sequence[bytes], heard: list[Any]
) -> Callable[[ServerConnection], None]:
    def talk(connection: ServerConnection) -> None:
        info = {"op": "serverInfo", "name": "x", "capabilities": ["clientPublish"]}
        connection.send(json.dumps(info | {"supportedEncodings": ["ros1"]}))
        connection.send(json.dumps({"op": "advertise", "channels": channels}))
        for frame in connection:
            heard.append(frame if isinstance(frame, bytes) else json.loads(frame))
            if isinstance(frame, str) and heard[-1]["op"] == "subscribe":
                for asked in heard[-1]["subscriptions"]:
                    for payload in payloads:
                        connection.send(struct.pack("<BIQ", 1, asked["id"], 9) + payload)

    return talk


def test_a_foxglove_bridge_of_ros_1_is_read_and_answered() -> None:
    definition, _ = ROS1.generate_msgdef(SCAN.type_name)
    kind = ROS1.types[SCAN.type_name]
    header = ROS1.types["std_msgs/msg/Header"](
        seq=4, stamp=ROS1.types["builtin_interfaces/msg/Time"](5, 7), frame_id="laser"
    )
    ranges = np.array([1.5, 2.5], np.float32)
    message = kind(header, -1.0, 1.0, 0.1, 0.0, 0.1, 0.1, 9.0, ranges, ranges[:0])
    payload = bytes(ROS1.serialize_ros1(message, SCAN.type_name))
    heard: list[Any] = []
    channels = [channel(7, "/scan", "ros1", "sensor_msgs/LaserScan", definition)]
    talk = foxglove_talk(channels, [payload], heard)
    with ExitStack() as opened:
        url = opened.enter_context(scripted(talk, "foxglove.websocket.v1"))
        with open_source(url, print) as source:
            assert source.topics() == [SCAN]
            source.subscribe(["/scan"])
            arrived = source.receive(TIMEOUT_S)
            assert arrived is not None
            values = plain_values(SCAN.type_name, arrived.data, ros1=False)
            assert values["header"]["stamp"] == {"sec": 5, "nanosec": 7}
            assert values["ranges"].tolist() == [1.5, 2.5]
            source.publish("/goal", POSE, cdr_of(POSE, {}, 1_000_000_002))
            wait_for(lambda: isinstance(heard[-1], bytes))
    assert heard[-2]["channels"][0]["schemaName"] == "geometry_msgs/PoseStamped"
    back: Any = ROS1.deserialize_ros1(heard[-1][5:], POSE)
    assert (back.header.stamp.sec, back.header.stamp.nanosec) == (1, 2)


def test_scans_in_foxgloves_own_schemas_are_read() -> None:
    """As a program with its SDK sends them."""
    position, upright = messages.Vector3(), messages.Quaternion(w=1.0)
    sent = messages.LaserScan(
        timestamp=messages.Timestamp(sec=5, nsec=7),
        frame_id="laser",
        pose=messages.Pose(position=position, orientation=upright),
        end_angle=1.0,
        ranges=[1.5, 2.5],
    )
    schema = base64.b64encode(messages.LaserScan.get_schema().data).decode()
    notices: list[str] = []
    channels = [
        channel(1, "/scan", "protobuf", "foxglove.LaserScan", schema),
        channel(2, "/wrong", "protobuf", "foxglove.LaserScan", "?"),
        channel(3, "/map", "protobuf", "foxglove.Grid", schema),
    ]
    talk = foxglove_talk(channels, [sent.encode()], [])
    with ExitStack() as opened:
        url = opened.enter_context(scripted(talk, "foxglove.sdk.v1"))
        with open_source(url, notices.append) as source:
            assert source.topics() == [SCAN, TopicKind("/wrong", SCAN.type_name)]
            source.subscribe(["/wrong", "/scan"])
            arrived = source.receive(TIMEOUT_S)
            assert arrived is not None and arrived.topic == SCAN
            values = plain_values(SCAN.type_name, arrived.data, ros1=False)
            assert values["header"]["stamp"] == {"sec": 5, "nanosec": 7}
            assert values["ranges"].tolist() == [1.5, 2.5] and values["angle_increment"] == 1.0
    assert len(notices) == 1 and "messages of /wrong are left out" in notices[0]


def test_each_channel_of_a_topic_has_a_schema_of_its_own() -> None:
    """Of two publishers in different schemas one is subscribed to; what is advertised anew in
    another encoding is read as that."""
    mount = messages.FrameTransform(parent_frame_id="base", child_frame_id="laser")
    many = messages.FrameTransforms(transforms=[mount])
    schemas = {
        kind: base64.b64encode(getattr(messages, kind).get_schema().data).decode()
        for kind in ("FrameTransform", "FrameTransforms")
    }
    tf = "tf2_msgs/msg/TFMessage"
    plain = cdr_of(tf, {"transforms": [{"child_frame_id": "camera"}]}, 1)
    first = [
        channel(1, "/tf", "protobuf", "foxglove.FrameTransforms", schemas["FrameTransforms"]),
        channel(2, "/tf", "protobuf", "foxglove.FrameTransform", schemas["FrameTransform"]),
    ]
    anew = [channel(1, "/tf", "cdr", tf, described(tf)[1])]

    def talk(connection: ServerConnection) -> None:
        connection.send(json.dumps({"op": "serverInfo", "capabilities": []}))
        connection.send(json.dumps({"op": "advertise", "channels": first}))
        for payload in (many.encode(), plain):
            asked = json.loads(connection.recv())["subscriptions"][0]
            connection.send(struct.pack("<BIQ", 1, asked["id"], 9) + payload)
            connection.send(json.dumps({"op": "unadvertise", "channelIds": [1, 2]}))
            connection.send(json.dumps({"op": "advertise", "channels": anew}))
        connection.recv()

    notices: list[str] = []
    with ExitStack() as opened:
        url = opened.enter_context(scripted(talk, "foxglove.sdk.v1"))
        with open_source(url, notices.append) as source:
            source.subscribe(["/tf"])
            arrived = [source.receive(TIMEOUT_S), source.receive(TIMEOUT_S)]
    told = [plain_values(tf, one.data, ros1=False) for one in arrived if one is not None]
    assert [each["transforms"][0]["child_frame_id"] for each in told] == ["laser", "camera"]
    assert not [text for text in notices if "left out" in text]


def test_messages_that_cannot_be_used_are_left_out_and_told_once() -> None:
    text = described("std_msgs/msg/String")[1]
    custom = "float64 strange\nfloat32[] ranges\n"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(custom, SCAN.type_name))
    odd = store.types[SCAN.type_name](1.0, np.zeros(2, np.float32))
    channels = [
        channel(1, "/scan", "cdr", SCAN.type_name, custom),
        channel(2, "/words", "cdr", "std_msgs/msg/String", text),
        channel(3, "/json", "json", "std_msgs/msg/String", "{}"),
        channel(4, "/bomb", "cdr", "a/msg/Bomb", "float64[999999999] x"),
        channel(5, "/loop", "cdr", "a/msg/Loop", "a/Loop x"),
    ]
    good = cdr_of("std_msgs/msg/String", {"data": "x"}, 0)
    payloads = [b"", b"\xff" * 9, bytes(store.serialize_cdr(odd, SCAN.type_name)), good]
    notices: list[str] = []
    talk = foxglove_talk(channels, payloads, [])
    with ExitStack() as opened:
        url = opened.enter_context(scripted(talk, "foxglove.sdk.v1"))
        with open_source(url, notices.append) as source:
            assert {one.name for one in source.topics()} == {"/scan", "/words", "/bomb", "/loop"}
            source.subscribe(["/scan", "/bomb", "/loop", "/words"])
            arrived = source.receive(TIMEOUT_S)
            while arrived is not None and arrived.data != good:
                arrived = source.receive(TIMEOUT_S)
            assert arrived is not None and arrived.topic.name == "/words"
    assert len(notices) == len(set(notices)) <= sources.MOST_NOTICES
    for topic in ("/scan", "/bomb", "/loop", "/words"):
        assert any(f"messages of {topic} are left out" in text for text in notices)


def test_topics_that_appear_later_are_told_by_rosbridge() -> None:
    answers = iter(["/scan", "/odom"])

    def talk(connection: ServerConnection) -> None:
        for frame in connection:
            if json.loads(frame).get("op") == "call_service":
                name = next(answers, "/imu")
                values = {"topics": [name], "types": ["sensor_msgs/LaserScan"]}
                told = {"op": "service_response", "id": "topics", "values": values, "result": True}
                connection.send(json.dumps(told))

    with scripted(talk) as address, open_source(address, print) as source:
        wait_for(lambda: [one.name for one in source.topics()] == ["/imu"])


@pytest.mark.fault
def test_a_server_that_reads_nothing_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "UNREAD_S", 1)
    notices, ended = list[str](), threading.Event()

    def talk(connection: ServerConnection) -> None:
        values: dict[str, list[str]] = {"topics": [], "types": []}
        told = {"op": "service_response", "id": "topics", "values": values, "result": True}
        connection.send(json.dumps(told))
        ended.wait()
        connection.socket.shutdown(socket.SHUT_RDWR)

    with scripted(talk) as address, open_source(address, notices.append) as source:
        text = cdr_of("std_msgs/msg/String", {"data": 4_000_000 * "a"}, 0)
        for _ in range(100):  # the queues of both sides are full long before
            source.publish("/text", "std_msgs/msg/String", text)
            if any("is tried again" in text for text in notices):
                break
        wait_for(lambda: any("is tried again" in text for text in notices))
        ended.set()


def test_the_end_does_not_wait_for_a_server_that_does_not_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The connection breaks, and the next one is being opened when the block ends."""
    monkeypatch.setattr(sources, "PATIENCE_S", 1000.0)
    notices: list[str] = []
    server = RosbridgeServer(hub(), NotedControls(), Access(), port=0)
    with server:
        source = open_source(server.address, notices.append)
        source.__enter__()
    with socket.create_server(("127.0.0.1", server.port), reuse_port=False) as silent:
        accepted, _ = silent.accept()
        with accepted:
            source.__exit__(None, None, None)
            assert source._thread.is_alive(), "it still waits for an answer"
    assert any("is tried again" in text for text in notices)


@pytest.mark.fault
@pytest.mark.parametrize("protocol", ["", "foxglove.sdk.v1"])
def test_frames_of_a_hostile_server_do_no_harm(protocol: str) -> None:
    frames: list[str | bytes] = [
        *("", "{", "[]", "null", '{"op":[1]}', '{"op":"png","data":3}', '{"op":"fragment"}'),
        *(b"", b"\x01", b"\x01" + bytes(12), b"\xff" * 99, b"\xa1\x62op\xd8\x56\x48" + bytes(8)),
        *('{"op":"advertise"}', '{"op":"advertise","channels":[3]}', '{"op":"publish"}'),
        '{"op":"advertise","channels":[{"id":[],"topic":1,"encoding":"cdr"}]}',
        '{"op":"unadvertise","channelIds":[[],"x",7]}',
        '{"op":"service_response","id":"topics","result":true,"values":{"topics":[1],"types":2}}',
        '{"op":"status","level":"error","msg":[]}',
        '{"op":"status","level":2,"message":{}}',
    ]

    def talk(connection: ServerConnection) -> None:
        if protocol:
            connection.send(json.dumps({"op": "serverInfo", "capabilities": 3}))
            connection.send(json.dumps({"op": "advertise", "channels": []}))
        else:
            values = {"topics": ["/a", "/b"], "types": ["x/Y", "std_msgs/String"]}
            answer = {"op": "service_response", "id": "topics", "values": values}
            connection.send(json.dumps(answer))
        for frame in frames:
            connection.send(frame)
        connection.send(json.dumps({"op": "status", "level": END[protocol], "msg": "end"} | LAST))
        for _ in connection:
            pass

    notices: list[str] = []
    names = [protocol] if protocol else []
    with scripted(talk, *names) as url, open_source(url, notices.append) as source:
        source.subscribe(["/a", "/b", "/none"])
        wait_for(lambda: any("'end'" in text for text in notices))
        assert source.receive(0.0) is None


LEAVES = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6)
    | st.binary(max_size=30)
    | st.sampled_from(["/a", "topics", "std_msgs/String", "cdr", "ros1", "error"])
    | st.just(5000).map(lambda digits: 10**digits)
)  # fmt: skip
NAMES = st.sampled_from(
    [
        *("op", "topic", "msg", "id", "values", "result", "topics", "types", "level", "num"),
        *("total", "data", "channels", "encoding", "schemaName", "schema", "schemaEncoding"),
        *("capabilities", "supportedEncodings", "channelIds", "message"),
    ]
)
ANYTHING = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=8),
    max_leaves=15,
)
SERVER_OPERATIONS = st.sampled_from(
    [
        *("publish", "service_response", "status", "fragment", "png", "serverInfo", "advertise"),
        *("unadvertise",),
    ]
)


@pytest.mark.long
@pytest.mark.fault
@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from([RosbridgeSource, FoxgloveSource]),
    st.lists(
        st.tuples(SERVER_OPERATIONS, st.dictionaries(NAMES, ANYTHING, max_size=8))
        | st.binary(max_size=40)
        | st.binary(max_size=20).map(lambda data: struct.pack("<BIQ", 1, 0, 9) + data),
        max_size=6,
    ),
)
def test_whatever_a_server_sends_is_used_or_left_out(
    kind: type[LiveSource], sent: list[Any]
) -> None:
    source = kind("ws://x", lambda text: None)
    connection: Any = SimpleNamespace(send=lambda *frame, **how: None)
    source._greet(connection)
    source.subscribe(["/a"])
    for one in sent:
        frame = one
        if isinstance(one, tuple):
            op, about = one
            try:
                frame = cbor2.dumps({**about, "op": op})
                frame = json.dumps({**about, "op": op})
            except (ValueError, TypeError):
                pass  # what JSON cannot hold goes as CBOR, what neither can as nothing
        if isinstance(frame, str | bytes):
            with suppress(WrongMessage):
                source._heard(connection, frame)


END: dict[str, Any] = {"": "error", "foxglove.sdk.v1": 2}
LAST = {"message": "end"}


def test_what_is_not_taken_in_time_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "LARGEST_INBOX", 3 * len(scan(0)))
    inbox = sources.Inbox()
    for number in range(10):
        inbox.put(Message(SCAN, number, scan(number)))
    assert inbox.dropped == 7
    taken = [inbox.take(0.0) for _ in range(4)]
    assert [one.log_ns for one in taken if one is not None] == [7, 8, 9]


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("http://127.0.0.1:9090", "an address such as ws://"),
        ("127.0.0.1:9090", "an address such as ws://"),
        ("ws://", "an address such as ws://"),
        ("ws://[::1", "an address such as ws://"),
        ("ws://127.0.0.1:99999", "an address such as ws://"),
        ("ws://127.0.0.1:9", "nothing answers there"),
    ],
)
def test_an_address_without_a_server_is_refused(url: str, reason: str) -> None:
    with pytest.raises(InputRefused, match=reason):
        open_source(url, print)


def test_a_server_without_rosapi_is_refused() -> None:
    def talk(connection: ServerConnection) -> None:
        asked = json.loads(connection.recv())
        answer = {"op": "service_response", "id": asked["id"], "result": False}
        connection.send(json.dumps(answer | {"values": "Service /rosapi/topics does not exist"}))
        for _ in connection:
            pass

    with scripted(talk) as url, pytest.raises(InputRefused, match="does not answer /rosapi/topics"):
        open_source(url, print).__enter__()
