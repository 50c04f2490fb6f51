"""What we record as ROS 2 messages: stages' values in, rows of CDR bytes out.

Each function is one message type of REP 103/105/117/145 meaning: metres, radians, seconds;
``inf`` where a beam met nothing; ``-1`` as first covariance where there is no orientation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.logs.cdr import CdrLayout, Rows, set_stamps
from slamsim.sensors.readings import ScanBatch
from slamsim.types import EncoderStream, FloatArray, ImuStream, IntArray

_NO_COVARIANCE = (0.0,) * 36


def scan_layout(frame_id: str, beams: int, intensities: int) -> CdrLayout:
    """sensor_msgs/LaserScan: declared are the seven numbers before the ranges, in their order.

    ranges and intensities are columns unless there are none.
    """
    layout = CdrLayout().header(frame_id).column("declared", "f4", 7)
    for name, count in (("ranges", beams), ("intensities", intensities)):
        layout.length(count)
        if count:
            layout.column(name, "f4", count)
    return layout


def laser_scans(batch: ScanBatch, scan_time_s: float) -> Rows:
    """sensor_msgs/LaserScan; the stamp is the first ray's."""
    geometry = batch.geometry
    angle_max = geometry.angle_min_rad + (geometry.beam_count - 1) * geometry.angle_step_rad
    bright = 0 if batch.intensities is None else geometry.beam_count
    rows = scan_layout(geometry.frame_id, geometry.beam_count, bright).rows(len(batch))
    set_stamps(rows, batch.stamps_ns)
    rows["declared"] = (
        geometry.angle_min_rad,
        angle_max,
        geometry.angle_step_rad,
        geometry.beam_dt_ns * 1e-9,
        scan_time_s,
        geometry.range_min_m,
        geometry.range_max_m,
    )
    rows["ranges"] = batch.ranges_m
    if batch.intensities is not None:
        rows["intensities"] = batch.intensities
    return rows


def imu_layout(frame_id: str, gyro_variance: float = 0.0, accel_variance: float = 0.0) -> CdrLayout:
    """sensor_msgs/Imu: orientation, its covariance, angular velocity, linear acceleration."""
    return (
        CdrLayout()
        .header(frame_id)
        .column("orientation", "f8", 4)
        .column("orientation_covariance", "f8", 9)
        .column("angular_velocity", "f8", 3)
        .constant("f8", *(np.eye(3) * gyro_variance).ravel())
        .column("linear_acceleration", "f8", 3)
        .constant("f8", *(np.eye(3) * accel_variance).ravel())
    )


def imu_samples(stream: ImuStream, gyro_variance: float, accel_variance: float) -> Rows:
    """sensor_msgs/Imu without orientation; variances in (rad/s)^2 and (m/s^2)^2 per sample."""
    layout = imu_layout(stream.frame_id, gyro_variance, accel_variance)
    rows = layout.rows(stream.stamps_ns.size)
    set_stamps(rows, stream.stamps_ns)
    rows["orientation"][:, 3], rows["orientation_covariance"][:, 0] = 1.0, -1.0
    rows["angular_velocity"] = stream.angular_velocity_rad_s
    rows["linear_acceleration"] = stream.linear_acceleration_m_s2
    return rows


def ticks_layout(frame_id: str) -> CdrLayout:
    """slamsim_msgs/EncoderTicks: ticks left and right, and what turns them into metres."""
    return (
        CdrLayout()
        .header(frame_id)
        .column("ticks", "i8", 2)
        .column("ticks_per_revolution", "u4")
        .column("wheel_radius_m", "f8")
        .column("track_m", "f8")
    )


def encoder_ticks(stream: EncoderStream, frame_id: str) -> Rows:
    """slamsim_msgs/EncoderTicks."""
    rows = ticks_layout(frame_id).rows(stream.stamps_ns.size)
    set_stamps(rows, stream.stamps_ns)
    rows["ticks"] = stream.ticks
    rows["ticks_per_revolution"] = stream.ticks_per_revolution
    rows["wheel_radius_m"], rows["track_m"] = stream.wheel_radius_m, stream.track_m
    return rows


def joints_layout(
    frame_id: str, names: Sequence[str], positions: int, velocities: int, efforts: int = 0
) -> CdrLayout:
    """sensor_msgs/JointState; position, velocity and effort are columns unless there are none."""
    layout = CdrLayout().header(frame_id).length(len(names))
    for name in names:
        layout.string(name)
    for field, count in (("position", positions), ("velocity", velocities), ("effort", efforts)):
        layout.length(count)
        if count:
            layout.column(field, "f8", count)
    return layout


