"""Checks of an inertial unit that hold for any motion: gravity, its direction, and noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.moving import moving_at
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    judge,
    same_subject,
    unanswered,
)
from slamsim.check.questions.inertial.frozen import IMU_STUCK
from slamsim.check.questions.inertial.readings import (
    AXES,
    LEAPS,
    ORIENTATION,
    SPIKES,
    VALUES,
    check_readings,
)
from slamsim.core.types import GRAVITY_M_S2, BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair

GRAVITY_LIMITS_M_S2 = (9.5, 10.5)
"""Of the usual reading of a drive on a floor; Cartographer's validator has them for the mean."""
UNITS_M_S2 = {
    "multiples of gravity": GRAVITY_M_S2,
    "thousandths of gravity": 1e-3 * GRAVITY_M_S2,
    "cm/s^2": 1e-2,
    "mm/s^2": 1e-3,
    "feet/s^2": 0.3048,
}
_SAME_UNIT = 0.1
MAX_TILT_RAD = float(np.radians(6.0))
"""Of gravity against the base's vertical while the robot does not turn: consumer units are off by
50 mg on both level axes (InvenSense MPU-6050, zero-g output), which is 4 degrees, and sit straight
within 2."""
MAX_TURNING_TILT_RAD = float(np.radians(15.0))
"""Of a unit that turns all the time: 1.5 m/s at 1 rad/s are 9 degrees to the side."""
_STRAIGHT_RAD_S = 0.1
"""Turning no faster, a robot at 1 m/s feels less than 0.6 degrees to the side."""
MAX_REPEATED_SHARE = 0.2
"""Drivers that read faster than the unit measures repeat half of all readings or more; by rounding
alone single ones are equal."""
MIN_SAMPLES = 20
_PARTS = 20
"""Over a part of a drive vibration comes to nothing, and the middle one of so many parts is moved
by no few spikes."""
_TURNING_RAD_S = 0.02
"""Turning faster, no two readings of six axes are equal by chance."""


GRAVITY_UNITS = FaultKind("gravity_units", "accelerations are in another unit than m/s^2")
GRAVITY_MISSING = FaultKind("gravity_missing", "the accelerometer does not feel gravity")
IMU_AXIS = FaultKind(
    "imu_axis",
    "the inertial unit is mounted otherwise than declared",
    (same_subject("gyro_sign", "gyro_scale", "gyro_bias"),),
)
GRAVITY = Question(
    "imu.gravity",
    "the median acceleration is gravity",
    (GRAVITY_UNITS, GRAVITY_MISSING),
    unit="m/s^2",
    consequence="filters take gravity, or its lack, for a motion of the robot",
    excitation_wanted=f"{MIN_SAMPLES} finite readings",
    repairs=("scale_acceleration",),
)
AXIS = Question(
    "imu.axis",
    "gravity points up in the base",
    (IMU_AXIS,),
    limit=float(np.degrees(MAX_TILT_RAD)),
    unit="deg",
    consequence="turns are felt about the wrong axis",
    excitation_wanted="a transform from the base to the unit's frame",
    repairs=("rotate_imu",),
    limit_of_ok=False,
)
STUCK = Question(
    "imu.stuck",
    "readings change while the robot moves",
    (IMU_STUCK,),
    limit=100.0 * MAX_REPEATED_SHARE,
    unit="%",
    consequence="a filter trusts old readings as if they were new",
    excitation_wanted="driving or turning",
    limit_of_ok=False,
)


def check_inertial(evidence: RecordingEvidence) -> list[Finding]:
    """Sound readings, gravity's length and direction, and repeats, of every inertial unit."""
    recording, graph, base = evidence.recording, evidence.frames, evidence.base
    findings: list[Finding] = []
    for imu in recording.imus:
        findings += check_readings(recording, imu)
        finite = is_sound(imu.linear_acceleration_m_s2)
        if int(finite.sum()) < MIN_SAMPLES:
            words = f"{int(finite.sum())} finite samples of {len(imu)}"
            findings.append(unanswered(GRAVITY, imu.topic, words))
            continue
        acceleration = imu.linear_acceleration_m_s2[finite]
        findings += [
            _gravity(imu, acceleration),
            *_direction(imu, finite, graph, base),
            _repeats(imu, moving_at(recording, imu.stamps_ns, ask_imus=False)),
        ]
    return findings


GROUP = QuestionGroup(
    "inertial unit",
    50,
    (VALUES, SPIKES, LEAPS, AXES, ORIENTATION, GRAVITY, AXIS, STUCK),
    check_inertial,
)


