"""Recordings with one part exchanged: what all faults are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, Protocol

import numpy as np

from slamsim.core.types import Float32Array, IntArray
from slamsim.recording import (
    Messages,
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawTicks,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.sensors.faults.base import CannotInject

StreamName = Literal["lidar", "imu", "wheels"]
"""The wheels are everything on their clock: counters, joints, odometry and its transform."""

ODOMETRY_FRAME = "odom"


class Change(Protocol):
    """From the messages of any topic or edge to others of the same kind."""

    def __call__(self, messages: Messages, /) -> Messages: ...


def with_scans(recording: Recording, change: Callable[[RawScans], RawScans]) -> Recording:
    """Every lidar changed. Raises CannotInject without any."""
    if not recording.scans:
        raise CannotInject(f"{recording.name} has no scans")
    return recording.changed(RawScans, change)


def with_ranges(
    recording: Recording, change: Callable[[Float32Array, RawScans], Float32Array]
) -> Recording:
    """change: from (n, beams) ranges of one lidar to new ones; the old ones are a copy."""

    def changed(scans: RawScans) -> RawScans:
        if len(scans) == 0:
            return scans
        return replace(scans, ranges_m=change(range_matrix(scans), scans))

    return with_scans(recording, changed)


def with_layouts(recording: Recording, change: Callable[[ScanLayout], ScanLayout]) -> Recording:
    """What the scans declare of their beams, changed."""
    return with_scans(
        recording, lambda scans: replace(scans, layouts=tuple(map(change, scans.layouts)))
    )


def with_imus(recording: Recording, change: Callable[[RawImu], RawImu]) -> Recording:
    """Every inertial unit changed. Raises CannotInject without any."""
    if not recording.imus:
        raise CannotInject(f"{recording.name} has no inertial unit")
    return recording.changed(RawImu, change)


def range_matrix(scans: RawScans) -> Float32Array:
    """(n, beams) a copy of all ranges. Raises CannotInject if scans differ in length."""
    if isinstance(scans.ranges_m, np.ndarray):
        return scans.ranges_m.copy()
    rows: Sequence[Float32Array] = [np.asarray(row) for row in scans.ranges_m]
    if len({row.size for row in rows}) > 1:
        raise CannotInject(f"the scans of {scans.topic} differ in their number of beams")
    return np.stack(rows) if rows else np.zeros((0, 0), dtype=np.float32)


def with_streams(recording: Recording, name: StreamName, change: Change) -> Recording:
    """Every topic of a stream changed, and the transform that the wheels publish."""
    if name == "lidar":
        return with_scans(recording, change)
    if name == "imu":
        return with_imus(recording, change)
    require_wheels(recording)
    return replace(
        recording.changed(RawOdometry, change).changed(RawTicks, change).changed(RawJoints, change),
        transforms=tuple(
            change(edge) if is_odometry(edge) else edge for edge in recording.transforms
        ),
    )


def with_stamps(
    recording: Recording, name: StreamName, change: Callable[[IntArray], IntArray]
) -> Recording:
    """change: from (n,) stamps of any one topic or edge of the stream to new ones."""

    def restamped(messages: Messages) -> Messages:
        if messages.stamps_ns.size == 0:
            return messages
        return replace(messages, stamps_ns=change(messages.stamps_ns))

    return with_streams(recording, name, restamped)


def require_wheels(recording: Recording) -> None:
    """Raises CannotInject for a recording without odometry and counters."""
    if not recording.odometries and not recording.ticks:
        raise CannotInject(f"{recording.name} has neither odometry nor wheel counters")


def is_odometry(edge: TransformEdge) -> bool:
    """Whether this is the moving edge that the wheels publish."""
    return not edge.is_static and edge.parent.strip("/") == ODOMETRY_FRAME
