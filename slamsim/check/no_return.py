"""How a lidar writes that nothing came back: ``inf`` (REP 117), or some distance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.scan_sample import ScanSample, positive
from slamsim.recording.cleaning.no_return import find_limit

MAX_ZERO_SHARE = 1e-4
MIN_COUNT = 20
"""Fewer readings than this are accidents."""


def check_no_return(topic: str, sample: ScanSample, maximum_is_usual: bool) -> Finding:
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
            f"{count} readings of {len(sample.scans)} scans are exactly {value_m:g} m, far more "
            "than just below: a code for nothing, inside the declared limits",
            "range_max_no_return",
            "Write inf where nothing came back (REP 117), or a wall grows there.",
            Estimate(value_m, 0.0, "m"),
            mends=(Mend("value_to_inf", topic, {"value_m": value_m}),),
            plots=(_histogram(topic, sample),),
        )
    words = "no return is not written as a distance"
    return Finding("ranges.no_return", topic, "ok", words)


def _code_for_nothing(sample: ScanSample) -> tuple[float, int] | None:
    """(value, count) of a largest reading that surfaces would not repeat as often."""
    codes = find_limit(sample.ranges_m, sample.layout.angle_step_rad, np.inf).codes
    value = codes[0].highest_m if codes else np.inf
    count = int((sample.ranges_m == np.float32(value)).sum())
    return (value, count) if value <= sample.layout.range_max_m and count >= MIN_COUNT else None


def _histogram(topic: str, sample: ScanSample) -> Plot:
    counts, edges = np.histogram(positive(sample), bins=120)
    middle = 0.5 * (edges[:-1] + edges[1:])
    curve = Curve("readings", middle, np.log10(counts + 1.0), "line")
    return Plot(f"Readings of {topic}", "range (m)", "log10(count + 1)", (curve,))


def freed_of_codes(sample: ScanSample) -> ScanSample:
    """The sample with ``inf`` in place of zeros and of a distance that means nothing."""
    code = _code_for_nothing(sample)
    values = [np.float32(0.0)] if code is None else [np.float32(0.0), np.float32(code[0])]
    nothing = np.float32(np.inf)
    return replace(
        sample,
        ranges_m=np.where(np.isin(sample.ranges_m, values), nothing, sample.ranges_m),
        following_m=np.where(np.isin(sample.following_m, values), nothing, sample.following_m),
    )