def _gravity(imu: RawImu, acceleration: FloatArray) -> Finding:
    length = _length(acceleration)
    low, high = GRAVITY_LIMITS_M_S2
    healthy = low <= length <= high
    unit = None if healthy else _unit_of(length)
    words = f"the median acceleration is {length:.4g} m/s^2"
    factor = UNITS_M_S2[unit] if unit else 1.0
    return judge(
        GRAVITY,
        imu.topic,
        {
            "ok": words,
            "fault": f"{words}: these are {unit}"
            if unit
            else f"{words}; a unit at rest feels 9.8, upward",
        },
        Measurement(length, 0.0, "m/s^2"),
        verdict="ok" if healthy else "fault",
        limit=low,
        fault=GRAVITY_UNITS if unit else GRAVITY_MISSING,
        advice=f"Multiply accelerations by {factor:.6g}."
        if unit
        else "Publish the raw acceleration: gravity is what tells up from down.",
        repairs=(Repair("scale_acceleration", imu.topic, {"factor": factor}),) if unit else (),
    )


def _length(acceleration: FloatArray) -> float:
    """Of gravity: of the median reading, for a few spikes weigh nothing in it, or of the median of
    means, whichever is nearer to gravity. Wheels that jump from contact to contact fall for longer
    than they are pushed: a Husky's median reading was 9.3 m/s^2, its mean 9.8."""
    means = [part.mean(axis=0) for part in np.array_split(acceleration, _PARTS)]
    lengths = np.linalg.norm([np.median(each, axis=0) for each in (acceleration, means)], axis=1)
    return float(lengths[np.argmin(np.abs(lengths - GRAVITY_M_S2))])


def _unit_of(length: float) -> str | None:
    """The unit in which that length is gravity's."""
    off = {unit: abs(length * factor / GRAVITY_M_S2 - 1.0) for unit, factor in UNITS_M_S2.items()}
    nearest = min(off, key=off.__getitem__)
    return nearest if off[nearest] < _SAME_UNIT else None


def _direction(imu: RawImu, finite: BoolArray, graph: FrameGraph, base: str) -> Iterator[Finding]:
    """Whether gravity points up in the base, once turned by the declared mounting."""
    straight = finite & (np.linalg.norm(imu.angular_velocity_rad_s, axis=1) < _STRAIGHT_RAD_S)
    turns = int(straight.sum()) < MIN_SAMPLES
    acceleration = imu.linear_acceleration_m_s2[finite if turns else straight]
    mean = np.median(acceleration, axis=0)  # speeding up and braking are no slope
    length = float(np.linalg.norm(mean))
    if length < 0.5:
        return
    T_base_imu = graph.between(base, imu.frame_ids[0]) if imu.frame_ids else None
    if T_base_imu is None:
        words = f"no transform says how {', '.join(imu.frame_ids) or 'its frame'} is mounted"
        yield unanswered(AXIS, imu.topic, words)
        return
    rotation = T_base_imu[:3, :3]
    up = rotation @ mean / length
    tilt_deg = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    words = f"gravity stands {tilt_deg:.1f} deg off the base's vertical"
    axis = "xyz"[int(np.argmax(np.abs(up)))]
    sign = "+" if up["xyz".index(axis)] > 0 else "-"
    felt = "" if sign + axis == "+z" else f": it is felt along {sign}{axis} of {base}"
    curves = tuple(
        Curve(name, np.arange(len(acceleration), dtype=np.float64), column, "line")
        for name, column in zip("xyz", (acceleration @ rotation.T).T, strict=True)
    )
    yield judge(
        AXIS,
        imu.topic,
        {"ok": words, "fault": words + felt},
        Measurement(tilt_deg, 0.0, "deg"),
        limit=float(np.degrees(MAX_TURNING_TILT_RAD if turns else MAX_TILT_RAD)),
        advice="Correct the transform of the unit's frame, or its driver's axes (REP 145: z up, "
        "+9.8).",
        repairs=(
            Repair("rotate_imu", imu.topic, dict(zip(("up_x", "up_y", "up_z"), up, strict=True))),
        ),
        fault_plots=(Plot("Acceleration in the base", "sample", "m/s^2", curves, (GRAVITY_M_S2,)),),
    )


def _repeats(imu: RawImu, moving: BoolArray | None) -> Finding:
    """Samples that equal the one before while the unit turns, or the odometry says that it moves.

    At rest a simulated unit without noise may repeat itself.
    """
    gyro, accel = imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2
    same = (np.diff(gyro, axis=0) == 0.0).all(axis=1) & (np.diff(accel, axis=0) == 0.0).all(axis=1)
    asked = np.abs(gyro[1:]).max(axis=1) > _TURNING_RAD_S
    if moving is not None:
        asked |= moving[1:]
    if int(asked.sum()) < MIN_SAMPLES:
        words = "the robot hardly moves, so equal samples mean nothing"
        return unanswered(STUCK, imu.topic, words)
    share = float((same & asked).sum() / asked.sum())
    return judge(
        STUCK,
        imu.topic,
        f"{100.0 * share:.2g} % of the samples repeat the one before while the robot moves",
        Measurement(100.0 * share, 0.0, "%"),
        advice="Look for a driver that publishes faster than the unit samples, or that hangs.",
    )
