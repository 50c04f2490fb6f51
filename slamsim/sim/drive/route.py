"""Routes: a tour of the whole world on the true map, random goals, or a file."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import DriveConfig, RouteConfig
from slamsim.core.geometry import wrap_angle
from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.sim.drive.legs import Leg, Route, speed_profile
from slamsim.sim.drive.route_file import PoseRoute, TwistRoute, read_route
from slamsim.sim.drive.smooth import resample, smooth_path
from slamsim.sim.drive.space import NoWay, Space, connect_places, free_space, reachable_cells
from slamsim.sim.drive.tour import closed_tour
from slamsim.sim.robot.model import RobotModel

if TYPE_CHECKING:
    from slamsim.world.model import World

FINEST_M = 0.01
"""Cells are not made smaller than this."""
GOAL_PLACES = 64
"""Among so many random places the goals are chosen."""
GOAL_SPARE_M = 0.05
"""Room to spare at a goal, where there are such places."""
MAX_GOALS = 100_000
FROM_END_M = 0.25
"""Between a stop and the ends of a leg, where the robot stops or turns anyway."""


def plan_route(world: World, robot: RobotModel, config: DriveConfig) -> Route:
    """A tour past every visit point and back to the start, random goals, or ``route.file``.

    Raises SlamsimError, with the widths, if the robot cannot get somewhere; InputRefused or
    NotFound for a route file.
    """
    if config.route.file is None:
        return _planned(world, config, room_needed_m(robot, config), config.route.resolution_m)
    given = read_route(Path(config.route.file))
    if isinstance(given, TwistRoute):
        if config.stops.every_m is not None:
            reason = "holds twists, which say themselves where to stop: leave drive.stops out"
            raise InputRefused(config.route.file, reason)
        return _twist_route(given.twists, config)
    space = free_space(world, config.route.resolution_m, room_needed_m(robot, config))
    return _route(_pose_legs(world, space, given, config), world, config)


def route_along(
    cells: IntArray, space: Space, config: DriveConfig, end_yaw_rad: float | None = None
) -> Route:
    """Along a chain of cells (n, 2), at least one; end_yaw_rad: heading to turn to at its end."""
    centres_m = space.centres_m(cells)
    line_m = smooth_path(centres_m, space) if len(cells) > 1 else centres_m[[0, 0]]
    legs = [_leg(line_m, space, config, end_yaw_rad)]
    return Route(tuple(legs), None, legs[0].length_m(), _duration_s(legs, config))


def room_needed_m(robot: RobotModel, config: DriveConfig) -> float:
    """Radius of the free disc that the robot needs, its clearance included."""
    return robot.footprint_radius_m + config.route.clearance_m


def _planned(world: World, config: DriveConfig, needed_m: float, resolution_m: float) -> Route:
    """Searched in finer cells where the world promises a way that coarse ones do not show."""
    space = free_space(world, resolution_m, needed_m)
    tours = config.route.kind == "tour"
    try:
        ways = _tour(world, space, config) if tours else _random_goals(world, space, config)
    except NoWay:
        if 2.0 * needed_m > world.clearance_m or resolution_m < 2.0 * FINEST_M:
            raise
        return _planned(world, config, needed_m, 0.5 * resolution_m)
    return _route(_ways_as_legs(world, space, config, ways), world, config)


def _tour(world: World, space: Space, config: DriveConfig) -> list[IntArray]:
    """Chains of cells (n, 2), one after the other."""
    places_m = np.vstack([world.start_pose[:2], world.visit_points_m])
    net = connect_places(space, places_m, config.route.preferred_clearance_m)
    order = closed_tour(net.lengths).tolist()
    stretches = zip(order, [*order[1:], order[0]], strict=True)
    return [way for a, b in stretches for way in net.cells_between(a, b)]


def _random_goals(world: World, space: Space, config: DriveConfig) -> list[IntArray]:
    """Chains of cells from goal to goal, past the visit points between them."""
    rng = random_stream(_seed(world, config.route), "route", "goals")
    goals_m = _goals_m(space, world.start_pose[:2], rng)
    places_m = np.vstack([world.start_pose[:2], world.visit_points_m, goals_m])
    net = connect_places(space, places_m, config.route.preferred_clearance_m)
    first = len(places_m) - len(goals_m)
    order, left_m = [0], _longest_way_m(config)
    while left_m > 0.0 and len(order) <= (MAX_GOALS if math.isfinite(left_m) else first):
        order.append(int(rng.integers(first, len(places_m))))
        left_m -= float(net.lengths[order[-2], order[-1]]) * space.resolution_m
    return [way for a, b in pairwise(order) for way in net.cells_between(a, b)]


def _goals_m(space: Space, start_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n, 2) random places with room to turn, as far as there are any."""
    reachable = reachable_cells(space, start_m)
    roomy = reachable & (space.room_m >= space.needed_m + GOAL_SPARE_M)
    cells = np.argwhere(roomy if roomy.any() else reachable)
    chosen = rng.choice(len(cells), size=min(GOAL_PLACES, len(cells)), replace=False)
    return space.centres_m(cells[chosen])


