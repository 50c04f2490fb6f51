"""sensor_msgs/LaserScan to our scans, lazily and as often as one likes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from slamsim.logs.bag import Bag
from slamsim.logs.bag_columns import stamp_ns_of
from slamsim.logs.frames import frame_name
from slamsim.logs.scans import StoredScans
from slamsim.safe.errors import InputRefused
from slamsim.safe.numbers import MOST, BadNumbers
from slamsim.types import Float32Array, Scan, ScanGeometry, ScanSource


def scan_from_message(message: Any) -> Scan | None:
    """One scan, None when its angles or limits describe no lidar.

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
    """A ScanSource that reads the file anew each time; memory does not grow with its length."""

    def __init__(self, bag: Bag, topic: str, count: int) -> None:
        self._bag, self._topic, self._count = bag, topic, count

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Scan]:
        last_ns: int | None = None
        for message in self._bag.messages([self._topic]):
            scan = scan_from_message(message)
            if scan is not None and (last_ns is None or scan.stamp_ns > last_ns):
                last_ns = scan.stamp_ns
                yield scan


def read_scans(bag: Bag, topic: str) -> tuple[ScanSource, int, int, list[str]]:
    """(scans, first stamp, last stamp, what was odd) after one pass over the topic.

    Scans that are not in the order of their stamps are sorted, in memory. Raises InputRefused
    when none is usable, or all carry one and the same stamp.
    """
    survey = _Survey()
    for message in bag.messages([topic]):
        survey.add(scan_from_message(message), message)
    stamps = np.unique(np.array(survey.stamps_ns, dtype=np.int64))
    where = f"topic {topic}"
    if stamps.size == 0:
        raise InputRefused(bag.path, f"none of {survey.unusable} scans describes a lidar", where)
    if stamps.size == 1 and len(survey.stamps_ns) > 1:
        shown = f"all {len(survey.stamps_ns)} scans carry the stamp {stamps[0]} ns"
        raise InputRefused(bag.path, f"{shown}: when they were taken is not known", where)
    backward = survey.backward
    source: ScanSource = BagScans(bag, topic, stamps.size)
    if backward:
        messages = (scan_from_message(message) for message in bag.messages([topic]))
        by_stamp = {scan.stamp_ns: scan for scan in messages if scan is not None}
        source = StoredScans([by_stamp[stamp_ns] for stamp_ns in stamps.tolist()])
    return source, int(stamps[0]), int(stamps[-1]), survey.warnings(topic, stamps.size)


class _Survey:
    """What a pass over all scans finds."""

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.unusable = 0
        self.backward = 0
        self._beam_counts: set[int] = set()
        self._odd_angle_max = 0
        self._instantaneous = True
        self._no_maximum = 0

    def add(self, scan: Scan | None, message: Any) -> None:
        if scan is None:
            self.unusable += 1
            return
        geometry = scan.geometry
        if self.stamps_ns and scan.stamp_ns < self.stamps_ns[-1]:
            self.backward += 1
        self.stamps_ns.append(scan.stamp_ns)
        self._beam_counts.add(geometry.beam_count)
        spanned = (geometry.beam_count - 1) * geometry.angle_step_rad
        off = abs(float(message.angle_max) - geometry.angle_min_rad - spanned)
        self._odd_angle_max += not off < 0.5 * abs(geometry.angle_step_rad)
        self._instantaneous &= geometry.beam_dt_ns == 0
        self._no_maximum += not math.isfinite(message.range_max)

    def warnings(self, topic: str, used: int) -> list[str]:
        total = len(self.stamps_ns)
        beams = ", ".join(map(str, sorted(self._beam_counts)))
        found = [
            (self.unusable, f"{self.unusable} scans that describe no lidar left out"),
            (
                self.backward,
                f"{self.backward} of {total} scans are stamped before the one above: sorted",
            ),
            (total - used, f"{total - used} scans carry the stamp of another one: left out"),
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
            (self._no_maximum, f"{self._no_maximum} scans declare no range_max"),
        ]
        return [f"{topic}: {text}" for applies, text in found if applies]
