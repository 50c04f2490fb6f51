"""Faults of the odometry: directions, units, rotations, slides, other sources."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np

from independent.drives import STEP_S, integrated
from independent.fault import Fault, Made, fault
from independent.recorded import Edge, Odometry, yaw_of, yaw_quaternion
from independent.sensors import BEGIN_NS, Conditions


def _odometry(made: Made) -> Odometry:
    return made.bag.odometry[0]


def _tf(made: Made) -> Edge:
    return made.bag.edge(_odometry(made).child)


def _publish(made: Made, xy_m: np.ndarray, yaw: np.ndarray) -> None:
    """These poses as odometry and transform; the twist stays."""
    odometry = _odometry(made)
    odometry.xy_m, odometry.quaternion = xy_m, yaw_quaternion(yaw)
    edge = _tf(made)
    edge.translation = np.column_stack([xy_m, np.zeros(len(xy_m))])
    edge.quaternion = odometry.quaternion.copy()


def _instants(made: Made) -> np.ndarray:
    return (_odometry(made).stamps_ns - BEGIN_NS) * 1e-9


def _integrated_anew(made: Made, forward: np.ndarray, turned: np.ndarray) -> None:
    """Poses from steps (n,) each, in m and rad; the twist follows."""
    odometry = _odometry(made)
    yaw = np.cumsum(turned)
    middle = yaw - 0.5 * turned
    along = np.column_stack([np.cos(middle), np.sin(middle)]) * forward[:, None]
    _publish(made, np.cumsum(along, axis=0), yaw)
    odometry.linear[:, 0] = forward * made.robot.odometry_hz
    odometry.angular[:, 2] = turned * made.robot.odometry_hz


def _steps(made: Made) -> tuple[np.ndarray, np.ndarray]:
    """Forward and turned since the message before."""
    odometry = _odometry(made)
    yaw = yaw_of(odometry.quaternion)
    turned = np.diff(yaw, prepend=yaw[0])
    moved = np.diff(odometry.xy_m, axis=0, prepend=odometry.xy_m[:1])
    middle = yaw - 0.5 * turned
    return moved[:, 0] * np.cos(middle) + moved[:, 1] * np.sin(middle), turned


def _scaled(made: Made, forward: float, turned: float) -> None:
    by_forward, by_turned = _steps(made)
    _integrated_anew(made, forward * by_forward, turned * by_turned)


def _unsigned(made: Made) -> None:
    """Counters that know no direction: forward even where the robot backs up."""
    forward, turned = _steps(made)
    _integrated_anew(made, np.abs(forward), turned)


def _changed_later(made: Made, by: float) -> None:
    """A tyre loses air half-way: both wheels are smaller from then on."""
    steps = _steps(made)
    later = np.arange(len(steps[0])) > 0.5 * len(steps[0])
    _integrated_anew(made, *(each * np.where(later, 1.0 + by, 1.0) for each in steps))


def _one_wheel(made: Made, left: float, right: float) -> None:
    """What each wheel counts, times this."""
    forward, turned = _steps(made)
    half = 0.5 * made.robot.track_m * turned
    by_left, by_right = left * (forward - half), right * (forward + half)
    _integrated_anew(made, 0.5 * (by_left + by_right), (by_right - by_left) / made.robot.track_m)


def _still(made: Made, begin_s: float, seconds: float) -> None:
    """No motion is counted for a while in which the robot moves."""
    at_s = _instants(made)
    counted = (at_s < begin_s) | (at_s > begin_s + seconds)
    _integrated_anew(made, *(each * counted for each in _steps(made)))


def _in_unit(made: Made, factor: float) -> None:
    """Places and speeds in another unit than metres, turns right."""
    odometry = _odometry(made)
    _publish(made, odometry.xy_m * factor, yaw_of(odometry.quaternion))
    odometry.linear *= factor


def _no_heading(made: Made, wholly: bool) -> None:
    """The orientation is never filled in; wholly: places too are those of a robot that never
    turns."""
    odometry = _odometry(made)
    xy_m = odometry.xy_m
    if wholly:
        forward, _ = _steps(made)
        xy_m = np.column_stack([np.cumsum(forward), np.zeros(len(forward))])
    _publish(made, xy_m, np.zeros(len(xy_m)))
    odometry.angular[:, 2] = 0.0


def _w_first(made: Made, tf_too: bool) -> None:
    """Quaternions written as w, x, y, z."""
    odometry = _odometry(made)
    odometry.quaternion = np.roll(odometry.quaternion, 1, axis=1)
    if tf_too:
        _tf(made).quaternion = odometry.quaternion.copy()


def _twist(made: Made, linear: float, angular: float) -> None:
    _odometry(made).linear *= linear
    _odometry(made).angular *= angular


def _twist_in_odom(made: Made) -> None:
    """The linear speed along the axes of odom, not of the base."""
    odometry = _odometry(made)
    yaw, speed = yaw_of(odometry.quaternion), odometry.linear[:, 0].copy()
    odometry.linear[:, 0], odometry.linear[:, 1] = speed * np.cos(yaw), speed * np.sin(yaw)


def _jump(made: Made, by_m: float) -> None:
    odometry = _odometry(made)
    later = np.arange(len(odometry.xy_m)) > 0.45 * len(odometry.xy_m)
    _publish(
        made, odometry.xy_m + later[:, None] * [0.6 * by_m, 0.8 * by_m], yaw_of(odometry.quaternion)
    )


def _not_numbers(made: Made) -> None:
    xy_m = _odometry(made).xy_m
    xy_m[len(xy_m) // 2 : len(xy_m) // 2 + 5] = np.nan


def _by_slam(made: Made, jump_m: float) -> None:
    """True poses, as a SLAM estimates them, corrected again and again by a small jump."""
    drive = made.conditions.drive
    begin = drive.poses[0]
    poses = drive.at(_instants(made)) - [*begin[:2], 0.0]
    cos, sin = np.cos(begin[2]), np.sin(begin[2])
    xy_m = poses[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    pieces = (_instants(made) / 4.0).astype(int)
    off_m = made.rng.normal(0.0, jump_m, (pieces.max() + 1, 2))[pieces]
    _publish(made, xy_m + off_m, poses[:, 2] - begin[2])


def _second(made: Made, drift: float) -> None:
    """Another odometry, which turns too far."""
    other = deepcopy(_odometry(made))
    other.topic = "/odom_visual"
    forward, turned = _steps(made)
    yaw = np.cumsum(turned * (1.0 + drift))
    along = np.column_stack([np.cos(yaw), np.sin(yaw)]) * forward[:, None]
    other.xy_m, other.quaternion = np.cumsum(along, axis=0), yaw_quaternion(yaw)
    made.bag.odometry.append(other)


def _held(conditions: Conditions, begin_s: float, seconds: float) -> Conditions:
    """The robot is held, as by a carpet's edge, while its wheels turn on."""
    drive = conditions.drive
    at_s = STEP_S * np.arange(len(drive.poses))
    held = (at_s > begin_s) & (at_s < begin_s + seconds)
    free = 1.0 - held
    moved = integrated(drive.speeds_m_s * free, drive.turns_rad_s * free, drive.poses[0])
    return replace(conditions, drive=moved)


