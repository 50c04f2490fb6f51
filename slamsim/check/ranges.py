"""Do the ranges mean what REP 117 says: metres, ``inf`` for no return, inside the limits?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.beams import check_beams
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.no_return import check_no_return, freed_of_codes
from slamsim.check.repeats import check_repeats
from slamsim.check.scan_sample import ScanSample, positive, sample_scans
from slamsim.check.stray import check_stray
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.types import FloatArray

MAX_OUTSIDE_SHARE = 2e-3
"""Rounding at the limits themselves puts a few readings a hair outside."""
MIN_COUNT = 20
"""Fewer readings than this are accidents."""
UNITS: dict[str, float] = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "kilometres": 1e3,
}
"""Units that the declared limits alone unmask, and what a reading is multiplied by to mend it."""
_LIMIT_TOLERANCE = 1e-3
_OVERFLOW = 0.9
_MOST, _HARDLY_ANY = 0.5, 0.01


def check_ranges(recording: Recording) -> list[Finding]:
    """Layout, unit, limits, no-return codes, stuck, constant and stray beams of every lidar."""
    findings: list[Finding] = []
    for scans in recording.scans:
        findings += _layouts(scans)
        sample = sample_scans(scans)
        if sample is None:
            words = "no scan holds a single beam"
            findings.append(Finding("ranges", scans.topic, "cannot tell", words))
            continue
        unit = _unit(sample)
        if unit is not None:
            findings.append(_wrong_unit(scans.topic, sample, unit))
            sample = sample.scaled(UNITS[unit])
        findings += [
            _limits(scans.topic, sample),
            check_no_return(scans.topic, sample, recording.format == "carmen"),
        ]
        sample = freed_of_codes(sample)
        findings += [
            check_repeats(recording, scans, sample),
            *check_beams(scans.topic, sample),
            check_stray(scans.topic, sample),
        ]
    return findings


def _layouts(scans: RawScans) -> Iterator[Finding]:
    """angle_max must be where the last beam looks."""
    for number, layout in enumerate(scans.layouts):
        with_it = np.flatnonzero(scans.layout_of == number)
        if with_it.size == 0:
            continue
        beams = scans.ranges_m[int(with_it[0])].size
        last_rad = layout.angle_min_rad + (beams - 1) * layout.angle_step_rad
        off = abs(layout.angle_max_rad - last_rad)
        if off <= 1.5 * abs(layout.angle_step_rad):
            continue  # the last beam, or one more as drivers that count a full turn write it
        yield Finding(
            "ranges.layout",
            scans.topic,
            "bad",
            f"the last of {beams} beams looks along {np.degrees(last_rad):.2f} deg, angle_max says "
            f"{np.degrees(layout.angle_max_rad):.2f}",
            "scan_layout",
            "Let angle_max be angle_min + (number of ranges - 1) x angle_increment.",
            mends=(Mend("set_angle_max", scans.topic),),
        )


def _unit(sample: ScanSample) -> str | None:
    """The unit in which most readings fit the declared limits, if metres are not it."""
    readings, layout = positive(sample), sample.layout
    if readings.size < MIN_COUNT or _outside_share(readings, layout) <= _MOST:
        return None
    fits = (unit for unit, factor in UNITS.items()
            if _outside_share(readings * factor, layout) < _HARDLY_ANY)  # fmt: skip
    return next(fits, None)


def _wrong_unit(topic: str, sample: ScanSample, unit: str) -> Finding:
    middle = float(np.median(positive(sample)))
    return Finding(
        "ranges.unit",
        topic,
        "bad",
        f"half of all readings are above {middle:.4g}, {_declared(sample.layout)}: these are "
        f"{unit}",
        "range_unit",
        f"Multiply every range by {UNITS[unit]:g}.",
        Estimate(middle, 0.0, "m"),
        sample.layout.range_max_m,
        (Mend("scale_ranges", topic, {"factor": UNITS[unit]}),),
    )


def _declared(layout: ScanLayout) -> str:
    return f"declared {layout.range_min_m:g} to {layout.range_max_m:g} m"


def _limits(topic: str, sample: ScanSample) -> Finding:
    layout, readings = sample.layout, positive(sample)
    if not layout.range_max_m > max(layout.range_min_m, 0.0):
        return Finding(
            "ranges.limits",
            topic,
            "bad",
            f"{_declared(layout)}: no range can lie between",
            "range_limits",
            "Declare what the data sheet of the lidar says.",
        )
    if readings.size < MIN_COUNT:
        words = f"{readings.size} finite readings in {len(sample.scans)} scans"
        return Finding("ranges.limits", topic, "cannot tell", words)
    outside = _outside_share(readings, layout)
    estimate = Estimate(100.0 * outside, 0.0, "%")
    if outside > MAX_OUTSIDE_SHARE:
        low, high = np.quantile(readings, [0.001, 0.999])
        return Finding(
            "ranges.limits",
            topic,
            "bad",
            f"{100.0 * outside:.2g} % of the readings lie outside ({low:.3g} to {high:.3g} m are "
            f"99.8 % of them), {_declared(layout)}",
            "range_limits",
            "Declare what the lidar can do, or a SLAM throws good readings away.",
            estimate,
            100.0 * MAX_OUTSIDE_SHARE,
            (_set_limits(topic, readings, layout),),
        )
    words = f"readings about {np.median(readings):.2f} m lie inside, {_declared(layout)}"
    return Finding("ranges.limits", topic, "ok", words, estimate=estimate)


def _set_limits(topic: str, readings: FloatArray, layout: ScanLayout) -> Mend:
    """Limits that hold all readings, and what is declared where that does."""
    low = min(layout.range_min_m, 0.99 * float(readings.min()))
    high = max(layout.range_max_m, 1.01 * float(readings.max()))
    return Mend("set_range_limits", topic, {"range_min_m": low, "range_max_m": high})


def _outside_share(readings: FloatArray, layout: ScanLayout) -> float:
    """Of readings; those of a common largest value above the maximum are its code for nothing."""
    slack = _LIMIT_TOLERANCE * layout.range_max_m
    below = readings < layout.range_min_m - _LIMIT_TOLERANCE
    above = (readings > layout.range_max_m + slack) & (readings < readings.max() * _OVERFLOW)
    return float((below | above).mean())
