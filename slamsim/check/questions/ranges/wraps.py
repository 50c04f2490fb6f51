"""Ranges that begin anew at zero where they pass a number: a counter of too few bits."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import BY_SCANS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, anywhere, judge, same_subject, unanswered
from slamsim.check.questions.ranges.noise import MOST_M
from slamsim.check.scan_sample import ScanSample, positive
from slamsim.core.types import BoolArray, Float32Array, FloatArray

MOST_ACCIDENTS = 20
"""In the directions of so many beams a surface may seem to go on behind the farthest reading:
something close, beside a wall that is as far as that, in line with it to a few centimetres on two
beams each. A robot that stands sees such a place in each scan, but in one direction."""

_IN_LINE_M = MOST_M
"""Four ranges along a wall bend by no more than a lidar scatters by; surfaces that bend by more are
not counted."""

_JUMP = 0.5
"""Share of the farthest reading. Where ranges begin anew they fall by nearly all of it."""

WRAPPED = Question(
    "ranges.wrapped",
    "no surface goes on at zero where it passes the farthest reading",
    (
        FaultKind(
            "ranges_wrapped",
            "ranges begin anew at zero beyond some distance: a counter of too few bits",
            (
                same_subject("range_zero_no_return", "range_limits", "range_noise", "beams_lost"),
                anywhere(*BY_SCANS, "time_offset_wheels", "time_offset_imu", "does_not_fit"),
            ),
        ),
    ),
    limit=float(MOST_ACCIDENTS),
    unit="directions",
    consequence="what is far is mapped close to the robot",
    excitation_wanted="surfaces that are seen from one beam to the next, near and far",
    limit_of_ok=False,
)


def check_wraps(topic: str, sample: ScanSample) -> Finding:
    """Neighbouring beams of one surface: two read nearly the most, the next two nearly nothing, and
    all four lie in line once the most is added to those."""
    readings = positive(sample)
    if sample.ranges_m.shape[1] < 4 or not readings.size:
        words = f"too few neighbouring beams; what would tell: {WRAPPED.excitation_wanted}"
        return unanswered(WRAPPED, topic, words)
    most_m = float(readings.max())
    wraps = [_wraps(rows, most_m) for rows in (sample.ranges_m, sample.ranges_m[:, ::-1])]
    count = sum(int(each.any(axis=0).sum()) for each in wraps)
    return judge(
        WRAPPED,
        topic,
        {
            "ok": "no surface goes on at zero where it passes the farthest reading",
            "fault": f"in {count} directions a surface that passes {most_m:.4g} m goes on at zero",
        },
        Measurement(float(count), 0.0, "directions"),
        advice=f"Look for a driver that keeps too few bits of a range: all beyond {most_m:.4g} m "
        "read that much too little.",
        fault_plots=(_plot(topic, sample, wraps[0] | wraps[1][:, ::-1], most_m),),
    )


def _wraps(ranges_m: Float32Array, most_m: float) -> BoolArray:
    """(scans, beams - 3) where ranges, read in this direction, pass the most between the second and
    the third of four beams. A number near zero that stands for no return is the same twice."""
    first, second, third, fourth = (
        ranges_m[:, begin : ranges_m.shape[1] - 3 + begin].astype(np.float64) for begin in range(4)
    )
    with np.errstate(invalid="ignore"):  # inf is no return, which bends everything
        falls = (second - third > _JUMP * most_m) & (third > 0.0) & (first > 0.0) & (fourth > 0.0)
        falls &= third != fourth
        third, fourth = third + most_m, fourth + most_m
        bent = np.abs(first - 2.0 * second + third), np.abs(second - 2.0 * third + fourth)
        return np.asarray(falls & (np.maximum(*bent) < _IN_LINE_M))


def _plot(topic: str, sample: ScanSample, wraps: BoolArray, most_m: float) -> Plot:
    """The scan in which most surfaces pass the farthest reading."""
    shown: FloatArray = sample.ranges_m[int(np.argmax(wraps.sum(axis=1)))].astype(np.float64)
    curve = Curve("readings", np.arange(shown.size, dtype=np.float64), shown)
    return Plot(f"One scan of {topic}", "beam", "range (m)", (curve,), (most_m,))
