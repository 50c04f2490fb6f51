"""The page's server, as programs see it: what it sends, what it takes, whom it lets in."""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import socket
import struct
import threading
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from fake_robot import CELL_M, FakeRobot, cdr, grid_message
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from slamsim.guard.errors import OutputRefused
from slamsim.live.servers.access import Access
from slamsim.live.servers.page import PageServer

TOKEN = "right-token_0123456789"


@pytest.fixture
def robot(tmp_path: Path) -> FakeRobot:
    return FakeRobot(tmp_path)


@pytest.fixture
def server(robot: FakeRobot) -> Iterator[PageServer]:
    with PageServer(robot.hub, robot, Access(), 0) as server:
        yield server


@pytest.fixture
def guarded(robot: FakeRobot) -> Iterator[PageServer]:
    with PageServer(robot.hub, robot, Access("127.0.0.1", TOKEN), 0) as server:
        yield server


def port_of(server: PageServer) -> int:
    port = urlsplit(server.address).port
    assert port is not None
    return port


def opened(server: PageServer, **options: Any) -> ClientConnection:
    address = f"ws://127.0.0.1:{port_of(server)}/live"
    connection: ClientConnection = connect(address, max_size=None, **options)
    return connection


def fetched(server: PageServer, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=60)
    with contextlib.closing(connection):
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


def until(socket: ClientConnection, wanted: Callable[[Any], Any]) -> Any:
    """The first message that is wanted: a dict, with ``body`` of a binary one."""
    while True:
        message = parsed(socket.recv(timeout=60))
        if wanted(message):
            return message


def parsed(message: str | bytes) -> dict[str, Any]:
    if isinstance(message, str):
        found: dict[str, Any] = json.loads(message)
        return found
    (size,) = struct.unpack_from("<I", message)
    return {**json.loads(message[4 : 4 + size]), "body": message[4 + size :]}


def of_type(kind: str) -> Callable[[Any], bool]:
    return lambda message: bool(message["type"] == kind)


def test_a_page_gets_state_scan_path_and_map(server: PageServer, robot: FakeRobot) -> None:
    with opened(server) as page:
        until(page, of_type("state"))
    for _ in range(20):
        robot.advance(0.05)
    robot.draw()
    found: dict[str, Any] = {}
    with opened(server) as page:
        while not {"state", "scan", "path", "map"} <= found.keys() or not found["state"]["pose"]:
            message = parsed(page.recv(timeout=60))
            found[message["type"]] = message
    state, scan, path, grid = (found[kind] for kind in ("state", "scan", "path", "map"))
    cells = np.frombuffer(zlib.decompress(grid["body"]), np.uint8)
    known = robot.known[robot.known >= 0]
    np.testing.assert_array_equal(np.sort(cells[cells != 255]), np.sort(known))
    assert grid["resolution_m"] == pytest.approx(CELL_M)
    np.testing.assert_allclose(np.frombuffer(path["body"], "<f4")[:2], [1.8, 4.5], atol=1e-6)
    frame, pose = state["pose"]
    assert frame == "map" and pose == pytest.approx(robot.pose.tolist(), abs=1e-4)
    assert state["time_s"] == pytest.approx(1.0) and state["clients"] >= 1
    points_m = np.frombuffer(scan["body"], "<i2").reshape(-1, 2) * scan["step_m"]
    points_m += np.array([scan["x_m"], scan["y_m"]])
    cells_hit = points_m / CELL_M
    rows, columns = cells_hit[:, 1].astype(int), cells_hit[:, 0].astype(int)
    around = np.pad(robot.known, 2)
    near = [around[r : r + 5, c : c + 5].max() for r, c in zip(rows, columns, strict=True)]
    assert len(near) > 300 and min(near) == 100, "each point lies on a wall of the map"


def test_a_robot_that_says_nothing_is_no_lost_connection(server: PageServer) -> None:
    """A page connects anew when it hears nothing for five seconds."""
    with opened(server) as page:
        for _ in range(3):
            until(page, of_type("state"))


