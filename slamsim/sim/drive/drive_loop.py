"""The drive loop: a robot in the engine, driven by twist commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.types import Drive, FloatArray
from slamsim.models.differential_drive import left_and_right
from slamsim.sim.bullet import pybullet
from slamsim.sim.drive.follow import Twist
from slamsim.sim.drive.record import Recorder
from slamsim.sim.robot.chassis import Engine
from slamsim.sim.robot.model import RobotModel
from slamsim.sim.robot.motors import build_motors

Vector = tuple[float, ...]

CONTACT_DISTANCE = 8
"""Place of the distance in PyBullet's contact points."""
TOUCHING_M = 0.0005
"""Bullet reports contacts from some distance on; nearer than this, bodies touch."""


class BasePose(NamedTuple):
    """Where base_footprint is; up is the cosine of the robot's tilt."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    up: float


def _nothing_to_watch() -> None:
    return None


class DriveLoop:
    """Commands, motors and record of one robot that is on its way."""

    def __init__(
        self, engine: Engine, robot: RobotModel, rate_hz: int, steps_per_tick: int
    ) -> None:
        self._engine, self._steps_per_tick = engine, steps_per_tick
        self._motors = build_motors(engine, robot.motor, 1.0 / rate_hz, steps_per_tick)
        self._recorder = Recorder(engine.T_base_com, rate_hz, steps_per_tick)
        self._com_base = _inverse_for_pybullet(engine.T_base_com)
        self._wheel_radius_m, self._track_m = robot.wheel_radius_m, robot.track_m
        self._command: Twist = (0.0, 0.0)

    def control_tick(
        self,
        decide: Callable[[BasePose], Twist],
        watch: Callable[[], None] = _nothing_to_watch,
    ) -> None:
        """Decide the command, then record and step until the next control tick.

        watch: called before each step, when its state is recorded. The hot loop: everything is
        looked up once, for each look-up counts at 240 Hz.
        """
        body, client, wheels = self._engine.body, self._engine.client, self._engine.wheels
        read_pose, read_velocity = pybullet.getBasePositionAndOrientation, pybullet.getBaseVelocity
        read_wheels, step, motors = pybullet.getJointStates, self._engine.step, self._motors
        record = self._recorder.states.extend
        for i in range(self._steps_per_tick):
            position, quaternion = read_pose(body, client)
            linear, angular = read_velocity(body, client)
            left, right = read_wheels(body, wheels, client)
            record((*position, *quaternion, *linear, *angular, *left[:2], *right[:2]))
            if i == 0:
                self._obey(decide(self._base_pose(position, quaternion)))
            watch()
            if motors.busy:
                motors.update((left[1], right[1]))
            step()

    def _obey(self, command: Twist) -> None:
        """From the commanded twist to the wheels' speeds."""
        if command != self._command:
            self._command = command
            left_m_s, right_m_s = left_and_right(*self._command, self._track_m)
            radius_m = self._wheel_radius_m
            self._motors.command((left_m_s / radius_m, right_m_s / radius_m))
        touches = any(_touching(self._engine, wall) for wall in self._engine.walls)
        self._recorder.ticks.extend((*command, float(touches)))

    def _base_pose(self, position: Vector, quaternion: Vector) -> BasePose:
        """From the pose of the centre of mass."""
        (x_m, y_m, z_m), (qx, qy, qz, qw) = pybullet.multiplyTransforms(
            position, quaternion, *self._com_base
        )
        yaw_rad = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        return BasePose(x_m, y_m, z_m, yaw_rad, 1.0 - 2.0 * (qx * qx + qy * qy))

    def take_window(self) -> Drive:
        """All motion since the last window, up to the first step that is not a number."""
        return self._recorder.take_window()


def _touching(engine: Engine, other: int) -> bool:
    """Whether the robot touches another body."""
    points = pybullet.getContactPoints(engine.body, other, -2, -2, engine.client)
    return any(point[CONTACT_DISTANCE] < TOUCHING_M for point in points)


def _inverse_for_pybullet(T_base_com: FloatArray) -> tuple[list[float], list[float]]:
    T_com_base: FloatArray = np.linalg.inv(T_base_com).astype(np.float64)
    return T_com_base[:3, 3].tolist(), xyzw_from_matrix(T_com_base[:3, :3]).tolist()
