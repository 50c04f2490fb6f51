"""Keeps simulated time in step with the clock on the wall."""

from __future__ import annotations

import math
import time
from collections import deque

SLIP_S = 1.0
"""Time by which the simulation may be behind before it gives up catching up: a machine that was
suspended would else race through the hours that it missed."""
_FACTOR_OVER_S = 5.0


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
        self._begun_s, self._begun_ns = time.monotonic(), stamp_ns
        self._passed.clear()
        self._passed.append((self._begun_s, stamp_ns))

    def computed(self, end_ns: int) -> bool:
        """A window up to this instant is there; whether it is late."""
        now_s = time.monotonic()
        self.windows += 1
        self._passed.append((now_s, end_ns))
        while now_s - self._passed[0][0] > _FACTOR_OVER_S:
            self._passed.popleft()
        behind_s = now_s - self.due_s(end_ns)
        if self._rate is None or behind_s <= 0.0:
            return False
        self.late += 1
        if behind_s > SLIP_S:
            self.slipped_s += behind_s
            self._begun_s += behind_s
        return True

    @property
    def realtime_factor(self) -> float:
        """Simulated over real time, over the last seconds without a break."""
        (first_s, first_ns), (last_s, last_ns) = self._passed[0], self._passed[-1]
        return (last_ns - first_ns) * 1e-9 / (last_s - first_s) if last_s > first_s else 0.0