def _longest_way_m(config: DriveConfig) -> float:
    """No drive is longer, inf if nothing limits it."""
    length_m, duration_s = config.route.max_path_length_m, config.route.max_duration_s
    ways_m = (
        math.inf if length_m is None else length_m,
        math.inf if duration_s is None else duration_s * config.limits.max_speed_m_s,
    )
    return min(ways_m)


def _ways_as_legs(
    world: World, space: Space, config: DriveConfig, ways: list[IntArray]
) -> list[Leg]:
    if not ways:
        raise SlamsimError(
            f"the tour of {world.name} has nowhere to go: its only place to visit is the start"
        )
    cells = np.concatenate(ways)
    cells = cells[np.append(True, np.any(np.diff(cells, axis=0) != 0, axis=1))]
    return [
        _leg(smooth_path(space.centres_m(stretch), space), space, config)
        for stretch in _split_where_it_turns_back(cells)
        if len(stretch) > 1
    ]


def _split_where_it_turns_back(cells: IntArray) -> list[IntArray]:
    """At the ends of dead ends the tour runs back over its own cells: the robot turns there."""
    back = 1 + np.flatnonzero(np.all(cells[2:] == cells[:-2], axis=1))
    ends = [0, *back.tolist(), len(cells) - 1]
    return [cells[a : b + 1] for a, b in pairwise(ends)]


def _leg(
    points_m: FloatArray, space: Space, config: DriveConfig, end_yaw_rad: float | None = None
) -> Leg:
    return Leg(points_m, speed_profile(points_m, space, config.limits), end_yaw_rad)


def _pose_legs(world: World, space: Space, given: PoseRoute, config: DriveConfig) -> list[Leg]:
    """Straight from pose to pose, turning on the spot; refused where a wall is in the way."""
    legs, here = list[Leg](), world.start_pose[:2]
    for place, (there, yaw) in enumerate(zip(given.points_m, given.yaws_rad, strict=True), 1):
        if np.linalg.norm(there - here) < 1e-3:
            line_m = np.stack([here, here])
        else:
            line_m = resample(np.stack([here, there]))
        room_m = space.room_at_m(line_m)
        if room_m.min() < space.needed_m - 0.5 * space.resolution_m:
            worst = line_m[int(room_m.argmin())]
            raise InputRefused(
                config.route.file or "route",
                f"at ({worst[0]:.2f}, {worst[1]:.2f}) there is room for a radius of "
                f"{room_m.min():.2f} m, the robot and its clearance need {space.needed_m:.2f} m",
                f"pose {place}, ({there[0]:g}, {there[1]:g})",
            )
        legs.append(_leg(line_m, space, config, None if np.isnan(yaw) else float(yaw)))
        here = there
    return legs


