"""One fault, one name: what follows from something else that was found is not held against anybody.

Every question is asked by itself, and a single fault may spoil the answers to many. Where one fault
makes another question unanswerable, or answers it wrongly, what was found "bad" there becomes
"cannot tell", with the reason. Faults that do not touch each other are both told.
"""

from __future__ import annotations

from collections.abc import Sequence

from slamsim.check.findings import Finding
from slamsim.recording.fault_names import FAULT_NAMES

_LIDAR_TIMES = ("time_offset_lidar", "scan_stamp_end", "scan_stamp_middle")
_SWEEPS = ("beam_time_scale", "beam_time_reversed", "flash_scan_timed", "rolling_scan_untimed")
_MOUNTING = ("laser_yaw", "laser_position")
_SIZES = ("wheel_radius", "wheel_track", "wheel_slip", "laser_yaw", "laser_position", "gyro_scale")
_STAMPS = ("stamps_quantised", "stamps_repeated", "stamps_jitter", "stamps_backward", "stream_gaps")
_WHEELS = (
    *("wheel_slip", "wheel_track", "wheel_radius", "wheel_reversed", "wheels_swapped"),
    *("odometry_contradicts_wheels", "time_offset_wheels"),
)

ON_ONE_SUBJECT: dict[str, tuple[str, ...]] = {
    "stamps_quantised": (*_LIDAR_TIMES, "time_offset_imu", "time_offset_wheels", "clock_drift"),
    "stamps_repeated": (*_LIDAR_TIMES, "time_offset_imu", "time_offset_wheels", "clock_drift"),
    "range_unit": ("range_limits", "range_offset", "scan_interference"),
    "imu_stuck": (
        *("time_offset_imu", "gyro_scale", "gyro_bias", "clock_drift", "imu_axis"),
        "imu_axis_dead",
    ),
    "imu_axis": ("gyro_sign", "gyro_scale", "gyro_bias"),
    "gyro_degrees": ("gyro_scale", "gyro_bias"),
    "stamps_invented": (*_LIDAR_TIMES, "clock_drift"),
    "imu_axis_dead": ("time_offset_imu", "gyro_scale", "gyro_bias", "clock_drift", "imu_axis"),
    "topic_shared": (
        *(*_STAMPS, "scans_overlap"),
        *("odometry_jump", "odometry_contradicts_wheels", "odometry_frozen"),
    ),
}
"""Faults, and what else they make of the same topic."""

ON_ANY_SUBJECT: dict[str, tuple[str, ...]] = {
    "laser_world_fixed": (*_SIZES, *_LIDAR_TIMES, *_SWEEPS, "laser_angle_step", "range_offset"),
    "laser_mirrored": (*_MOUNTING, *_SWEEPS, "gyro_sign", "wheels_swapped"),
    "laser_upside_down": (*_MOUNTING, *_SWEEPS, "laser_mirrored"),
    "laser_degrees": ("laser_angle_step", *_SWEEPS, "range_offset"),
    "scan_stuck": (*_SIZES, *_LIDAR_TIMES, *_SWEEPS, "stamps_invented", "laser_world_fixed"),
    "stamps_invented": (*_SIZES, *_SWEEPS, "laser_angle_step"),
    "flash_scan_timed": (*_LIDAR_TIMES, "laser_angle_step", "scans_overlap"),
    "rolling_scan_untimed": (*_LIDAR_TIMES, "laser_angle_step"),
    "beam_time_reversed": (*_LIDAR_TIMES, "laser_yaw", "laser_angle_step"),
    "wheel_reversed": ("odometry_contradicts_wheels", "wheel_slip", "wheel_track", "wheel_radius"),
    "wheel_unit": ("odometry_jump", "wheel_slip", "odometry_contradicts_wheels"),
    "wheels_swapped": ("odometry_contradicts_wheels", "wheel_slip", "wheel_track"),
    "ticks_wrap": ("odometry_contradicts_wheels", "wheel_slip", "odometry_jump"),
    "odometry_unsigned": ("wheel_slip", "odometry_contradicts_wheels"),
    "ticks_frozen": (*_WHEELS, "odometry_frozen"),
    "odometry_invalid": (
        *("odometry_contradicts_wheels", "odometry_frozen", "odometry_jump", "wheel_slip"),
        *("tf_contradicts_odometry", "odometries_contradict"),
    ),
    "topic_shared": ("tf_contradicts_odometry", "odometries_contradict", "wheel_slip"),
    "odometry_frozen": (
        *("wheel_slip", "odometry_contradicts_wheels", "tf_contradicts_odometry"),
        "odometries_contradict",
    ),
    "odometry_jump": ("odometry_contradicts_wheels", "wheel_slip"),
}
"""Faults, and what else they make of everything."""

