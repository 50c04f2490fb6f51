"""The rosbridge server against clients that are broken, slow or hostile."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import cbor2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_data import grid, hub, scan
from rosbridge_robot import Robot, ask, call, serving, subscribe, told
from served_robot import NotedControls
from waiting import TIMEOUT_S, wait_for
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from slamsim.guard.errors import OutputRefused
from slamsim.io.ros.values import WrongMessage
from slamsim.live import rosbridge
from slamsim.live.requests import SUBSCRIBED
from slamsim.live.servers import front
from slamsim.live.servers.access import Access
from slamsim.live.servers.foxglove import FoxgloveServer
from slamsim.live.servers.rosbridge import client as clients
from slamsim.live.servers.rosbridge.client import Client
from slamsim.live.servers.rosbridge.operations import Operations
from slamsim.live.servers.rosbridge.server import RosbridgeServer
from slamsim.live.servers.rosbridge.topics import MOST_TOPICS, Topics

pytestmark = pytest.mark.fault

OPERATIONS = (
    *("advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service"),
    *("set_level", "fragment", "advertise_service", "unadvertise_service", "service_response"),
)
NAMES = st.sampled_from([*SUBSCRIBED, "/scan", "/map", "/chatter", "", "/" * 3000, "\ud800"])
TYPES = st.sampled_from(
    ["geometry_msgs/Twist", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid", "x", ""]
)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=3)
    | st.just(5000).map(lambda digits: 10**digits)
    | st.sampled_from([10**400, -1, 0, 1, 1e9, 1e308, 2**63])
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                [
                    "linear",
                    "angular",
                    "x",
                    "z",
                    "header",
                    "stamp",
                    "secs",
                    "pose",
                    "position",
                    "data",
                ]
            )
            | st.text(max_size=4),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)
ASKED = st.fixed_dictionaries(
    {"op": st.sampled_from(OPERATIONS) | VALUES},
    optional={
        "id": SCALARS | st.sampled_from(["f", "slamsim:0"]),
        "topic": NAMES | VALUES,
        "type": TYPES | VALUES,
        "msg": VALUES,
        "service": st.sampled_from(
            ["/slamsim/step", "/rosapi/topics", "/rosapi/topic_type", "#", "/mine"]
        )
        | VALUES,
        "args": VALUES,
        "compression": st.sampled_from(["none", "png", "cbor", "cbor-raw"]) | VALUES,
        "throttle_rate": VALUES,
        "queue_length": VALUES,
        "fragment_size": VALUES,
        "level": VALUES,
        "num": st.integers(-1, 3) | VALUES,
        "total": st.integers(-1, 3) | VALUES,
        "data": st.text(max_size=9) | VALUES,
    },
)


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.lists(ASKED | VALUES, max_size=6), st.booleans())
def test_whatever_is_asked_is_obeyed_or_told(asked: list[Any], as_cbor: bool) -> None:
    async def obey() -> None:
        messages, controls = hub(), NotedControls()
        messages.publish("/map", 1, grid(3))
        topics = Topics(messages)
        operations = Operations(topics, controls)
        client = Client(None)
        for one in asked:
            before = len(client._replies)
            operations.handle(client, frame(one))
            known = isinstance(one, dict) and one.get("op") in OPERATIONS
            assert known or len(client._replies) == before + 1 or client._level == 0
            messages.publish("/scan", 2, scan(1))
            topics.publish(messages.latched["/map"])
        await asyncio.gather(*operations._tasks)
        operations.leave(client)
        assert client.queued_bytes == 0 and client.calls == 0
        topics.close()
        operations.close()

    def frame(one: Any) -> str | bytes:
        return cbor2.dumps(one) if as_cbor else json.dumps(one)

    try:
        frames = [frame(one) for one in asked]
    except (ValueError, TypeError):  # CBOR cannot hold half a character, nor JSON bytes
        return
    assert frames is not None
    asyncio.run(obey())


@pytest.mark.parametrize(
    "frame",
    [
        *("", "{", "null", "[]", '"op"', "[" * 100_000, '{"op":' * 50_000, "9" * 5000, "\0"),
        *(b"", b"\xff\xfe", b"\x9f" * 100_000, b"\xd8\x40\x00", cbor2.dumps({"op": 3}), b"\xbf"),
        b"\xd8\x56\x43abc",  # three bytes of float64
        cbor2.dumps({"op": 10**5000}),
        cbor2.dumps({"op": "fly", "id": 10**5000}),
        cbor2.dumps({"op": cbor2.CBORTag(86, bytes(16))}),
        '{"op": ' + "[" * 900 + "]" * 900 + "}",
    ],
)
def test_what_is_no_operation_is_told(frame: str | bytes) -> None:
    with serving() as robot, robot.connect() as client:
        client.send(frame)
        assert told(client)["op"] == "status"
        call(client, "/rosapi/nodes")


def test_what_cannot_be_passed_on_is_told() -> None:
    """From one client to another that serves."""
    with serving() as robot, robot.connect() as server, robot.connect() as caller:
        ask(server, op="advertise_service", service="/mine", type="x/Y")
        call(server, "/rosapi/nodes")
        asked = {"op": "call_service", "service": "/mine", "id": "a"}
        caller.send(cbor2.dumps({**asked, "args": {"x": b"bytes", "y": 10**5000}}))
        answer = told(caller)
        assert answer["op"] == "status" and answer["id"] == "a", answer
        call(caller, "/rosapi/nodes")
        ask(caller, **asked, args={})
        assert told(server)["args"] == {}


def test_a_frame_that_is_too_large_ends_the_connection() -> None:
    with serving() as robot, robot.connect() as client, robot.connect() as another:
        with pytest.raises(ConnectionClosedError, match="1009"):
            client.send(" " * (rosbridge.LARGEST_MESSAGE + 1))
            client.recv(timeout=TIMEOUT_S)
        call(another, "/rosapi/nodes")


def test_half_fragments_are_limited() -> None:
    with serving() as robot, robot.connect() as client:
        for number in range(rosbridge.MOST_OPEN):
            ask(client, op="fragment", id=number, num=0, total=2, data="x")
        ask(client, op="fragment", id="more", num=0, total=2, data="x")
        assert "incomplete already" in told(client)["msg"]
    joined = rosbridge.Fragments(largest=10)
    part = {"id": 1, "num": 0, "total": 2, "data": "x" * 8}
    assert joined.add(part, 0.0) is None
    with pytest.raises(WrongMessage, match="more than 10 bytes"):
        joined.add({**part, "id": 2}, 0.0)
    assert joined.add({**part, "id": 2}, 61.0) is None, "what is old must have been forgotten"
    assert joined.add({**part, "id": 2, "num": 1, "data": "yz"}, 61.0) == "x" * 8 + "yz"


def test_subscriptions_are_limited() -> None:
    with serving() as robot, robot.connect() as client:
        for number in range(MOST_TOPICS + 1):
            ask(client, op="subscribe", topic=f"/t{number}", type="std_msgs/String")
        assert "256 topics at most" in told(client)["msg"]
        subscribe(client, "/t0", type="std_msgs/String", id="again")


def test_clients_that_vanish_leave_nothing_behind() -> None:
    with serving() as robot:
        for _ in range(20):
            with robot.connect() as client:
                subscribe(client, "/scan")
                ask(client, op="advertise", topic="/chatter", type="std_msgs/String")
                client.socket.shutdown(socket.SHUT_RDWR)
        with robot.connect() as client:
            subscribe(client, "/scan")
            robot.hub.publish("/scan", 1, scan(1))
            assert told(client)["topic"] == "/scan"
            wait_for(lambda: robot.server._topics.subscribers("/scan") == 1)
            assert "/chatter" not in call(client, "/rosapi/topics")["topics"]


@pytest.mark.parametrize(
    ("access", "headers", "query"),
    [
        (Access(), {"Origin": "https://elsewhere.example"}, ""),
        (Access(), {"Origin": "null"}, ""),
        (Access(token="secret"), {}, ""),
        (Access(token="secret"), {}, "?token=guess"),
        (Access(token="secret"), {"Authorization": "Bearer guess"}, ""),
        (Access(token="secret"), {"Authorization": "Basic secret"}, ""),
    ],
)
def test_who_may_not_connect_is_refused(
    access: Access, headers: dict[str, str], query: str
) -> None:
    with serving(access) as robot, pytest.raises(InvalidStatus) as caught:
        address = f"ws://127.0.0.1:{robot.server.port}/{query}"
        connect(address, additional_headers=headers, proxy=None)
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize("by_header", [False, True])
def test_the_token_lets_a_client_in(by_header: bool) -> None:
    with serving(Access(token="a secret/&")) as robot:
        address = robot.server.address
        headers = {"Origin": "http://localhost:8000"}
        if by_header:
            address = f"ws://127.0.0.1:{robot.server.port}"
            headers["Authorization"] = "Bearer a secret/&"
        with connect(address, additional_headers=headers, proxy=None) as client:
            call(client, "/rosapi/nodes")


def test_a_client_of_another_protocol_is_refused() -> None:
    foxglove = Subprotocol("foxglove.sdk.v1")
    with serving() as robot:
        with pytest.raises(InvalidStatus) as caught:
            robot.connect(subprotocols=[foxglove])
        assert caught.value.response.status_code == 400
        assert b"rosbridge" in (caught.value.response.body or b"")
        with robot.connect(subprotocols=[foxglove, Subprotocol("rosbridge_v2")]) as client:
            call(client, "/rosapi/nodes")


def test_half_requests_keep_no_other_client_out() -> None:
    """Neither clients of rosbridge nor those of Foxglove; the oldest are cut off at once."""
    live = FoxgloveServer(hub(), NotedControls(), Access(), 0)
    with live as viewers, serving() as robot, ExitStack() as opened:
        for port in (robot.server.port, int(viewers.address.rpartition(":")[2])):
            halves = []
            for _ in range(150):
                half = socket.create_connection(("127.0.0.1", port), TIMEOUT_S)
                half.sendall(b"GET / HTTP/1.1\r\nHo")
                halves.append(opened.enter_context(half))
            with suppress(ConnectionResetError):
                assert halves[0].recv(1) == b""
        with robot.connect() as client:
            call(client, "/rosapi/nodes")
        protocols = [Subprotocol("foxglove.sdk.v1")]
        with connect(viewers.address, subprotocols=protocols, proxy=None) as viewer:
            assert "serverInfo" in viewer.recv(timeout=TIMEOUT_S)


@pytest.mark.parametrize("value", [0, {}, [], "a,b"])
def test_messages_of_too_many_values_are_refused(value: object) -> None:
    """Some 40,000 poses would hold up all other clients for a second."""
    most = rosbridge.MOST_VALUES
    for dumps in (json.dumps, cbor2.dumps):
        sound = {"op": "fly", "msg": [value] * (most - 3)}
        assert rosbridge.request_of(dumps(sound)) == sound
        with pytest.raises(WrongMessage, match="more than 10,000 values"):
            rosbridge.request_of(dumps({"op": "fly", "msg": [value] * most}))
    with pytest.raises(WrongMessage, match="more than"):
        rosbridge.request_of(cbor2.dumps({"op": "fly", "msg": [{}] * 300_000}))
    with pytest.raises(WrongMessage, match="more than"):
        rosbridge.request_of(json.dumps([[]] * 300_000))
    text = {"op": "fly", "msg": "," * (5 * most)}
    assert rosbridge.request_of(json.dumps(text)) == text


def test_what_is_no_websocket_is_answered() -> None:
    with serving() as robot:
        for request in (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"\x16\x03\x01\x02\0" * 9):
            with socket.create_connection(("127.0.0.1", robot.server.port)) as client:
                client.sendall(request)
                client.shutdown(socket.SHUT_WR)
                client.settimeout(TIMEOUT_S)
                while client.recv(4096):
                    pass
        with robot.connect() as websocket:
            call(websocket, "/rosapi/nodes")


def test_a_second_server_on_a_port_names_the_first() -> None:
    with serving() as robot, pytest.raises(OutputRefused, match=f"process {os.getpid()} "):
        RosbridgeServer(hub(), NotedControls(), Access(), robot.server.port)


@pytest.mark.long
def test_a_slow_client_costs_no_more_than_its_queue_and_delays_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is published meanwhile is many times what may wait for it."""
    monkeypatch.setattr(clients, "LARGEST_QUEUE", 1 << 20)
    with serving() as robot, silent(robot) as slow, robot.connect() as quick:
        slow.sendall(masked({"op": "subscribe", "topic": "/scan"}))
        wait_for(lambda: robot.server._topics.subscribers("/scan") == 1)
        subscribe(quick, "/scan")
        most = 0
        for number in range(900):
            robot.hub.publish("/scan", number, scan(number, beams=2000))
            stamp = told(quick)["msg"]["header"]["stamp"]["nanosec"]
            assert stamp == number * 1_000_000, "a scan is missing, or out of order"
            most = max(most, *(one.queued_bytes for one in robot.server._clients))
        behind = max(robot.server._clients, key=lambda one: one.dropped)
        assert behind.dropped > 0
        assert 1 << 19 < most <= 1 << 20


