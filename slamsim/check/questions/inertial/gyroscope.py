"""The gyroscope against scans and wheels: scale, sign, unit, bias."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.explanation import LIMITS, Explanation
from slamsim.check.calibration.joint import Calibration
from slamsim.check.evidence import of_sizes
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    judge,
    same_subject,
    unanswered,
)
from slamsim.check.questions.inertial.gravity import IMU_AXIS
from slamsim.recording.repairs.base import Repair

BIAS_LIMIT_RAD_S = 0.0105
"""0.6 degrees per second, five times the usual turn-on bias of the units that robots carry."""

DEGREES = float(np.degrees(1.0))
"""In a radian."""
SAME_UNIT = 0.1
"""Of 57.3: a scale that is off by less is the unit, no error of the sensor."""
TURNING = "a few full turns on the spot"


_ORIENTATION = same_subject("imu_orientation")  # which is compared with the gyroscope
GYRO_SCALE = FaultKind("gyro_scale", "the gyroscope's scale is wrong", (_ORIENTATION,))
GYRO_DEGREES = FaultKind(
    "gyro_degrees",
    "the gyroscope speaks degrees per second",
    (same_subject("gyro_scale", "gyro_bias"), _ORIENTATION),
)
GYRO_SIGN = FaultKind("gyro_sign", "the gyroscope turns the wrong way", (_ORIENTATION,))
AXIS = Question(
    "gyro.axis",
    "the robot's turns are felt about the base's z axis",
    (IMU_AXIS,),
    consequence="the heading of a filter does not turn with the robot",
    excitation_wanted=TURNING,
)
SCALE = Question(
    "gyro.scale",
    "the gyroscope turns as far as the robot, in radians, to the left",
    (GYRO_SCALE, GYRO_DEGREES, GYRO_SIGN),
    limit=100.0 * LIMITS["gyro"],
    unit="%",
    consequence="the heading is off by this share of every turn until a scan corrects it",
    excitation_wanted=TURNING,
    repairs=("scale_gyro",),
)
BIAS = Question(
    "gyro.bias",
    "the gyroscope reads nothing at rest",
    (FaultKind("gyro_bias", "the gyroscope has a large bias"),),
    limit=BIAS_LIMIT_RAD_S,
    unit="rad/s",
    consequence="the heading drifts by this much, all the time",
    excitation_wanted="standing still for some seconds",
    repairs=("subtract_gyro_bias",),
)


def check_gyro(calibration: Calibration, explained: Explanation) -> list[Finding]:
    """Scale, with sign and unit, and bias."""
    gyro = calibration.inputs.gyro
    if gyro is None:
        return []
    if not calibration.scans_count:
        ratio = 1.0 / calibration.value("gyro_gain")
        words = f"turns by it are {ratio:.4g} of those by the wheels; which is right, scans tell"
        return [unanswered(SCALE, gyro.topic, words)]
    if not calibration.follows("gyro"):
        words = f"its turns do not follow those of the scans; what would tell: {TURNING}"
        return [unanswered(SCALE, gyro.topic, words)]
    if gyro.axis != "z":
        return [_sideways(gyro)]
    return [
        _scale(calibration, gyro, explained.too_large["gyro"]),
        _bias(calibration, gyro, "gyro" in explained.wrong),
    ]


GROUP = QuestionGroup("motion", 170, (AXIS, SCALE, BIAS), of_sizes(check_gyro), thorough=True)


def _sideways(gyro: IntegratedMotion) -> Finding:
    return judge(
        AXIS,
        gyro.topic,
        f"the robot's turns are felt about the {gyro.axis} axis of the base, not about z",
        verdict="fault",
        advice="Correct the rotation of the unit's transform.",
    )


def _scale(
    calibration: Calibration, gyro: IntegratedMotion, too_large: Measurement | None
) -> Finding:
    if too_large is None:
        return unanswered(SCALE, gyro.topic, "nothing tells whether it or the scans turn too far")
    read = (1.0 + too_large.value / 100.0) * float(np.sign(calibration.value("gyro_gain")))
    unit, fault = read, GYRO_SCALE
    if _in_degrees(read):
        unit, fault = DEGREES, GYRO_DEGREES
    elif read < 0.0:
        unit, fault = -1.0, GYRO_SIGN
    return judge(
        SCALE,
        gyro.topic,
        f"it reads {read:.5g} of what the robot turns",
        Measurement(100.0 * (read - 1.0), too_large.sigma, "%"),
        fault=fault,
        advice=f"Divide its rates by {unit:.5g}.",
        repairs=(Repair("scale_gyro", gyro.topic, {"factor": 1.0 / unit}),),
    )


def _in_degrees(read: float) -> bool:
    """Whether a unit that reads so many times what the robot turns speaks degrees."""
    return abs(abs(read) / DEGREES - 1.0) < SAME_UNIT


def _bias(calibration: Calibration, gyro: IntegratedMotion, scaled: bool) -> Finding:
    """scaled: whether its scale is wrong, and a bias within the limit as it turns reads so too."""
    # The fit's bias is of true turns: what it reads at rest has the scale of all that it reads.
    scale = 1.0 / calibration.value("gyro_gain")
    read = calibration.value("gyro_bias_rad_s") * scale
    to_rad = 1.0 / DEGREES if _in_degrees(scale) else 1.0
    sigma = calibration.sigma("gyro_bias_rad_s") * abs(scale)
    return judge(
        BIAS,
        gyro.topic,
        f"it reads {np.degrees(read * to_rad):+.3g} deg/s at rest",
        Measurement(read * to_rad, sigma * to_rad, "rad/s"),
        limit=BIAS_LIMIT_RAD_S * (abs(scale) * to_rad if scaled else 1.0),
        advice="Subtract its mean at rest before use.",
        repairs=(Repair("subtract_gyro_bias", gyro.topic, {"bias_rad_s": read}),),
    )
