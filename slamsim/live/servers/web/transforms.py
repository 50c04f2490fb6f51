"""Transforms of a live robot as they come, for drawing its scans where they were measured."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slamsim.core.geometry import (
    compose,
    matrix_from_xyzw,
    se2_from_se3,
    se3_from_parts,
    transform_points,
    yaw_from_xyzw,
)
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import require_finite

_KEPT = 256
"""Poses of each moving frame: more than a second at 200 Hz, longer than any scan takes."""


@dataclass(slots=True)
class _Edge:
    """A frame below its parent; a moving one has (stamp_ns, x, y, yaw) of its last poses."""

    parent: str
    T_parent_child: FloatArray
    poses: deque[tuple[int, float, float, float]] = field(
        default_factory=lambda: deque(maxlen=_KEPT)
    )

    def pose_at(self, stamps_ns: IntArray) -> FloatArray:
        """(n, 3) in the plane, interpolated; the first and the last pose hold beyond them."""
        times_ns, x, y, yaw = map(np.array, zip(*self.poses, strict=True))
        since_ns, wanted_ns = times_ns - times_ns[0], stamps_ns - times_ns[0]
        columns = (np.interp(wanted_ns, since_ns, each) for each in (x, y, np.unwrap(yaw)))
        return np.stack(list(columns), axis=-1)

    def newest_pose(self) -> FloatArray:
        if not self.poses:
            return se2_from_se3(self.T_parent_child)
        return np.array(self.poses[-1][1:])


class LiveTransforms:
    """Of a tree of frames, all that is needed to place its scans and its base in its root."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Any, *, moving: bool) -> None:
        """The transforms of a tf2_msgs/msg/TFMessage. A moving frame is taken as planar. Time that
        runs back is a new drive: the poses before it are forgotten. Raises BadNumbers."""
        for each in message.transforms:
            stamp = each.header.stamp
            p, q = each.transform.translation, each.transform.rotation
            quat_xyzw = np.array([q.x, q.y, q.z, q.w])
            require_finite("a transform", np.array([p.x, p.y, p.z, *quat_xyzw]), (7,))
            child, parent = each.child_frame_id, each.header.frame_id
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent or not moving:
                translation_m = np.array([p.x, p.y, p.z])
                T = se3_from_parts(matrix_from_xyzw(quat_xyzw), translation_m)
                edge = self._edges[child] = _Edge(parent, T)
            if moving:
                stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
                if edge.poses and stamp_ns < edge.poses[-1][0]:
                    edge.poses.clear()
                edge.poses.append((stamp_ns, p.x, p.y, float(yaw_from_xyzw(quat_xyzw))))

    def base_above(self, frame: str) -> str:
        """The first frame at or above a frame that moves: the robot's base; the frame itself where
        nothing moves."""
        return next((name for name, edge in self._above(frame) if edge.poses), frame)

    def newest_pose(self, frame: str) -> tuple[str, FloatArray]:
        """(root, T_root_frame in the plane)."""
        root, pose = frame, np.zeros(3)
        for _, edge in self._above(frame):
            root, pose = edge.parent, compose(edge.newest_pose(), pose)
        return root, pose

    def to_root(self, frame: str, points_m: FloatArray, stamps_ns: IntArray) -> FloatArray:
        """(n, 2) points in the root of the tree, from (n, 3) in a frame, each at its own time."""
        for _, edge in self._above(frame):
            if edge.poses:
                planar_m = transform_points(edge.pose_at(stamps_ns), points_m[:, :2])
                points_m = np.column_stack([planar_m, points_m[:, 2]])
            else:
                T = edge.T_parent_child
                points_m = points_m @ T[:3, :3].T + T[:3, 3]
        return points_m[:, :2]

    def _above(self, frame: str) -> list[tuple[str, _Edge]]:
        """From a frame up to its root; a loop, which no tree has, ends after one round."""
        found: dict[str, _Edge] = {}
        while frame in self._edges and frame not in found:
            found[frame] = self._edges[frame]
            frame = found[frame].parent
        return list(found.items())
