"""What a recording of another format needs besides, to say the same as ROS messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.core.types import Float32Array
from slamsim.recording import RawScans, Recording
from slamsim.recording.edits.frames import with_odometry_edge


def as_ros(recording: Recording) -> Recording:
    """A CARMEN log in the words of REP 105 and REP 117; anything else as it is.

    Its laser lines carry the pose, which ROS asks the transform tree for, and write their
    maximum where nothing came back, which ROS takes for a wall.
    """
    if recording.format != "carmen":
        return recording
    found = recording.changed(RawScans, _without_maximum)
    for odometry in recording.odometries[:1]:
        found = with_odometry_edge(found, odometry)
    return found


def _without_maximum(scans: RawScans) -> RawScans:
    limits_m = [scans.layout(scan).range_max_m for scan in range(len(scans))]
    rows = [_freed(row, limit) for row, limit in zip(scans.ranges_m, limits_m, strict=True)]
    as_array = isinstance(scans.ranges_m, np.ndarray)
    return replace(scans, ranges_m=np.array(rows) if as_array and rows else rows)


def _freed(ranges_m: Float32Array, limit_m: float) -> Float32Array:
    return np.where(ranges_m >= np.float32(limit_m), np.float32(np.inf), ranges_m)