def joint_states(
    stamps_ns: IntArray, names: Sequence[str], angles_rad: FloatArray, speeds_rad_s: FloatArray
) -> Rows:
    """sensor_msgs/JointState of so many joints; angles and speeds (n, joints), no effort."""
    rows = joints_layout("", names, len(names), len(names)).rows(stamps_ns.size)
    set_stamps(rows, stamps_ns)
    rows["position"], rows["velocity"] = angles_rad, speeds_rad_s
    return rows


def odometry_layout(frames: tuple[str, str]) -> CdrLayout:
    """nav_msgs/Odometry: position, orientation (x, y, z, w), linear, angular."""
    return (
        CdrLayout()
        .header(frames[0])
        .string(frames[1])
        .column("position", "f8", 3)
        .column("orientation", "f8", 4)
        .constant("f8", *_NO_COVARIANCE)
        .column("linear", "f8", 3)
        .column("angular", "f8", 3)
        .constant("f8", *_NO_COVARIANCE)
    )


def odometry(
    stamps_ns: IntArray,
    frames: tuple[str, str],
    positions_m: FloatArray,
    quats_xyzw: FloatArray,
    linear_m_s: FloatArray,
    angular_rad_s: FloatArray,
) -> Rows:
    """nav_msgs/Odometry: pose of frames[1] in frames[0], twist (n, 3) in frames[1]."""
    rows = odometry_layout(frames).rows(stamps_ns.size)
    set_stamps(rows, stamps_ns)
    rows["position"], rows["orientation"] = positions_m, quats_xyzw
    rows["linear"], rows["angular"] = linear_m_s, angular_rad_s
    return rows


def transforms_layout(frames: Sequence[tuple[str, str]]) -> CdrLayout:
    """tf2_msgs/TFMessage: of each edge (parent, child) stamp, translation, rotation, numbered."""
    layout = CdrLayout().length(len(frames))
    for i, (parent, child) in enumerate(frames):
        layout.stamp(f"stamp{i}").string(parent).string(child)
        layout.column(f"translation{i}", "f8", 3).column(f"rotation{i}", "f8", 4)
    return layout


def transforms(
    stamps_ns: IntArray, frames: tuple[str, str], positions_m: FloatArray, quats_xyzw: FloatArray
) -> Rows:
    """tf2_msgs/TFMessage with one transform each: parent frames[0], child frames[1]."""
    rows = transforms_layout([frames]).rows(stamps_ns.size)
    set_stamps(rows, stamps_ns, "stamp0")
    rows["translation0"], rows["rotation0"] = positions_m, quats_xyzw
    return rows


def static_transforms(
    stamp_ns: int,
    frames: Sequence[tuple[str, str]],
    positions_m: FloatArray,
    quats_xyzw: FloatArray,
) -> Rows:
    """One tf2_msgs/TFMessage that holds all of them: frames as (parent, child)."""
    rows = transforms_layout(frames).rows(1)
    for i in range(len(frames)):
        set_stamps(rows, np.array([stamp_ns]), f"stamp{i}")
        rows[f"translation{i}"], rows[f"rotation{i}"] = positions_m[i], quats_xyzw[i]
    return rows


def twists(stamps_ns: IntArray, frame_id: str, commands: FloatArray) -> Rows:
    """geometry_msgs/TwistStamped from (n, 2) forward speeds in m/s and yaw rates in rad/s."""
    rows = (
        CdrLayout()
        .header(frame_id)
        .column("forward", "f8")
        .constant("f8", 0.0, 0.0, 0.0, 0.0)
        .column("yaw_rate", "f8")
        .rows(stamps_ns.size)
    )
    set_stamps(rows, stamps_ns)
    rows["forward"], rows["yaw_rate"] = commands[:, 0], commands[:, 1]
    return rows


def clocks(stamps_ns: IntArray) -> Rows:
    """rosgraph_msgs/Clock."""
    rows = CdrLayout().stamp().rows(stamps_ns.size)
    set_stamps(rows, stamps_ns)
    return rows


def text(data: str) -> Rows:
    """One std_msgs/String."""
    return CdrLayout().string(data).rows(1)
