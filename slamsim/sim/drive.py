"""Drives the robot along a route and records its true motion at the physics rate."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import DriveConfig, PhysicsConfig
from slamsim.geometry import xyzw_from_matrix
from slamsim.progress import Progress, silent
from slamsim.sim.bullet import pybullet
from slamsim.sim.engine import Engine, hold_wheels, running_engine
from slamsim.sim.floor import Floor
from slamsim.sim.motors import build_motors
from slamsim.sim.pilot import Pilot
from slamsim.sim.record import Recorder
from slamsim.sim.robot import RobotModel
from slamsim.sim.route import Route
from slamsim.types import Drive, FloatArray

if TYPE_CHECKING:
    from slamsim.world.model import World

Vector = tuple[float, ...]

CONTACT_DISTANCE = 8
"""Place of the distance in PyBullet's contact points."""
TOUCHING_M = 0.0005


@dataclass(frozen=True, slots=True)
class DriveOutcome:
    """How a drive ended.

    finished: whether the route was driven to its end or to the configured largest duration.
    reason: how it ended, in words. duration_s: in control ticks, each recorded whole.
    path_length_m: of the true path.
    """

    finished: bool
    reason: str
    duration_s: float
    path_length_m: float


class DriveRun:
    """A drive as an iterable of consecutive windows; each iteration drives anew, identically.

    The physics runs while the windows are taken, so that memory does not grow with the drive.
    """

    def __init__(
        self,
        world: World,
        robot: RobotModel,
        route: Route,
        config: DriveConfig,
        progress: Progress = silent,
    ) -> None:
        self._world, self._robot, self._route = world, robot, route
        self._config, self._progress = config, progress
        self._outcome: DriveOutcome | None = None

    @property
    def outcome(self) -> DriveOutcome:
        """Raises RuntimeError until the last window has been taken."""
        if self._outcome is None:
            raise RuntimeError("the outcome of a drive is known once its last window was taken")
        return self._outcome

    def __iter__(self) -> Iterator[Drive]:
        self._outcome = None
        with running_engine(self._world, self._robot, self._config.physics) as engine:
            ride = _Ride(engine, self._world, self._robot, self._route, self._config)
            path_length_m, last = 0.0, np.empty((0, 2))
            for window in ride.windows(self._progress, self._route.duration_estimate_s):
                path = np.vstack([last, window.positions_m[:, :2]])
                path_length_m += float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
                last = path[-1:]
                yield window
            self._outcome = DriveOutcome(
                ride.pilot.finished, ride.pilot.ended, ride.time_s(), path_length_m
            )


def drive(
    world: World,
    robot: RobotModel,
    route: Route,
    config: DriveConfig,
    progress: Progress = silent,
) -> DriveRun:
    """The drive of a robot along a route: windows of motion, consecutive and without overlap.

    A robot that is stuck, tips over or whose physics fails ends the drive; what was driven so
    far is yielded, and the outcome tells why. progress is in seconds of simulated time.
    """
    return DriveRun(world, robot, route, config, progress)


