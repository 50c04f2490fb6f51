"""The unit of the ranges: by the declared limits, and by how ranges change along the path."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.question import FaultKind, Question, judge, same_subject
from slamsim.check.scan_sample import ScanSample, positive
from slamsim.core.geometry import wrap_angle
from slamsim.core.types import FloatArray
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.repairs.base import Repair

MIN_COUNT = 20
UNITS: dict[str, float] = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "kilometres": 1e3,
}
"""Units that the declared limits alone unmask, and how many metres one of them is."""
RARE_UNITS: dict[str, float] = {"inches": 0.0254, "feet": 0.3048}
"""These are told from the others by the path that is driven alone."""
LIMIT_TOLERANCE = 1e-3
"""A millimetre, or a thousandth of the largest range: what floats and rounding make of a limit."""
_OVERFLOW = 0.9
"""Of the largest reading: near it stands a code for no return, not a range."""
_MOST, _HARDLY_ANY = 0.5, 0.01
"""Of the readings outside the declared limits: most of them in a wrong unit, hardly any in the
right one."""
_MIN_STEP_M, _MAX_TURN_RAD = 0.02, 0.01
"""A pair of scans tells lengths if the robot went straight on in between."""
_MIN_PAIRS = 5

RANGE_UNIT = FaultKind(
    "range_unit",
    "ranges are in another unit than metres",
    (same_subject("range_limits", "range_offset", "scan_interference", "ranges_coarse"),),
)
UNIT = Question(
    "ranges.unit",
    "ranges in metres lie inside the declared limits",
    (RANGE_UNIT,),
    unit="m",
    consequence="the map is larger or smaller than the world, and contradicts the odometry",
    repairs=("scale_ranges",),
)


def unit_of(recording: Recording, scans: RawScans, sample: ScanSample) -> str | None:
    """The unit in which most readings fit the declared limits, if metres are not it.

    Of several that fit, the one in which ranges ahead change as much as the robot drove.
    """
    readings, layout = positive(sample), sample.layout
    if readings.size < MIN_COUNT or outside_share(readings, layout) <= _MOST:
        return None
    fit, rare = (
        [u for u, metres in units.items() if outside_share(readings * metres, layout) < _HARDLY_ANY]
        for units in (UNITS, RARE_UNITS)
    )
    changes = _changes_per_metre(recording, scans, sample) if fit else None
    if changes is None:
        return next(iter(fit), None)
    return min([*fit, *rare], key=lambda unit: abs(np.log(changes * metres_of(unit))))


def metres_of(unit: str) -> float:
    """What a reading in that unit is multiplied by to become metres."""
    return {**UNITS, **RARE_UNITS}[unit]


def _changes_per_metre(recording: Recording, scans: RawScans, sample: ScanSample) -> float | None:
    """How far the beams that change most change while the odometry goes straight on by a metre.

    1 if ranges are metres: beams ahead and behind change by the path that is driven. None without
    odometry, or where it hardly ever goes straight on between two sampled scans.
    """
    if not recording.odometries or len(sample.scans) < 2:
        return None
    odometry = recording.odometries[0]
    known_ns, track = planar_track(odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw)
    if known_ns.size == 0:
        return None
    steps = np.diff(track_at(known_ns, track, scans.stamps_ns[sample.scans]), axis=0)
    step_m = np.hypot(steps[:, 0], steps[:, 1])
    straight = (step_m > _MIN_STEP_M) & (np.abs(wrap_angle(steps[:, 2])) < _MAX_TURN_RAD)
    if int(straight.sum()) < _MIN_PAIRS:
        return None
    change = np.abs(np.diff(sample.ranges_m, axis=0)[straight])
    known = np.isfinite(change).any(axis=1)
    change = np.where(np.isfinite(change), change, np.nan)[known]
    if not known.any():
        return None
    per_metre = float(np.median(np.nanquantile(change, 0.8, axis=1) / step_m[straight][known]))
    return per_metre if per_metre > 0.0 else None


def wrong_unit(topic: str, sample: ScanSample, unit: str) -> Finding:
    """The finding for a unit of ``unit_of``; middle and limit as recorded."""
    middle = float(np.median(positive(sample)))
    return judge(
        UNIT,
        topic,
        f"half of all readings are above {middle:.4g}, {declared(sample.layout)}: these are {unit}",
        Measurement(middle, 0.0, "m"),
        verdict="fault",
        limit=sample.layout.range_max_m,
        advice=f"Multiply every range by {metres_of(unit):g}.",
        repairs=(Repair("scale_ranges", topic, {"factor": metres_of(unit)}),),
    )


def declared(layout: ScanLayout) -> str:
    """The declared limits, in words."""
    return f"declared {layout.range_min_m:g} to {layout.range_max_m:g} m"


def outside_share(readings: FloatArray, layout: ScanLayout) -> float:
    """Of readings (n,); a common largest value above the maximum is a code for no return."""
    slack = LIMIT_TOLERANCE * layout.range_max_m
    below = readings < layout.range_min_m - LIMIT_TOLERANCE
    above = (readings > layout.range_max_m + slack) & (readings < readings.max() * _OVERFLOW)
    return float((below | above).mean())
