"""A clock that was set during the recording: from one message to the next its stamps leap."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import BY_SCANS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, anywhere, judge, unanswered
from slamsim.check.questions.streams.series import StampSeries
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

MAX_STEP_S = 0.01
"""Clocks of two computers are kept together to a millisecond; a tenth of a turn at 1 rad/s is seen
0.1 m aside at a wall 10 m away."""
_AROUND = 50
"""Messages on each side by which a leap is told from a single message that waited."""
_LASTS = 0.8
"""Of the leap, that the middle of those after it keeps."""
_OF_STAMPS = 0.5
"""Of the leap, by which the step between the stamps is longer or shorter than usual. Where the
network's delay changes, messages come late and the stamps go on evenly."""

CLOCK_STEP = FaultKind(
    "clock_step",
    "a clock is set during the recording",
    (
        anywhere(
            *("clock_drift", "stamps_invented", "stream_gaps", "stamps_late", "stamps_future"),
            *BY_SCANS,
            *("time_offset_imu", "time_offset_wheels"),
        ),
    ),
)
STEP = Question(
    "time.step",
    "the clock of the stamps is never set during the recording",
    (CLOCK_STEP,),
    limit=1e3 * MAX_STEP_S,
    unit="ms",
    consequence="from then on scans are placed where the robot was before or after",
    excitation_wanted=f"{2 * _AROUND} messages with times of receipt",
    repairs=("undo_clock_step",),
)


def check_step(series: StampSeries) -> Finding:
    """The largest leap of the stamps against their receipt that lasts."""
    received_ns = series.received_ns
    if received_ns is None or series.is_copied or len(series) < 2 * _AROUND:
        words = "no times of receipt beside the stamps, or too few messages, to see a clock set"
        return unanswered(STEP, series.subject, words)
    delay_s = (received_ns - received_ns[0]) * 1e-9 - series.since_first_s
    leaps = np.flatnonzero(np.abs(np.diff(delay_s)) > MAX_STEP_S)
    lasting = [(int(at), found) for at in leaps if (found := _stepped_s(series, delay_s, int(at)))]
    if not lasting:
        words = "the clock of the stamps is never set against the receiver's"
        return judge(STEP, series.subject, words, Measurement(0.0, 0.0, "ms"))
    at, leap_s = max(lasting, key=lambda one: abs(one[1]))
    after_s = float(series.since_first_s[at])
    curve = Curve("receipt less stamp", series.since_first_s, delay_s)
    told = f"{1e3 * abs(leap_s):.4g} ms {'forward' if leap_s > 0.0 else 'back'}"
    return judge(
        STEP,
        series.subject,
        f"the clock of the stamps leaps {told}, {after_s:.1f} s after the first message",
        Measurement(1e3 * abs(leap_s), 0.0, "ms"),
        advice="Let chrony or PTP slew the clock, and set it before a recording begins.",
        repairs=(
            Repair(
                "undo_clock_step",
                series.subject,
                {"after_ns": str(int(series.stamps_ns[at])), "jump_s": leap_s},
            ),
        ),
        fault_plots=(
            Plot(f"Clock of {series.subject}", "stamp (s)", "receipt less stamp (s)", (curve,)),
        ),
    )


def _stepped_s(series: StampSeries, delay_s: FloatArray, at: int) -> float:
    """By how much stamps leap from message ``at`` to the next, 0 unless it lasts and the stamps
    themselves show it."""
    before, after = delay_s[max(at - _AROUND + 1, 0) : at + 1], delay_s[at + 1 : at + 1 + _AROUND]
    if min(before.size, after.size) < _AROUND // 2:
        return 0.0
    leap_s = float(np.median(before) - np.median(after))
    at_once_s = float(delay_s[at] - delay_s[at + 1])
    longer_s = float(series.steps_s[at]) - series.period_s
    lasts = abs(leap_s) > MAX_STEP_S and leap_s / at_once_s > _LASTS
    # Less scatter than leap on both sides: else the delay just varies that much.
    steady = max(map(_spread, (before, after))) < (1.0 - _LASTS) * abs(leap_s)
    return leap_s if lasts and steady and longer_s / leap_s > _OF_STAMPS else 0.0


def _spread(values: FloatArray) -> float:
    return float(np.quantile(values, 0.9) - np.quantile(values, 0.1))
