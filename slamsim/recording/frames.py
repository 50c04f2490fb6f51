"""The transform tree of a recording: which sensor sits where on the robot."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.guard.errors import printable
from slamsim.guard.numbers import is_sound

_RIGID_TOLERANCE = 1e-4


def frame_name(name: str) -> str:
    """ROS 1 names sometimes begin with a slash that means nothing; what is no letter is shown."""
    return printable(name.strip().lstrip("/"))


def matrix_of(transform: Any) -> FloatArray | None:
    """4 x 4 of a geometry_msgs/Transform, None if it is no rigid motion."""
    t, q = transform.translation, transform.rotation
    quat_xyzw = np.array([q.x, q.y, q.z, q.w], dtype=np.float64)
    translation_m = np.array([t.x, t.y, t.z], dtype=np.float64)
    norm = math.hypot(*quat_xyzw.tolist())
    if not (is_sound(translation_m).all() and abs(norm - 1.0) < 0.1):
        return None
    return se3_from_parts(matrix_from_xyzw(quat_xyzw / norm), translation_m)


class FrameTree:
    """Edges parent -> child that never moved in all the messages shown to ``add``."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, FloatArray]] = {}
        self._moving: dict[str, str] = {}

    def add(self, messages: Iterable[Any]) -> None:
        """tf2_msgs/TFMessage, latched or not: an edge that moves is forgotten."""
        for message in messages:
            for edge in message.transforms:
                parent, child = frame_name(edge.header.frame_id), frame_name(edge.child_frame_id)
                T_parent_child = matrix_of(edge.transform)
                if child in self._moving or parent == child or T_parent_child is None:
                    continue
                known = self._parents.setdefault(child, (parent, T_parent_child))
                off = np.abs(known[1] - T_parent_child).max()
                if known[0] != parent or off > _RIGID_TOLERANCE:
                    self._moving[child] = parent
                    del self._parents[child]

    def __contains__(self, frame: str) -> bool:
        return frame in self._parents or any(
            frame == parent for parent, _ in self._parents.values()
        )

    def path_up(self, frame: str) -> list[tuple[str, str, bool]]:
        """(parent, child, whether it moves) of each edge from a frame up to its root."""
        path: list[tuple[str, str, bool]] = []
        while frame not in [child for _, child, _ in path]:
            if frame in self._moving:
                path.append((self._moving[frame], frame, True))
            elif frame in self._parents:
                path.append((self._parents[frame][0], frame, False))
            else:
                break
            frame = path[-1][0]
        return path

    def _to_ancestors(self, frame: str) -> dict[str, FloatArray]:
        """T_ancestor_frame for the frame itself and all its ancestors."""
        found: dict[str, FloatArray] = {}
        T_ancestor_frame = np.eye(4)
        while frame not in found:
            found[frame] = T_ancestor_frame
            if frame not in self._parents:
                break
            frame, T_parent_child = self._parents[frame]
            T_ancestor_frame = T_parent_child @ T_ancestor_frame
        return found

    def between(self, target: str, source: str) -> FloatArray | None:
        """4 x 4 ``T_target_source`` over edges that never move, None if they do not connect."""
        from_source, from_target = self._to_ancestors(source), self._to_ancestors(target)
        for ancestor, T_ancestor_source in from_source.items():
            if ancestor in from_target:
                return np.asarray(np.linalg.inv(from_target[ancestor]) @ T_ancestor_source)
        return None
