"""Drives the robot along a route and records its true motion at the physics rate."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
import pybullet

from slamsim.config.drive import DriveConfig, LimitsConfig, PhysicsConfig
from slamsim.geometry import xyzw_from_matrix
from slamsim.progress import Progress, silent
from slamsim.sim.engine import Engine, hold_wheels, running_engine
from slamsim.sim.floor import Floor
from slamsim.sim.follow import Twist, build_follower
from slamsim.sim.motors import build_motors
from slamsim.sim.record import Recorder
from slamsim.sim.robot import RobotModel
from slamsim.sim.route import Route
from slamsim.sim.supervise import Supervisor
from slamsim.types import Drive, FloatArray

if TYPE_CHECKING:
    from slamsim.world.model import World


@dataclass(frozen=True, slots=True)
class DriveOutcome:
    """How a drive ended.

    finished: whether the route was driven to its end or to the configured largest duration.
    reason: how it ended, in words. path_length_m: of the true path.
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
            self._outcome = DriveOutcome(ride.finished, ride.reason, ride.time_s(), path_length_m)


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
    """One running drive."""

    def __init__(
        self, engine: Engine, world: World, robot: RobotModel, route: Route, config: DriveConfig
    ) -> None:
        self._engine, self._config = engine, config
        rate_hz, control_hz = config.physics.rate_hz, config.follow.control_rate_hz
        self._steps_per_tick, self._tick_s = rate_hz // control_hz, 1.0 / control_hz
        self._motors = build_motors(engine, robot.motor, 1.0 / rate_hz)
        self._floor = Floor(engine, world)
        self._follower = build_follower(route, config.follow, config.limits)
        self._supervisor = Supervisor(config.follow, self._follower)
        self._recorder = Recorder(engine.T_base_com, rate_hz, self._steps_per_tick)
        self._com_base = _inverse_for_pybullet(engine.T_base_com)
        self._wheel_radius_m, self._half_track_m = robot.wheel_radius_m, 0.5 * robot.track_m
        self._last_start_s = _last_start_s(config)
        self._command: Twist = (0.0, 0.0)
        self._tick = 0
        self._rest_ticks: int | None = None
        self.finished, self.reason = False, ""

    def time_s(self) -> float:
        return self._tick * self._tick_s

    def windows(self, progress: Progress, estimate_s: float) -> Iterator[Drive]:
        window_ticks = max(round(self._config.physics.window_s / self._tick_s), 1)
        while not self.reason:
            self._control()
            self._step()
            self._tick += 1
            if self._tick % window_ticks == 0:
                window = _finite_part(self._recorder.take_window())
                progress(self.time_s(), max(estimate_s, self.time_s()))
                yield window
        self._record_last()
        yield _finite_part(self._recorder.take_window())
        progress(self.time_s(), self.time_s())

    def _control(self) -> None:
        """Sense the true pose, decide, and command the wheels for the next steps."""
        engine, tick_s = self._engine, self._tick_s
        com = pybullet.getBasePositionAndOrientation(engine.body, engine.client)
        (x_m, y_m, z_m), (qx, qy, qz, qw) = pybullet.multiplyTransforms(*com, *self._com_base)
        yaw_rad = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        upset = self._supervisor.upset(x_m, y_m, z_m, 1.0 - 2.0 * (qx * qx + qy * qy))
        if upset is not None:
            self.reason = upset
            wanted: Twist = (0.0, 0.0)
        else:
            wanted = self._wanted(x_m, y_m, yaw_rad)
        self._command = limited(self._command, wanted, self._config.limits, tick_s)
        speed, yaw_rate = self._command
        turn = yaw_rate * self._half_track_m
        radius_m = self._wheel_radius_m
        self._motors.command(((speed - turn) / radius_m, (speed + turn) / radius_m))
        self._floor.update(x_m, y_m, yaw_rad)
        self._recorder.commands.append(self._command)
        self._recorder.contacts.append(self._touches_wall())

    def _wanted(self, x_m: float, y_m: float, yaw_rad: float) -> Twist:
        follow = self._config.follow
        time_s = self.time_s()
        if time_s + 1e-9 < follow.standstill_s:
            return 0.0, 0.0
        if self._rest_ticks is not None:
            return self._rest()
        if self._follower.done or time_s >= self._last_start_s:
            self._rest_ticks = math.ceil(follow.final_standstill_s / self._tick_s)
            return self._rest()
        trouble = self._supervisor.stuck(x_m, y_m, yaw_rad, self._command, self._tick_s)
        if trouble is not None and not self._supervisor.recover():
            self.reason = trouble
            return 0.0, 0.0
        backing = self._supervisor.backing(self._tick_s)
        if backing is not None:
            return backing
        return self._follower.command(x_m, y_m, yaw_rad, self._command[1])

    def _rest(self) -> Twist:
        """Brake, then stand still for the configured time, then end."""
        assert self._rest_ticks is not None
        if self._command == (0.0, 0.0):
            self._rest_ticks -= 1
        if self._rest_ticks < 0:
            self.finished = True
            self.reason = (
                "the route was driven to its end"
                if self._follower.done
                else f"stopped for route.max_duration_s {self._config.route.max_duration_s:g}"
            )
        return 0.0, 0.0

    def _touches_wall(self) -> bool:
        engine = self._engine
        return any(
            pybullet.getContactPoints(engine.body, wall, physicsClientId=engine.client)
            for wall in engine.walls
        )

    def _step(self) -> None:
        """Record and step the physics for one control tick."""
        body, client, wheels = self._engine.body, self._engine.client, self._engine.wheels
        recorder, motors = self._recorder, self._motors
        for _ in range(self._steps_per_tick):
            states = pybullet.getJointStates(body, wheels, client)
            recorder.wheels.append(states)
            recorder.poses.append(pybullet.getBasePositionAndOrientation(body, client))
            recorder.velocities.append(pybullet.getBaseVelocity(body, client))
            if motors.every_step:
                motors.update((states[0][1], states[1][1]))
            pybullet.stepSimulation(client)

    def _record_last(self) -> None:
        """The state after the last step, so that the drive covers its whole duration."""
        body, client, wheels = self._engine.body, self._engine.client, self._engine.wheels
        self._recorder.wheels.append(pybullet.getJointStates(body, wheels, client))
        self._recorder.poses.append(pybullet.getBasePositionAndOrientation(body, client))
        self._recorder.velocities.append(pybullet.getBaseVelocity(body, client))
        self._recorder.commands.append(self._command)
        self._recorder.contacts.append(self._touches_wall())


