"""Messages over a WebSocket while they are simulated, for Foxglove, Lichtblick and their like.

The protocol is foxglove.websocket, served by ``foxglove-sdk``; messages are the bytes of the
recording (CDR), described by their ROS 2 definitions.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from threading import Event
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from slamsim.config.streams import SinkEntry
from slamsim.guard.errors import OutputRefused
from slamsim.io.staged_writer import StagedWriter
from slamsim.simulation.foxglove_channels import FoxgloveChannels, Listener

if TYPE_CHECKING:
    from slamsim.io.bag2.writer import TopicKind
    from slamsim.io.ros.encoding import Outgoing


LINGER_S = 1.0
"""The server drops what it has not sent when it is stopped, and has no call that waits for that."""


class FoxgloveEntry(SinkEntry):
    """A WebSocket server of the Foxglove protocol."""

    type: Literal["foxglove"]
    """Kind of sink."""
    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 lets other machines connect."""
    port: int = Field(default=8765, ge=0, le=65535)
    """Port to listen at; 0 chooses a free one."""
    rate: float | None = Field(default=1.0, gt=0.0, le=1000.0)
    """Times real time at which messages are sent; null as fast as they are simulated."""
    wait_s: float = Field(default=0.0, ge=0.0, le=3600.0)
    """How long the start waits for the first viewer to subscribe."""

    def start(self, topics: Sequence[TopicKind]) -> FoxgloveSink:
        return FoxgloveSink(self, topics)


class FoxgloveSink(StagedWriter):
    """Serves from when it is made until its block ends.

    Viewers that come late get the last message of each latched topic. Raises OutputRefused where
    the address is taken.
    """

    def __init__(self, entry: FoxgloveEntry, topics: Sequence[TopicKind]) -> None:
        import foxglove

        super().__init__()
        self._entry = entry
        self._channels = FoxgloveChannels(topics)
        self._open.callback(self._channels.close)
        self._viewers = _Viewers(self._channels)
        try:
            self._server = foxglove.start_server(
                name="slamsim",
                host=entry.host,
                port=entry.port,
                server_listener=self._viewers,
                capabilities=[foxglove.Capability.Time],
                context=self._channels.context,
            )
        except (OSError, RuntimeError) as error:
            self._channels.close()
            place = f"{entry.host}:{entry.port}"
            raise OutputRefused(f"nothing can be served at {place}: {error}") from None
        self._open.callback(self._server.stop)
        self._held: list[tuple[int, str, bytes]] = []
        self._begin: tuple[float, int] | None = None

    @property
    def port(self) -> int:
        """At which it listens."""
        return int(self._server.port)

    def add(self, streams: Sequence[Outgoing]) -> None:
        """The next messages of some topics."""
        for stream in streams:
            rows = stream.rows(slice(None))
            data = rows.view(np.uint8).reshape(rows.size, -1)
            held = zip(stream.log_ns.tolist(), data, strict=True)
            self._held += [(log_ns, stream.topic, row.tobytes()) for log_ns, row in held]

    def release(self, until_ns: int | None) -> None:
        """Send what has arrived by then, each message when its time has come."""
        if self._begin is None:
            self._viewers.wait(self._entry.wait_s)
        self._held.sort(key=lambda message: message[0])
        count = len(self._held)
        if until_ns is not None:
            count = sum(log_ns <= until_ns for log_ns, _, _ in self._held)
        now, self._held = self._held[:count], self._held[count:]
        for log_ns, topic, data in now:
            self._pace(log_ns)
            self._channels.send(topic, log_ns, data)
        if now:
            self._server.broadcast_time(now[-1][0])

    def _finish(self) -> None:
        self.release(None)
        if self._viewers.came:
            time.sleep(LINGER_S)

    def _pace(self, log_ns: int) -> None:
        """Wait until a message is due."""
        if self._begin is None:
            self._begin = time.monotonic(), log_ns
        if self._entry.rate is None:
            return
        since_s, since_ns = self._begin
        due_s = since_s + (log_ns - since_ns) * 1e-9 / self._entry.rate
        time.sleep(max(due_s - time.monotonic(), 0.0))


class _Viewers(Listener):
    """Tells when the first viewer has come."""

    def __init__(self, channels: FoxgloveChannels) -> None:
        super().__init__(channels)
        self._any = Event()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        super().on_subscribe(client, channel)
        self._any.set()

    @property
    def came(self) -> bool:
        """Whether any viewer subscribed to anything."""
        return self._any.is_set()

    def wait(self, at_most_s: float) -> None:
        if at_most_s > 0.0 and self._any.wait(at_most_s):
            time.sleep(0.2)  # its other subscriptions follow at once
