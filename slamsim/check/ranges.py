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
from slamsim.check.units import declared, metres_of, outside_share, unit_of, wrong_unit
from slamsim.core.types import FloatArray
from slamsim.recording import RawScans, Recording, ScanLayout

MAX_OUTSIDE_SHARE = 2e-3
"""Rounding at the limits themselves puts a few readings a hair outside."""
MIN_COUNT = 20
"""Fewer readings than this are accidents."""


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
        unit = unit_of(recording, scans, sample)
        if unit is not None:
            findings.append(wrong_unit(scans.topic, sample, unit))
            sample = sample.scaled(metres_of(unit))
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
    """angle_max must be where the last beam looks; told of the first layout that is wrong."""
    for number, scan in zip(*np.unique(scans.layout_of, return_index=True), strict=True):
        layout, beams = scans.layouts[int(number)], scans.ranges_m[int(scan)].size
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
        return


def _limits(topic: str, sample: ScanSample) -> Finding:
    layout, readings = sample.layout, positive(sample)
    if not layout.range_max_m > max(layout.range_min_m, 0.0):
        return Finding(
            "ranges.limits",
            topic,
            "bad",
            f"{declared(layout)}: no range can lie between",
            "range_limits",
            "Declare what the data sheet of the lidar says.",
        )
    if readings.size < MIN_COUNT:
        words = f"{readings.size} finite readings in {len(sample.scans)} scans"
        return Finding("ranges.limits", topic, "cannot tell", words)
    outside = outside_share(readings, layout)
    estimate = Estimate(100.0 * outside, 0.0, "%")
    if outside > MAX_OUTSIDE_SHARE:
        low, high = np.quantile(readings, [0.001, 0.999])
        return Finding(
            "ranges.limits",
            topic,
            "bad",
            f"{100.0 * outside:.2g} % of the readings lie outside ({low:.3g} to {high:.3g} m are "
            f"99.8 % of them), {declared(layout)}",
            "range_limits",
            "Declare what the lidar can do, or a SLAM throws good readings away.",
            estimate,
            100.0 * MAX_OUTSIDE_SHARE,
            (_set_limits(topic, readings, layout),),
        )
    words = f"readings about {np.median(readings):.2f} m lie inside, {declared(layout)}"
    return Finding("ranges.limits", topic, "ok", words, estimate=estimate)


def _set_limits(topic: str, readings: FloatArray, layout: ScanLayout) -> Mend:
    """Limits that hold all readings, and what is declared where that does."""
    low = min(layout.range_min_m, 0.99 * float(readings.min()))
    high = max(layout.range_max_m, 1.01 * float(readings.max()))
    return Mend("set_range_limits", topic, {"range_min_m": low, "range_max_m": high})
