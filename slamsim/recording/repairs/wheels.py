"""Repairs of wheel counters and of the odometry that is made from them."""

from __future__ import annotations

from slamsim.recording import RawOdometry, RawTicks, Recording
from slamsim.recording.edits.base import Edit
from slamsim.recording.edits.messages import ChangeMessages
from slamsim.recording.edits.motion import (
    scaled_heading,
    scaled_odometry,
    with_twists,
    without_jumps,
)
from slamsim.recording.edits.odometry import ChangeOdometry, OdometryFromTicks, WithOdometry
from slamsim.recording.edits.wheels import RewireWheels, ScaleWheelNumbers, UnwrapTicks
from slamsim.recording.repairs.base import Repair


def scale_wheels(recording: Recording, repair: Repair) -> Edit:
    """Multiply the declared radius by radius_factor, the track by track_factor."""
    radius, track = repair.number("radius_factor"), repair.number("track_factor")
    return _with_odometry(repair, ScaleWheelNumbers(repair.target(RawTicks), radius, track))


def scale_lengths(recording: Recording, repair: Repair) -> Edit:
    """Of counters as ``scale_wheels``; of an odometry the path by radius_factor."""
    if any(ticks.topic == repair.subject for ticks in recording.ticks):
        return scale_wheels(recording, repair)
    path = repair.number("radius_factor")
    return ChangeOdometry(repair.subject, lambda one: scaled_odometry(one, path, 1.0))


def swap_wheels(recording: Recording, repair: Repair) -> Edit:
    """Exchange left and right."""
    return _with_odometry(repair, RewireWheels(repair.target(RawTicks), order=(1, 0)))


def reverse_wheel(recording: Recording, repair: Repair) -> Edit:
    """Count one wheel, left or right, the other way."""
    signs = (-1, 1) if repair.parameters["wheel"] == "left" else (1, -1)
    return _with_odometry(repair, RewireWheels(repair.target(RawTicks), signs=signs))


def unwrap_ticks(recording: Recording, repair: Repair) -> Edit:
    """Go on counting where a counter of so many values (modulus) begins anew."""
    modulus = round(repair.number("modulus"))
    return _with_odometry(repair, UnwrapTicks(repair.target(RawTicks), modulus))


def odometry_from_ticks(recording: Recording, repair: Repair) -> Edit:
    """Compute an odometry's poses anew from the counters."""
    return OdometryFromTicks(repair.subject)


def scale_odometry(recording: Recording, repair: Repair) -> Edit:
    """Multiply the path by path_factor and the turn by turn_factor, and turn by curvature_rad_m
    more on each metre of the path."""
    path, turn = repair.number("path_factor"), repair.number("turn_factor")
    curvature = repair.number("curvature_rad_m") if "curvature_rad_m" in repair.parameters else 0.0
    return ChangeOdometry(repair.subject, lambda one: scaled_odometry(one, path, turn, curvature))


def scale_heading(recording: Recording, repair: Repair) -> Edit:
    """Multiply an odometry's heading by factor, and leave its path as it is."""
    factor = repair.number("factor")
    return ChangeOdometry(repair.subject, lambda one: scaled_heading(one, factor))


def remove_odometry_jumps(recording: Recording, repair: Repair) -> Edit:
    """Let the robot move on as before where a step is longer than longest_m."""
    longest_m = repair.number("longest_m")
    return ChangeOdometry(repair.subject, lambda one: without_jumps(one, longest_m))


def twist_from_poses(recording: Recording, repair: Repair) -> Edit:
    """Compute an odometry's twists anew from its poses."""
    return ChangeMessages(repair.target(RawOdometry), with_twists)


def _with_odometry(repair: Repair, edit: Edit) -> Edit:
    """The counters edited, and with them every odometry that says what they say."""
    return WithOdometry(repair.subject, edit)
