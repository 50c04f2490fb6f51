"""From streams as they arrive to what a SLAM session takes: scans with the motion since."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Generic, TypeVar

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.types import BoolArray, EncoderStream, ImuStream, IntArray, PlanarTrajectory, Scan
from slamsim.recording import RawImu, RawOdometry, RawScans, RawStream, RawTicks
from slamsim.recording.cleaning.no_return import AS_DECLARED, RangeLimit
from slamsim.recording.cleaning.scans import (
    LEAST_REPEATED,
    WITHOUT_NOISE,
    RecordedScans,
    moves,
    usable_rows,
)
from slamsim.recording.cleaning.streams import encoders_of, imu_of, odometry_of
from slamsim.slam.online.samples import MotionSamples

PATIENCE_NS = 300_000_000
"""A scan waits so long for the motion until its end, by the stamps of what has arrived: wireless
links delay messages by a few tenths of a second at most, or lose them."""

Arrived = RawStream | PlanarTrajectory
"""A part of a stream; the latter is odometry that came as transforms."""
_Stream = TypeVar("_Stream", PlanarTrajectory, EncoderStream, ImuStream)


class SlamFeed:
    """Holds each scan back until every stream that ever spoke has covered its end, the inertial
    unit the reading of the wheels after it too. A scan that repeats the one before while the robot
    moves is left out: a driver that is stuck publishes its last one again.

    limit: beyond which a reading of the lidar is no return.
    """

    def __init__(self, limit: RangeLimit = AS_DECLARED) -> None:
        self._limit = limit
        self._waiting: deque[Scan] = deque()
        self._odometry = _Held[PlanarTrajectory]()
        self._ticks = _Held[EncoderStream]()
        self._imu = _Held[ImuStream]()
        self._newest_ns: dict[type[object], int] = {}
        self._before, self._scans, self._repeats = b"", 0, 0
        """The ranges of the last scan, and how many of those so far repeated the one before."""
        self._driven: PlanarTrajectory | None = None
        """The last odometry that was given."""

    def take(self, streams: Sequence[Arrived]) -> Iterator[tuple[Scan, MotionSamples]]:
        """streams: what arrived, of one topic of each kind. Gives the scans that are ready, each
        with the motion since the one before it."""
        for stream in streams:
            if len(stream):
                self._keep(stream)
        while self._waiting:
            end_ns = self._waiting[0].span_ns[1]
            rolled_ns = self._rolled_ns(end_ns)
            if not self._ready(end_ns, rolled_ns):
                break
            scan = self._waiting.popleft()
            if self._is_stuck(scan):
                continue  # what the robot moved meanwhile goes with the next one
            odometry, ticks = self._odometry.until(end_ns), self._ticks.until(end_ns)
            motion = MotionSamples(odometry, ticks, self._imu.until(rolled_ns))
            self._driven = odometry or self._driven
            yield scan, motion

    def _keep(self, stream: Arrived) -> None:
        if isinstance(stream, RawScans):
            self._waiting.extend(self._usable(stream))
        elif isinstance(stream, PlanarTrajectory):
            self._odometry.add(stream)
        elif isinstance(stream, RawTicks):
            self._ticks.add(encoders_of(stream)[0])
        elif isinstance(stream, RawOdometry):
            self._odometry.add(odometry_of(stream)[0])
        elif isinstance(stream, RawImu):
            self._imu.add(imu_of(stream)[0])
        else:
            return
        newest_ns = int(stream.stamps_ns.max())
        self._newest_ns[type(stream)] = max(newest_ns, self._newest_ns.get(type(stream), newest_ns))

    def _usable(self, raw: RawScans) -> RecordedScans:
        """The scans that describe a lidar and are later than all before them."""
        rows = usable_rows(raw)
        last_ns = self._newest_ns.get(RawScans, int(np.iinfo(np.int64).min))
        rows = rows[_rising(np.concatenate([[last_ns], raw.stamps_ns[rows]]))[1:]]
        return RecordedScans(raw, rows, raw.stamps_ns[rows], self._limit)

    def _ready(self, end_ns: int, rolled_ns: int) -> bool:
        if max(self._newest_ns.values()) - end_ns > PATIENCE_NS:
            return True
        motions_ns = [ns for kind, ns in self._newest_ns.items() if kind is not RawScans]
        covered = bool(motions_ns) and min(motions_ns) >= end_ns
        return covered and self._newest_ns.get(RawImu, rolled_ns) >= rolled_ns

    def _is_stuck(self, scan: Scan) -> bool:
        now, before = scan.ranges_m.tobytes(), self._before
        self._before = now
        self._scans += 1
        if now != before or np.isfinite(scan.ranges_m).sum() < LEAST_REPEATED:
            return False
        self._repeats += 1
        if self._repeats >= WITHOUT_NOISE * self._scans:
            return False
        since, driven = self._driven, self._odometry.seen(scan.span_ns[1])
        if since is None or driven is None:
            return False
        step = between(since.poses[-1], driven.poses[-1])
        seconds = 1e-9 * float(driven.stamps_ns[-1] - since.stamps_ns[-1])
        return bool(moves(step, seconds))

    def _rolled_ns(self, end_ns: int) -> int:
        """Until when the inertial unit has to be known: an interval of the wheels is taken in once
        the gyroscope covers all of it, and without the one that a scan ends in, the scan's last
        part would be extrapolated."""
        return max(self._odometry.first_ns(end_ns), self._ticks.first_ns(end_ns))


class _Held(Generic[_Stream]):
    """Samples that no scan has been given yet."""

    def __init__(self) -> None:
        self._parts: list[_Stream] = []

    def add(self, part: _Stream | None) -> None:
        """None stands for messages without sound numbers."""
        if part is not None:
            self._parts.append(part)

    def first_ns(self, end_ns: int) -> int:
        """Stamp of the first one that is not earlier; end_ns itself where that was given before."""
        stamps_ns = (ns for part in self._parts for ns in part.stamps_ns.tolist())
        return min((ns for ns in stamps_ns if ns >= end_ns), default=end_ns)

    def seen(self, end_ns: int) -> _Stream | None:
        """Those up to the first one that is not earlier; None without any."""
        if not self._parts:
            return None
        held = _joined(self._parts)
        self._parts = [held]
        return held.select(slice(0, int(np.searchsorted(held.stamps_ns, end_ns)) + 1))

    def until(self, end_ns: int) -> _Stream | None:
        """The same, which are given away."""
        given = self.seen(end_ns)
        if given is not None:
            later = self._parts[0].select(slice(len(given.stamps_ns), None))
            self._parts = [later] if len(later.stamps_ns) else []
        return given


def _joined(parts: Sequence[_Stream]) -> _Stream:
    """A sample that is not later than all before it, for its message came late, is left out."""
    rising = _rising(np.concatenate([part.stamps_ns for part in parts]))
    ends = np.cumsum([part.stamps_ns.size for part in parts])
    kept = zip(parts, np.split(rising, ends[:-1]), strict=True)
    return type(parts[0]).joined([part.select(rows) for part, rows in kept])


def _rising(stamps_ns: IntArray) -> BoolArray:
    """(n,) whether a stamp is later than all before it."""
    before = np.maximum.accumulate(stamps_ns)
    return np.asarray(np.concatenate([[True], stamps_ns[1:] > before[:-1]]))