def _wheels_turn_on(made: Made, begin_s: float, seconds: float) -> None:
    """Forward, at 0.4 m/s, though the robot is held."""
    forward, turned = _steps(made)
    at_s = _instants(made)
    slides = (at_s > begin_s) & (at_s < begin_s + seconds)
    rolled = 0.4 / made.robot.odometry_hz
    _integrated_anew(made, np.where(slides, rolled, forward), np.where(slides, 0.0, turned))


def _slide(name: str, begin_s: float, seconds: float) -> Fault:
    return fault(
        name,
        "slip",
        "wheel_slip",
        conditions=partial(_held, begin_s=begin_s, seconds=seconds),
        change=partial(_wheels_turn_on, begin_s=begin_s, seconds=seconds),
    )


DIRECTIONS = [
    fault(
        "odometry_backward",
        "direction",
        "odometry_reversed wheel_reversed laser_yaw",
        change=partial(_scaled, forward=-1.0, turned=1.0),
    ),
    fault(
        "odometry_turns_other_way",
        "direction",
        "wheels_swapped",
        change=partial(_scaled, forward=1.0, turned=-1.0),
    ),
    fault("odometry_unsigned", "direction", "odometry_unsigned", change=_unsigned),
    fault(
        "left_wheel_backward",
        "direction",
        "wheel_reversed",
        change=partial(_one_wheel, left=-1.0, right=1.0),
    ),
    fault("right_wheel_dead", "direction", None, change=partial(_one_wheel, left=1.0, right=0.0)),
    fault("odometry_never_turns", "heading", None, change=partial(_no_heading, wholly=False)),
    fault("odometry_knows_no_turns", "heading", None, change=partial(_no_heading, wholly=True)),
]

