"""A client of the Foxglove WebSocket protocol, written from its specification."""

from __future__ import annotations

import json
import struct
from typing import Any, Self

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

MESSAGE, TIME, SERVICE_RESPONSE = 0x01, 0x02, 0x03
PATIENCE_S = 60.0

Told = tuple[str, Any]
"""What a frame from the server is, and what it holds."""


class FoxgloveClient:
    """One connection; a context manager. channels, services: as they were advertised, by name."""

    def __init__(self, address: str, **options: Any) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self._topics: dict[int, str] = {}
        kinds = [Subprotocol("foxglove.sdk.v1")]
        self._connecting = connect(address, subprotocols=kinds, max_size=None, **options)

    def __enter__(self) -> Self:
        self.socket: ClientConnection = self._connecting.__enter__()
        self.server = self.until("serverInfo")
        return self

    def __exit__(self, *error: Any) -> None:
        self._connecting.__exit__(*error)

    def say(self, op: str, **fields: Any) -> None:
        self.socket.send(json.dumps({"op": op, **fields}))

    def subscribe(self, *topics: str) -> None:
        wanted = []
        for topic in topics:
            while topic not in self.channels:
                self.next()
            number = len(self._topics)
            self._topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.say("subscribe", subscriptions=wanted)

    def advertise(self, number: int, topic: str, kind: str, encoding: str) -> None:
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": kind}
        self.say("advertise", channels=[channel])

    def publish(self, number: int, data: bytes) -> None:
        self.socket.send(struct.pack("<BI", MESSAGE, number) + data)

    def call(self, name: str, payload: bytes, encoding: str = "cdr") -> bytes:
        """The response of a service."""
        while name not in self.services:
            self.next()
        number = self.services[name]["id"]
        head = struct.pack("<BIII", 0x02, number, 7, len(encoding))
        self.socket.send(head + encoding.encode() + payload)
        return bytes(self.until("service"))

    def next(self, timeout_s: float = PATIENCE_S) -> Told:
        """The next frame. Raises TimeoutError."""
        frame = self.socket.recv(timeout=timeout_s)
        if isinstance(frame, str):
            told = json.loads(frame)
            self.channels.update({each["topic"]: each for each in told.get("channels", [])})
            self.services.update({each["name"]: each for each in told.get("services", [])})
            return str(told["op"]), told
        if frame[0] == MESSAGE:
            number, log_ns = struct.unpack_from("<IQ", frame, 1)
            return self._topics[number], (log_ns, frame[13:])
        if frame[0] == TIME:
            return "time", struct.unpack_from("<Q", frame, 1)[0]
        assert frame[0] == SERVICE_RESPONSE
        length = struct.unpack_from("<I", frame, 9)[0]
        return "service", frame[13 + length :]

    def until(self, what: str) -> Any:
        """What the next frame of a kind, or of a topic, holds."""
        while True:
            kind, told = self.next()
            if kind == what:
                return told

    def rest(self, timeout_s: float = 0.5) -> list[Told]:
        """All frames until none comes for some time."""
        found = []
        while True:
            try:
                found.append(self.next(timeout_s))
            except TimeoutError:
                return found
