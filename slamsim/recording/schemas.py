"""Schema of each kind of stream: one table from which every format follows.

A field says what it is called in a stream, where it stands in the ROS message, and which columns
of a Parquet table hold it. How messages are serialised and parsed, how tables are written and
read, and what an edit sets in a message is made of these tables (``slamsim.io``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DType = Literal["float64", "float32", "int64", "uint8"]


@dataclass(frozen=True, slots=True)
class Field:
    """One quantity of a message: (n,) numbers of a stream, or (n, k) where it has several.

    name: as in the stream, with its unit. paths: places in the ROS message, by dots; several for
    one number each. axes: the members of the vector at the place, such as ``xyz``. is_list: a
    sequence of any length stands there. is_constant: what all messages of a stream say alike.
    dtype: of the numbers in memory. is_single: a message has it in single precision all the same.
    column: in a Parquet table, with ``{}`` for one of ``parts``;
    empty for what is not kept there. about: what the column is, if its name does not say it all.
    repeats: whether the same few thousand values come again and again. is_optional: a stream may
    lack it. absent: what the place holds in a message without it, whose covariance at
    ``covariance`` begins with -1 (sensor_msgs/Imu).
    """

    name: str
    paths: tuple[str, ...]
    axes: str = ""
    is_list: bool = False
    is_constant: bool = False
    dtype: DType = "float64"
    is_single: bool = False
    column: str = ""
    parts: tuple[str, ...] = ()
    about: str = ""
    repeats: bool = False
    is_optional: bool = False
    absent: tuple[float, ...] = ()
    covariance: str = ""


@dataclass(frozen=True, slots=True)
class Schema:
    """A kind of stream. type_name: of its ROS messages. table: of its first stream in Parquet.

    frames: (field of the stream, place in the message) of the frames that a message names.
    parts: the field of the stream that names the parts of its columns. about: what a table says of
    itself, by key.
    """

    type_name: str
    fields: tuple[Field, ...]
    table: str = ""
    frames: tuple[tuple[str, str], ...] = (("frame_ids", "header.frame_id"),)
    stamp: str = "header.stamp"
    parts: str = ""
    about: tuple[tuple[str, str], ...] = ()

    @property
    def paths(self) -> tuple[str, ...]:
        """All places of all fields, and of the covariances that tell whether there is one."""
        told = (field.covariance for field in self.fields if field.covariance)
        return (*(path for field in self.fields for path in field.paths), *told)

    def field(self, name: str) -> Field:
        return next(field for field in self.fields if field.name == name)


def _vector(name: str, path: str, column: str = "", axes: str = "xyz") -> Field:
    return Field(name, (path,), axes, column=column, parts=tuple(axes))


def _single(name: str, path: str) -> Field:
    return Field(name, (path,), is_single=True)


LASER_LAYOUT = (
    _single("angle_min_rad", "angle_min"),
    _single("angle_max_rad", "angle_max"),
    _single("angle_step_rad", "angle_increment"),
    _single("beam_dt_s", "time_increment"),
    _single("scan_time_s", "scan_time"),
    _single("range_min_m", "range_min"),
    _single("range_max_m", "range_max"),
)
"""What a scan declares of its beams, in the order of ``ScanLayout``."""

SCANS = Schema(
    "sensor_msgs/msg/LaserScan",
    (
        *LASER_LAYOUT,
        Field(
            "ranges_m",
            ("ranges",),
            is_list=True,
            dtype="float32",
            column="ranges_m",
            about="inf: no return, nan: invalid",
            repeats=True,
        ),
        Field(
            "intensities",
            ("intensities",),
            is_list=True,
            dtype="float32",
            column="intensities",
            about="0 without a return",
            is_optional=True,
        ),
    ),
    "scans",
    about=(
        (
            "beams",
            "beam i fires i * beam_dt_s after the stamp at angle_min_rad + i * angle_step_rad",
        ),
    ),
)
IMU = Schema(
    "sensor_msgs/msg/Imu",
    (
        Field(
            "orientation_xyzw",
            ("orientation",),
            "xyzw",
            is_optional=True,
            absent=(0.0, 0.0, 0.0, 1.0),
            covariance="orientation_covariance",
        ),
        _vector("angular_velocity_rad_s", "angular_velocity", "angular_velocity_{}_rad_s"),
        _vector("linear_acceleration_m_s2", "linear_acceleration", "linear_acceleration_{}_m_s2"),
    ),
    "imu",
    about=(("acceleration", "specific force: +9.8 on z at rest"),),
)
ODOMETRY = Schema(
    "nav_msgs/msg/Odometry",
    (
        _vector("positions_m", "pose.pose.position", "position_{}_m"),
        _vector("quats_xyzw", "pose.pose.orientation", "quat_{}", "xyzw"),
        _vector("linear_m_s", "twist.twist.linear", "linear_velocity_{}_m_s"),
        _vector("angular_rad_s", "twist.twist.angular", "angular_velocity_{}_rad_s"),
    ),
    "odometry",
    (("frame_ids", "header.frame_id"), ("child_frame_ids", "child_frame_id")),
    about=(("pose", "of the child in the frame; velocities in the child"),),
)
TICKS = Schema(
    "slamsim_msgs/msg/EncoderTicks",
    (
        Field(
            "ticks",
            ("left", "right"),
            dtype="int64",
            column="ticks_{}",
            parts=("left", "right"),
            about="since the start",
        ),
        Field("ticks_per_revolution", ("ticks_per_revolution",), is_constant=True, dtype="int64"),
        Field("wheel_radius_m", ("wheel_radius_m",), is_constant=True),
        Field("track_m", ("track_m",), is_constant=True),
    ),
    "encoders",
)
JOINTS = Schema(
    "sensor_msgs/msg/JointState",
    (
        Field("positions_rad", ("position",), is_list=True, column="{}_position_rad"),
        Field("velocities_rad_s", ("velocity",), is_list=True, column="{}_velocity_rad_s"),
    ),
    "joints",
    parts="names",
)

TRANSFORM = Schema(
    "geometry_msgs/msg/TransformStamped",
    (
        _vector("positions_m", "transform.translation", "position_{}_m"),
        _vector("quats_xyzw", "transform.rotation", "quat_{}", "xyzw"),
    ),
    "transforms",
    (("parent", "header.frame_id"), ("child", "child_frame_id")),
)
"""One of the transforms of a message."""
TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""The messages that hold them."""

TWISTS = Schema(
    "geometry_msgs/msg/TwistStamped",
    (Field("commands", ("twist.linear.x", "twist.angular.z"), parts=("forward", "yaw_rate")),),
)
CLOCK = Schema("rosgraph_msgs/msg/Clock", (), frames=(), stamp="clock")
