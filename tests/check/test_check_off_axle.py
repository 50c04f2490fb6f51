"""Odometry of a frame that is not at the axle moves sideways in turns, and is right to; so does a
robot that drives to the side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_example import FINE_S, T_BASE_LASER, Robot

from slamsim.check.calibration.joint import calibrate_inputs
from slamsim.check.motion.integrated import integrated_odometry
from slamsim.core.geometry import compose, xyzw_from_yaw
from slamsim.core.types import FloatArray
from slamsim.recording import RawOdometry


class Car(Robot):
    """It does not turn on the spot, and drives fast and slowly."""

    def rates(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        forward = 1.2 + 0.9 * np.sin(0.6 * t)
        return forward, forward * 0.4 * np.sin(1.1 * t)


class Omni(Robot):
    """It turns to where it goes while it goes there already."""

    def totals(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        path, heading, poses = super().totals()
        t = self.times_s()
        aside = 0.15 * self.rates(t)[1] + 0.1 * np.sin(0.9 * t)
        steps = (
            np.column_stack([-np.sin(heading), np.cos(heading)])[:-1] * aside[:-1, None] * FINE_S
        )
        poses[1:, :2] += np.cumsum(steps, axis=0)
        return path, heading, poses


def odometry_of(
    robot: Robot,
    ahead_m: float,
    heading_late_s: float = 0.0,
    left: float = 1.0,
    step_m: float = 0.0,
    noise_m: float = 0.0,
) -> RawOdometry:
    """Poses of a frame so far ahead of the axle, whose heading may come late. left: -1 if mirrored.
    step_m: to which positions are rounded; then they also jump by 30 m. noise_m: of each."""
    t = np.arange(0.1, robot.seconds - 0.1, 0.02)
    times, axle = robot.times_s(), robot.totals()[2]
    at = np.column_stack([np.interp(t, times, axle[:, k]) for k in range(3)])
    poses = compose(at, np.array([ahead_m, 0.0, 0.0]))
    yaw = left * np.interp(t - heading_late_s, times, axle[:, 2])
    poses[:, 1] *= left
    if step_m:
        poses[:, :2] = np.round(poses[:, :2] / step_m) * step_m
        poses[500:, 1] += 30.0
    poses[:, :2] += noise_m * np.random.default_rng(robot.seed).standard_normal((len(t), 2))
    none = np.full((len(t), 3), np.nan)
    return RawOdometry(
        topic="/odom",
        frame_ids=("odom",),
        stamps_ns=5_000_000_000 + np.round(1e9 * t).astype(np.int64),
        received_ns=None,
        child_frame_ids=("base_link",),
        positions_m=np.column_stack([poses[:, :2], np.zeros(len(t))]),
        quats_xyzw=xyzw_from_yaw(yaw),
        linear_m_s=none,
        angular_rad_s=none,
    )


@pytest.mark.parametrize(
    ("ahead_m", "left", "step_m"),
    [(0.15, 1.0, 0.0), (-0.3, 1.0, 0.0), (0.15, -1.0, 0.0), (0.15, 1.0, 0.001)],
)
def test_the_laser_is_found_from_a_base_that_is_not_at_the_axle(
    ahead_m: float, left: float, step_m: float
) -> None:
    robot = Car(seed=1)
    wheels = integrated_odometry(odometry_of(robot, ahead_m, left=left, step_m=step_m))
    declared = T_BASE_LASER - [ahead_m, 0.0, 0.0]
    inputs = replace(robot.inputs(), wheels=wheels, T_base_laser=declared)
    calibration = calibrate_inputs(inputs)
    assert calibration is not None
    off_m = calibration.value("laser_x_m") - declared[0]
    assert abs(off_m) < 3.0 * calibration.sigma("laser_x_m") < 0.01


@pytest.mark.parametrize(("ahead_m", "late_s"), [(0.0, 0.0), (0.0, 0.08), (0.001, 0.0)])
def test_a_frame_at_the_axle_is_not_taken_for_one_ahead(ahead_m: float, late_s: float) -> None:
    wheels = integrated_odometry(odometry_of(Car(seed=1), ahead_m, late_s))
    assert wheels is not None and wheels.sideways_m is None


@pytest.mark.parametrize(("left", "rolled"), [(1.0, 1.0), (-1.0, 1.0), (1.0, 0.85)])
def test_the_laser_is_found_on_a_robot_that_drives_sideways(left: float, rolled: float) -> None:
    """rolled: how far rollers bring it to the side, of what they turn."""
    robot = Omni(seed=2)
    wheels = integrated_odometry(odometry_of(robot, 0.0, left=left))
    assert wheels is not None and wheels.aside_m is not None and wheels.sideways_m is None
    wheels = replace(wheels, aside_m=wheels.aside_m / rolled)
    calibration = calibrate_inputs(replace(robot.inputs(), wheels=wheels))
    assert calibration is not None
    off_m = calibration.value("laser_x_m") - T_BASE_LASER[0]
    assert abs(off_m) < 3.0 * calibration.sigma("laser_x_m") < 0.01


@pytest.mark.parametrize(
    ("robot", "late_s", "noise_m"),
    [(Robot(seed=3), 0.0, 0.003), (Car(seed=1), 0.08, 0.0), (Car(seed=1), 0.0, 0.003)],
)
def test_steps_to_the_side_that_no_scan_sees_are_left_out(
    robot: Robot, late_s: float, noise_m: float
) -> None:
    wheels = integrated_odometry(odometry_of(robot, 0.0, late_s, noise_m=noise_m))
    calibration = calibrate_inputs(replace(robot.inputs(), wheels=wheels))
    assert calibration is not None
    assert calibration.model.wheels is not None and calibration.model.wheels.sideways_m is None
