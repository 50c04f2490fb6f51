"""Drives the robot along a route and records its true motion at the physics rate."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import DriveConfig, PhysicsConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Drive
from slamsim.sim.bullet import pybullet
from slamsim.sim.drive.drive_loop import BasePose, DriveLoop
from slamsim.sim.drive.follow import Twist
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.pilot import Pilot
from slamsim.sim.engine import running_engine
from slamsim.sim.ground import Floor
from slamsim.sim.robot.chassis import Engine, hold_wheels
from slamsim.sim.robot.model import RobotModel

if TYPE_CHECKING:
    from slamsim.world.model import World


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


class Driving:
    """A drive whose outcome is known in the end."""

    _outcome: DriveOutcome | None = None

    @property
    def outcome(self) -> DriveOutcome:
        """Raises RuntimeError until the last window has been taken."""
        if self._outcome is None:
            raise RuntimeError("the outcome of a drive is known once its last window was taken")
        return self._outcome


class DriveRun(Driving):
    """A drive along a route: windows of motion, consecutive and without overlap.

    Each iteration drives anew, identically. The physics runs while the windows are taken, so that
    memory does not grow with the drive. A robot that is stuck, tips over or whose physics fails
    ends the drive; what was driven so far is yielded, and the outcome tells why. progress is in
    seconds of simulated time.
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

    def __iter__(self) -> Iterator[Drive]:
        self._outcome = None
        with running_engine(self._world, self._robot, self._config.physics) as engine:
            loop = _RouteLoop(engine, self._world, self._robot, self._route, self._config)
            path_length_m, last = 0.0, np.empty((0, 2))
            for window in loop.windows(self._progress, self._route.duration_estimate_s):
                path = np.vstack([last, window.positions_m[:, :2]])
                path_length_m += float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
                last = path[-1:]
                yield window
            self._outcome = DriveOutcome(
                loop.pilot.finished, loop.pilot.ended, loop.time_s(), path_length_m
            )


class _RouteLoop:
    """One running drive along a route: the pilot, the floor and the walls around a drive loop."""

    def __init__(
        self, engine: Engine, world: World, robot: RobotModel, route: Route, config: DriveConfig
    ) -> None:
        rate_hz, control_hz = config.physics.rate_hz, config.follow.control_rate_hz
        self._tick, self._tick_s = 0, 1.0 / control_hz
        self._window_ticks = max(round(config.physics.window_s * control_hz), 1)
        self._ride = DriveLoop(engine, robot, rate_hz, rate_hz // control_hz)
        self._floor = Floor(engine, world.floor_friction, world.floor_patches)
        self.pilot = Pilot(route, config)

    def time_s(self) -> float:
        return self._tick * self._tick_s

    def windows(self, progress: Progress, estimate_s: float) -> Iterator[Drive]:
        while not self.pilot.ended:
            self._ride.control_tick(self._decide)
            self._tick += 1
            if self.pilot.ended or self._tick % self._window_ticks == 0:
                window = self._ride.take_window()
                progress(self.time_s(), max(estimate_s, self.time_s()))
                yield window
        progress(self.time_s(), self.time_s())

    def _decide(self, pose: BasePose) -> Twist:
        self.pilot.decide(self.time_s(), *pose)
        self._floor.update(pose.x_m, pose.y_m, pose.yaw_rad)
        return self.pilot.command


def bare_step_seconds(
    world: World, robot: RobotModel, physics: PhysicsConfig, seconds: float
) -> float:
    """Wall-clock time of ``stepSimulation`` alone, for so many simulated seconds of slow turning.

    The yardstick for the cost of driving: same world, same robot, wheels turning, nothing read.
    """
    with running_engine(world, robot, physics) as engine:
        torque_n_m = robot.motor.max_torque_n_m
        hold_wheels(engine, (-1.0, 1.0), (torque_n_m, torque_n_m))
        count, client = round(seconds * physics.rate_hz), engine.client
        begin = time.perf_counter()
        for _ in range(count):
            pybullet.stepSimulation(client)
        return time.perf_counter() - begin
