"""What an inertial unit must show whatever the robot does: gravity, upward, and noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.inertial_values import check_inertial_values
from slamsim.check.moving import moving_at
from slamsim.core.types import GRAVITY_M_S2, BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu, Recording
from slamsim.recording.frame_graph import FrameGraph

GRAVITY_LIMITS_M_S2 = (9.5, 10.5)
"""Of the mean over a drive on a floor, as Cartographer's validator has it."""
MAX_TILT_RAD = float(np.radians(15.0))
"""Of the mean acceleration against the base's vertical: a ramp is less, a sideways unit 90."""
MAX_REPEATED_SHARE = 0.2
MIN_SAMPLES = 20
_TURNING_RAD_S = 0.02


def check_inertial(recording: Recording) -> list[Finding]:
    """Sound readings, gravity's length and direction, and repeats, of every inertial unit."""
    graph = FrameGraph(recording.transforms)
    base = graph.base(recording.odometries[0].child_frame_ids if recording.odometries else ())
    findings: list[Finding] = []
    for imu in recording.imus:
        findings += check_inertial_values(recording, imu)
        finite = is_sound(imu.linear_acceleration_m_s2)
        if int(finite.sum()) < MIN_SAMPLES:
            words = f"{int(finite.sum())} finite samples of {len(imu)}"
            findings.append(Finding("imu.gravity", imu.topic, "cannot tell", words))
            continue
        acceleration = imu.linear_acceleration_m_s2[finite]
        findings += [
            _gravity(imu, acceleration),
            *_direction(imu, acceleration, graph, base),
            _repeats(imu, moving_at(recording, imu.stamps_ns, ask_imus=False)),
        ]
    return findings


def _gravity(imu: RawImu, acceleration: FloatArray) -> Finding:
    mean = acceleration.mean(axis=0)
    length = float(np.linalg.norm(mean))
    estimate = Estimate(length, 0.0, "m/s^2")
    low, high = GRAVITY_LIMITS_M_S2
    words = f"the mean acceleration is {length:.3g} m/s^2"
    if low <= length <= high:
        return Finding("imu.gravity", imu.topic, "ok", words, estimate=estimate, limit=low)
    if 0.9 < length < 1.1:
        mend = Mend("scale_acceleration", imu.topic, {"factor": GRAVITY_M_S2})
        return Finding(
            "imu.gravity",
            imu.topic,
            "bad",
            f"{words}: these are multiples of gravity",
            "gravity_units",
            "Multiply accelerations by 9.80665.",
            estimate,
            low,
            (mend,),
        )
    return Finding(
        "imu.gravity",
        imu.topic,
        "bad",
        f"{words}; a unit at rest feels 9.8, upward",
        "gravity_missing",
        "Publish the raw acceleration: gravity is what tells up from down.",
        estimate,
        low,
    )


def _direction(
    imu: RawImu, acceleration: FloatArray, graph: FrameGraph, base: str
) -> Iterator[Finding]:
    """Whether gravity points up in the base, once turned by the declared mounting."""
    mean = acceleration.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.5:
        return
    T_base_imu = graph.between(base, imu.frame_ids[0]) if imu.frame_ids else None
    if T_base_imu is None:
        words = f"no transform says how {', '.join(imu.frame_ids) or 'its frame'} is mounted"
        yield Finding("imu.axis", imu.topic, "cannot tell", words)
        return
    rotation = T_base_imu[:3, :3]
    up = rotation @ mean / length
    tilt_rad = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    estimate = Estimate(float(np.degrees(tilt_rad)), 0.0, "deg")
    words = f"gravity stands {np.degrees(tilt_rad):.1f} deg off the base's vertical"
    if tilt_rad <= MAX_TILT_RAD:
        yield Finding("imu.axis", imu.topic, "ok", words, estimate=estimate)
        return
    axis = "xyz"[int(np.argmax(np.abs(up)))]
    sign = "+" if up["xyz".index(axis)] > 0 else "-"
    curves = tuple(
        Curve(name, np.arange(len(acceleration), dtype=np.float64), column, "line")
        for name, column in zip("xyz", (acceleration @ rotation.T).T, strict=True)
    )
    yield Finding(
        "imu.axis",
        imu.topic,
        "bad",
        f"{words}: it is felt along {sign}{axis} of {base}",
        "imu_axis",
        "Correct the transform of the unit's frame, or its driver's axes (REP 145: z up, +9.8).",
        estimate,
        float(np.degrees(MAX_TILT_RAD)),
        (Mend("rotate_imu", imu.topic, dict(zip(("up_x", "up_y", "up_z"), up, strict=True))),),
        (Plot("Acceleration in the base", "sample", "m/s^2", curves, (GRAVITY_M_S2,)),),
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
        return Finding("imu.stuck", imu.topic, "cannot tell", words)
    share = float((same & asked).sum() / asked.sum())
    estimate = Estimate(100.0 * share, 0.0, "%")
    words = f"{100.0 * share:.2g} % of the samples repeat the one before while the robot moves"
    if share <= MAX_REPEATED_SHARE:
        return Finding("imu.stuck", imu.topic, "ok", words, estimate=estimate)
    return Finding(
        "imu.stuck",
        imu.topic,
        "bad",
        words,
        "imu_stuck",
        "Look for a driver that publishes faster than the unit samples, or that hangs.",
        estimate,
        100.0 * MAX_REPEATED_SHARE,
    )
