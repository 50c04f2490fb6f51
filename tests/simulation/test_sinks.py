"""Sinks: the messages of a simulation over a WebSocket, as a viewer gets them."""

from __future__ import annotations

import errno
import json
import socket
import struct
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from log_data import drive, header, readings
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from waiting import wait_for
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from slamsim.guard.errors import OutputRefused
from slamsim.io.open import read_log
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.sinks.foxglove import FoxgloveEntry

MESSAGE_DATA = 0x01


class Viewer(Thread):
    """Subscribes to some topics and keeps what it gets, by topic, with log times."""

    def __init__(self, port: int, topics: set[str]) -> None:
        super().__init__(daemon=True)
        self.messages: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in topics}
        self.schemas: dict[str, str] = {}
        self._address = f"ws://127.0.0.1:{port}"

    def run(self) -> None:
        kinds = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
        with connect(self._address, subprotocols=kinds, max_size=None) as connected:
            topics: list[str] = []
            for told in connected:
                if isinstance(told, str):
                    self._advertised(connected, json.loads(told), topics)
                elif told[0] == MESSAGE_DATA:
                    number, log_ns = struct.unpack_from("<IQ", told, 1)
                    self.messages[topics[number]].append((log_ns, told[13:]))

    def _advertised(
        self, connected: ClientConnection, told: dict[str, Any], topics: list[str]
    ) -> None:
        if told["op"] != "advertise":
            return
        wanted = []
        for channel in told["channels"]:
            self.schemas[channel["topic"]] = channel["schemaName"]
            if channel["topic"] in self.messages:
                wanted.append({"id": len(topics), "channelId": channel["id"]})
                topics.append(channel["topic"])
        request = json.dumps({"op": "subscribe", "subscriptions": wanted})
        connected.send(request)


def test_a_viewer_gets_the_bytes_of_the_recording(tmp_path: Path) -> None:
    entry = FoxgloveEntry(type="foxglove", port=0, rate=None, wait_s=30.0)
    with LogWriter(tmp_path / "log", header(), sinks=[entry]) as log:
        viewer = Viewer(log._sinks[1].port, {"/scan", "/odom", "/tf_static"})  # type: ignore[attr-defined]
        viewer.start()
        for start_s in (0, 1, 2):
            log.write(readings(start_s, start_s + 1.0), drive(start_s, start_s + 1.0))
    viewer.join(timeout=60.0)

    assert not viewer.is_alive()
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, sent = viewer.schemas["/scan"], viewer.messages["/scan"]
    scans: list[Any] = [store.deserialize_cdr(data, kind) for _, data in sent]
    recorded = list(read_log(tmp_path / "log").scans)
    assert [scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec for scan in scans] == [
        scan.stamp_ns for scan in recorded
    ]
    assert scans[-1].ranges.tobytes() == recorded[-1].ranges_m.tobytes()
    with AnyReader([tmp_path / "log"]) as reader:
        odometry = [each for each in reader.connections if each.topic == "/odom"]
        written = [(log_ns, bytes(data)) for _, log_ns, data in reader.messages(odometry)]
    assert viewer.messages["/odom"] == written
    assert len(viewer.messages["/tf_static"]) >= 1


def test_a_port_that_is_taken_is_told(tmp_path: Path) -> None:
    entry = FoxgloveEntry(type="foxglove", port=0, rate=None)
    with LogWriter(tmp_path / "log", header(), sinks=[entry]) as log:
        log.write(readings(0, 1.0), drive(0, 1.0))
        port = log._sinks[1].port  # type: ignore[attr-defined]
        taken = FoxgloveEntry(type="foxglove", port=port)
        with pytest.raises(OutputRefused, match=f"nothing can be served at 127.0.0.1:{port}"):
            LogWriter(tmp_path / "again", header(), sinks=[taken])


def test_sinks_that_were_begun_end_where_a_later_one_cannot_begin(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other, socket.create_server(("", 0)) as free:
        taken, port = other.getsockname()[1], free.getsockname()[1]
        free.close()
        entries = [FoxgloveEntry(type="foxglove", port=each) for each in (port, taken)]
        with pytest.raises(OutputRefused, match=str(taken)):
            LogWriter(tmp_path / "log", header(), sinks=entries)

    def is_refused() -> bool:  # the server's thread closes the socket after stop() has returned
        with socket.socket() as client:
            return client.connect_ex(("127.0.0.1", port)) == errno.ECONNREFUSED

    wait_for(is_refused)
