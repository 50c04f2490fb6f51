"""sensor_msgs/LaserScan to our scans, lazily and as often as one likes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from slamsim.core.types import Float32Array, PlanarTrajectory, Scan, ScanGeometry, ScanSource
from slamsim.guard.errors import InputRefused
from slamsim.guard.numbers import MOST, BadNumbers
from slamsim.io.ros.bag import Bag
from slamsim.io.ros.columns import stamp_ns_of
from slamsim.recording.cleaning.no_return import AS_DECLARED, RangeLimit, RangeSample
from slamsim.recording.cleaning.rising_stamps import NoTime, Times, rising_times
from slamsim.recording.cleaning.scans import StoredScans
from slamsim.recording.frames import frame_name


def scan_from_message(message: Any, limit: RangeLimit = AS_DECLARED) -> Scan | None:
    """One scan, None when its angles or limits describe no lidar. limit: of this lidar's ranges.

    Readings at or beyond range_max are no return (``inf``); readings of 0, below range_min or not
    a number are no reading (``nan``), as REP 117 has it. The stamp is the first ray's.
    """
    ranges_m = np.asarray(message.ranges, dtype=np.float32)
    angle_min, step = float(message.angle_min), float(message.angle_increment)
    beam_dt_s, range_max_m = float(message.time_increment), float(message.range_max)
    range_min_m = float(message.range_min) if math.isfinite(message.range_min) else 0.0
    sound = math.isfinite(angle_min) and math.isfinite(step) and math.isfinite(beam_dt_s)
    if not sound or step == 0.0 or ranges_m.size == 0 or not range_max_m > max(range_min_m, 0.0):
        return None
    range_max_m = limit.maximum_m(range_max_m)
    if abs(step) * (ranges_m.size - 1) > 2.0 * math.pi + abs(step) or not 0.0 <= beam_dt_s < 1.0:
        return None
    try:
        geometry = ScanGeometry(
            angle_min_rad=angle_min,
            angle_step_rad=step,
            beam_count=ranges_m.size,
            beam_dt_ns=round(beam_dt_s * 1e9),
            range_min_m=max(range_min_m, 0.0),
            range_max_m=range_max_m if math.isfinite(range_max_m) else _largest_m(ranges_m),
            frame_id=frame_name(message.header.frame_id),
        )
    except BadNumbers:
        return None
    intensities = np.asarray(message.intensities, dtype=np.float32)
    return Scan(
        stamp_ns=stamp_ns_of(message.header),
        ranges_m=_mended(ranges_m, geometry),
        geometry=geometry,
        intensities=intensities if intensities.size == ranges_m.size else None,
    )


def _largest_m(ranges_m: Float32Array) -> float:
    """Just above every reading, for a driver that declares no maximum."""
    finite = ranges_m[ranges_m < np.float32(MOST)]
    return float(np.nextafter(finite.max(initial=np.float32(1.0)), np.float32(np.inf)))


def _mended(ranges_m: Float32Array, geometry: ScanGeometry) -> Float32Array:
    mended = np.where(ranges_m >= np.float32(geometry.range_max_m), np.float32(np.inf), ranges_m)
    too_close = ~(mended > 0.0) | (mended < np.float32(geometry.range_min_m))
    return np.where(too_close, np.float32(np.nan), mended)


class BagScans:
    """A ScanSource that reads the file anew each time; memory does not grow with its length.

    times: of the messages that describe a lidar, in the order of the file.
    """

    def __init__(self, bag: Bag, topic: str, times: Times, limit: RangeLimit) -> None:
        self._bag, self._topic, self._times, self._limit = bag, topic, times, limit

    def __len__(self) -> int:
        return int(self._times.order.size)

    def __iter__(self) -> Iterator[Scan]:
        messages = self._bag.messages([self._topic])
        scans = (scan_from_message(message, self._limit) for message in messages)
        return self._times.applied(scan for scan in scans if scan is not None)


class Survey:
    """What a pass over all scans of a topic finds."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._received_ns: list[int] = []
        self._is_repeat: list[bool] = []
        self._last: Scan | None = None
        self._frame_id = ""
        self._sample = RangeSample()
        self._declared_m: Counter[float] = Counter()
        self._beam_counts: set[int] = set()
        self._unusable = 0
        self._odd_angle_max = 0
        self._instantaneous = True

    @property
    def frame_id(self) -> str:
        """The frame of the first scan that describes a lidar, ``""`` without any."""
        return self._frame_id

    @property
    def recorded(self) -> int:
        """Scans that were added, with those that describe no lidar."""
        return self._unusable + len(self._stamps_ns)

    def add(self, message: Any, received_ns: int) -> None:
        """The next scan of the recording."""
        scan = scan_from_message(message)
        if scan is None:
            self._unusable += 1
            return
        geometry = scan.geometry
        self._frame_id = self._frame_id if self._last else geometry.frame_id
        self._stamps_ns.append(scan.stamp_ns)
        self._received_ns.append(received_ns)
        self._is_repeat.append(_is_repeat(self._last, scan))
        self._last = scan
        readings_m = np.asarray(message.ranges, dtype=np.float32)
        self._sample.add(readings_m, geometry.angle_step_rad)
        self._declared_m[float(message.range_max)] += 1
        self._beam_counts.add(geometry.beam_count)
        spanned = (geometry.beam_count - 1) * geometry.angle_step_rad
        off = abs(float(message.angle_max) - geometry.angle_min_rad - spanned)
        self._odd_angle_max += not off < 0.5 * abs(geometry.angle_step_rad)
        self._instantaneous &= geometry.beam_dt_ns == 0

    def times(self) -> Times:
        """Of the scans that describe a lidar; ValueError if none does, or nothing tells them."""
        if not self._stamps_ns:
            raise ValueError(f"none of {self._unusable} scans describes a lidar")
        try:
            return rising_times(
                np.array(self._stamps_ns, dtype=np.int64),
                np.array(self._received_ns, dtype=np.int64),
                is_repeat=np.array(self._is_repeat, dtype=np.bool_),
            )
        except NoTime:
            few = sorted(set(self._stamps_ns))
            stamps = f"the stamp {few[0]} ns" if len(few) == 1 else f"one of {len(few)} stamps"
            raise ValueError(
                f"all {len(self._stamps_ns)} scans carry {stamps}, and were received at no time: "
                "when they were taken is not known"
            ) from None

    def limit(
        self, times: Times, odometry: PlanarTrajectory | None
    ) -> tuple[RangeLimit, list[str]]:
        """(the limit of the ranges, in words what of it is not as declared)."""
        declared_m = self._declared_m.most_common(1)[0][0]
        positions_m = None
        if odometry is not None and len(odometry):
            stamps_ns = np.empty(len(self._stamps_ns), dtype=np.int64)
            stamps_ns[:] = times.stamps_ns[0]
            stamps_ns[times.order] = times.stamps_ns
            first_ns, last_ns = odometry.stamps_ns[0], odometry.stamps_ns[-1]
            sampled_ns = np.clip(stamps_ns[self._sample.numbers], first_ns, last_ns)
            positions_m = odometry.at(sampled_ns)[:, :2]
        limit = self._sample.limit(declared_m, positions_m)
        return limit, limit.warnings(declared_m)

    def warnings(self, times: Times) -> list[str]:
        """What was odd, and what was done about it."""
        beams = ", ".join(map(str, sorted(self._beam_counts)))
        without = sum(
            n for declared_m, n in self._declared_m.items() if not np.isfinite(declared_m)
        )
        found = [
            (self._unusable, f"{self._unusable} scans that describe no lidar left out"),
            *((True, words) for words in times.told),
            (len(self._beam_counts) > 1, f"the number of beams changes: {beams}"),
            (
                self._odd_angle_max,
                f"angle_max of {self._odd_angle_max} scans contradicts increment and count, "
                "which are believed",
            ),
            (
                self._instantaneous,
                "time_increment is 0: all beams of a scan count as one instant",
            ),
            (without, f"{without} scans declare no range_max"),
        ]
        return [text for applies, text in found if applies]


def _is_repeat(before: Scan | None, scan: Scan) -> bool:
    """Whether a scan is the one before once more."""
    if before is None or before.stamp_ns != scan.stamp_ns:
        return False
    return before.geometry == scan.geometry and before.ranges_m.tobytes() == scan.ranges_m.tobytes()


def survey_scans(bag: Bag, topic: str) -> tuple[Survey, Times]:
    """One pass over a topic of scans.

    Raises InputRefused when none describes a lidar, or nothing tells when they were taken.
    """
    survey = Survey()
    for _, received_ns, data in bag.received({topic}):
        survey.add(bag.deserialize(topic, data), received_ns)
    try:
        return survey, survey.times()
    except ValueError as error:
        raise InputRefused(bag.path, str(error), f"topic {topic}") from None


def bag_scans(bag: Bag, topic: str, times: Times, limit: RangeLimit) -> ScanSource:
    """The scans of a topic, in memory if they are not in the order of time in the file."""
    scans = BagScans(bag, topic, times, limit)
    return scans if (np.diff(times.order) > 0).all() else StoredScans(list(scans))
