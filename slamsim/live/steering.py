"""Who drives a live robot at the moment, and where to."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.core.types import FloatArray, Grid
from slamsim.live.controls import Goal, Mode
from slamsim.live.drivers import (
    ManualDriver,
    RouteDriver,
    borders_on_unknown,
    require_map,
    route_end_m,
    route_to,
    route_to_frontier,
)
from slamsim.live.live_map import LiveMap
from slamsim.live.robot import Driver
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.pilot import BACKING_M_S
from slamsim.sim.drive.route import plan_route, room_needed_m
from slamsim.sim.robot.model import RobotModel
from slamsim.world.model import World

EXPLORED = "all that can be reached is mapped"
_BUMPER_RAD = math.radians(15.0)
"""To both sides of straight ahead: no more is remembered than is likely, since what is remembered
may close a passage; a robot that meets the rest of it bumps once more."""
_BACKING_S = 2.0
_SEEN_WITHIN_M = 0.3
"""A frontier is done with as soon as nothing so near to it is unknown."""


class Steering:
    """Routes are planned on a thread of their own, while the robot stands or goes on.

    ended: why the tour or the exploration is over, empty while it is not. goal: see ``Status``.
    """

    def __init__(self, config: RunConfig, world: World, robot: RobotModel, known: LiveMap) -> None:
        self._config, self._world, self._map = config, world, known
        self._needed_m = room_needed_m(robot, config.drive)
        self._robot = robot
        self._planner = ThreadPoolExecutor(1, "slamsim-planner")
        self._plan: Future[Route | None] | None = None
        self._planned_version = -1
        self._goal_m: FloatArray | None = None
        self._given_up_m: list[FloatArray] = []
        self._bumps_m: list[FloatArray] = []
        self._on_route = False
        self.manual = ManualDriver()
        self.driver: Driver = self.manual
        self.mode: Mode = "manual"
        self.ended = ""
        self.goal: Goal = "none"

    def close(self) -> None:
        """End the planner."""
        self._planner.shutdown(wait=False, cancel_futures=True)

    def begin(self, mode: Mode) -> None:
        """A new drive from the start pose."""
        self._stand(mode)
        self._bumps_m.clear()
        if mode == "tour":
            route = plan_route(self._world, self._robot, self._config.drive)
            self.driver = RouteDriver(route, self._config.drive)
        elif mode == "explore":
            self.driver = RouteDriver(self._full_turn(), self._config.drive)

    @property
    def is_driven_by_twists(self) -> bool:
        """Whether a twist was the last that was asked for, or nothing yet."""
        return self.mode == "manual" and self.driver is self.manual and self.goal == "none"

    @property
    def is_driven_by_belief(self) -> bool:
        """Whether routes are followed by what SLAM believes; a tour goes by the true pose."""
        return self.mode != "tour" and not self.is_driven_by_twists

    def take_over(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float) -> None:
        """From now on twists come from outside, this one first."""
        if not self.is_driven_by_twists:
            self._stand("manual")
            self.manual.drive(speed_m_s, yaw_rate_rad_s, hold_s)

    def switch(self, mode: Mode, T_map_base: FloatArray) -> None:
        """To another mode, from where the robot truly is, (3,)."""
        self._stand(mode)
        if mode == "tour":
            here = replace(self._world, start_pose=T_map_base)
            self._begin_plan(lambda: plan_route(here, self._robot, self._config.drive))
        elif mode == "explore":
            self.driver = RouteDriver(self._full_turn(), self._config.drive)

    def go(self, route: Route) -> None:
        """Drive along a route by what SLAM believes."""
        self._stand("manual")
        self._follow(route)
        self.goal = "driving"

    def route_to(self, x_m: float, y_m: float, yaw_rad: float | None) -> Route:
        """On the map by now. Raises SlamsimError or BadNumbers."""
        grid, here = require_map(self._map.grid), self._map.pose()
        here = np.zeros(3) if here is None else here
        goal, config = np.array([x_m, y_m]), self._config.drive
        return route_to(self._with_bumps(grid), here, goal, yaw_rad, self._needed_m, config)

    def update(self, bumped: bool) -> None:
        """After each window: take over routes that were planned, and plan the next.

        bumped: whether the robot touched something, as its bumper tells.
        """
        if bumped and self._on_route:
            self._back_off()
        if self._plan is not None and self._plan.done():
            plan, self._plan = self._plan, None
            self._take(plan)
        if self.driver.ended:
            self.ended = self.driver.ended if self.mode == "tour" else self.ended
            if self.goal == "driving":
                at_end = isinstance(self.driver, RouteDriver) and self.driver.at_end
                self.goal = "reached" if at_end else "not reached"
            self.driver, self._on_route = self.manual, False
        if self.mode == "explore" and self._plan is None and not self.ended:
            self._explore()

    def _stand(self, mode: Mode) -> None:
        self.mode, self.driver, self.ended, self.goal = mode, self.manual, "", "none"
        self.manual.drive(0.0, 0.0)
        self._plan, self._goal_m, self._planned_version = None, None, -1
        self._given_up_m.clear()
        self._on_route = False

    def _full_turn(self) -> Route:
        """On the spot: a scan from where the robot stands makes no cell sure to be free."""
        rate_rad_s = 0.5 * self._config.drive.limits.max_yaw_rate_rad_s
        turn_s = math.tau / rate_rad_s
        twists = np.array([[0.0, 0.0, rate_rad_s], [turn_s, 0.0, 0.0]])
        return Route((), twists, 0.0, turn_s)

    def _back_off(self) -> None:
        """Away from what the lidar does not see, and remember where it is."""
        here = self._map.pose()
        if here is not None:
            around = here[2] + np.linspace(-_BUMPER_RAD, _BUMPER_RAD, 3)
            rim = self._robot.footprint_radius_m * np.column_stack([np.cos(around), np.sin(around)])
            self._bumps_m.extend(here[:2] + rim)
        twists = np.array([[0.0, BACKING_M_S, 0.0], [_BACKING_S, 0.0, 0.0]])
        self.driver = RouteDriver(Route((), twists, 0.0, _BACKING_S), self._config.drive)
        self._on_route, self._goal_m = False, None
        self.goal = "none" if self.goal == "none" else "not reached"

    def _begin_plan(self, plan: Callable[[], Route | None]) -> None:
        self._plan = self._planner.submit(plan)

    def _take(self, plan: Future[Route | None]) -> None:
        """Raises SlamsimError where the route could not be planned."""
        route = plan.result()
        if route is None:
            self.ended, self.driver = EXPLORED, self.manual
        elif self.mode == "tour":
            self.driver = RouteDriver(route, self._config.drive)
        else:
            self._goal_m = route_end_m(route)
            self._follow(route)

    def _follow(self, route: Route) -> None:
        self._on_route = True
        self.driver = RouteDriver(route, self._config.drive, self._map.pose)

    def _explore(self) -> None:
        """Plan anew where the robot has arrived, or where its goal is known by now."""
        grid, here = self._map.grid, self._map.pose()
        if grid is None or here is None or self._map.version == self._planned_version:
            return
        arrived = self.driver is self.manual
        goal_m = self._goal_m
        if goal_m is None and not arrived:
            return  # it looks round
        if goal_m is not None:
            unknown = borders_on_unknown(grid, goal_m, _SEEN_WITHIN_M)
            if arrived and unknown:
                self._given_up_m.append(goal_m)
            elif unknown:
                return
        self._planned_version = self._map.version
        given_up = np.array(self._given_up_m).reshape(-1, 2)
        config, needed_m = self._config.drive, self._needed_m
        known = self._with_bumps(grid)
        self._begin_plan(lambda: route_to_frontier(known, here, given_up, needed_m, config))

    def _with_bumps(self, grid: Grid) -> Grid:
        """The map with what the bumper met."""
        if not self._bumps_m:
            return grid
        occupancy = grid.occupancy.copy()
        at = (np.array(self._bumps_m) - np.array(grid.origin_m)) / grid.resolution_m
        columns, rows = np.floor(at).astype(np.int64).T
        inside = (rows >= 0) & (columns >= 0)
        inside &= (rows < occupancy.shape[0]) & (columns < occupancy.shape[1])
        occupancy[rows[inside], columns[inside]] = 1.0
        return replace(grid, occupancy=occupancy)
