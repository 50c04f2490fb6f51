"""Streams of a recording as rows of ROS 2 messages: what is to be written, and when it came."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from slamsim.logs import messages
from slamsim.logs.cdr import Rows, set_stamps
from slamsim.logs.ros_types import ENCODER_TICKS
from slamsim.recording import (
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawTicks,
    Recording,
    TransformEdge,
)
from slamsim.types import Float32Array, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Outgoing:
    """Messages of one topic and one size. log_ns: (n,) when each was received, in file order.

    rows: the messages of these numbers. message_bytes: about as long as one is.
    """

    topic: str
    type_name: str
    log_ns: IntArray
    message_bytes: int
    rows: Callable[[IntArray], Rows]
    latched: bool = False


def outgoing(recording: Recording) -> list[Outgoing]:
    """All that a recording holds, static transforms and description first."""
    found = [*_description(recording), *_static(recording), *_clock(recording)]
    for scans in recording.scans:
        found += _scans(scans)
    found += [_imu(stream) for stream in recording.imus]
    found += [_ticks(stream) for stream in recording.ticks]
    found += [_joints(stream) for stream in recording.joints]
    found += [_odometry(stream) for stream in recording.odometries]
    return found + [_moving(edge) for edge in recording.transforms if not edge.is_static]


def _received(stamps_ns: IntArray, received_ns: IntArray | None) -> IntArray:
    """At its stamp where nobody says; never before the message above, for the order to stay."""
    log_ns = stamps_ns if received_ns is None else received_ns
    return np.maximum.accumulate(np.maximum(log_ns, 0))  # MCAP has no time before 0


def _first(names: Sequence[str]) -> str:
    return names[0] if names else ""


def _begin_ns(recording: Recording) -> IntArray:
    streams = (*recording.scans, *recording.imus, *recording.odometries, *recording.ticks)
    firsts = [int(_received(s.stamps_ns, s.received_ns).min()) for s in streams if len(s)]
    return np.array([min(firsts, default=0)], dtype=np.int64)


def _scans(scans: RawScans) -> list[Outgoing]:
    """One for each number of beams."""
    beams = np.array([len(row) for row in scans.ranges_m], dtype=np.int64)
    if isinstance(scans.ranges_m, np.ndarray):
        beams = np.full(len(scans), scans.ranges_m.shape[1])
    log_ns = _received(scans.stamps_ns, scans.received_ns)
    declared = np.array([astuple(layout) for layout in scans.layouts])
    found = []
    for count in np.unique(beams).tolist():
        mine = np.flatnonzero(beams == count)

        def rows(which: IntArray, mine: IntArray = mine, count: int = count) -> Rows:
            chosen = mine[which]
            bright = 0 if scans.intensities is None else count
            made = messages.scan_layout(_first(scans.frame_ids), count, bright).rows(chosen.size)
            set_stamps(made, scans.stamps_ns[chosen])
            made["declared"] = declared[scans.layout_of[chosen]]
            if count:
                made["ranges"] = _chosen(scans.ranges_m, chosen)
            if bright and scans.intensities is not None:
                made["intensities"] = _chosen(scans.intensities, chosen)
            return made

        size = 100 + 4 * count * (1 if scans.intensities is None else 2)
        kind = "sensor_msgs/msg/LaserScan"
        found.append(Outgoing(scans.topic, kind, log_ns[mine], size, rows))
    return found


def _chosen(values: Sequence[Float32Array] | Float32Array, which: IntArray) -> Float32Array:
    if isinstance(values, np.ndarray):
        return values[which]
    return np.stack([values[i] for i in which.tolist()])


def _imu(stream: RawImu) -> Outgoing:
    def rows(which: IntArray) -> Rows:
        made = messages.imu_layout(_first(stream.frame_ids)).rows(which.size)
        set_stamps(made, stream.stamps_ns[which])
        if stream.orientation_xyzw is None:
            made["orientation"][:, 3], made["orientation_covariance"][:, 0] = 1.0, -1.0
        else:
            made["orientation"] = stream.orientation_xyzw[which]
        made["angular_velocity"] = stream.angular_velocity_rad_s[which]
        made["linear_acceleration"] = stream.linear_acceleration_m_s2[which]
        return made

    log_ns = _received(stream.stamps_ns, stream.received_ns)
    return Outgoing(stream.topic, "sensor_msgs/msg/Imu", log_ns, 340, rows)


def _ticks(stream: RawTicks) -> Outgoing:
    def rows(which: IntArray) -> Rows:
        made = messages.ticks_layout(_first(stream.frame_ids)).rows(which.size)
        set_stamps(made, stream.stamps_ns[which])
        made["ticks"] = stream.ticks[which]
        made["ticks_per_revolution"] = stream.ticks_per_revolution
        made["wheel_radius_m"], made["track_m"] = stream.wheel_radius_m, stream.track_m
        return made

    log_ns = _received(stream.stamps_ns, stream.received_ns)
    return Outgoing(stream.topic, ENCODER_TICKS, log_ns, 80, rows)


def _joints(stream: RawJoints) -> Outgoing:
    def rows(which: IntArray) -> Rows:
        numbers = stream.positions_rad[which], stream.velocities_rad_s[which]
        return messages.joint_states(stream.stamps_ns[which], stream.names, *numbers)

    log_ns = _received(stream.stamps_ns, stream.received_ns)
    size = 60 + 50 * len(stream.names)
    return Outgoing(stream.topic, "sensor_msgs/msg/JointState", log_ns, size, rows)


def _odometry(stream: RawOdometry) -> Outgoing:
    frames = _first(stream.frame_ids), _first(stream.child_frame_ids)

    def rows(which: IntArray) -> Rows:
        return messages.odometry(
            stream.stamps_ns[which],
            frames,
            stream.positions_m[which],
            stream.quats_xyzw[which],
            stream.linear_m_s[which],
            stream.angular_rad_s[which],
        )

    log_ns = _received(stream.stamps_ns, stream.received_ns)
    return Outgoing(stream.topic, "nav_msgs/msg/Odometry", log_ns, 750, rows)


def _moving(edge: TransformEdge) -> Outgoing:
    def rows(which: IntArray) -> Rows:
        poses = edge.positions_m[which], edge.quats_xyzw[which]
        return messages.transforms(edge.stamps_ns[which], (edge.parent, edge.child), *poses)

    log_ns = _received(edge.stamps_ns, edge.received_ns)
    return Outgoing(edge.topic, "tf2_msgs/msg/TFMessage", log_ns, 150, rows)


def _static(recording: Recording) -> list[Outgoing]:
    """The first of every edge in one message, as a latched topic has it; what is said later of
    an edge in messages of its own."""
    edges = [edge for edge in recording.transforms if edge.is_static and edge.stamps_ns.size]
    if not edges:
        return []
    frames = [(edge.parent, edge.child) for edge in edges]

    def first(which: IntArray) -> Rows:
        made = messages.transforms_layout(frames).rows(which.size)
        for i, edge in enumerate(edges):
            set_stamps(made, edge.stamps_ns[:1], f"stamp{i}")
            made[f"translation{i}"], made[f"rotation{i}"] = edge.positions_m[0], edge.quats_xyzw[0]
        return made

    kind = "tf2_msgs/msg/TFMessage"
    begin_ns = min(int(_received(edge.stamps_ns, edge.received_ns)[0]) for edge in edges)
    at_ns = np.array([begin_ns], dtype=np.int64)
    found = [Outgoing("/tf_static", kind, at_ns, 150 * len(edges), first, latched=True)]
    for edge in edges:
        if edge.stamps_ns.size > 1:
            found.append(_later(edge, kind))
    return found


def _later(edge: TransformEdge, kind: str) -> Outgoing:
    def rows(which: IntArray) -> Rows:
        return _moving(edge).rows(which + 1)

    log_ns = _received(edge.stamps_ns, edge.received_ns)[1:]
    return Outgoing("/tf_static", kind, log_ns, 150, rows, latched=True)


def _description(recording: Recording) -> list[Outgoing]:
    text = recording.robot_description
    if text is None:
        return []
    size = len(text.encode())
    return [
        Outgoing(
            "/robot_description",
            "std_msgs/msg/String",
            _begin_ns(recording),
            size,
            lambda which: messages.text(text),
            latched=True,
        )
    ]


def _clock(recording: Recording) -> list[Outgoing]:
    if recording.clock_ns is None:
        return []
    shown_ns, log_ns = recording.clock_ns.T
    kind = "rosgraph_msgs/msg/Clock"
    log_ns = _received(shown_ns, log_ns)
    return [Outgoing("/clock", kind, log_ns, 12, lambda which: messages.clocks(shown_ns[which]))]
