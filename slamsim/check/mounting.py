"""Where the laser sits on the base: hand-eye calibration against what the transforms declare.

What the laser sees of a turn tells how far from the axle it sits, what it sees of a straight drive
which way it looks (Censi, Franchi, Marchionni & Oriolo 2013).
"""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration import Calibration
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.rolling import POSES_TIMES
from slamsim.check.verdicts import Answer, Question, judged
from slamsim.core.geometry import wrap_angle

YAW_LIMIT_DEG, YAW_HARM_DEG = 0.3, 2.0
PLACE_LIMIT_M, PLACE_HARM_M = 0.01, 0.05
"""What brackets and tape measures leave; tyres that give move the axle by a millimetre."""

DRIVING = "ten metres of straight driving"
TURNING = "turning on the spot to both sides"


def check_mounting(calibration: Calibration) -> list[Finding]:
    """Yaw and place of the laser."""
    inputs = calibration.inputs
    if not calibration.scans_count or inputs.wheels is None:
        return []
    if calibration.alignment.mirror:
        words = (
            "the scans turn the wrong way: how the laser sits cannot be told before that is mended"
        )
        return [Finding("laser.mounting", inputs.laser_frame, "cannot tell", words)]
    if inputs.T_base_laser is None:
        words = f"nothing declares where {inputs.laser_frame or 'the laser'} sits on the base"
        x, y, yaw = (calibration.value(name) for name in _NAMES)
        words += f"; by its motion x {x:.3f} m, y {y:.3f} m, yaw {np.degrees(yaw):.2f} deg"
        return [Finding("laser.mounting", inputs.laser_frame, "cannot tell", words)]
    if not calibration.follows("wheel"):
        words = f"the wheels' turns do not follow those of the scans; what would tell: {TURNING}"
        return [Finding("laser.mounting", inputs.laser_frame, "cannot tell", words)]
    return [_yaw(calibration), _place(calibration, 0), _place(calibration, 1)]


_NAMES = ("laser_x_m", "laser_y_m", "laser_yaw_rad")


def _times(calibration: Calibration) -> float:
    """How much coarser poses are than counters."""
    wheels = calibration.model.wheels
    return 1.0 if wheels is None or wheels.wired else POSES_TIMES


def _mend(calibration: Calibration) -> Mend:
    found = {
        name: calibration.value(long)
        for name, long in zip(("x_m", "y_m", "yaw_rad"), _NAMES, strict=True)
    }
    found["yaw_rad"] = float(wrap_angle(np.asarray(found["yaw_rad"])))
    parameters: dict[str, float | str] = {"parent": calibration.inputs.base_frame, **found}
    return Mend("set_mounting", calibration.inputs.laser_frame, parameters)


def _yaw(calibration: Calibration) -> Finding:
    inputs = calibration.inputs
    assert inputs.T_base_laser is not None
    off = float(wrap_angle(np.asarray(calibration.value("laser_yaw_rad") - inputs.T_base_laser[2])))
    sigma = calibration.sigma("laser_yaw_rad")
    return judged(
        Question(
            *("laser.yaw", inputs.laser_frame, "laser_yaw"),
            *(_times(calibration) * YAW_LIMIT_DEG, YAW_HARM_DEG, DRIVING),
        ),
        Estimate(float(np.degrees(off)), float(np.degrees(sigma)), "deg"),
        Answer(
            f"the laser looks {np.degrees(off):+.3g} deg further to the left than declared",
            f"Turn its transform by {np.degrees(off):.3f} deg about z.",
            (_mend(calibration),),
        ),
    )


def _place(calibration: Calibration, axis: int) -> Finding:
    """x or y."""
    inputs = calibration.inputs
    assert inputs.T_base_laser is not None
    name = _NAMES[axis]
    off_m = calibration.value(name) - float(inputs.T_base_laser[axis])
    estimate = Estimate(1e3 * off_m, 1e3 * calibration.sigma(name), "mm")
    side = ("forward", "to the left")[axis]
    return judged(
        Question(
            *(f"laser.{'xy'[axis]}", inputs.laser_frame, "laser_position"),
            *(_times(calibration) * 1e3 * PLACE_LIMIT_M, 1e3 * PLACE_HARM_M, TURNING),
        ),
        estimate,
        Answer(
            f"the laser sits {1e3 * off_m:+.1f} mm further {side} than declared",
            f"Correct {'xy'[axis]} of its transform.",
            (_mend(calibration),),
        ),
    )
