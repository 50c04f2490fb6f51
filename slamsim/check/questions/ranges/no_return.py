"""How a lidar encodes no return: ``inf`` (REP 117), or some distance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, judge
from slamsim.check.scan_sample import ScanSample, positive
from slamsim.core.types import BoolArray, Float32Array
from slamsim.recording.cleaning.no_return import Code, find_limit
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.scans import isolated_returns

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
    value_m, count = _most_frequent(sample, code)
    parameters: dict[str, float | str] = {"value_m": value_m}
    are = f"{count} readings of {len(sample.scans)} scans are exactly {value_m:g} m"
    if code.is_noisy:
        value_m = code.highest_m
        parameters = {"value_m": value_m, "from_m": code.lowest_m}
        are = f"{code.count} readings of {len(sample.scans)} scans are {code}"
    return judge(
        NO_RETURN,
        topic,
        f"{are}, far more than just below: a code for nothing, inside the declared limits",
        Measurement(value_m, 0.0, "m"),
        verdict="fault",
        fault=MAXIMUM,
        advice="Write inf where nothing came back (REP 117), or a wall grows there.",
        repairs=(Repair("value_to_inf", topic, parameters),),
        plots=(_histogram(topic, sample),),
    )


def _code_for_nothing(sample: ScanSample) -> Code | None:
    """Largest readings, within the limits, that surfaces would not repeat as often."""
    code = _code_of_driver(sample)
    if code is None or not (code.is_noisy or _most_frequent(sample, code)[1] >= MIN_COUNT):
        return None
    return code if code.lowest_m <= sample.layout.range_max_m else None


def _code_of_driver(sample: ScanSample) -> Code | None:
    """The code of the largest readings: about the declared maximum, whatever exceeds it, or at any
    distance."""
    for declared_m in (sample.layout.range_max_m, np.inf):
        if not declared_m > 0.0:
            continue
        codes = find_limit(sample.ranges_m, sample.layout.angle_step_rad, declared_m).codes
        if codes and (codes[0].is_noisy or np.isinf(declared_m)):
            return codes[0]
    return _repeated_alone(sample)


def _most_frequent(sample: ScanSample, code: Code) -> tuple[float, int]:
    """The value that most readings of a code have, and how many."""
    values, counts = np.unique(sample.ranges_m[_is_code(sample.ranges_m, code)], return_counts=True)
    most = int(np.argmax(counts))
    return float(values[most]), int(counts[most])


def _is_code(ranges_m: Float32Array, code: Code) -> BoolArray:
    lowest_m, highest_m = np.float32(code.lowest_m), np.float32(code.highest_m)
    return np.asarray((ranges_m >= lowest_m) & (ranges_m <= highest_m))


def _repeated_alone(sample: ScanSample) -> Code | None:
    """The largest of the readings that stand alone between their neighbours, if most of these are
    exactly that. Stray readings of sunlight or another lidar all differ."""
    if sample.layout.angle_step_rad == 0.0 or sample.ranges_m.shape[1] < 3:
        return None
    alone = isolated_returns(sample.ranges_m, sample.following_m, sample.layout.angle_step_rad)[1]
    values, counts = np.unique(sample.ranges_m[alone], return_counts=True)
    most = counts.size > 0 and counts[-1] > max(MIN_COUNT - 1, MOSTLY_ONE * counts.sum())
    return Code(float(values[-1]), float(values[-1]), int(counts[-1])) if most else None


def _histogram(topic: str, sample: ScanSample) -> Plot:
    counts, edges = np.histogram(positive(sample), bins=120)
    middle = 0.5 * (edges[:-1] + edges[1:])
    curve = Curve("readings", middle, np.log10(counts + 1.0), "line")
    return Plot(f"Readings of {topic}", "range (m)", "log10(count + 1)", (curve,))


def without_codes(sample: ScanSample) -> ScanSample:
    """The sample with ``inf`` in place of zeros and of distances that mean nothing."""
    code = _code_for_nothing(sample)

    def cleaned(ranges_m: Float32Array) -> Float32Array:
        nothing = ranges_m == 0.0
        if code is not None:
            nothing |= _is_code(ranges_m, code)
        return np.where(nothing, np.float32(np.inf), ranges_m)

    return replace(
        sample, ranges_m=cleaned(sample.ranges_m), following_m=cleaned(sample.following_m)
    )
