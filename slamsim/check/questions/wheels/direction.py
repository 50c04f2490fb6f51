"""Detects wheel counters that lose the sign when the robot reverses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.model import LASER_YAW
from slamsim.check.evidence import of_calibration
from slamsim.check.findings import SURE_SIGMAS, Curve, Finding, Measurement, Plot
from slamsim.check.motion.alignment import laser_path
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.core.types import BoolArray, FloatArray

LEAST_STEP_M = 0.003
"""Shorter steps are taken for standstill."""

LEAST_BACKWARD_M = 0.5
SAME_WAY = 0.5
"""Of what the scans say: a wheel that slips shows too much, none shows the other direction."""

_BACKING_UP = "driving backward by a metre"


DIRECTION = Question(
    "odometry.direction",
    "the wheels count backward where the robot backs up",
    (
        FaultKind(
            "odometry_unsigned",
            "the odometry goes forward while the robot drives backward",
            (anywhere("wheel_slip", "odometry_contradicts_wheels"),),
        ),
    ),
    unit="of the path by scans",
    consequence="the odometry leaves the path wherever the robot backs up",
    excitation_wanted=_BACKING_UP,
    limit_of_ok=False,
)


def check_reversing(calibration: Calibration) -> list[Finding]:
    """The path ahead by wheels and by scans, where the scans see the robot back up."""
    wheels = calibration.model.wheels
    if wheels is None or not calibration.scans_count or not calibration.comparable:
        return []
    by_wheels, by_scans, known = _paths(calibration)
    backward, forward = known & (by_scans < -LEAST_STEP_M), known & (by_scans > LEAST_STEP_M)
    behind_m = -float(by_scans[backward].sum())
    if behind_m < LEAST_BACKWARD_M:
        words = (
            f"the robot backs up by {abs(behind_m):.2g} m in all; what would tell: {_BACKING_UP}"
        )
        return [unanswered(DIRECTION, wheels.topic, words)]
    ratio = -float(by_wheels[backward].sum()) / behind_m
    ahead = float(by_wheels[forward].sum()) > SAME_WAY * float(by_scans[forward].sum())
    seen = Curve("steps", by_scans[known], by_wheels[known])
    title = "way ahead of each step by wheels and by scans"
    return [
        judge(
            DIRECTION,
            wheels.topic,
            {
                "ok": f"where scans see the robot back up by {behind_m:.2f} m, wheels say "
                f"{ratio:.2g} of it",
                "fault": f"where the scans see the robot back up, by {behind_m:.2f} m in all, the "
                f"wheels say that it goes {-ratio * behind_m:.2f} m forward",
            },
            Measurement(ratio, 0.0, "of the path by scans"),
            verdict="fault" if ratio <= -SAME_WAY and ahead else "ok",
            limit=-SAME_WAY,
            advice="Look for a driver that adds up lengths, or for counters that cannot tell "
            "direction; do not trust the wheels while the robot backs up.",
            fault_plots=(Plot(title, "scans, m", "wheels, m", (seen,), (0.0,)),),
        )
    ]


GROUP = QuestionGroup("motion", 140, (DIRECTION,), of_calibration(check_reversing), thorough=True)


def _paths(calibration: Calibration) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(n,) path ahead, m, of each step by wheels and by scans, and where both know it."""
    model, values = calibration.model, calibration.fit.values
    T_wheels = model.predicted(values)[0]
    by_wheels, by_scans = (
        laser_path(steps, float(values[LASER_YAW]))
        for steps in (replace(model.steps, T_first_second=T_wheels), model.steps)
    )
    sure = np.abs(by_scans) > SURE_SIGMAS * _sigma(model.steps, float(values[LASER_YAW]))
    return by_wheels, by_scans, np.asarray(model.rolling(values) & sure)


def _sigma(steps: LaserSteps, yaw_rad: float) -> FloatArray:
    """(n,) standard deviation, m, of the path ahead by scans: along a corridor not at all."""
    covariance = np.linalg.pinv(steps.information, hermitian=True)
    ahead = np.array([np.cos(yaw_rad), -np.sin(yaw_rad), 0.0])
    return np.asarray(np.sqrt(np.einsum("i,nij,j->n", ahead, covariance, ahead)))
