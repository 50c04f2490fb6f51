"""How a lidar encodes no return: ``inf`` (REP 117), or some distance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, judge
from slamsim.check.scan_sample import ScanSample, positive
from slamsim.recording.cleaning.no_return import find_limit
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.isolated import isolated_returns

MAX_ZERO_SHARE = 1e-4
MIN_COUNT = 20
"""Fewer readings than this are accidents."""


MOSTLY_ONE = 0.5
"""Of the readings that stand alone, which are one and the same value."""

ZERO = FaultKind("range_zero_no_return", "zero stands for no return")
MAXIMUM = FaultKind("range_max_no_return", "a range within the limits stands for no return")
NO_RETURN = Question(
    "ranges.no_return",
    "no return is not written as a distance",
    (ZERO, MAXIMUM),
    consequence="a wall grows in the map where there is nothing",
    repairs=("zero_to_inf", "value_to_inf"),
)


def check_no_return(topic: str, sample: ScanSample, maximum_is_usual: bool) -> Finding:
    """maximum_is_usual: the format itself writes the maximum where nothing was."""
    ranges = sample.ranges_m
    zeros = int((ranges == 0.0).sum())
    if zeros >= MIN_COUNT and zeros > MAX_ZERO_SHARE * ranges.size:
        share = 100.0 * zeros / ranges.size
        return judge(
            NO_RETURN,
            topic,
            f"{share:.2g} % of the readings are exactly 0, which is a place and not nothing",
            Measurement(share, 0.0, "%"),
            limit=100.0 * MAX_ZERO_SHARE,
            fault=ZERO,
            advice="Write inf where nothing came back (REP 117).",
            repairs=(Repair("zero_to_inf", topic),),
        )
    code = None if maximum_is_usual else _code_for_nothing(sample)
    if code is None:
        return judge(NO_RETURN, topic, "no return is not written as a distance", verdict="ok")
    value_m, count = code
    return judge(
        NO_RETURN,
        topic,
        f"{count} readings of {len(sample.scans)} scans are exactly {value_m:g} m, far more "
        "than just below: a code for nothing, inside the declared limits",
        Measurement(value_m, 0.0, "m"),
        verdict="fault",
        fault=MAXIMUM,
        advice="Write inf where nothing came back (REP 117), or a wall grows there.",
        repairs=(Repair("value_to_inf", topic, {"value_m": value_m}),),
        plots=(_histogram(topic, sample),),
    )


def _code_for_nothing(sample: ScanSample) -> tuple[float, int] | None:
    """(value, count) of a largest reading that surfaces would not repeat as often."""
    codes = find_limit(sample.ranges_m, sample.layout.angle_step_rad, np.inf).codes
    value = codes[0].highest_m if codes else _repeated_alone(sample)
    count = int((sample.ranges_m == np.float32(value)).sum())
    return (value, count) if value <= sample.layout.range_max_m and count >= MIN_COUNT else None


def _repeated_alone(sample: ScanSample) -> float:
    """The largest of the readings that stand alone between their neighbours, if most of these are
    exactly that; ``inf`` otherwise. Stray readings of sunlight or another lidar all differ."""
    if sample.layout.angle_step_rad == 0.0 or sample.ranges_m.shape[1] < 3:
        return np.inf
    alone = isolated_returns(sample.ranges_m, sample.following_m, sample.layout.angle_step_rad)[1]
    values, counts = np.unique(sample.ranges_m[alone], return_counts=True)
    most = counts.size > 0 and counts[-1] > max(MIN_COUNT - 1, MOSTLY_ONE * counts.sum())
    return float(values[-1]) if most else np.inf


def _histogram(topic: str, sample: ScanSample) -> Plot:
    counts, edges = np.histogram(positive(sample), bins=120)
    middle = 0.5 * (edges[:-1] + edges[1:])
    curve = Curve("readings", middle, np.log10(counts + 1.0), "line")
    return Plot(f"Readings of {topic}", "range (m)", "log10(count + 1)", (curve,))


def without_codes(sample: ScanSample) -> ScanSample:
    """The sample with ``inf`` in place of zeros and of a distance that means nothing."""
    code = _code_for_nothing(sample)
    values = [np.float32(0.0)] if code is None else [np.float32(0.0), np.float32(code[0])]
    nothing = np.float32(np.inf)
    return replace(
        sample,
        ranges_m=np.where(np.isin(sample.ranges_m, values), nothing, sample.ranges_m),
        following_m=np.where(np.isin(sample.following_m, values), nothing, sample.following_m),
    )
