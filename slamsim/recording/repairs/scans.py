"""Repairs of scans: ranges, directions and times of their beams, isolated readings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slamsim.core.types import BoolArray, Float32Array
from slamsim.recording import RawScans, Recording
from slamsim.recording.edits.base import Edit, Edits
from slamsim.recording.edits.beams import (
    Axis,
    CloseAngles,
    ConvertAngles,
    MirrorAngles,
    Pivot,
    ReverseBeams,
    ScaleAngles,
    ScaleBeamTimes,
    ScaleRangeLimits,
    SetRangeLimits,
    SetScanTime,
    SetSweep,
    beam_counts,
    with_last_angle,
)
from slamsim.recording.edits.messages import ChangeMessages, SelectMessages
from slamsim.recording.edits.ranges import (
    BlankBeams,
    DecodeNoReturn,
    OffsetRanges,
    ScaleRanges,
)
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.readings import heading_from
from slamsim.recording.row_store import RowStore

_SAME_VALUE = 1e-4
"""Of a code for no return, or 0.1 mm: what single precision and text round."""
PIVOTS: tuple[Pivot, ...] = ("middle", "first", "last")
AXES: tuple[Axis, ...] = ("zero", "middle")
_BEYOND_SHARE = 0.05
"""Of the readings: where more are longer than declared, the limits are in another unit."""


def zero_to_inf(recording: Recording, repair: Repair) -> Edit:
    """Write no return as infinity where it is 0."""
    return DecodeNoReturn(repair.target(RawScans), 0.0)


def value_to_inf(recording: Recording, repair: Repair) -> Edit:
    """Write no return as infinity where it is value_m; from from_m on, where noise is added."""
    value_m = repair.number("value_m")
    tolerance_m = _SAME_VALUE * max(abs(value_m), 1.0)
    if "from_m" in repair.parameters:
        tolerance_m += value_m - repair.number("from_m")
    return DecodeNoReturn(repair.target(RawScans), value_m, tolerance_m)


def scale_ranges(recording: Recording, repair: Repair) -> Edit:
    """Multiply readings by factor; the declared limits if limits is "scale", not if it is "keep",
    and if nothing is said where the readings keep within them."""
    factor, limits = repair.number("factor"), repair.parameters.get("limits")
    scans = repair.target(RawScans)
    mine = (each for each in recording.scans if each.topic == repair.subject)
    keeps = limits == "keep" or (limits is None and any(map(_beyond_limits, mine)))
    readings = ScaleRanges(scans, factor)
    return readings if keeps else Edits((readings, ScaleRangeLimits(scans, factor)))


def add_to_ranges(recording: Recording, repair: Repair) -> Edit:
    """Add offset_m to every reading that is one: above zero and below the declared maximum."""
    offset_m = repair.number("offset_m")
    return OffsetRanges(repair.target(RawScans), offset_m, only_returns=True)


def drop_beams(recording: Recording, repair: Repair) -> Edit:
    """Mark the beams first to last as without a reading."""
    first, last = int(repair.number("first")), int(repair.number("last"))
    return BlankBeams(repair.target(RawScans), first, last)


def drop_stray_beams(recording: Recording, repair: Repair) -> Edit:
    """Mark beams that stand alone in one scan, and are gone in the next, as without a reading."""
    return ChangeMessages(repair.target(RawScans), without_isolated_returns)


def drop_repeated_scans(recording: Recording, repair: Repair) -> Edit:
    """Leave out scans with bit for bit the ranges of the one before."""

    def fresh(scans: RawScans) -> BoolArray:
        again = np.zeros(len(scans), dtype=np.bool_)
        before: Float32Array | None = None
        for number, row in enumerate(scans.ranges_m):
            again[number] = before is not None and np.array_equal(before, row, equal_nan=True)
            before = row
        return ~again

    return SelectMessages(repair.target(RawScans), fresh)


def set_angle_max(recording: Recording, repair: Repair) -> Edit:
    """Declare the last angle that increment and number of beams say."""
    return CloseAngles(repair.target(RawScans))


def set_range_limits(recording: Recording, repair: Repair) -> Edit:
    """Declare range_min_m and range_max_m."""
    low_m, high_m = repair.number("range_min_m"), repair.number("range_max_m")
    return SetRangeLimits(repair.target(RawScans), low_m, high_m)


def scale_angles(recording: Recording, repair: Repair) -> Edit:
    """Multiply the angle between beams by factor; the middle beam keeps its direction, or the first
    or the last one if pivot says so."""
    scans = repair.target(RawScans)
    pivot = repair.choice("pivot", PIVOTS)
    scaled = ScaleAngles(scans, repair.number("factor"), by_beams=True, pivot=pivot)
    return Edits((scaled, CloseAngles(scans)))


def angles_to_radians(recording: Recording, repair: Repair) -> Edit:
    """Turn the degrees of the angle between beams, and of the first if it is one, to radians."""
    scans = repair.target(RawScans)
    return Edits((ConvertAngles(scans, "radians", ends=None), CloseAngles(scans)))


def negate_angles(recording: Recording, repair: Repair) -> Edit:
    """Mirror the scan: what was declared to the left lies to the right.

    about: "zero", the usual axis, of angles with the wrong sign; "middle", the middle beam, of
    readings in the wrong order, which is another axis where the beams are not the same on both
    sides, as in a full turn.
    """
    scans = repair.target(RawScans)
    mirrored = MirrorAngles(scans, repair.choice("about", AXES))
    return Edits((mirrored, CloseAngles(scans)))


def scale_beam_times(recording: Recording, repair: Repair) -> Edit:
    """Multiply the time between beams by factor; below 0 the last beam of the message is first.

    Hardly a reader expects negative times: beams are then written in the order in which they fire.
    Of times that are declared as negative the sign alone is wrong.
    """
    scans, factor = repair.target(RawScans), repair.number("factor")
    layouts = [
        one for each in recording.scans if each.topic == repair.subject for one in each.layouts
    ]
    if any(layout.beam_dt_s < 0.0 for layout in layouts):
        return ScaleBeamTimes(scans, factor)
    return _in_firing_order(ScaleBeamTimes(scans, abs(factor)), factor)


def set_sweep(recording: Recording, repair: Repair) -> Edit:
    """Let sweep_s pass from the first beam to the last; below 0 as for ``scale_beam_times``."""
    scans, sweep_s = repair.target(RawScans), repair.number("sweep_s")
    return _in_firing_order(SetSweep(scans, abs(sweep_s)), sweep_s)


def set_scan_time(recording: Recording, repair: Repair) -> Edit:
    """Declare scan_time_s from one scan to the next."""
    return SetScanTime(repair.target(RawScans), repair.number("scan_time_s"))


def turn_with_robot(recording: Recording, repair: Repair) -> Edit:
    """Turn the rays of each scan by the robot's heading, which they should have had in them.

    heading_from: the topic that tells it; turns: how many times, -1 for rays that have had it
    twice; drift_rad_s and offset_rad, if they are given: what it
    tells too much each second, and the heading at the start. Each beam is turned by the heading
    of its own instant.
    """
    turns = repair.number("turns") if "turns" in repair.parameters else 1.0
    fitted = "drift_rad_s" in repair.parameters
    drift = (repair.number("drift_rad_s"), repair.number("offset_rad")) if fitted else None
    heading_rad = heading_from(recording, str(repair.parameters["heading_from"]), drift)

    def turned(scans: RawScans) -> RawScans:
        beams = beam_counts(scans)
        layouts = []
        for i, stamp_ns in enumerate(scans.stamps_ns.tolist()):
            layout = scans.layout(i)
            last = max(int(beams[i]) - 1, 1)
            ends = np.array([stamp_ns, stamp_ns + round(last * layout.beam_dt_s * 1e9)])
            begin, end = (turns * heading_rad(ends)).tolist()
            layout = replace(
                layout,
                angle_min_rad=layout.angle_min_rad - begin,
                angle_step_rad=layout.angle_step_rad - (end - begin) / last,
            )
            layouts.append(with_last_angle(layout, int(beams[i])))
        every = np.arange(len(scans), dtype=np.int32)
        return replace(scans, layouts=tuple(layouts), layout_of=every)

    return ChangeMessages(repair.target(RawScans), turned)


def _in_firing_order(timed: ScaleBeamTimes | SetSweep, sign: float) -> Edit:
    """The edit of the times, and the beams turned round for a negative one."""
    return timed if sign >= 0.0 else Edits((timed, ReverseBeams(timed.target)))


def _beyond_limits(scans: RawScans) -> bool:
    """Whether many readings are longer than declared: the limits are in another unit."""
    beyond = [
        float(np.mean(row[np.isfinite(row)] > scans.layout(i).range_max_m))
        for i, row in enumerate(scans.ranges_m[: len(scans) : max(len(scans) // 100, 1)])
        if np.isfinite(row).any()
    ]
    return bool(beyond and np.median(beyond) > _BEYOND_SHARE)


_BLOCK = 2048
_NAN = np.float32(np.nan)
_JUMP_M, _AGREE_M = 0.3, 0.1
_TURNED_RAD = float(np.radians(10.0))
"""A robot hardly turns further between two scans: a pole is found again within this."""


def without_isolated_returns(scans: RawScans) -> RawScans:
    """NaN in the place of each isolated return; scans of several lengths as they are."""
    if not isinstance(scans.ranges_m, np.ndarray):
        return scans
    store = RowStore()
    for start in range(0, len(scans), _BLOCK):
        rows = scans.ranges_m[start : start + _BLOCK]
        after = scans.ranges_m[start + 1 : start + 1 + _BLOCK]
        if len(after) < len(rows):
            after = np.concatenate([after, rows[-1:]])
        isolated = isolated_returns(rows, after, scans.layout(start).angle_step_rad)[1]
        store.add(np.where(isolated, _NAN, rows))
    return replace(scans, ranges_m=store.rows())


def isolated_returns(
    ranges_m: Float32Array, following_m: Float32Array, angle_step_rad: float
) -> tuple[BoolArray, BoolArray]:
    """(k, beams) of which beams it could be told, and which of them are isolated.

    ranges_m, following_m: (k, beams) of some scans and of the scan after each.
    """
    known, alone = _alone(ranges_m)
    known &= np.isfinite(following_m).any(axis=1, keepdims=True)
    beams = ranges_m.shape[1]  # which no angle that is declared by mistake exceeds
    step_rad = abs(angle_step_rad) if np.isfinite(angle_step_rad) else np.inf
    reach = beams if step_rad * beams < _TURNED_RAD else max(math.ceil(_TURNED_RAD / step_rad), 1)
    return known, alone & known & ~_found_again(ranges_m, following_m, reach)


def _alone(ranges_m: Float32Array) -> tuple[BoolArray, BoolArray]:
    """(k, beams) whether the neighbours of a beam agree, and whether it differs from them."""
    left, right = np.roll(ranges_m, 1, axis=1), np.roll(ranges_m, -1, axis=1)
    with np.errstate(invalid="ignore"):
        known = (np.abs(left - right) < _AGREE_M) & np.isfinite(ranges_m) & (ranges_m > 0.0)
        alone = np.abs(ranges_m - 0.5 * (left + right)) > _JUMP_M
    known[:, [0, -1]] = False
    return known, alone & known


def _found_again(now: Float32Array, after: Float32Array, reach: int) -> BoolArray:
    """(k, beams) whether the scan after has such a reading within so many beams."""
    found = np.zeros(now.shape, dtype=np.bool_)
    rows, beams = np.nonzero(_alone(now)[1])
    for shift in range(-reach, reach + 1):
        beside = np.clip(beams + shift, 0, now.shape[1] - 1)
        with np.errstate(invalid="ignore"):
            found[rows, beams] |= np.abs(after[rows, beside] - now[rows, beams]) < _JUMP_M
    return found
