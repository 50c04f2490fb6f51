"""What the checker says: findings, each with its number, its evidence and the mend."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from slamsim.types import FloatArray

Verdict = Literal["ok", "bad", "cannot tell"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured size with its standard deviation, in ``unit``; the interval is 95 %.

    bound: the least standard deviation that any method could have on these data (Cramer-Rao).
    """

    value: float
    sigma: float
    unit: str
    bound: float | None = None

    @property
    def interval(self) -> tuple[float, float]:
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma


@dataclass(frozen=True, slots=True)
class Mend:
    """One correction that ``slamsim fix`` can apply.

    operation: its name in check/mends.py. subject: topic, frame or edge that it acts on.
    parameters: numbers and words under names with units.
    """

    operation: str
    subject: str
    parameters: dict[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line or cloud of a plot: x, y (n,)."""

    label: str
    x: FloatArray
    y: FloatArray
    style: Literal["line", "points"] = "points"


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Evidence to look at: curves over labelled axes (with units), horizontal limits, and spans
    (from, to) of x that are shaded."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[float, ...] = ()
    spans: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """The answer to one question about one subject.

    check: stable dotted name of the question, such as ``laser.rotation`` or ``time.offset.lidar``.
    subject: the topic, frame or edge it is about. fault: the name of what is wrong, one of
    ``FAULT_NAMES``, if and only if the verdict is bad. words: one sentence saying what was found,
    with numbers; for "cannot tell" the reason and which motion or data would have told. advice:
    one sentence saying what to do, empty unless bad. statistic and limit: the number on which the
    verdict rests and the bound it is held against, in ``estimate.unit`` or the unit in words.
    """

    check: str
    subject: str
    verdict: Verdict
    words: str
    fault: str | None = None
    advice: str = ""
    estimate: Estimate | None = None
    limit: float | None = None
    mends: tuple[Mend, ...] = ()
    plots: tuple[Plot, ...] = ()

    def __post_init__(self) -> None:
        if (self.verdict == "bad") != (self.fault is not None):
            raise ValueError(f"{self.check}: a fault is named if and only if something is bad")
        if self.fault is not None and self.fault not in FAULT_NAMES:
            raise ValueError(f"{self.check}: {self.fault!r} is no known fault")

    def untold(self, reason: str) -> Finding:
        """The same as something that cannot be told, the reason added to its words."""
        words = f"{self.words}; {reason}"
        return replace(self, verdict="cannot tell", fault=None, words=words, advice="", mends=())


@dataclass(frozen=True, slots=True, eq=False)
class CheckReport:
    """All findings about a recording, in the order of the questions."""

    name: str
    findings: tuple[Finding, ...]
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def bad(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.verdict == "bad")


FAULT_NAMES: dict[str, str] = {
    "laser_world_fixed": "the rays keep their directions in the world while the robot turns",
    "laser_mirrored": "the scan turns the wrong way: mirrored, left-handed or upside down",
    "laser_angle_step": "the angle between beams is wrong",
    "laser_degrees": "angles in degrees where radians are asked for",
    "laser_yaw": "the laser is mounted with another yaw than declared",
    "laser_position": "the laser sits elsewhere than declared",
    "laser_upside_down": "the laser hangs upside down, its frame does not say so",
    "beam_time_reversed": "the beams fire in the opposite order of what is declared",
    "beam_time_scale": "the time between beams is wrong",
    "flash_scan_timed": "beams of one instant are declared as fired one after the other",
    "rolling_scan_untimed": "beams fired one after the other are declared as of one instant",
    "scan_stamp_end": "the stamp is that of the last beam, not the first",
    "scan_stamp_middle": "the stamp is that of the middle beam, not the first",
    "time_offset_lidar": "the lidar's stamps are early or late against the other sensors",
    "time_offset_imu": "the inertial unit's stamps are early or late against the other sensors",
    "time_offset_wheels": "the wheels' stamps are early or late against the other sensors",
    "clock_drift": "one clock runs faster than another",
    "epoch_mismatch": "streams count time from different origins",
    "stamps_quantised": "stamps are rounded coarsely",
    "stamps_repeated": "messages carry the stamp of another one",
    "stamps_backward": "stamps go backward",
    "stamps_jitter": "stamps scatter: time of publishing, not of measuring",
    "stamps_invented": "stamps of a constant rate that the data contradict",
    "stamps_future": "stamps lie after the message was received",
    "stamps_late": "messages are received long after their stamp",
    "stream_gaps": "messages are missing",
    "scans_overlap": "a scan begins before the one before it ended",
    "topic_shared": "two publishers share a topic",
    "frame_on_two_topics": "two sensors name one frame",
    "tf_missing_link": "frames that should be connected are not",
    "tf_two_parents": "a frame has two parents",
    "tf_loop": "transforms run in a circle",
    "tf_unknown_frame": "messages name a frame that no transform knows",
    "tf_static_changes": "a fixed transform changes",
    "tf_coverage": "no transform covers the instants of the scans",
    "tf_contradicts_odometry": "the transform tree and the odometry disagree",
    "tf_not_rigid": "a transform is no rotation and translation",
    "tf_map_recorded": "the recording holds a map's transform: a SLAM has run already",
    "odometry_invalid": "the odometry holds numbers that are no pose",
    "odometries_contradict": "two odometries tell different drives",
    "odometry_contradicts_wheels": "the published odometry is not what the wheels say",
    "odometry_jump": "the odometry makes a step that no robot makes",
    "odometry_unsigned": "the odometry goes forward while the robot drives backward",
    "odometry_frozen": "the odometry stands still while the robot moves",
    "ticks_frozen": "a wheel counter stands still while the robot moves",
    "wheel_radius": "the wheels are larger or smaller than declared",
    "wheel_unit": "the wheels or the odometry count in another unit than metres",
    "wheel_track": "the wheels stand wider or closer than declared",
    "wheel_reversed": "one wheel counts backward",
    "wheels_swapped": "left and right wheel are exchanged",
    "ticks_wrap": "the wheel counter wraps round",
    "wheel_slip": "the wheels slip",
    "gyro_scale": "the gyroscope's scale is wrong",
    "gyro_sign": "the gyroscope turns the wrong way",
    "gyro_degrees": "the gyroscope speaks degrees per second",
    "gyro_bias": "the gyroscope has a large bias",
    "imu_axis": "the inertial unit is mounted otherwise than declared",
    "gravity_missing": "the accelerometer does not feel gravity",
    "gravity_units": "the accelerometer speaks multiples of g",
    "imu_stuck": "the inertial unit repeats its readings",
    "imu_invalid": "the inertial unit's readings are not finite",
    "imu_spikes": "accelerations that no robot feels",
    "imu_axis_dead": "an axis of the inertial unit never changes",
    "imu_orientation": "the inertial unit's orientation is none, though it is published",
    "range_zero_no_return": "zero stands for no return",
    "range_max_no_return": "a range within the limits stands for no return",
    "range_unit": "ranges are in another unit than metres",
    "range_limits": "declared minimum and maximum contradict the readings",
    "range_offset": "ranges are too long or too short by a constant",
    "beams_constant": "some beams always see the same: the robot itself",
    "beams_dead": "some beams never return anything",
    "scan_stuck": "scans repeat unchanged while the robot moves",
    "scan_interference": "stray short or long readings: another lidar or sunlight",
    "scan_layout": "what the scan declares of its beams does not fit its readings",
    "urdf_inertia": "mass or inertia does not fit the shape",
    "urdf_support_wheels": "support wheels are fixed and not free to slide",
    "urdf_wheel_height": "wheels do not touch the ground",
    "urdf_balance": "the robot would topple where it stands",
    "urdf_unconnected": "links that nothing connects",
    "urdf_unreadable": "the robot description cannot be read",
}
"""Every fault that can be named, and what it means."""
