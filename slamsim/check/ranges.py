"""Do the ranges mean what REP 117 says: metres, ``inf`` for no return, inside the limits?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.beams import check_beams
from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.repeats import check_repeats
from slamsim.check.scan_sample import ScanSample, sample_scans
from slamsim.check.stray import check_stray
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.types import FloatArray

MAX_ZERO_SHARE = 1e-4
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
_SPIKE_FACTOR = 10.0
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
            _no_return(scans.topic, sample, recording.format == "carmen"),
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
    readings, layout = _positive(sample), sample.layout
    if readings.size < MIN_COUNT or _outside_share(readings, layout) <= _MOST:
        return None
    fits = (unit for unit, factor in UNITS.items()
            if _outside_share(readings * factor, layout) < _HARDLY_ANY)  # fmt: skip
    return next(fits, None)


def _wrong_unit(topic: str, sample: ScanSample, unit: str) -> Finding:
    middle = float(np.median(_positive(sample)))
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
    layout, readings = sample.layout, _positive(sample)
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
        )
    words = f"readings about {np.median(readings):.2f} m lie inside, {_declared(layout)}"
    return Finding("ranges.limits", topic, "ok", words, estimate=estimate)


def _positive(sample: ScanSample) -> FloatArray:
    flat = sample.ranges_m[np.isfinite(sample.ranges_m)].astype(np.float64)
    return flat[flat > 0.0]


def _outside_share(readings: FloatArray, layout: ScanLayout) -> float:
    """Of readings; those of a common largest value above the maximum are its code for nothing."""
    slack = _LIMIT_TOLERANCE * layout.range_max_m
    below = readings < layout.range_min_m - _LIMIT_TOLERANCE
    above = (readings > layout.range_max_m + slack) & (readings < readings.max() * _OVERFLOW)
    return float((below | above).mean())


def _no_return(topic: str, sample: ScanSample, maximum_is_usual: bool) -> Finding:
    """maximum_is_usual: the format itself writes the maximum where nothing was."""
    ranges = sample.ranges_m
    zeros = int((ranges == 0.0).sum())
    if zeros >= MIN_COUNT and zeros > MAX_ZERO_SHARE * ranges.size:
        share = 100.0 * zeros / ranges.size
        return Finding(
            "ranges.no_return",
            topic,
            "bad",
            f"{share:.2g} % of the readings are exactly 0, which is a place and not nothing",
            "range_zero_no_return",
            "Write inf where nothing came back (REP 117).",
            Estimate(share, 0.0, "%"),
            100.0 * MAX_ZERO_SHARE,
            (Mend("zero_to_inf", topic),),
        )
    code = None if maximum_is_usual else _code_for_nothing(sample)
    if code is not None:
        value_m, count = code
        return Finding(
            "ranges.no_return",
            topic,
            "bad",
            f"{count} readings of {len(sample.scans)} scans are exactly {value_m:g} m and hardly "
            "any just below: a code for nothing, inside the declared limits",
            "range_max_no_return",
            "Write inf where nothing came back (REP 117), or a wall grows there.",
            Estimate(value_m, 0.0, "m"),
            mends=(Mend("value_to_inf", topic, {"value_m": value_m}),),
            plots=(_histogram(topic, sample),),
        )
    words = "no return is not written as a distance"
    return Finding("ranges.no_return", topic, "ok", words)


def _code_for_nothing(sample: ScanSample) -> tuple[float, int] | None:
    """(value, count) of a largest reading that is common while nothing lies just below it."""
    readings = _positive(sample)
    if readings.size == 0:
        return None
    value = float(readings.max())
    count = int((readings == value).sum())
    just_below = int(((readings < value) & (readings > 0.95 * value)).sum())
    is_inside = value <= sample.layout.range_max_m
    is_spike = count >= MIN_COUNT and count > _SPIKE_FACTOR * just_below
    return (value, count) if is_inside and is_spike else None


def _histogram(topic: str, sample: ScanSample) -> Plot:
    counts, edges = np.histogram(_positive(sample), bins=120)
    middle = 0.5 * (edges[:-1] + edges[1:])
    curve = Curve("readings", middle, np.log10(counts + 1.0), "line")
    return Plot(f"Readings of {topic}", "range (m)", "log10(count + 1)", (curve,))
