"""Faults of the odometry as it is published: units, rotations, twists, jumps, other sources."""

from __future__ import annotations

from copy import deepcopy
from functools import partial

import numpy as np

from independent.fault import Fault, Made, fault
from independent.odometry import edge_in, instants, odometry_in, publish, steps_in
from independent.recorded import yaw_of, yaw_quaternion


def _in_unit(made: Made, factor: float) -> None:
    """Places and speeds in another unit than metres, turns right."""
    odometry = odometry_in(made)
    publish(made, odometry.xy_m * factor, yaw_of(odometry.quaternion))
    odometry.linear *= factor


def _no_heading(made: Made, wholly: bool) -> None:
    """The orientation is never filled in; wholly: places too are those of a robot that never
    turns."""
    odometry = odometry_in(made)
    xy_m = odometry.xy_m
    if wholly:
        forward, _ = steps_in(made)
        xy_m = np.column_stack([np.cumsum(forward), np.zeros(len(forward))])
    publish(made, xy_m, np.zeros(len(xy_m)))
    odometry.angular[:, 2] = 0.0


def _w_first(made: Made, tf_too: bool) -> None:
    """Quaternions written as w, x, y, z."""
    odometry = odometry_in(made)
    odometry.quaternion = np.roll(odometry.quaternion, 1, axis=1)
    if tf_too:
        edge_in(made).quaternion = odometry.quaternion.copy()


def _twist(made: Made, linear: float, angular: float) -> None:
    odometry_in(made).linear *= linear
    odometry_in(made).angular *= angular


def _twist_in_odom(made: Made) -> None:
    """The linear speed along the axes of odom, not of the base."""
    odometry = odometry_in(made)
    yaw, speed = yaw_of(odometry.quaternion), odometry.linear[:, 0].copy()
    odometry.linear[:, 0], odometry.linear[:, 1] = speed * np.cos(yaw), speed * np.sin(yaw)


def _jump(made: Made, by_m: float) -> None:
    odometry = odometry_in(made)
    later = np.arange(len(odometry.xy_m)) > 0.45 * len(odometry.xy_m)
    publish(
        made, odometry.xy_m + later[:, None] * [0.6 * by_m, 0.8 * by_m], yaw_of(odometry.quaternion)
    )


def _not_numbers(made: Made) -> None:
    xy_m = odometry_in(made).xy_m
    xy_m[len(xy_m) // 2 : len(xy_m) // 2 + 5] = np.nan


def _by_slam(made: Made, jump_m: float) -> None:
    """True poses, as a SLAM estimates them, corrected again and again by a small jump."""
    drive = made.conditions.drive
    begin = drive.poses[0]
    poses = drive.at(instants(made)) - [*begin[:2], 0.0]
    cos, sin = np.cos(begin[2]), np.sin(begin[2])
    xy_m = poses[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    pieces = (instants(made) / 4.0).astype(int)
    off_m = made.rng.normal(0.0, jump_m, (pieces.max() + 1, 2))[pieces]
    publish(made, xy_m + off_m, poses[:, 2] - begin[2])


def _second(made: Made, drift: float) -> None:
    """Another odometry, which turns too far."""
    other = deepcopy(odometry_in(made))
    other.topic = "/odom_visual"
    forward, turned = steps_in(made)
    yaw = np.cumsum(turned * (1.0 + drift))
    along = np.column_stack([np.cos(yaw), np.sin(yaw)]) * forward[:, None]
    other.xy_m, other.quaternion = np.cumsum(along, axis=0), yaw_quaternion(yaw)
    made.bag.odometry.append(other)


UNITS = [
    fault(
        "odometry_never_turns",
        "heading",
        "odometry_no_turn",
        change=partial(_no_heading, wholly=False),
    ),
    fault(
        "odometry_knows_no_turns",
        "heading",
        "odometry_no_turn",
        change=partial(_no_heading, wholly=True),
    ),
    fault(
        "odometry_jump_0.2m", "jump", "odometry_jump", change=partial(_jump, by_m=0.2), pairs=True
    ),
    fault("odometry_jump_1m", "jump", "odometry_jump", change=partial(_jump, by_m=1.0), pairs=True),
    fault("odometry_nan", "nan", "odometry_invalid", change=_not_numbers),
    fault("odometry_mm", "unit_of_odometry", "wheel_unit", change=partial(_in_unit, factor=1e3)),
    fault("odometry_cm", "unit_of_odometry", "wheel_unit", change=partial(_in_unit, factor=1e2)),
    fault(
        "quaternion_w_first",
        "quaternion",
        "quaternion_order",
        "tf_contradicts_odometry",
        change=partial(_w_first, tf_too=False),
    ),
    fault(
        "quaternion_w_first_tf",
        "quaternion",
        "quaternion_order",
        change=partial(_w_first, tf_too=True),
    ),
    *(
        fault(f"twist_{name}", "twist", "odometry_twist", change=change)
        for name, change in (
            ("mm", partial(_twist, linear=1e3, angular=1.0)),
            ("deg", partial(_twist, linear=1.0, angular=180.0 / np.pi)),
            ("half", partial(_twist, linear=0.5, angular=0.5)),
            ("turns_other_way", partial(_twist, linear=1.0, angular=-1.0)),
            ("in_odom", _twist_in_odom),
        )
    ),
]

SOURCES = [
    fault(
        "odometry_of_slam_jumps",
        "source",
        "odometry_jump odometry_from_slam",
        "wheel_slip",
        change=partial(_by_slam, jump_m=0.03),
    ),
    fault("odometry_of_slam_perfect", "source", None, change=partial(_by_slam, jump_m=0.0)),
    fault(
        "second_odometry",
        "second_odometry",
        "odometries_contradict",
        "tf_contradicts_odometry",
        change=partial(_second, drift=0.05),
        pairs=True,
    ),
]

ODOMETRY_FAULTS: list[Fault] = [*UNITS, *SOURCES]