def test_requests_reach_the_controls(server: PageServer, robot: FakeRobot) -> None:
    asked: list[tuple[dict[str, Any], tuple[str, tuple[Any, ...]]]] = [
        ({"op": "drive", "speed_m_s": 0.25, "yaw_rate_rad_s": -1}, ("drive", (0.25, -1.0, 0.25))),
        ({"op": "go_to", "x_m": 2.5, "y_m": 4.5}, ("go_to", (2.5, 4.5, None))),
        ({"op": "mode", "mode": "explore"}, ("set_mode", ("explore",))),
        ({"op": "pause", "paused": True}, ("pause", (True,))),
        ({"op": "step", "seconds": 0.1}, ("step", (0.1,))),
        ({"op": "rate", "rate": None}, ("set_rate", (None,))),
        ({"op": "save_map"}, ("save_map", ())),
        ({"op": "reset"}, ("reset", ())),
    ]
    with opened(server) as page:
        for request, call in asked:
            page.send(json.dumps(request))
            if request["op"] != "drive":
                until(page, of_type("done"))
            else:
                wait_for(lambda: robot.calls)
            assert robot.calls[-1] == call


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        ("nothing", "Invalid JSON"),
        ("{", "Invalid JSON"),
        ("[]", "an object"),
        ("{}", "op"),
        ('{"op": "fly"}', "'fly'"),
        ('{"op": "drive", "speed_m_s": 1}', "yaw_rate_rad_s"),
        ('{"op": "drive", "speed_m_s": "1", "yaw_rate_rad_s": 0}', "speed_m_s"),
        ('{"op": "drive", "speed_m_s": NaN, "yaw_rate_rad_s": 0}', "not finite"),
        ('{"op": "drive", "speed_m_s": 0, "yaw_rate_rad_s": 1e999}', "not finite"),
        ('{"op": "step", "seconds": 61}', "60"),
        ('{"op": "rate", "rate": 1e9}', "100"),
        ('{"op": "mode", "mode": "sleep"}', "'sleep'"),
        ('{"op": "go_to", "x_m": 1e9, "y_m": 0}', "no known free path"),
        ('{"op": "reset", "why": 1}', "why"),
        ("[" * 1000, "Invalid JSON"),
    ],
)
def test_what_cannot_be_done_is_told_and_the_connection_stays(
    sent: str, told: str, server: PageServer
) -> None:
    with opened(server) as page:
        page.send(sent)
        assert told in until(page, of_type("error"))["text"]
        page.send(json.dumps({"op": "pause", "paused": False}))
        until(page, of_type("done"))


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)
REQUESTS = st.dictionaries(
    st.sampled_from(["op", "speed_m_s", "yaw_rate_rad_s", "x_m", "mode", "on", "rate", "seconds"]),
    st.sampled_from(["drive", "go_to", "mode", "rate", "step", "tour"]) | JSON_VALUES,
)


def test_no_message_ends_the_connection(server: PageServer, robot: FakeRobot) -> None:
    with opened(server) as page:

        @settings(max_examples=150, deadline=None)
        @given(st.one_of(JSON_VALUES, REQUESTS).map(json.dumps) | st.text() | st.binary())
        def no_matter_what(sent: str | bytes) -> None:
            page.send(sent)

        no_matter_what()
        page.send(json.dumps({"op": "save_map"}))
        until(page, lambda message: "Map saved" in message.get("text", ""))
    for name, given_ in robot.calls:
        if name == "drive":
            assert np.isfinite(given_).all()


def test_a_message_that_is_too_long_ends_the_connection_alone(server: PageServer) -> None:
    with opened(server) as other, opened(server) as page:
        page.send("x" * (1 << 16) + "x")
        with pytest.raises(ConnectionClosed) as ended:
            until(page, lambda message: False)
        assert ended.value.rcvd is not None and ended.value.rcvd.code == 1009
        until(other, of_type("state"))


def test_the_page_is_whole_and_nothing_else_is_served(server: PageServer) -> None:
    status, headers, body = fetched(server, "/")
    assert status == 200 and headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    text = body.decode()
    assert "hear_binary" in text and "--accent" in text
    assert (
        "http://" not in text.replace("http://www.w3.org/2000/svg", "") and "https://" not in text
    )


