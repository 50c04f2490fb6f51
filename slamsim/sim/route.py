"""Where the robot goes: a tour of the whole world on the true map, or a route from a file."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import DriveConfig, RouteConfig
from slamsim.geometry import wrap_angle
from slamsim.safe.errors import InputRefused, SlamsimError
from slamsim.sim.robot import RobotModel
from slamsim.sim.route_file import PoseRoute, TwistRoute, read_route
from slamsim.sim.smooth import resample, smooth_path, speed_profile
from slamsim.sim.space import Space, connect_places, free_space
from slamsim.sim.tour import closed_tour
from slamsim.types import FloatArray, IntArray

if TYPE_CHECKING:
    from slamsim.world.model import World


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A line to drive along, forwards, to a stop; the robot first turns into its direction.

    points_m: (n, 2) evenly spaced, in the map frame. speeds_m_s: (n,) speed to have there.
    end_yaw_rad: heading to turn to at the end, None for any.
    """

    points_m: FloatArray
    speeds_m_s: FloatArray
    end_yaw_rad: float | None = None

    def length_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.points_m, axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Either legs or twists: (n, 3) rows of (t_s, v_m_s, w_rad_s), each held until the next.

    narrowest_m: free radius at the tightest place of the legs, inf for twists. The last twist
    only tells when the route ends.
    """

    legs: tuple[Leg, ...]
    twists: FloatArray | None
    length_m: float
    duration_estimate_s: float
    narrowest_m: float


def plan_route(world: World, robot: RobotModel, config: DriveConfig) -> Route:
    """A tour past every visit point and back to the start, or the route of ``route.file``.

    Raises SlamsimError, with the widths, if the robot cannot get somewhere; InputRefused or
    NotFound for a route file.
    """
    if config.route.file is None:
        space = _space(world, robot, config.route)
        return _route(_tour_legs(world, space, config), space, config)
    given = read_route(Path(config.route.file))
    if isinstance(given, TwistRoute):
        return _twist_route(given.twists, config)
    space = _space(world, robot, config.route)
    legs = _pose_legs(world, space, given, config)
    return _route(legs, space, config)


def _space(world: World, robot: RobotModel, route: RouteConfig) -> Space:
    return free_space(world, route.resolution_m, robot.footprint_radius_m + route.clearance_m)


def _tour_legs(world: World, space: Space, config: DriveConfig) -> list[Leg]:
    places_m = np.vstack([world.start_pose[:2], world.visit_points_m])
    net = connect_places(space, places_m, config.route.preferred_clearance_m)
    order = closed_tour(net.lengths).tolist()
    pieces = [
        piece
        for a, b in zip(order, [*order[1:], order[0]], strict=True)
        for piece in net.cells_between(a, b)
    ]
    if not pieces:
        raise SlamsimError(
            f"the tour of {world.name} has nowhere to go: its only place to visit is the start"
        )
    cells = np.concatenate(pieces)
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


def _route(legs: list[Leg], space: Space, config: DriveConfig) -> Route:
    legs = _cut(legs, config)
    length_m = sum(leg.length_m() for leg in legs)
    narrowest_m = min(float(space.room_at_m(leg.points_m).min()) for leg in legs)
    return Route(tuple(legs), None, length_m, _duration_s(legs, config), narrowest_m)


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
        count = max(int(left_m / length_m * (len(leg.points_m) - 1)) + 1, 2)
        points_m = leg.points_m[:count]
        stop = speed_profile(points_m, None, config.limits)
        kept.append(Leg(points_m, np.minimum(leg.speeds_m_s[:count], stop)))
        break
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
    return total_s


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
    return Route((), twists, length_m, float(twists[-1, 0]) + rest_s, float("inf"))
