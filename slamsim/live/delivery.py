"""Simulated time in step with the clock on the wall; each message is delivered when it is due."""

from __future__ import annotations

import heapq
import math
import time
from collections import deque

import numpy as np

from slamsim.live.hub import Hub
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


SLIP_S = 1.0
"""Time by which the simulation may be behind before it gives up catching up: a machine that was
suspended would else race through the hours that it missed."""
_FACTOR_OVER_S = 5.0
"""Over so much the pace that is shown is averaged."""


class Pace:
    """From simulated time to the moment (``time.monotonic``) at which it is due.

    rate: times real time, None for as fast as possible. While paused nothing is due.
    """

    def __init__(self, rate: float | None, stamp_ns: int) -> None:
        self._rate, self._paused = rate, False
        self._begun_s, self._begun_ns = time.monotonic(), stamp_ns
        self._passed: deque[tuple[float, int]] = deque([(self._begun_s, stamp_ns)])
        self.windows = self.late = 0
        self.slipped_s = 0.0
        """Real time that was given up because the simulation could not catch up."""
        self.behind_s = 0.0
        """Real time by which the last window was later than it was due."""

    @property
    def rate(self) -> float | None:
        return self._rate

    @property
    def paused(self) -> bool:
        return self._paused

    def due_s(self, stamp_ns: int) -> float:
        """When an instant is due: ``inf`` while paused, ``-inf`` at no rate."""
        if self._paused:
            return math.inf
        if self._rate is None:
            return -math.inf
        return self._begun_s + (stamp_ns - self._begun_ns) * 1e-9 / self._rate

    def set(self, stamp_ns: int, *, rate: float | None, paused: bool) -> None:
        """Go on from this instant, now, at this rate."""
        self._rate, self._paused = rate, paused
        self._begun_s, self._begun_ns, self.behind_s = time.monotonic(), stamp_ns, 0.0
        self._passed.clear()
        self._passed.append((self._begun_s, stamp_ns))

    def computed(self, end_ns: int) -> bool:
        """A window up to this instant is there; whether it is late."""
        now_s = time.monotonic()
        self.windows += 1
        self._passed.append((now_s, end_ns))
        while now_s - self._passed[0][0] > _FACTOR_OVER_S:
            self._passed.popleft()
        self.behind_s = 0.0 if self._rate is None else max(now_s - self.due_s(end_ns), 0.0)
        if not self.behind_s:
            return False
        self.late += 1
        if self.behind_s > SLIP_S:
            self.slipped_s += self.behind_s
            self._begun_s += self.behind_s
            self.behind_s = 0.0
        return True

    @property
    def realtime_factor(self) -> float:
        """Simulated over real time, over the last seconds without a break."""
        (first_s, first_ns), (last_s, last_ns) = self._passed[0], self._passed[-1]
        return (last_ns - first_ns) * 1e-9 / (last_s - first_s) if last_s > first_s else 0.0