@pytest.mark.parametrize(
    "path",
    [
        "/page.js", "/index.html", "/..", "/../page.py", "/%2e%2e/%2e%2e/etc/passwd",
        "/recording/", "/recording/..", "/recording/../../../etc/passwd", "/recording/%2e%2e",
        "/recording/recording_1", "/recording//etc/passwd", "//etc/passwd",
        "http://127.0.0.1/etc/passwd", "*",
        "/live",
    ],
)  # fmt: skip
def test_no_address_names_a_file(path: str, server: PageServer, robot: FakeRobot) -> None:
    robot.record(True), robot.record(False)
    status, _, body = fetched(server, path)
    assert status == 404 and b"root:" not in body and b"import" not in body


def recorded(server: PageServer, robot: FakeRobot) -> dict[str, str]:
    with opened(server) as page:
        page.send(json.dumps({"op": "record", "on": True}))
        until(page, of_type("done"))
        page.send(json.dumps({"op": "record", "on": False}))
        finished: list[dict[str, str]] = until(page, lambda m: m.get("recordings"))["recordings"]
        return finished[0]


def test_a_finished_recording_can_be_downloaded(
    server: PageServer, robot: FakeRobot, tmp_path: Path
) -> None:
    found = recorded(server, robot)
    folder = tmp_path / found["name"]
    (folder / "secret").symlink_to("/etc/passwd")
    (folder / "all").symlink_to("/etc")
    status, headers, body = fetched(server, f"/recording/{found['id']}")
    assert status == 200 and f'filename="{found["name"]}.zip"' in headers["Content-Disposition"]
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        assert archive.testzip() is None
        data = {name: archive.read(name) for name in archive.namelist()}
    assert data == {
        f"{folder.name}/{name}": (folder / name).read_bytes()
        for name in ("drive.yaml", "log/log_0.mcap")
    }


def test_what_is_still_written_is_not_offered(server: PageServer, robot: FakeRobot) -> None:
    with opened(server) as page:
        page.send(json.dumps({"op": "record", "on": True}))
        state = until(page, lambda message: message.get("recording"))
        assert state["recording"] == "recording_1" and state["recordings"] == []


