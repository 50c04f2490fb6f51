"""Delivers the messages of a live robot, each when it is due."""

from __future__ import annotations

import heapq
import math
import time

import numpy as np

from slamsim.live.hub import Hub
from slamsim.live.pace import Pace
from slamsim.live.robot import Window


class Delivery:
    """Messages on their way to a hub, in the order of their arrival."""

    def __init__(self, hub: Hub, pace: Pace) -> None:
        self._hub, self._pace = hub, pace
        self._pending: list[tuple[int, int, str, bytes]] = []
        self._sequence = 0

    def add(self, window: Window) -> None:
        """The messages of one more window."""
        for stream in window.messages:
            if not stream.log_ns.size:
                continue
            rows = stream.rows(slice(None))
            data = rows.view(np.uint8).reshape(rows.size, -1)
            for log_ns, row in zip(stream.log_ns.tolist(), data, strict=True):
                self.post(stream.topic, log_ns, row.tobytes())

    def post(self, topic: str, log_ns: int, data: bytes) -> None:
        """One more message."""
        self._sequence += 1
        heapq.heappush(self._pending, (log_ns, self._sequence, topic, data))

    def wait(self, until_s: float) -> None:
        """Publish what becomes due until a moment (``time.monotonic``)."""
        while True:
            now_s = time.monotonic()
            while self._next_s <= now_s:
                self._publish_next()
            if until_s <= now_s:
                return
            time.sleep(max(min(self._next_s, until_s) - now_s, 0.0))

    def up_to(self, until_ns: int) -> None:
        """Publish all that has arrived by then, due or not."""
        while self._pending and self._pending[0][0] <= until_ns:
            self._publish_next()

    def clear(self) -> None:
        """Forget what was not delivered."""
        self._pending.clear()

    @property
    def _next_s(self) -> float:
        return self._pace.due_s(self._pending[0][0]) if self._pending else math.inf

    def _publish_next(self) -> None:
        log_ns, _, topic, data = heapq.heappop(self._pending)
        self._hub.publish(topic, log_ns, data)