def test_a_client_that_reads_nothing_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clients, "SILENCE_S", 0.2)
    monkeypatch.setattr(clients, "_PING_EVERY_S", 0.05)
    ended: list[str] = []
    end = Client.end

    async def heard(client: Client, reason: str) -> None:
        ended.append(reason)
        await end(client, reason)

    monkeypatch.setattr(Client, "end", heard)
    with serving() as robot, silent(robot):
        wait_for(lambda: bool(ended))
        wait_for(lambda: not robot.server._clients)
    assert ended == ["nothing was read for 0 s"]


def test_who_does_not_read_its_replies_is_not_listened_to() -> None:
    """So that what waits for it does not grow."""
    question = masked({"op": "call_service", "service": "/rosapi/topics_and_raw_types"})
    with serving() as robot, silent(robot) as client, robot.connect() as another:
        client.settimeout(1.0)
        with pytest.raises(TimeoutError):
            while True:
                client.sendall(question)
        call(another, "/rosapi/nodes")
        assert any(not one._room.is_set() for one in robot.server._clients)
        assert all(one._reply_bytes < 2 * clients.REPLIES for one in robot.server._clients)


@pytest.mark.long
def test_a_flood_of_pings_that_reads_no_pong_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front, "MOST_UNREAD", 1 << 20)
    pings = (b"\x89\xfd\0\0\0\0" + bytes(125)) * 1_000
    with serving() as robot, silent(robot, None) as client, robot.connect() as another:
        client.settimeout(TIMEOUT_S)
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            while True:
                client.sendall(pings)
        call(another, "/rosapi/nodes")


def test_a_server_with_a_client_that_does_not_read_stops() -> None:
    with ExitStack() as opened:
        with serving() as robot:
            client = opened.enter_context(silent(robot))
            client.sendall(masked({"op": "subscribe", "topic": "/map"}))
            robot.hub.publish("/map", 1, grid(2048))
            wait_for(lambda: any(one.queued_bytes for one in robot.server._clients))
        assert not robot.server._thread.is_alive()


@contextmanager
def silent(robot: Robot, buffer: int | None = 1 << 14) -> Iterator[socket.socket]:
    """A client that is connected, and reads nothing any more. buffer: bytes that its kernel reads
    nevertheless; None for as many as it likes."""
    with socket.socket() as client:
        if buffer is not None:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        client.connect(("127.0.0.1", robot.server.port))
        client.sendall(
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        wait_for(lambda: len(robot.server._clients) > 0)
        yield client


def masked(operation: Any) -> bytes:
    """A text frame of a client, its mask zero."""
    text = json.dumps(operation).encode()
    assert len(text) < 126
    return bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text