def test_a_download_that_is_given_up_holds_up_nobody(
    server: PageServer, robot: FakeRobot, tmp_path: Path
) -> None:
    found = recorded(server, robot)
    with (tmp_path / found["name"] / "large").open("wb") as large:
        large.truncate(1 << 28)
    with socket.create_connection(("127.0.0.1", port_of(server))) as stuck:
        stuck.sendall(f"GET /recording/{found['id']} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert stuck.recv(15) == b"HTTP/1.1 200 OK"
        with opened(server) as page:
            until(page, of_type("state"))
    with opened(server) as page:
        until(page, of_type("state"))


def refused(server: PageServer, **options: Any) -> int:
    with pytest.raises(InvalidStatus) as error, opened(server, **options):
        pass
    return error.value.response.status_code


def test_pages_and_names_from_elsewhere_are_refused(server: PageServer) -> None:
    assert refused(server, origin="http://evil.example") == 403
    assert refused(server, additional_headers={"Host": "evil.example"}) == 403
    assert fetched(server, "/", Host="evil.example")[0] == 403
    assert fetched(server, "/", Origin="http://evil.example")[0] == 403
    assert fetched(server, "/", Host=f"localhost:{port_of(server)}")[0] == 200
    with opened(server, origin=f"http://127.0.0.1:{port_of(server)}") as page:
        until(page, of_type("state"))


def test_a_token_is_asked_for_everywhere(guarded: PageServer, robot: FakeRobot) -> None:
    assert refused(guarded) == refused(guarded, additional_headers={"Cookie": "a=b;;=;"}) == 401
    assert refused(guarded, additional_headers={"Authorization": "Bearer wrong"}) == 401
    for path in ("/", "/?token=wrong", "/?token=", "/recording/x", "/nothing"):
        status, headers, body = fetched(guarded, path)
        assert status == 401 and b'name="token"' in body and b"hear_binary" not in body
        assert TOKEN not in str(headers)
    status, headers, _ = fetched(guarded, f"/?token={TOKEN}")
    assert status == 303 and headers["Location"] == "/"
    kept = headers["Set-Cookie"]
    assert "HttpOnly" in kept and "SameSite" in kept
    cookie = {"Cookie": f"other=1; {kept.partition(';')[0]}"}
    assert fetched(guarded, "/", **cookie)[0] == 200
    for headers in (cookie, {"Authorization": f"Bearer {TOKEN}"}):
        with opened(guarded, additional_headers=headers) as page:
            until(page, of_type("state"))
    assert guarded.address.endswith(f"/?token={TOKEN}")


def test_the_address_is_one_that_others_can_open(robot: FakeRobot) -> None:
    assert Access("::1", "x").url_host == "[::1]"
    with PageServer(robot.hub, robot, Access("0.0.0.0", TOKEN), 0) as server:
        assert server.address.endswith(f":{port_of(server)}/?token={TOKEN}")
        assert "0.0.0.0" not in server.address
        assert fetched(server, f"/?token={TOKEN}", Host="robot.local:8000")[0] == 303


def test_two_pages_see_the_same_and_the_last_twist_wins(
    server: PageServer, robot: FakeRobot
) -> None:
    with opened(server) as one, opened(server) as other:
        one.send(json.dumps({"op": "drive", "speed_m_s": 0.1, "yaw_rate_rad_s": 0}))
        wait_for(lambda: len(robot.calls) == 1)
        other.send(json.dumps({"op": "drive", "speed_m_s": 0.2, "yaw_rate_rad_s": 0}))
        for page in (one, other):
            state = until(page, lambda message: message.get("speed_m_s") == 0.2)
            assert state["clients"] == 2


NOISE = np.random.default_rng(1).integers(0, 101, (2500, 2500))


def busy(robot: FakeRobot) -> None:
    """A map that does not compress, larger than what the sockets between hold."""
    robot.hub.publish("/map", robot.stamp_ns, cdr(grid_message(robot.stamp_ns, NOISE, 0.0, 0.0)))


@contextlib.contextmanager
def reads_nothing(server: PageServer) -> Iterator[None]:
    """A page that is connected and takes nothing of what it is sent."""
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", port_of(server)))
        slow.sendall(
            b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        yield


def test_a_page_that_reads_nothing_is_dropped_and_delays_no_other(robot: FakeRobot) -> None:
    with (
        PageServer(robot.hub, robot, Access(), 0, drop_s=1.0) as server,
        opened(server) as page,
        reads_nothing(server),
    ):
        until(page, lambda message: message.get("clients") == 2)
        busy(robot)
        until(page, of_type("map"))
        until(page, lambda message: message.get("clients") == 1)


def test_it_ends_with_a_page_that_reads_nothing(robot: FakeRobot) -> None:
    server = PageServer(robot.hub, robot, Access(), 0)
    with reads_nothing(server), opened(server) as page:
        until(page, lambda message: message.get("clients") == 2)
        busy(robot)
        until(page, of_type("map"))
        with server:
            pass
    assert not any(thread.name == "page" for thread in threading.enumerate())


def test_a_port_that_is_taken_is_told(server: PageServer, robot: FakeRobot) -> None:
    with pytest.raises(OutputRefused, match=f"port {port_of(server)} of 127.0.0.1 is already in"):
        PageServer(robot.hub, robot, Access(), port_of(server))
    with pytest.raises(OutputRefused, match=r"nothing can be served at 192\.0\.2\.1:0"):
        PageServer(robot.hub, robot, Access("192.0.2.1", "token"), 0)


def test_a_message_that_cannot_be_read_is_left_out(server: PageServer, robot: FakeRobot) -> None:
    with opened(server) as page:
        robot.hub.publish("/scan", 0, b"\0\1\0\0nonsense")
        robot.hub.publish("/map", 0, b"")
        robot.hub.publish("/tf", 0, b"\0\1\0\0\xff\xff\xff\xff")
        robot.advance(0.05)
        until(page, of_type("scan"))
