"""Turns sensor readings and the drive into the streams of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.types import Drive, EncoderStream, IntArray, Trajectory
from slamsim.recording import (
    Origin,
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    RawTwists,
    Recording,
    TransformEdge,
)
from slamsim.recording.schemas import TRANSFORMS
from slamsim.sensors.readings import EncoderBatch, ImuBatch, Readings, scan_streams
from slamsim.simulation.header import LogHeader
from slamsim.simulation.tails import OdometryTail, TruthTail, WheelMotion, at_rate, joined_path

TRUTH, _COMMANDS = "/ground_truth/odom", "/cmd_vel"
TOPICS = {
    "/robot_description": "std_msgs/msg/String",
    "/tf_static": TRANSFORMS,
    "/clock": "rosgraph_msgs/msg/Clock",
    "/scan": RawScans.schema.type_name,
    "/imu/data": RawImu.schema.type_name,
    "/encoder_ticks": RawTicks.schema.type_name,
    "/joint_states": RawJoints.schema.type_name,
    "/odom": RawOdometry.schema.type_name,
    "/tf": TRANSFORMS,
    _COMMANDS: RawTwists.schema.type_name,
    TRUTH: RawOdometry.schema.type_name,
}
"""The topics of a simulated recording and the types of their messages."""

_CLOCK_RATE_HZ, _COMMAND_RATE_HZ = 50.0, 20.0
"""Of /clock, and of the commands that moved the robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What is recorded of some windows of a drive.

    recording: as ``read_recording`` would give it of the file, but for what the additional
    sensors measured. beside: that, the commands and the truth.
    """

    recording: Recording
    beside: tuple[RawStream, ...]


class DriveRecorder:
    """Windows of a drive, one after the other, as parts of one recording of this name."""

    def __init__(self, name: str, header: LogHeader) -> None:
        self._name, self._header = name, header
        self._odometry, self._truth = OdometryTail(), TruthTail(header.truth_rate_hz)
        self._last_ns: int | None = None
        self._fixed = _fixed(header)

    @property
    def constants(self) -> dict[str, dict[str, Sequence[float]]]:
        """What messages say besides, by topic and place in the message: covariances."""
        variances = self._header.imu_gyro_variance, self._header.imu_accel_variance
        names = "angular_velocity_covariance", "linear_acceleration_covariance"
        covariances = ((np.eye(3) * variance).ravel().tolist() for variance in variances)
        return {"/imu/data": dict(zip(names, covariances, strict=True))}

    def take(self, readings: Sequence[Readings], windows: Sequence[Drive]) -> Part:
        """The next windows, and what was sensed in each.

        A stream without a single sample is left out. Numbers that a message holds in single
        precision are kept in it.
        """
        header, last_ns = self._header, self._last_ns
        stamps_ns = np.concatenate([window.stamps_ns for window in windows])
        ticking = stamps_ns[at_rate(stamps_ns, last_ns, _CLOCK_RATE_HZ)]
        wheels, moving = _wheels(readings, header, self._odometry)
        at_start = stamps_ns[:1]
        fixed = (replace(edge, stamps_ns=at_start, received_ns=at_start) for edge in self._fixed)
        recording = Recording(
            name=self._name,
            format="memory",
            streams=(*_scans(readings, header), *_imus(readings), *wheels),
            transforms=(*moving, *fixed),
            robot_description=header.robot_description,
            clock_ns=np.column_stack([ticking, ticking]),
            epoch=header.epoch,
        )
        beside = [stream for window in windows for stream in self._beside(window)]
        batches = [batch for part in readings for batch in part.additional]
        further = [stream for batch in batches for stream in batch.streams() if len(stream)]
        return Part(recording, (*beside, *further))

    def rest(self) -> tuple[RawStream, ...]:
        """What is recorded only because the drive is over: where it truly ended."""
        rest = self._truth.rest
        return () if rest is None else (self._true_odometry(rest),)

    def _beside(self, window: Drive) -> tuple[RawStream, ...]:
        chosen = at_rate(window.stamps_ns, self._last_ns, _COMMAND_RATE_HZ)
        when_ns, frame = window.stamps_ns[chosen], (self._header.base_frame,)
        commands = RawTwists(_COMMANDS, frame, when_ns, when_ns, window.commands[chosen])
        truth = self._true_odometry(self._truth.take(window, self._last_ns))
        self._last_ns = int(window.stamps_ns[-1])
        return commands, truth

    def _true_odometry(self, truth: Drive) -> RawOdometry:
        frames = (self._header.map_frame,), (self._header.base_frame,)
        return RawOdometry(
            TRUTH,
            frames[0],
            truth.stamps_ns,
            truth.stamps_ns,
            frames[1],
            truth.positions_m,
            truth.quats_xyzw,
            *TruthTail.twist_in_base(truth),
        )


def true_trajectory(windows: Sequence[Drive], header: LogHeader) -> Trajectory:
    """``T_map_base`` as it is recorded of these windows, thinned to its rate."""
    tail, last_ns, parts = TruthTail(header.truth_rate_hz), None, []
    for window in windows:
        parts.append(tail.take(window, last_ns))
        last_ns = int(window.stamps_ns[-1])
    if tail.rest is not None:
        parts.append(tail.rest)
    return joined_path(parts)


def _scans(readings: Sequence[Readings], header: LogHeader) -> tuple[RawScans, ...]:
    return scan_streams("/scan", [part.scans for part in readings], header.scan_rate_hz)


def _imus(readings: Sequence[Readings]) -> tuple[RawImu, ...]:
    batches = [part.imu for part in readings if len(part.imu)]
    if not batches:
        return ()
    batch = ImuBatch.joined(batches)
    stream = batch.stream
    return (
        RawImu(
            topic="/imu/data",
            frame_ids=(stream.frame_id,),
            stamps_ns=stream.stamps_ns,
            received_ns=batch.arrival_ns,
            angular_velocity_rad_s=stream.angular_velocity_rad_s,
            linear_acceleration_m_s2=stream.linear_acceleration_m_s2,
            origin=Origin.in_order("/imu/data", np.arange(stream.stamps_ns.size)),
        ),
    )


def _wheels(
    readings: Sequence[Readings], header: LogHeader, tail: OdometryTail
) -> tuple[tuple[RawStream, ...], tuple[TransformEdge, ...]]:
    """All that the driver of the wheels publishes."""
    batches = [part.encoders for part in readings if len(part.encoders)]
    if not batches:
        return (), ()
    motion = WheelMotion.joined([tail.extend(batch.stream) for batch in batches])
    whole = EncoderBatch.joined(batches)
    stream, received_ns = whole.stream, whole.arrival_ns
    odometry, moving = _odometry(stream.stamps_ns, received_ns, motion, header)
    ticks = _ticks(stream, received_ns, header.base_frame)
    joints = _joints(stream.stamps_ns, received_ns, motion, header)
    return (odometry, ticks, joints), (moving,)


def _ticks(stream: EncoderStream, received_ns: IntArray, base_frame: str) -> RawTicks:
    return RawTicks(
        "/encoder_ticks",
        (base_frame,),
        stream.stamps_ns,
        received_ns,
        stream.ticks,
        stream.ticks_per_revolution,
        stream.wheel_radius_m,
        stream.track_m,
        origin=Origin.in_order("/encoder_ticks", np.arange(stream.stamps_ns.size)),
    )


def _joints(
    stamps_ns: IntArray, received_ns: IntArray, motion: WheelMotion, header: LogHeader
) -> RawJoints:
    moved = motion.angles_rad, motion.speeds_rad_s
    common = "/joint_states", ("",), stamps_ns, received_ns
    origin = Origin.in_order("/joint_states", np.arange(stamps_ns.size))
    return RawJoints(*common, header.wheel_joints, *moved, origin=origin)


def _odometry(
    stamps_ns: IntArray, received_ns: IntArray, motion: WheelMotion, header: LogHeader
) -> tuple[RawOdometry, TransformEdge]:
    """The same poses as messages and as the moving edge of the transform tree."""
    odom, base, when = header.odom_frame, header.base_frame, (stamps_ns, received_ns)
    poses, twists = (
        (motion.positions_m, motion.quats_xyzw),
        (motion.linear_m_s, motion.angular_rad_s),
    )
    each = np.arange(stamps_ns.size)
    published = Origin.in_order("/odom", each)
    odometry = RawOdometry("/odom", (odom,), *when, (base,), *poses, *twists, origin=published)
    moved = Origin.in_order("/tf", each)
    return odometry, TransformEdge("/tf", odom, base, False, *when, *poses, moved)


def _fixed(header: LogHeader) -> tuple[TransformEdge, ...]:
    """The mounts of the robot's sensors, at no time yet."""
    at_start: IntArray = np.zeros(1, dtype=np.int64)
    return tuple(
        TransformEdge(
            "/tf_static",
            edge.parent,
            edge.child,
            True,
            at_start,
            at_start,
            edge.T_parent_child[None, :3, 3],
            xyzw_from_matrix(edge.T_parent_child[:3, :3])[None],
            Origin("/tf_static", np.array([[0, number]])),
        )
        for number, edge in enumerate(header.static_transforms)
    )
