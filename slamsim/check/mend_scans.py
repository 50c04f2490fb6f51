"""Mends of scans: ranges, directions and times of their beams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slamsim.check.findings import Mend
from slamsim.check.mend_heading import heading_from
from slamsim.check.mend_subjects import number, with_topic
from slamsim.check.scan_sample import ScanSample
from slamsim.check.stray import stray_beams
from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.edits import kept
from slamsim.recording.row_store import RowStore

PER_BEAM = ("drop_beams", "value_to_inf")
"""Operations that may come several times on one subject, with other numbers."""
_BLOCK = 2048
_INF, _NAN = np.float32(np.inf), np.float32(np.nan)
_SAME_VALUE = 1e-4


def zero_to_inf(recording: Recording, mend: Mend) -> Recording:
    """Write no return as infinity where it is 0."""
    return _ranges(recording, mend, lambda ranges_m: np.where(ranges_m == 0.0, _INF, ranges_m))


def value_to_inf(recording: Recording, mend: Mend) -> Recording:
    """Write no return as infinity where it is value_m."""
    value_m = number(mend, "value_m")

    def freed(ranges_m: Float32Array) -> Float32Array:
        near = np.abs(ranges_m - np.float32(value_m)) <= _SAME_VALUE * max(abs(value_m), 1.0)
        return np.where(near, _INF, ranges_m)

    return _ranges(recording, mend, freed)


def scale_ranges(recording: Recording, mend: Mend) -> Recording:
    """Multiply readings by factor; the declared limits if limits is "scale", not if it is "keep",
    and if nothing is said where the readings keep within them."""
    factor, limits = number(mend, "factor"), mend.parameters.get("limits")

    def scaled(scans: RawScans) -> RawScans:
        found = _with_ranges(scans, lambda ranges_m: ranges_m * np.float32(factor))
        if limits == "keep" or (limits is None and _beyond_limits(scans)):
            return found
        layouts = (
            replace(
                layout,
                range_min_m=layout.range_min_m * factor,
                range_max_m=layout.range_max_m * factor,
            )
            for layout in scans.layouts
        )
        return replace(found, layouts=tuple(layouts))

    return with_topic(recording, RawScans, mend, scaled)


def _beyond_limits(scans: RawScans) -> bool:
    """Whether many readings are longer than declared: the limits are in another unit."""
    beyond = [
        float(np.mean(row[np.isfinite(row)] > scans.layout(i).range_max_m))
        for i, row in enumerate(scans.ranges_m[: len(scans) : max(len(scans) // 100, 1)])
        if np.isfinite(row).any()
    ]
    return bool(beyond and np.median(beyond) > 0.05)


def add_to_ranges(recording: Recording, mend: Mend) -> Recording:
    """Add offset_m to every reading that is one: above zero and below the declared maximum."""
    offset_m = np.float32(number(mend, "offset_m"))

    def added(scans: RawScans) -> RawScans:
        largest = np.float32(max(layout.range_max_m for layout in scans.layouts))
        return _with_ranges(
            scans,
            lambda r: np.where(np.isfinite(r) & (r > 0.0) & (r < largest), r + offset_m, r),
        )

    return with_topic(recording, RawScans, mend, added)


def drop_beams(recording: Recording, mend: Mend) -> Recording:
    """Mark the beams first to last as without a reading."""
    first, last = int(number(mend, "first")), int(number(mend, "last"))

    def dropped(ranges_m: Float32Array) -> Float32Array:
        found = np.array(ranges_m)
        found[:, first : last + 1] = _NAN
        return found

    return _ranges(recording, mend, dropped)


def drop_stray_beams(recording: Recording, mend: Mend) -> Recording:
    """Mark beams that stand alone in one scan, and are gone in the next, as without a reading."""

    def freed(scans: RawScans) -> RawScans:
        if not isinstance(scans.ranges_m, np.ndarray):
            return scans
        store = RowStore()
        for start in range(0, len(scans), _BLOCK):
            rows = scans.ranges_m[start : start + _BLOCK]
            after = scans.ranges_m[start + 1 : start + 1 + _BLOCK]
            if len(after) < len(rows):
                after = np.concatenate([after, rows[-1:]])
            numbers = np.arange(start, start + len(rows))
            none: BoolArray = np.zeros(0, dtype=np.bool_)
            sample = ScanSample(scans.layout(start), numbers, rows, after, none)
            store.add(np.where(stray_beams(sample)[1], _NAN, rows))
        return replace(scans, ranges_m=store.rows())

    return with_topic(recording, RawScans, mend, freed)


def drop_repeated_scans(recording: Recording, mend: Mend) -> Recording:
    """Leave out scans with bit for bit the ranges of the one before."""

    def fresh(scans: RawScans) -> RawScans:
        again = np.zeros(len(scans), dtype=np.bool_)
        before: Float32Array | None = None
        for number_of, row in enumerate(scans.ranges_m):
            again[number_of] = before is not None and np.array_equal(before, row, equal_nan=True)
            before = row
        return kept(scans, ~again)

    return with_topic(recording, RawScans, mend, fresh)


def set_angle_max(recording: Recording, mend: Mend) -> Recording:
    """Declare the last angle that increment and number of beams say."""
    return _layouts(recording, mend, _closed)


def set_range_limits(recording: Recording, mend: Mend) -> Recording:
    """Declare range_min_m and range_max_m."""
    low, high = number(mend, "range_min_m"), number(mend, "range_max_m")

    def limited(layout: ScanLayout, _: int) -> ScanLayout:
        return replace(layout, range_min_m=low, range_max_m=high)

    return _layouts(recording, mend, limited)


def scale_angles(recording: Recording, mend: Mend) -> Recording:
    """Multiply the angle between beams by factor, about the middle beam."""
    factor = number(mend, "factor")

    def scaled(layout: ScanLayout, beams: int) -> ScanLayout:
        half = 0.5 * (beams - 1) * layout.angle_step_rad
        angle_min = layout.angle_min_rad + half * (1.0 - factor)
        step = layout.angle_step_rad * factor
        return _closed(replace(layout, angle_min_rad=angle_min, angle_step_rad=step), beams)

    return _layouts(recording, mend, scaled)


def angles_to_radians(recording: Recording, mend: Mend) -> Recording:
    """Turn the degrees of the angle between beams, and of the first if it is one, to radians."""

    def turned(layout: ScanLayout, beams: int) -> ScanLayout:
        step = float(np.radians(layout.angle_step_rad))
        first = layout.angle_min_rad
        if abs(first) > 2.0 * np.pi:
            first = float(np.radians(first))
        return _closed(replace(layout, angle_min_rad=first, angle_step_rad=step), beams)

    return _layouts(recording, mend, turned)


def negate_angles(recording: Recording, mend: Mend) -> Recording:
    """Mirror the scan: what was declared to the left lies to the right."""

    def mirrored(layout: ScanLayout, beams: int) -> ScanLayout:
        found = replace(
            layout, angle_min_rad=-layout.angle_min_rad, angle_step_rad=-layout.angle_step_rad
        )
        return _closed(found, beams)

    return _layouts(recording, mend, mirrored)


def scale_beam_times(recording: Recording, mend: Mend) -> Recording:
    """Multiply the time between beams by factor; below 0 the last beam of the message is first.

    ROS has no negative times: beams are then written in the order in which they fire.
    """
    factor = number(mend, "factor")

    def scaled(layout: ScanLayout, _: int) -> ScanLayout:
        return replace(layout, beam_dt_s=layout.beam_dt_s * abs(factor))

    found = _layouts(recording, mend, scaled)
    return _turned_round(found, mend) if factor < 0.0 else found


def set_sweep(recording: Recording, mend: Mend) -> Recording:
    """Let sweep_s pass from the first beam to the last; below 0 as for ``scale_beam_times``."""
    sweep_s = number(mend, "sweep_s")

    def timed(layout: ScanLayout, beams: int) -> ScanLayout:
        return replace(layout, beam_dt_s=abs(sweep_s) / max(beams - 1, 1))

    found = _layouts(recording, mend, timed)
    return _turned_round(found, mend) if sweep_s < 0.0 else found


def turn_with_robot(recording: Recording, mend: Mend) -> Recording:
    """Turn the rays of each scan by the robot's heading, which they should have had in them.

    heading_from: the topic that tells it; drift_rad_s and offset_rad, if they are given: what it
    tells too much each second, and the heading at the start. Each beam is turned by the heading
    of its own instant.
    """
    fitted = "drift_rad_s" in mend.parameters
    correction = (number(mend, "drift_rad_s"), number(mend, "offset_rad")) if fitted else None
    heading_rad = heading_from(recording, str(mend.parameters["heading_from"]), correction)

    def turned(scans: RawScans) -> RawScans:
        beams = _beams(scans)
        layouts = []
        for i, stamp_ns in enumerate(scans.stamps_ns.tolist()):
            layout = scans.layout(i)
            last = max(int(beams[i]) - 1, 1)
            ends = np.array([stamp_ns, stamp_ns + round(last * layout.beam_dt_s * 1e9)])
            begin, end = heading_rad(ends).tolist()
            layout = replace(
                layout,
                angle_min_rad=layout.angle_min_rad - begin,
                angle_step_rad=layout.angle_step_rad - (end - begin) / last,
            )
            layouts.append(_closed(layout, int(beams[i])))
        every = np.arange(len(scans), dtype=np.int32)
        return replace(scans, layouts=tuple(layouts), layout_of=every)

    return with_topic(recording, RawScans, mend, turned)


def _closed(layout: ScanLayout, beams: int) -> ScanLayout:
    """With the last angle that follows from the first, the increment and the number of beams."""
    last = layout.angle_min_rad + max(beams - 1, 0) * layout.angle_step_rad
    return replace(layout, angle_max_rad=last)


def _turned_round(recording: Recording, mend: Mend) -> Recording:
    def turned(scans: RawScans) -> RawScans:
        if isinstance(scans.ranges_m, np.ndarray):
            found = _with_ranges(scans, lambda ranges_m: ranges_m[:, ::-1])
        else:
            found = replace(scans, ranges_m=[row[::-1] for row in scans.ranges_m])
        if isinstance(scans.intensities, np.ndarray):
            found = replace(found, intensities=scans.intensities[:, ::-1])
        return found

    def other_end(layout: ScanLayout, beams: int) -> ScanLayout:
        last = layout.angle_min_rad + max(beams - 1, 0) * layout.angle_step_rad
        found = replace(layout, angle_min_rad=last, angle_step_rad=-layout.angle_step_rad)
        return _closed(found, beams)

    return _layouts(with_topic(recording, RawScans, mend, turned), mend, other_end)


def _ranges(
    recording: Recording, mend: Mend, change: Callable[[Float32Array], Float32Array]
) -> Recording:
    return with_topic(recording, RawScans, mend, lambda scans: _with_ranges(scans, change))


def _with_ranges(scans: RawScans, change: Callable[[Float32Array], Float32Array]) -> RawScans:
    """change: from (k, beams) ranges to new ones; long recordings stay on the disk."""
    store = RowStore()
    if isinstance(scans.ranges_m, np.ndarray):
        for start in range(0, len(scans), _BLOCK):
            changed = change(scans.ranges_m[start : start + _BLOCK])
            store.add(np.ascontiguousarray(changed, dtype=np.float32))
    else:
        for row in scans.ranges_m:
            store.add(np.ascontiguousarray(change(row[None]), dtype=np.float32))
    return replace(scans, ranges_m=store.rows())


def _beams(scans: RawScans) -> FloatArray:
    """(n,) number of beams of each scan."""
    if isinstance(scans.ranges_m, np.ndarray):
        return np.full(len(scans), scans.ranges_m.shape[1])
    return np.array([row.size for row in scans.ranges_m])


def _layouts(
    recording: Recording, mend: Mend, change: Callable[[ScanLayout, int], ScanLayout]
) -> Recording:
    """change: from a declaration and the number of beams that it is of to a new declaration."""

    def changed(scans: RawScans) -> RawScans:
        beams = _beams(scans)
        counts = {int(layout): int(beams[i]) for i, layout in enumerate(scans.layout_of.tolist())}
        layouts = (change(layout, counts.get(i, 0)) for i, layout in enumerate(scans.layouts))
        return replace(scans, layouts=tuple(layouts))

    return with_topic(recording, RawScans, mend, changed)
