"""Who drives a live robot (a person, a route, or the commands of an earlier drive), and where
to."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage

from slamsim.config.drive import DriveConfig
from slamsim.core.types import BoolArray, FloatArray, Grid
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite, require_number
from slamsim.live.controls import HOLD_S
from slamsim.sim.drive.drive_loop import BasePose
from slamsim.sim.drive.follow import Twist
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.pilot import STANDING, Pilot
from slamsim.sim.drive.route import route_along
from slamsim.sim.drive.space import NoWay, Space, cheapest_way

FASTEST = 1e12
"""A twist beyond is an error of its sender; all others are cut down to the limits."""
_KEPT = 10_000


class ManualDriver:
    """Twists as they come, each held for a while of real time.

    A base at rest, and one whose commands stop coming, stands still.
    """

    ended = ""

    def __init__(self) -> None:
        self._twist, self._received_s, self._until_s = STANDING, 0.0, 0.0
        self._taken_s = 0.0
        self.delays_s: deque[float] = deque(maxlen=_KEPT)
        """From when a twist came to when the wheels were told, of the last ones."""

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        """See ``Controls``. Raises BadNumbers."""
        require_number("the speed of a twist in m/s", speed_m_s, -FASTEST, FASTEST)
        require_number("the yaw rate of a twist in rad/s", yaw_rate_rad_s, -FASTEST, FASTEST)
        require_number("the seconds to hold a twist", hold_s, 0.0, 60.0)
        now_s = time.monotonic()
        self._twist = float(speed_m_s), float(yaw_rate_rad_s)
        self._received_s, self._until_s = now_s, now_s + hold_s

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        now_s, received_s = time.monotonic(), self._received_s
        if received_s != self._taken_s:
            self._taken_s = received_s
            self.delays_s.append(now_s - received_s)
        return self._twist if now_s < self._until_s else STANDING


PoseSource = Callable[[], FloatArray | None]
"""(3,) where the robot believes it is, in the frame of the route; None while it does not know."""


class RouteDriver:
    """Follows a route as ``simulate`` does, by the true pose or by what the robot believes.

    pose: None for the true one.
    """

    def __init__(self, route: Route, config: DriveConfig, pose: PoseSource | None = None) -> None:
        self._pilot, self._pose = Pilot(route, config), pose

    @property
    def ended(self) -> str:
        return self._pilot.ended

    @property
    def at_end(self) -> bool:
        """Whether it ended where the route does."""
        return self._pilot.at_end

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        if self._pose is not None:
            believed = self._pose()
            if believed is None or not np.isfinite(believed).all():
                return STANDING
            x_m, y_m, yaw_rad = believed.tolist()
            pose = BasePose(x_m, y_m, 0.0, yaw_rad, 1.0)
        self._pilot.decide(time_s, *pose)
        return self._pilot.command


class PlayedDriver:
    """The commands of an earlier drive, control tick by control tick.

    commands: (control tick from which on, twist), rising. ticks: how many the drive had.
    """

    def __init__(self, commands: Sequence[tuple[int, Twist]], ticks: int) -> None:
        self._commands, self._ticks = deque(commands), ticks
        self._tick, self._twist = 0, STANDING

    @property
    def ended(self) -> str:
        return "all commands were played" if self._tick >= self._ticks else ""

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        while self._commands and self._commands[0][0] <= self._tick:
            self._twist = self._commands.popleft()[1]
        self._tick += 1
        return self._twist


_AROUND = np.ones((3, 3), dtype=np.bool_)


def route_to(
    grid: Grid,
    here: FloatArray,
    goal: FloatArray,
    yaw_rad: float | None,
    needed_m: float,
    config: DriveConfig,
) -> Route:
    """Through known free ground. here: (3,) T_map_base. goal: (2,). needed_m: the robot's radius
    with its clearance. Raises NoWay where none leads there, BadNumbers for what is not finite."""
    require_finite("the place to drive to", goal, (2,))
    space, free = _space(grid, here, needed_m)
    targets = np.zeros(free.shape, dtype=np.bool_)
    cell = np.rint((goal - space.origin_m) / space.resolution_m).astype(np.int64)[::-1]
    where = f"({goal[0]:.2f}, {goal[1]:.2f})"
    if (cell < 0).any() or (cell >= free.shape).any() or not free[tuple(cell)]:
        raise NoWay(f"the map does not show free ground at {where}")
    targets[tuple(cell)] = True
    targets = ndimage.binary_dilation(targets, _AROUND, round(needed_m / space.resolution_m))
    way = cheapest_way(space, here[:2], targets, config.route.preferred_clearance_m)
    if way is None:
        raise NoWay(f"no known free path leads to {where}")
    return route_along(way, space, config, yaw_rad)


def route_to_frontier(
    grid: Grid,
    here: FloatArray,
    given_up_m: FloatArray,
    needed_m: float,
    config: DriveConfig,
) -> Route | None:
    """To the nearest place, by the path, where free ground borders on the unknown (Yamauchi 1997);
    None where all that can be reached is known.

    given_up_m: (k, 2) places that showed nothing new when the robot was there.
    """
    try:
        space, _ = _space(grid, here, needed_m)
        targets = _frontiers(grid, space)
        for place in given_up_m:
            cells = np.argwhere(targets)
            near = np.linalg.norm(space.centres_m(cells) - place, axis=1) < needed_m
            targets[tuple(cells[near].T)] = False
        way = cheapest_way(space, here[:2], targets, config.route.preferred_clearance_m)
    except NoWay:
        return None
    return None if way is None else route_along(way, space, config)


def borders_on_unknown(grid: Grid, place_m: FloatArray, within_m: float) -> bool:
    """Whether anything about a place (2,) is still unknown."""
    centre = np.rint((place_m - np.array(grid.origin_m)) / grid.resolution_m - 0.5).astype(np.int64)
    reach = int(np.ceil(within_m / grid.resolution_m))
    padded = np.pad(np.isnan(grid.occupancy), reach, constant_values=True)
    column, row = np.clip(centre, 0, np.array(grid.occupancy.shape)[::-1] - 1).tolist()
    return bool(padded[row : row + 2 * reach + 1, column : column + 2 * reach + 1].any())


def route_end_m(route: Route) -> FloatArray:
    """(2,) where it leads."""
    return np.asarray(route.legs[-1].points_m[-1])


def _space(grid: Grid, here: FloatArray, needed_m: float) -> tuple[Space, BoolArray]:
    """Room about each known free cell, 0 on all others; and which are free."""
    occupied = np.pad(grid.occupancy > grid.OCCUPIED_ABOVE, 1)
    free = np.pad(grid.occupancy < grid.FREE_BELOW, 1)
    away_m = ndimage.distance_transform_edt(~occupied) * grid.resolution_m
    room_m = np.where(free, np.maximum(away_m - 0.5 * grid.resolution_m, 0.0), 0.0)
    origin_m = np.array(grid.origin_m) - 0.5 * grid.resolution_m
    space = Space(room_m, origin_m, grid.resolution_m, needed_m)
    _clear_under_robot(space, here, needed_m)
    return space, free


def _clear_under_robot(space: Space, here: FloatArray, needed_m: float) -> None:
    """Where it stands there is room for it, whatever the map shows: it has to get away."""
    rows, columns = np.indices(space.room_m.shape)
    x_m, y_m = (here[:2] - space.origin_m) / space.resolution_m
    under = np.hypot(columns - x_m, rows - y_m) * space.resolution_m <= needed_m
    space.room_m[under] = np.maximum(space.room_m[under], needed_m)


def _frontiers(grid: Grid, space: Space) -> BoolArray:
    """Cells with room for the robot beside unknown ones, in stretches as long as it is wide."""
    unknown = np.pad(np.isnan(grid.occupancy), 1, constant_values=True)
    edge = (space.room_m >= space.needed_m) & ndimage.binary_dilation(unknown, _AROUND)
    labels, count = ndimage.label(edge, structure=_AROUND)
    if count == 0:
        return np.asarray(edge)
    sizes = ndimage.sum_labels(edge, labels, np.arange(count + 1))
    long_enough = sizes * space.resolution_m >= 2.0 * space.needed_m
    return np.asarray(long_enough[labels] & edge)


def require_map(grid: Grid | None) -> Grid:
    """Raises SlamsimError while there is none."""
    if grid is None:
        raise SlamsimError("there is no map yet; SLAM gives one a second after its first scans")
    return grid