UNITS = [
    fault("odometry_mm", "unit_of_odometry", "wheel_unit", change=partial(_in_unit, factor=1e3)),
    fault("odometry_cm", "unit_of_odometry", "wheel_unit", change=partial(_in_unit, factor=1e2)),
    fault(
        "odometry_forward_x1.05",
        "unit_of_odometry",
        "wheel_radius range_scale",
        "wheel_track",
        change=partial(_scaled, forward=1.05, turned=1.0),
    ),
    fault("quaternion_w_first", "quaternion", None, change=partial(_w_first, tf_too=False)),
    fault("quaternion_w_first_tf", "quaternion", None, change=partial(_w_first, tf_too=True)),
    fault("twist_mm", "twist", None, change=partial(_twist, linear=1e3, angular=1.0)),
    fault("twist_deg", "twist", None, change=partial(_twist, linear=1.0, angular=180.0 / np.pi)),
    fault("twist_half", "twist", None, change=partial(_twist, linear=0.5, angular=0.5)),
    fault("twist_turns_other_way", "twist", None, change=partial(_twist, linear=1.0, angular=-1.0)),
    fault("twist_in_odom", "twist", None, change=_twist_in_odom),
]

EVENTS = [
    fault(
        "odometry_still_5s",
        "frozen",
        "odometry_frozen",
        change=partial(_still, begin_s=25.0, seconds=5.0),
    ),
    fault(
        "odometry_still_10s",
        "frozen",
        "odometry_frozen",
        change=partial(_still, begin_s=35.0, seconds=10.0),
    ),
    fault(
        "odometry_still",
        "frozen",
        "odometry_frozen",
        change=partial(_still, begin_s=-1.0, seconds=1e3),
    ),
    fault(
        "odometry_jump_0.2m", "jump", "odometry_jump", change=partial(_jump, by_m=0.2), pairs=True
    ),
    fault("odometry_jump_1m", "jump", "odometry_jump", change=partial(_jump, by_m=1.0), pairs=True),
    fault("odometry_nan", "nan", "odometry_invalid", change=_not_numbers),
    fault(
        "wheels_smaller_later_2%",
        "changed",
        "wheels_changed",
        change=partial(_changed_later, by=0.02),
    ),
    fault(
        "wheels_smaller_later_-5%",
        "changed",
        "wheels_changed",
        change=partial(_changed_later, by=-0.05),
    ),
    _slide("slide_2s", 30.0, 2.0),
    _slide("slide_5s", 20.0, 5.0),
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

WHEEL_FAULTS: list[Fault] = [*DIRECTIONS, *UNITS, *EVENTS, *SOURCES]