SWEEPS = 2.0
"""Stamps are off by no more than this many sweeps because nobody declared the sweep."""

UNTIL_TURNS_AGREE = (*_SIZES, "range_offset", "stamps_invented")
"""What scans of a wrong shape, or wheels of wrong sizes, make of everything else."""

LIDAR_STAMPS = (
    "topic_shared",
    "stamps_quantised",
    "stamps_repeated",
    "stamps_jitter",
    "stamps_backward",
)
LIDAR_QUESTIONS = ("laser.", "ranges.offset")
SPOILT_BY_LIDAR_STAMPS = (
    *(
        *_SIZES,
        *_SWEEPS,
        "laser_angle_step",
        "range_offset",
        "stamps_invented",
        "scan_interference",
    ),
    *("laser_world_fixed", "laser_mirrored", "odometry_frozen", *_LIDAR_TIMES, "clock_drift"),
)


SPOILT_BY_COARSE_STAMPS = ("time_offset_imu", "time_offset_wheels")
"""Stamps that repeat leave scans at instants when they were not made, for all to be compared to."""


def explained(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The same findings, the consequences among them no longer "bad"."""
    findings = _without_contradicted(findings)
    bad = [finding for finding in findings if finding.verdict == "bad"]
    lidars = {one.subject for one in findings if one.check.startswith(LIDAR_QUESTIONS)}
    return tuple(_judged(finding, bad, lidars) for finding in findings)


def _without_contradicted(findings: Sequence[Finding]) -> list[Finding]:
    """Where turns of scans and of all others differ, and scans do not fit each other well enough
    to know their angles, no size that rests on either is told."""
    open_questions = {
        one.check for one in findings if one.verdict == "cannot tell" and one.estimate is not None
    }
    if not {"laser.rotation", "laser.angle_step"} <= open_questions:
        return list(findings)
    reason = "cannot be told while the turns of the scans and of the others contradict each other"
    return [one.untold(reason) if one.fault in UNTIL_TURNS_AGREE else one for one in findings]


def _judged(finding: Finding, bad: Sequence[Finding], lidars: set[str]) -> Finding:
    if finding.verdict != "bad":
        return finding
    causes = [one for one in bad if _follows(finding, one, lidars)]
    if not causes:
        return finding
    cause = causes[0]
    assert cause.fault is not None
    reason = f"cannot be told while {FAULT_NAMES[cause.fault]} ({cause.subject})"
    return finding.untold(reason)


def _follows(finding: Finding, cause: Finding, lidars: set[str]) -> bool:
    """Whether the one may be nothing but a consequence of the other."""
    fault, by = finding.fault, cause.fault
    if fault is None or by is None or fault == by:
        return False
    if fault in ON_ANY_SUBJECT.get(by, ()):
        return not _is_larger(finding, cause)
    if by in LIDAR_STAMPS and cause.subject in lidars:
        coarse = by == "stamps_quantised" and fault in SPOILT_BY_COARSE_STAMPS
        if coarse or fault in SPOILT_BY_LIDAR_STAMPS:
            return True
    return finding.subject == cause.subject and fault in ON_ONE_SUBJECT.get(by, ())


def _is_larger(finding: Finding, cause: Finding) -> bool:
    """Whether an offset is more than an undeclared sweep can make of the stamps."""
    if cause.fault != "rolling_scan_untimed" or finding.fault not in _LIDAR_TIMES:
        return False
    if finding.estimate is None or cause.estimate is None:
        return False
    return abs(finding.estimate.value) > SWEEPS * abs(cause.estimate.value)
