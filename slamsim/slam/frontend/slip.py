"""Wheels that slip, spin, or stand while the robot is pushed: noticed, sized and told."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from slamsim.core.result import Event
from slamsim.core.types import FloatArray

WINDOW_S = 0.6
LEAST_LOOKS = 3
SLIP_SIGMAS = 5.0
LEAST_M, LEAST_RAD = 0.02, 0.02
COAST_SHARE = 0.25
OPENED_M, OPENED_RAD = 0.1, 0.05
"""What odometry is worth at most on a stretch that is not believed."""

TOLD_M, TOLD_RAD = 0.05, np.deg2rad(3.0)
STILL_SHARE = 0.1
"""Wheels that rolled less than this of what the robot moved stood."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One step between scans, by odometry and by matches.

    wheels, coast: (3,) step of the base from where odometry, or constant velocity, has it to where
    it was matched; nan without a match. variance: (3,) of wheels. turn_rad, turn_variance: the
    wheels' turn less the gyroscope's; nan without one. path_m: by the wheels.
    """

    start_ns: int
    end_ns: int
    wheels: FloatArray
    coast: FloatArray
    variance: FloatArray
    turn_rad: float
    turn_variance: float
    path_m: float

    @property
    def differs(self) -> bool:
        """Whether it may be part of a disagreement."""
        wheels, turn_rad = np.nan_to_num(self.wheels), np.nan_to_num(self.turn_rad)
        return bool(max(*np.abs(wheels), abs(turn_rad)) > LEAST_M / LEAST_LOOKS)


@dataclass(slots=True)
class _Open:
    """A disagreement that goes on."""

    start_ns: int
    end_ns: int
    wheels: FloatArray = field(default_factory=lambda: np.zeros(3))
    turn_rad: float = 0.0
    path_m: float = 0.0

    def add(self, look: Look) -> None:
        self.end_ns = look.end_ns
        self.wheels += np.nan_to_num(look.wheels)
        self.turn_rad += float(np.nan_to_num(look.turn_rad))
        self.path_m += look.path_m


class SlipWatch:
    """Compares wheels with gyroscope and matches over a short while.

    A disagreement counts when it is beyond its sigmas over the whole window, so that single bad
    readings that the next one takes back do not.
    """

    def __init__(self) -> None:
        self._looks: deque[Look] = deque()
        self._open: _Open | None = None
        self._events: list[Event] = []
        self.coasting = False
        """Whether constant velocity has lately told the way better than slipping wheels."""
        self.twisting = False
        """Whether wheels have lately turned otherwise than the gyroscope."""

    def see(self, look: Look) -> FloatArray:
        """(3,) variances m^2, m^2, rad^2 by which odometry over this step is to be doubted."""
        self._looks.append(look)
        while look.end_ns - self._looks[0].end_ns > WINDOW_S * 1e9:
            self._looks.popleft()
        far_m, far_rad, far_turn = self._far()
        self.twisting = far_turn
        self.coasting = far_m and self._coasts_better()
        if not (far_m or far_rad or far_turn):
            self._close(look)
            return np.zeros(3)
        if self._open is None:
            before = [seen for seen in list(self._looks)[:-1] if seen.differs]
            self._open = _Open((before or [look])[0].start_ns, look.end_ns)
            for seen in before:
                self._open.add(seen)
        self._open.add(look)
        opened_m = OPENED_M**2 if far_m or far_turn else 0.0
        return np.array([opened_m, opened_m, OPENED_RAD**2 if far_rad else 0.0])

    def events(self) -> tuple[Event, ...]:
        """What is worth telling by now."""
        return (*self._events, *(() if self._open is None else _told(self._open)))

    def _far(self) -> tuple[bool, bool, bool]:
        """Whether wheels and matches differ in position, in turn; wheels and gyroscope in turn."""
        matched = [look for look in self._looks if np.isfinite(look.wheels[0])]
        far_m = far_rad = False
        if matched:
            error = np.sum([look.wheels for look in matched], axis=0)
            sigma = np.sqrt(np.sum([look.variance for look in matched], axis=0))
            least = np.array([LEAST_M, LEAST_M, LEAST_RAD])
            far = np.abs(error) > SLIP_SIGMAS * sigma + least
            far_m, far_rad = bool(far[:2].any()), bool(far[2])
        turned = [look for look in self._looks if np.isfinite(look.turn_rad)]
        excess_rad = abs(sum(look.turn_rad for look in turned))
        sigma_rad = np.sqrt(sum(look.turn_variance for look in turned))
        return far_m, far_rad, bool(excess_rad > SLIP_SIGMAS * sigma_rad + LEAST_RAD)

    def _coasts_better(self) -> bool:
        matched = [look for look in self._looks if np.isfinite(look.coast[0])]
        if len(matched) < LEAST_LOOKS:
            return False
        coast = sum(float(np.square(look.coast[:2]).sum()) for look in matched)
        wheels = sum(float(np.square(look.wheels[:2]).sum()) for look in matched)
        return coast < COAST_SHARE * wheels

    def _close(self, look: Look) -> None:
        """The last look may have taken back what was wrong: then there was nothing."""
        if self._open is None:
            return
        self._open.add(look)
        self._events.extend(_told(self._open))
        self._open = None
        self._looks.clear()


def coasted(T_odometry: FloatArray, velocity: FloatArray, seconds: float, gyro: bool) -> FloatArray:
    """(3,) a step at constant velocity; its turn is the gyroscope's where there is one."""
    step = velocity * seconds
    if not gyro:
        return np.asarray(step)
    half = 0.5 * (T_odometry[2] - step[2])
    cos, sin = np.cos(half), np.sin(half)
    x, y = cos * step[0] - sin * step[1], sin * step[0] + cos * step[1]
    return np.array([x, y, T_odometry[2]])


def _told(slip: _Open) -> tuple[Event, ...]:
    """The event in words; nothing if it is too small to matter."""
    moved_m, turned_rad = float(np.hypot(*slip.wheels[:2])), abs(slip.turn_rad)
    by = "the gyroscope"
    if abs(slip.wheels[2]) > turned_rad:
        turned_rad, by = abs(float(slip.wheels[2])), "the scans"
    words = []
    if moved_m >= TOLD_M and slip.path_m < STILL_SHARE * moved_m:
        words.append(f"the robot was moved {moved_m:.2f} m while its wheels stood")
    elif moved_m >= TOLD_M:
        way = "farther" if slip.wheels[0] < 0.0 else "less far"
        words.append(f"the wheels rolled {moved_m:.2f} m {way} than the robot moved")
    if turned_rad >= TOLD_RAD:
        words.append(
            f"turns by the wheels and by {by} differ by {np.rad2deg(turned_rad):.0f} degrees"
        )
    if not words:
        return ()
    return (Event(slip.start_ns, slip.end_ns, "slip", " and ".join(words)),)
