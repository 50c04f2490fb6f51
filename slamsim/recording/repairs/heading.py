"""The heading of the robot from any one of its streams."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.differential_drive import wheel_odometry
from slamsim.models.wheel_gyro import turn_at_samples
from slamsim.recording import RawImu, Recording
from slamsim.recording.edits.base import CannotEdit
from slamsim.recording.edits.motion import ordered_encoder_stream
from slamsim.recording.frame_graph import FrameGraph

Heading = Callable[[IntArray], FloatArray]


def heading_from(
    recording: Recording, topic: str, correction: tuple[float, float] | None = None
) -> Heading:
    """Heading in rad, without jumps, at any stamps, from odometry, wheel counters or gyroscope.

    correction: of what the stream turns since its first message, to take off each second, and
    then to add; without one, a gyroscope is freed of what wheels or odometry say that it turns
    too far. Beyond the ends it stays what it was there. Raises CannotEdit for another topic.
    """
    for odometry in recording.odometries:
        if odometry.topic == topic:
            yaw_rad = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
            return _corrected(odometry.stamps_ns, yaw_rad, correction)
    for ticks in recording.ticks:
        if ticks.topic == topic:
            path = wheel_odometry(ordered_encoder_stream(ticks))
            return _corrected(path.stamps_ns, np.unwrap(path.poses[:, 2]), correction)
    for imu in recording.imus:
        if imu.topic == topic:
            return _integrated(recording, imu, correction)
    raise CannotEdit(f"{topic!r} tells no heading")


def base_rotation(recording: Recording, imu: RawImu) -> FloatArray:
    """(3, 3) R_base_imu as declared; the identity where no transform declares it."""
    graph = FrameGraph(recording.transforms)
    base = graph.base(recording.base_frames)
    T_base_imu = graph.between(base, imu.frame_ids[0]) if imu.frame_ids else None
    return np.eye(3) if T_base_imu is None else T_base_imu[:3, :3]


def _corrected(
    stamps_ns: IntArray, heading_rad: FloatArray, correction: tuple[float, float] | None
) -> Heading:
    if correction is None:
        return _between(stamps_ns, heading_rad)
    drift_rad_s, offset_rad = correction
    since_s = (stamps_ns - stamps_ns.min(initial=stamps_ns[0])) * 1e-9
    turned = heading_rad - heading_rad[0]
    return _between(stamps_ns, turned - drift_rad_s * since_s + offset_rad)


def _integrated(
    recording: Recording, imu: RawImu, correction: tuple[float, float] | None
) -> Heading:
    """Rates about the base's vertical, less what wheels or odometry say that they are too high."""
    rates = imu.angular_velocity_rad_s @ base_rotation(recording, imu).T[:, 2]
    order = np.argsort(imu.stamps_ns, kind="stable")
    stamps_ns, rates = imu.stamps_ns[order], np.nan_to_num(rates[order])
    turned = turn_at_samples(stamps_ns, rates)
    if correction is not None:
        return _corrected(stamps_ns, turned, correction)
    others = [stream.topic for stream in (*recording.odometries, *recording.ticks)]
    if others and stamps_ns.size > 1:
        apart = turned - heading_from(recording, others[0])(stamps_ns)
        since_s = (stamps_ns - stamps_ns[0]) * 1e-9
        turned = turned - since_s * (apart[-1] - apart[0]) / max(float(since_s[-1]), 1e-9)
    return _between(stamps_ns, turned)


def _between(stamps_ns: IntArray, heading_rad: FloatArray) -> Heading:
    order = np.unique(stamps_ns, return_index=True)[1]
    known_ns, known_rad = stamps_ns[order], heading_rad[order]

    def at(query_ns: IntArray) -> FloatArray:
        origin_ns = known_ns[0]
        since_s = (known_ns - origin_ns) * 1e-9
        return np.asarray(np.interp((query_ns - origin_ns) * 1e-9, since_s, known_rad))

    return at
