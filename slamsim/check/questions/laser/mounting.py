"""Where the laser sits on the base: hand-eye calibration against what the transforms declare.

What the laser sees of a turn tells how far from the axle it sits, what it sees of a straight drive
in which direction it looks (Censi, Franchi, Marchionni & Oriolo 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slamsim.check.calibration.explanation import PLACE_LIMIT_M, Explanation
from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.thinned import Thinned
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement, decide
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.check.questions.frames.directions import frames_without_sensor
from slamsim.check.wording import SIDES
from slamsim.core.geometry import se2_from_se3, wrap_angle
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

YAW_LIMIT_DEG = 0.3
"""What brackets leave."""

DRIVING = "ten metres of straight driving"
TURNING = "turning on the spot to both sides"


_NAMES = ("laser_x_m", "laser_y_m", "laser_yaw_rad")

LASER_POSITION = FaultKind("laser_position", "the laser sits elsewhere than declared")
MOUNTING = Question(
    "laser.mounting",
    "it is declared where the laser sits, and scans can tell whether that is so",
    (),
    consequence="scans are placed where nothing says they belong",
    excitation_wanted=TURNING,
)
YAW = Question(
    "laser.yaw",
    "the laser looks where it is declared to look",
    (FaultKind("laser_yaw", "the laser is mounted with another yaw than declared"),),
    limit=YAW_LIMIT_DEG,
    unit="deg",
    consequence="scans and odometry disagree about the direction of every metre driven",
    excitation_wanted=DRIVING,
    repairs=("set_mounting",),
)
PLACE = tuple(
    Question(
        f"laser.{axis}",
        f"the laser sits where it is declared to sit, along {axis}",
        (LASER_POSITION,),
        limit=1e3 * PLACE_LIMIT_M,
        unit="mm",
        consequence="scans and odometry disagree about the path of every turn",
        excitation_wanted=TURNING,
        repairs=("set_mounting",),
    )
    for axis in "xy"
)


FRAME = Question(
    "laser.frame",
    "the scans name the frame in which the laser sits",
    (
        FaultKind(
            "laser_frame",
            "the scans name the frame of another part of the robot",
            (anywhere("laser_yaw", "laser_position"),),
        ),
    ),
    consequence="scans are placed where that other part sits",
    excitation_wanted=f"{TURNING}, and {DRIVING}",
    repairs=("rename_frame",),
)


def check_mounting(
    calibration: Calibration, explained: Explanation, thinned: Thinned | None = None
) -> list[Finding]:
    """Yaw and place of the laser. thinned: which of its beams were kept."""
    inputs = calibration.inputs
    if not calibration.scans_count or inputs.wheels is None:
        return []
    frame = inputs.laser_frame
    if calibration.alignment.mirror:
        words = "the scans turn the wrong way, which must be repaired before the mount is measured"
        return [unanswered(MOUNTING, frame, words)]
    if inputs.T_base_laser is None:
        x, y, yaw = (calibration.value(name) for name in _NAMES)
        words = (
            f"nothing declares where {frame or 'the laser'} sits on the base; by its motion "
            f"x {x:.3f} m, y {y:.3f} m, yaw {np.degrees(yaw):.2f} deg"
        )
        return [unanswered(MOUNTING, frame, words)]
    if not calibration.follows("wheel"):
        words = f"the wheels' turns do not follow those of the scans; what would tell: {TURNING}"
        return [unanswered(MOUNTING, frame, words)]
    declared, found = inputs.T_base_laser, _mount(calibration, explained)
    if thinned is not None:  # its angles, put right, turn all rays as well
        found[2] -= thinned.turned_rad
    return [
        _yaw(calibration, declared, found),
        _place(calibration, declared, found, 0),
        _place(calibration, declared, found, 1),
    ]


def _checked(evidence: RecordingEvidence) -> list[Finding]:
    """``check_mounting``, and whether the laser sits where another frame is."""
    calibration, explained, recording = (
        evidence.calibration,
        evidence.explanation,
        evidence.recording,
    )
    if calibration is None or explained is None:
        return []
    found = check_mounting(calibration, explained, evidence.thinned)
    if not any(one.fault for one in found):
        return found
    inputs, asked = calibration.inputs, [YAW.id, *(place.id for place in PLACE)]
    named = [stream.topic for stream in recording.streams if inputs.laser_frame in stream.frame_ids]
    if len(named) > 1:  # What moves the frame moves the other sensor as well.
        found = [replace(one, repairs=()) if one.check in asked else one for one in found]
    others = [
        frame
        for frame in frames_without_sensor(recording, inputs.base_frame)
        if _sits(calibration, evidence.frames.between(inputs.base_frame, frame), found)
    ]
    return [*found, *(_named(calibration, frame) for frame in others[:1])]


GROUP = QuestionGroup("motion", 180, (MOUNTING, YAW, *PLACE, FRAME), _checked, thorough=True)


def _sits(
    calibration: Calibration, T_base_frame: FloatArray | None, found: Sequence[Finding]
) -> bool:
    """Whether the laser, by its motion, sits where a frame is, as far as that can be told."""
    declared = calibration.inputs.T_base_laser
    if T_base_frame is None or declared is None:
        return False
    if bool(T_base_frame[2, 2] < 0.0) != calibration.inputs.upside_down:
        return False
    other = se2_from_se3(T_base_frame) - declared
    apart = {
        YAW.id: float(np.degrees(wrap_angle(other[2]))),
        **{place.id: 1e3 * float(other[axis]) for axis, place in enumerate(PLACE)},
    }
    return all(
        decide(one.estimate, one.limit or 0.0, apart[one.check]) != "fault"
        for one in found
        if one.estimate is not None and one.check in apart
    )


def _named(calibration: Calibration, frame: str) -> Finding:
    inputs = calibration.inputs
    return judge(
        FRAME,
        inputs.steps.topic,
        f"its messages name {inputs.laser_frame}, but the laser sits where {frame} is",
        verdict="fault",
        advice=f"Give the driver the frame {frame}.",
        repairs=(Repair("rename_frame", inputs.steps.topic, {"frame": frame}),),
    )


def _mount(calibration: Calibration, explained: Explanation) -> FloatArray:
    """(3,) x, y, yaw by the motion. Scans measure the lever arm of a turn in lengths of their own:
    ranges that are too long by a share make it longer by as much."""
    found = np.array([calibration.value(name) for name in _NAMES])
    too_long = explained.too_large["ranges"] if "ranges" in explained.wrong else None
    if too_long is not None:
        found[:2] /= 1.0 + too_long.value / 100.0
    return found


def _repair(calibration: Calibration, found: FloatArray) -> Repair:
    x_m, y_m, yaw_rad = found[0], found[1], float(wrap_angle(found[2]))
    pose: dict[str, float | str] = {"x_m": float(x_m), "y_m": float(y_m), "yaw_rad": yaw_rad}
    parameters = {"parent": calibration.inputs.base_frame, **pose}
    return Repair("set_mounting", calibration.inputs.laser_frame, parameters)


def _yaw(calibration: Calibration, declared: FloatArray, found: FloatArray) -> Finding:
    """declared, found: (3,) T_base_laser as x, y, yaw."""
    off = float(wrap_angle(np.asarray(found[2] - declared[2])))
    sigma, side = calibration.sigma("laser_yaw_rad"), "left" if off > 0.0 else "right"
    return judge(
        YAW,
        calibration.inputs.laser_frame,
        f"the laser looks {abs(np.degrees(off)):.3g} deg further to the {side} than declared",
        Measurement(float(np.degrees(off)), float(np.degrees(sigma)), "deg"),
        advice=f"Turn its transform by {np.degrees(off):.3f} deg about z.",
        repairs=(_repair(calibration, found),),
    )


def _place(calibration: Calibration, declared: FloatArray, found: FloatArray, axis: int) -> Finding:
    """declared, found: (3,) T_base_laser. axis: 0 of x, 1 of y."""
    off_m = float(found[axis] - declared[axis])
    side = SIDES["xy"[axis]][0 if off_m > 0.0 else 1]
    sigma_m, given_m = calibration.sigma(_NAMES[axis]), calibration.given(_NAMES[axis])
    return judge(
        PLACE[axis],
        calibration.inputs.laser_frame,
        f"the laser sits {1e3 * abs(off_m):.1f} mm further {side} than declared",
        Measurement(1e3 * off_m, 1e3 * sigma_m, "mm", allowed=1e3 * given_m),
        advice=f"Correct {'xy'[axis]} of its transform.",
        repairs=(_repair(calibration, found),),
    )