def limited(current: Twist, wanted: Twist, limits: LimitsConfig, tick_s: float) -> Twist:
    """The next command: as near to the wanted one as the limits let it come in one tick."""
    step_m_s = limits.max_acceleration_m_s2 * tick_s
    step_rad_s = limits.max_yaw_acceleration_rad_s2 * tick_s
    speed = max(-limits.max_speed_m_s, min(limits.max_speed_m_s, wanted[0]))
    rate = max(-limits.max_yaw_rate_rad_s, min(limits.max_yaw_rate_rad_s, wanted[1]))
    return (
        max(current[0] - step_m_s, min(current[0] + step_m_s, speed)),
        max(current[1] - step_rad_s, min(current[1] + step_rad_s, rate)),
    )


def _last_start_s(config: DriveConfig) -> float:
    """When to begin to stop so that the largest duration is kept."""
    if config.route.max_duration_s is None:
        return math.inf
    limits = config.limits
    braking_s = max(
        limits.max_speed_m_s / limits.max_acceleration_m_s2,
        limits.max_yaw_rate_rad_s / limits.max_yaw_acceleration_rad_s2,
    )
    ticks_s = 2.0 / config.follow.control_rate_hz
    return config.route.max_duration_s - config.follow.final_standstill_s - braking_s - ticks_s


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
