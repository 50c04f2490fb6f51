"""The gyroscope against scans and wheels: scale, sign, unit, bias."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.majority import Vote
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.judge import Answer, Question, judged
from slamsim.check.motion.integrated import Course

SCALE_LIMIT, SCALE_HARM = 0.01, 0.03
"""Consumer gyroscopes are sold with 1 % of scale error; 3 % are ten degrees in a full turn."""

BIAS_LIMIT_RAD_S, BIAS_HARM_RAD_S = 0.0105, 0.03
"""0.6 degrees per second, five times the usual turn-on bias of the units that robots carry."""

DEGREES = np.degrees(1.0)
SAME_UNIT = 0.1
TURNING = "a few full turns on the spot"


def check_gyro(calibration: Calibration, vote: Vote) -> list[Finding]:
    """Scale, with sign and unit, and bias."""
    gyro = calibration.inputs.gyro
    if gyro is None:
        return []
    if not calibration.scans_count:
        ratio = 1.0 / calibration.value("gyro_gain")
        words = f"turns by it are {ratio:.4g} of those by the wheels: without scans nobody knows"
        return [Finding("gyro.scale", gyro.topic, "cannot tell", words)]
    if not calibration.follows("gyro"):
        words = f"its turns do not follow those of the scans; what would tell: {TURNING}"
        return [Finding("gyro.scale", gyro.topic, "cannot tell", words)]
    if gyro.axis != "z":
        return [_sideways(gyro)]
    return [_scale(calibration, vote), _bias(calibration)]


def _sideways(gyro: Course) -> Finding:
    words = f"the robot's turns are felt about the {gyro.axis} axis of the base, not about z"
    advice = "Correct the rotation of the unit's transform."
    return Finding("gyro.axis", gyro.topic, "bad", words, "imu_axis", advice)


def _scale(calibration: Calibration, vote: Vote) -> Finding:
    gyro = calibration.inputs.gyro
    assert gyro is not None
    read = 1.0 / vote.gyro_gain
    sigma = calibration.sigma("gyro_gain") / calibration.value("gyro_gain") ** 2
    unit, fault = read, "gyro_scale"
    if abs(abs(read) / DEGREES - 1.0) < SAME_UNIT:
        unit, fault = DEGREES, "gyro_degrees"
    elif read < 0.0:
        unit, fault = -1.0, "gyro_sign"
    words = f"it reads {read:.5g} of what the robot turns"
    if vote.laser_gain != 1.0:
        words = f"it turns like the wheels, while the scans turn {vote.laser_gain:.4g} times as far"
    advice = f"Divide its rates by {unit:.5g}."
    return judged(
        Question(
            *("gyro.scale", gyro.topic, fault, 100.0 * SCALE_LIMIT, 100.0 * SCALE_HARM, TURNING)
        ),
        Estimate(100.0 * (read - 1.0), 100.0 * sigma, "%"),
        Answer(words, advice, (Mend("scale_gyro", gyro.topic, {"factor": 1.0 / unit}),)),
    )


def _bias(calibration: Calibration) -> Finding:
    gyro = calibration.inputs.gyro
    assert gyro is not None
    # What it reads when the robot stands, in true radians.
    bias = calibration.value("gyro_bias_rad_s")
    read = bias / calibration.value("gyro_gain")
    return judged(
        Question(
            *("gyro.bias", gyro.topic, "gyro_bias", BIAS_LIMIT_RAD_S, BIAS_HARM_RAD_S),
            "standing still for some seconds",
        ),
        Estimate(bias, calibration.sigma("gyro_bias_rad_s"), "rad/s"),
        Answer(
            f"it turns by {np.degrees(bias):+.3g} deg/s at rest",
            "Subtract its mean at rest before use.",
            (Mend("subtract_gyro_bias", gyro.topic, {"bias_rad_s": read}),),
        ),
    )