def _route(legs: list[Leg], world: World, config: DriveConfig) -> Route:
    legs = _cut(legs, config)
    if config.stops.every_m is not None:
        rng = random_stream(_seed(world, config.route), "route", "stops")
        legs = _with_stops(legs, config.stops.every_m, config, rng)
    length_m = sum(leg.length_m() for leg in legs)
    return Route(tuple(legs), None, length_m, _duration_s(legs, config))


def _cut(legs: list[Leg], config: DriveConfig) -> list[Leg]:
    """The legs up to the largest path length, the last one ending in a stop."""
    left_m = config.route.max_path_length_m
    if left_m is None:
        return legs
    kept = list[Leg]()
    for leg in legs:
        length_m = leg.length_m()
        if length_m <= left_m:
            kept.append(leg)
            left_m -= length_m
            continue
        last = max(int(left_m / length_m * (len(leg.points_m) - 1)), 1)
        kept.append(leg.first(last, config.limits))
        break
    return kept


def _with_stops(
    legs: list[Leg], every_m: float, config: DriveConfig, rng: np.random.Generator
) -> list[Leg]:
    """The legs taken apart at random places, with what is to be done there."""
    stops, kept = config.stops, list[Leg]()
    to_go_m = every_m * rng.uniform(0.5, 1.5)
    for leg in legs:
        ahead = leg
        while ahead.length_m() > to_go_m + FROM_END_M:
            at = max(round(to_go_m / ahead.length_m() * (len(ahead.points_m) - 1)), 1)
            before, ahead = ahead.first(at, config.limits), ahead.rest(at)
            turn = np.radians(stops.turn_deg) * rng.uniform(-1.0, 1.0)
            yaw = before.heading_rad() + turn if stops.turn_deg > 0.0 else None
            kept.append(replace(before, end_yaw_rad=yaw, rest_s=rng.uniform(*stops.rest_s)))
            to_go_m = every_m * rng.uniform(0.5, 1.5)
        to_go_m = max(to_go_m - ahead.length_m(), FROM_END_M)
        kept.append(ahead)
    return kept


def _duration_s(legs: list[Leg], config: DriveConfig) -> float:
    follow, limits = config.follow, config.limits
    total_s = follow.standstill_s + follow.final_standstill_s
    heading = None
    for leg in legs:
        steps_m = np.linalg.norm(np.diff(leg.points_m, axis=0), axis=1)
        total_s += float((steps_m / np.maximum(leg.speeds_m_s[:-1], 0.05)).sum()) + 0.5
        first, last = leg.points_m[1] - leg.points_m[0], leg.points_m[-1] - leg.points_m[-2]
        if heading is not None:
            turn = np.arctan2(first[1], first[0]) - np.arctan2(heading[1], heading[0])
            total_s += abs(float(wrap_angle(turn))) / (0.7 * limits.max_yaw_rate_rad_s)
        heading = last
        total_s += leg.rest_s
    return total_s


def _seed(world: World, route: RouteConfig) -> int:
    return world.seed if route.seed is None else route.seed


def _twist_route(twists: FloatArray, config: DriveConfig) -> Route:
    limits = config.limits
    for column, limit, what in (
        (1, limits.max_speed_m_s, "m/s"),
        (2, limits.max_yaw_rate_rad_s, "rad/s"),
    ):
        worst = float(np.abs(twists[:, column]).max())
        if worst > limit * (1.0 + 1e-9):
            raise InputRefused(
                config.route.file or "route",
                f"commands up to {worst:g} {what}, drive.limits allow {limit:g} {what}",
            )
    held_s = np.diff(twists[:, 0])
    length_m = float((held_s * np.abs(twists[:-1, 1])).sum())
    rest_s = config.follow.standstill_s + config.follow.final_standstill_s
    return Route((), twists, length_m, float(twists[-1, 0]) + rest_s)