class _Ride:
    """One running drive: the loop around the physics engine."""

    def __init__(
        self, engine: Engine, world: World, robot: RobotModel, route: Route, config: DriveConfig
    ) -> None:
        self._engine = engine
        rate_hz, control_hz = config.physics.rate_hz, config.follow.control_rate_hz
        self._steps_per_tick, self._tick_s = rate_hz // control_hz, 1.0 / control_hz
        self._window_ticks = max(round(config.physics.window_s * control_hz), 1)
        self._motors = build_motors(engine, robot.motor, 1.0 / rate_hz, self._steps_per_tick)
        self._floor = Floor(engine, world)
        self._recorder = Recorder(engine.T_base_com, rate_hz, self._steps_per_tick)
        self._com_base = _inverse_for_pybullet(engine.T_base_com)
        self._wheel_radius_m, self._half_track_m = robot.wheel_radius_m, 0.5 * robot.track_m
        self._tick = 0
        self.pilot = Pilot(route, config)

    def time_s(self) -> float:
        return self._tick * self._tick_s

    def windows(self, progress: Progress, estimate_s: float) -> Iterator[Drive]:
        while not self.pilot.ended:
            self._control_tick()
            self._tick += 1
            if self.pilot.ended or self._tick % self._window_ticks == 0:
                window = _finite_part(self._recorder.take_window())
                progress(self.time_s(), max(estimate_s, self.time_s()))
                yield window
        progress(self.time_s(), self.time_s())

    def _control_tick(self) -> None:
        """Decide the command, then record and step until the next control tick.

        The hot loop: everything is looked up once, for each look-up counts at 240 Hz.
        """
        body, client, wheels = self._engine.body, self._engine.client, self._engine.wheels
        read_pose, read_velocity = pybullet.getBasePositionAndOrientation, pybullet.getBaseVelocity
        read_wheels, step, motors = pybullet.getJointStates, pybullet.stepSimulation, self._motors
        record = self._recorder.states.extend
        for i in range(self._steps_per_tick):
            position, quaternion = read_pose(body, client)
            linear, angular = read_velocity(body, client)
            left, right = read_wheels(body, wheels, client)
            record((*position, *quaternion, *linear, *angular, *left[:2], *right[:2]))
            if i == 0:
                self._decide(position, quaternion)
            if motors.busy:
                motors.update((left[1], right[1]))
            step(client)

    def _decide(self, position: Vector, quaternion: Vector) -> None:
        """From the pose of the centre of mass to the wheels' speeds."""
        (x_m, y_m, z_m), (qx, qy, qz, qw) = pybullet.multiplyTransforms(
            position, quaternion, *self._com_base
        )
        yaw_rad = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        pilot, before = self.pilot, self.pilot.command
        up = 1.0 - 2.0 * (qx * qx + qy * qy)
        pilot.decide(self._tick * self._tick_s, x_m, y_m, z_m, yaw_rad, up)
        if pilot.command != before:
            speed, turn = pilot.command[0], pilot.command[1] * self._half_track_m
            radius_m = self._wheel_radius_m
            self._motors.command(((speed - turn) / radius_m, (speed + turn) / radius_m))
        self._floor.update(x_m, y_m, yaw_rad)
        self._recorder.ticks.extend((*pilot.command, float(self._touches_wall())))

    def _touches_wall(self) -> bool:
        engine = self._engine
        for wall in engine.walls:
            for point in pybullet.getContactPoints(engine.body, wall, -2, -2, engine.client):
                if point[CONTACT_DISTANCE] < TOUCHING_M:
                    return True
        return False


def _inverse_for_pybullet(T_base_com: FloatArray) -> tuple[list[float], list[float]]:
    T_com_base: FloatArray = np.linalg.inv(T_base_com).astype(np.float64)
    return T_com_base[:3, 3].tolist(), xyzw_from_matrix(T_com_base[:3, :3]).tolist()


def _finite_part(window: Drive) -> Drive:
    """The window up to the first step that is not a number; physics that fails stays failed."""
    whole = np.isfinite(np.hstack([window.positions_m, window.quats_xyzw, window.wheel_angles_rad]))
    bad = np.flatnonzero(~whole.all(axis=1))
    if bad.size == 0:
        return window
    return Drive(*(getattr(window, column.name)[: bad[0]] for column in fields(window)))


def bare_step_seconds(
    world: World, robot: RobotModel, physics: PhysicsConfig, seconds: float
) -> float:
    """Wall-clock time of ``stepSimulation`` alone, for so many simulated seconds of slow turning.

    The yardstick for the cost of driving: same world, same robot, wheels turning, nothing read.
    """
    with running_engine(world, robot, physics) as engine:
        hold_wheels(engine, (-1.0, 1.0), robot.motor.max_torque_n_m)
        count, client = round(seconds * physics.rate_hz), engine.client
        begin = time.perf_counter()
        for _ in range(count):
            pybullet.stepSimulation(client)
        return time.perf_counter() - begin
