"""A gyroscope that the robot out-turns: its rates end at one value."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, same_subject
from slamsim.check.questions.inertial.frozen import changed_axes, has_noise
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu

LEAST_AT_END = 10
TIMES_AS_OFTEN, BELOW = 5.0, 5
"""The largest rate comes so many times as often as any of so many values just below it. Without a
limit the largest of noisy values comes about as often as those, and once where none is rounded."""

SATURATED = Question(
    "gyro.range",
    "the gyroscope's rates are not cut off at a largest one",
    (
        FaultKind(
            "gyro_saturated",
            "the robot turns faster than the gyroscope can tell",
            (
                same_subject(
                    *("gyro_scale", "gyro_bias", "time_offset_imu"),
                    *("imu_orientation", "imu_stuck"),
                ),
            ),
        ),
    ),
    limit=0.0,
    unit="%",
    consequence="the heading falls behind in every fast turn",
    limit_of_ok=False,
)


def check_saturation(evidence: RecordingEvidence) -> Iterator[Finding]:
    """How often each gyroscope gives its largest rate, of either sign."""
    for imu in evidence.recording.imus:
        sound = is_sound(imu.angular_velocity_rad_s)
        if int(sound.sum()) > LEAST_AT_END:
            yield _at_end(imu, imu.angular_velocity_rad_s[sound], imu.stamps_ns[sound])


GROUP = QuestionGroup("inertial unit", 52, (SATURATED,), check_saturation)


def _at_end(imu: RawImu, rates: FloatArray, stamps_ns: IntArray) -> Finding:
    # A simulator without noise turns at the same rate again and again.
    noisy = has_noise(changed_axes(imu))
    ends = [_end(rate) if noisy else (0.0, 0) for rate in np.abs(rates.T)]
    axis = int(np.argmax([count for _, count in ends]))
    most_rad_s, count = ends[axis]
    name = "xyz"[axis]
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    curve = Curve(f"about {name}", seconds, rates[:, axis], "line")
    return judge(
        SATURATED,
        imu.topic,
        {
            "ok": "rates are not cut off at a largest one",
            "fault": f"{count} rates about {name} are exactly {most_rad_s:.4g} rad/s, and none is "
            "larger",
        },
        Measurement(100.0 * count / len(rates), 0.0, "%"),
        advice="Set a larger range in the unit's driver; until then trust scans in fast turns.",
        fault_plots=(
            Plot(
                *(f"Rates of {imu.topic}", "stamp (s)", "rad/s", (curve,)),
                limits=(-most_rad_s, most_rad_s),
            ),
        ),
    )


def _end(sizes: FloatArray) -> tuple[float, int]:
    """(the largest of sizes (n,), how often it comes if far more often than others: else 0)."""
    values, counts = np.unique(sizes, return_counts=True)
    at_end, below = int(counts[-1]), counts[-1 - BELOW : -1].max(initial=0)
    if len(values) <= BELOW or at_end < LEAST_AT_END or at_end <= TIMES_AS_OFTEN * below:
        return float(values[-1]), 0
    return float(values[-1]), at_end
