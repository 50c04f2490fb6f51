"""SLAM beside a live robot, in a process of its own: it never holds up simulation or messages.

The child is ``python -m slamsim.live.mapping_worker``. It is sent streams as they arrive and
answers with a ``Placed`` for each scan, and with the map when it has changed,
at most once a second.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self, cast

from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.live.slam_feed import Arrived
from slamsim.process.exit_codes import ended_by
from slamsim.process.module_process import ModuleProcess
from slamsim.process.pipe import Ended, packed
from slamsim.recording import RawScans
from slamsim.recording.cleaning.no_return import AS_DECLARED, RangeLimit
from slamsim.slam.frontend.tracking import Status


@dataclass(frozen=True, slots=True, eq=False)
class Begin:
    """Begin a map. T_base_laser, T_base_imu: 4 x 4 mounts, the latter None without a gyroscope.
    limit: beyond which a reading is no return. start: (3,) T_map_base at the first scan."""

    slam: SlamConfig
    mapping: MappingConfig
    T_base_laser: FloatArray
    T_base_imu: FloatArray | None
    limit: RangeLimit = AS_DECLARED
    start: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Ready:
    """Kernels are compiled, the session waits for scans."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What arrived at one time was dealt with."""


@dataclass(frozen=True, slots=True)
class Finish:
    """Asks for the final solution."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Where a scan was taken. status as of a ``Step``; None for a scan that was left out."""

    stamp_ns: int
    T_map_base: FloatArray
    status: Status | None
    keyframes: int
    closures: int
    events: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MapNews:
    """The map by now. path: (n, 3) T_map_base of its key frames."""

    stamp_ns: int
    grid: Grid
    path: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """The final solution. trajectory: T_map_base of every scan; grid: drawn from it."""

    trajectory: PlanarTrajectory
    grid: Grid
    keyframes: int
    closures: int


Answer = Placed | MapNews | Finished


class MappingProcess:
    """A context manager: the process ends with its block."""

    def __init__(self) -> None:
        self._child = ModuleProcess("slamsim.live.mapping_worker")
        self.scans_sent = self.scans_answered = 0
        self._awaited = 0
        self._sent_s: deque[float] = deque()
        """When each part was sent that is not dealt with yet."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._child.end()

    @property
    def is_ready(self) -> bool:
        """Whether the newest map was begun."""
        return not self._awaited

    @property
    def behind(self) -> int:
        """Scans sent and not yet placed."""
        return self.scans_sent - self.scans_answered

    @property
    def lag_s(self) -> float:
        """How long the oldest part waits that is not dealt with yet; 0 without any."""
        return time.monotonic() - self._sent_s[0] if self._sent_s else 0.0

    def begin(self, begin: Begin) -> None:
        """A new map; what was sent before is forgotten."""
        self.scans_sent = self.scans_answered = 0
        self._awaited += 1
        self._child.send(packed(begin))

    def take(self, streams: Sequence[Arrived]) -> None:
        """What arrived since the last call; returns at once."""
        self.scans_sent += sum(len(s) for s in streams if isinstance(s, RawScans))
        if streams:
            self._sent_s.append(time.monotonic())
            self._child.send(packed(tuple(streams)))

    def answers(self) -> list[Answer]:
        """All that it said of the present map since the last call. Raises SlamsimError where the
        process ended."""
        try:
            found = self._child.receive()
        except Ended:
            code = self._child.exit_code()
            how = ended_by(-code) if code < 0 else f"ended with code {code}"
            raise SlamsimError(f"the SLAM process {how}") from None
        told = []
        for answer in found:
            if isinstance(answer, SlamsimError):
                raise answer
            if isinstance(answer, Ready):
                self._awaited -= 1
            elif isinstance(answer, Taken):
                self._sent_s.popleft()
            elif not self._awaited:  # else of the map before
                self.scans_answered += isinstance(answer, Placed)
                told.append(answer)
        return cast(list[Answer], told)

    def wait(self) -> None:
        """Until there may be an answer."""
        self._child.wait()

    def finish(self) -> Finished:
        """Wait for the final solution. Raises SlamsimError where there is none."""
        self._child.send(packed(Finish()))
        while True:
            self.wait()
            for answer in self.answers():
                if isinstance(answer, Finished):
                    return answer
