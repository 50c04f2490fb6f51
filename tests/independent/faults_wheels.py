"""Faults of wheels and their counters: directions, spells without motion, slides, tyres."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from independent.drives import STEP_S, integrated
from independent.fault import Fault, Made, fault
from independent.odometry import instants, integrated_anew, steps_in
from independent.sensors import Conditions


def _scaled(made: Made, forward: float, turned: float) -> None:
    by_forward, by_turned = steps_in(made)
    integrated_anew(made, forward * by_forward, turned * by_turned)


def _unsigned(made: Made) -> None:
    """Counters that know no direction: forward even where the robot backs up."""
    forward, turned = steps_in(made)
    integrated_anew(made, np.abs(forward), turned)


def _changed_later(made: Made, by: float) -> None:
    """A tyre loses air half-way: both wheels are smaller from then on."""
    steps = steps_in(made)
    later = np.arange(len(steps[0])) > 0.5 * len(steps[0])
    integrated_anew(made, *(each * np.where(later, 1.0 + by, 1.0) for each in steps))


def _one_wheel(made: Made, left: float, right: float) -> None:
    """What each wheel counts, times this."""
    forward, turned = steps_in(made)
    half = 0.5 * made.robot.track_m * turned
    by_left, by_right = left * (forward - half), right * (forward + half)
    integrated_anew(made, 0.5 * (by_left + by_right), (by_right - by_left) / made.robot.track_m)


def _still(made: Made, begin_s: float, seconds: float) -> None:
    """No motion is counted for a while in which the robot moves."""
    at_s = instants(made)
    counted = (at_s < begin_s) | (at_s > begin_s + seconds)
    integrated_anew(made, *(each * counted for each in steps_in(made)))


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
    forward, turned = steps_in(made)
    at_s = instants(made)
    slides = (at_s > begin_s) & (at_s < begin_s + seconds)
    rolled = 0.4 / made.robot.odometry_hz
    integrated_anew(made, np.where(slides, rolled, forward), np.where(slides, 0.0, turned))


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
        "odometry_forward_x1.05",
        "unit_of_odometry",
        "wheel_radius range_scale",
        "wheel_track",
        change=partial(_scaled, forward=1.05, turned=1.0),
    ),
    fault(
        "odometry_backward",
        "direction",
        "odometry_reversed wheel_reversed laser_yaw",
        "imu_axis laser_position",  # as of a base whose front is declared at its back
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
    fault(
        "right_wheel_dead",
        "direction",
        "ticks_frozen",
        change=partial(_one_wheel, left=1.0, right=0.0),
    ),
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


WHEEL_FAULTS: list[Fault] = [*DIRECTIONS, *EVENTS]
