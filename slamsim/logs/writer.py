"""Writes a simulated recording while it is being made: a rosbag2 folder with one MCAP file.

The file's log time is true time: a message is logged when it arrives, and the file is in the
order of arrival. Stamps inside the messages are acquisition times on each sensor's own clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from slamsim.geometry import xyzw_from_matrix
from slamsim.logs import messages
from slamsim.logs.bag_folder import BagFolder, TopicKind
from slamsim.logs.cdr import Rows
from slamsim.logs.mcap_file import MessageBatch
from slamsim.logs.recorded import OdometryTail, TruthTail, at_rate
from slamsim.logs.ros_types import ENCODER_TICKS
from slamsim.logs.written import Written
from slamsim.sensors.readings import Readings
from slamsim.types import Drive, Epoch, FloatArray, IntArray

TRUTH_TOPIC = "/ground_truth/odom"

CLOCK_RATE_HZ = 50.0
_COMMAND_RATE_HZ = 20.0
_TYPES = {
    "/robot_description": "std_msgs/msg/String",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/encoder_ticks": ENCODER_TICKS,
    "/joint_states": "sensor_msgs/msg/JointState",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    TRUTH_TOPIC: "nav_msgs/msg/Odometry",
}
_LATCHED = ("/robot_description", "/tf_static")


class StaticTransform(Protocol):
    """One edge of the transform tree that never moves: T_parent_child is 4 x 4."""

    @property
    def parent(self) -> str: ...

    @property
    def child(self) -> str: ...

    @property
    def T_parent_child(self) -> FloatArray: ...  # noqa: N802


@dataclass(frozen=True, slots=True, eq=False)
class LogHeader:
    """What a recording says once.

    robot_description: the URDF. scan_rate_hz: turns of the lidar per second. wheel_joints: names
    of the (left, right) joint. The variances are those of one IMU sample, in (rad/s)^2 and
    (m/s^2)^2, 0 for unknown. truth_rate_hz: how often the true pose is recorded, at most the
    physics rate. metadata: whatever else shall stand in the file, such as sensor constants and
    versions.
    """

    robot_description: str
    static_transforms: Sequence[StaticTransform]
    scan_rate_hz: float
    wheel_joints: tuple[str, str] = ("wheel_left_joint", "wheel_right_joint")
    imu_gyro_variance: float = 0.0
    imu_accel_variance: float = 0.0
    epoch: Epoch = "simulation"
    truth_rate_hz: float = 120.0
    odom_frame: str = "odom"
    base_frame: str = "base_footprint"
    map_frame: str = "map"
    metadata: Mapping[str, str] = field(default_factory=dict)


class LogWriter(Written):
    """A recording being written into an existing or new folder; a context manager.

    After an exception inside the block the file ends where it stands, without an index: the
    folder is then unfinished, and whoever made it discards it. A killed writer loses at most
    the open chunk of 1 MiB; closed ones reach the disk every second.
    """

    def __init__(self, folder: Path, header: LogHeader) -> None:
        super().__init__()
        self._header = header
        topics = [TopicKind(name, kind, name in _LATCHED) for name, kind in _TYPES.items()]
        custom = {"epoch": header.epoch, **dict(sorted(header.metadata.items()))}
        self._bag = self._open.enter_context(BagFolder(folder, topics, custom))
        self._held: dict[str, list[MessageBatch]] = {topic.name: [] for topic in topics}
        self._odometry = OdometryTail()
        self._truth = TruthTail(header.truth_rate_hz)
        self._last_ns: int | None = None

    def write(self, readings: Readings, window: Drive) -> None:
        """The next window of the drive and what was sensed up to its end.

        Messages that arrive after the window's end are held back until their time has come.
        """
        if len(window) == 0:
            return
        end_ns = int(window.stamps_ns[-1])
        if self._last_ns is None:
            self._add_once(int(window.stamps_ns[0]))
        self._add_drive(window)
        self._add_readings(readings)
        self._last_ns = end_ns
        self._release(end_ns)

    def _add(self, topic: str, log_ns: IntArray, rows: Rows) -> None:
        if log_ns.size:
            self._held[topic].append(self._bag.batch(topic, log_ns, rows))

    def _add_once(self, first_ns: int) -> None:
        at_start = np.array([first_ns], dtype=np.int64)
        fixed = self._header.static_transforms
        self._add("/robot_description", at_start, messages.text(self._header.robot_description))
        self._add(
            "/tf_static",
            at_start,
            messages.static_transforms(
                first_ns,
                [(edge.parent, edge.child) for edge in fixed],
                np.array([edge.T_parent_child[:3, 3] for edge in fixed]).reshape(-1, 3),
                np.array([xyzw_from_matrix(edge.T_parent_child[:3, :3]) for edge in fixed]),
            ),
        )

    def _add_drive(self, window: Drive) -> None:
        clock = at_rate(window.stamps_ns, self._last_ns, CLOCK_RATE_HZ)
        ticking_ns = window.stamps_ns[clock]
        self._add("/clock", ticking_ns, messages.clocks(ticking_ns))
        command = at_rate(window.stamps_ns, self._last_ns, _COMMAND_RATE_HZ)
        commanded_ns = window.stamps_ns[command]
        twists = messages.twists(commanded_ns, self._header.base_frame, window.commands[command])
        self._add("/cmd_vel", commanded_ns, twists)
        self._add_truth(self._truth.take(window, self._last_ns))

    def _add_truth(self, truth: Drive) -> None:
        frames = (self._header.map_frame, self._header.base_frame)
        linear_m_s, angular_rad_s = TruthTail.twist_in_base(truth)
        rows = messages.odometry(
            truth.stamps_ns, frames, truth.positions_m, truth.quats_xyzw, linear_m_s, angular_rad_s
        )
        self._add(TRUTH_TOPIC, truth.stamps_ns, rows)

    def _add_readings(self, readings: Readings) -> None:
        header, scans, imu = self._header, readings.scans, readings.imu
        if len(scans):
            rows = messages.laser_scans(scans, 1.0 / header.scan_rate_hz)
            self._add("/scan", scans.arrival_ns, rows)
        if len(imu):
            rows = messages.imu_samples(
                imu.stream, header.imu_gyro_variance, header.imu_accel_variance
            )
            self._add("/imu/data", imu.arrival_ns, rows)
        if len(readings.encoders):
            self._add_wheels(readings)

    def _add_wheels(self, readings: Readings) -> None:
        header, stream = self._header, readings.encoders.stream
        arrival_ns, stamps_ns = readings.encoders.arrival_ns, stream.stamps_ns
        wheels = self._odometry.extend(stream)
        frames = (header.odom_frame, header.base_frame)
        self._add("/encoder_ticks", arrival_ns, messages.encoder_ticks(stream, header.base_frame))
        joints = messages.joint_states(
            stamps_ns, header.wheel_joints, wheels.angles_rad, wheels.speeds_rad_s
        )
        self._add("/joint_states", arrival_ns, joints)
        odometry = messages.odometry(
            stamps_ns,
            frames,
            wheels.positions_m,
            wheels.quats_xyzw,
            wheels.linear_m_s,
            wheels.angular_rad_s,
        )
        self._add("/odom", arrival_ns, odometry)
        moves = messages.transforms(stamps_ns, frames, wheels.positions_m, wheels.quats_xyzw)
        self._add("/tf", arrival_ns, moves)

    def _release(self, until_ns: int | None) -> None:
        """Write what has arrived by then, or all of it, and keep the rest."""
        ready = []
        for topic, batches in self._held.items():
            late = []
            for batch in batches:
                count = batch.log_ns.size
                if until_ns is not None:
                    count = int(np.searchsorted(batch.log_ns, until_ns, side="right"))
                ready.append(_part(batch, slice(0, count)))
                late.append(_part(batch, slice(count, None)))
            self._held[topic] = [batch for batch in late if batch.log_ns.size]
        self._bag.write(ready)

    def _finish(self) -> None:
        if self._truth.rest is not None:
            self._add_truth(self._truth.rest)
        self._release(None)


def _part(batch: MessageBatch, which: slice) -> MessageBatch:
    return MessageBatch(batch.channel, batch.log_ns[which], batch.data[which])
