"""The transform tree of a recording: the pose of each sensor on the robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import printable
from slamsim.guard.numbers import is_sound
from slamsim.recording import TransformEdge

_RIGID_TOLERANCE = 1e-4
"""Metres, or of an element of the rotation: rounding of single precision at some hundred metres."""
_UNIT_TOLERANCE = 0.1
"""A quaternion whose norm is off by more is no rotation."""


def frame_name(name: str) -> str:
    """ROS 1 names sometimes begin with a slash that means nothing; what is no letter is shown."""
    return printable(name.strip().lstrip("/"))


def unqualified(frame: str) -> str:
    """Without the namespace of a robot: ``base_link`` of ``robot1/base_link``."""
    return frame.rpartition("/")[2]


def _matrix_of(position_m: FloatArray, quat_xyzw: FloatArray) -> FloatArray:
    """4 x 4 of a pose whose quaternion need not be unit."""
    norm = math.hypot(*quat_xyzw.tolist())
    return se3_from_parts(matrix_from_xyzw(quat_xyzw / norm), position_m)


class FrameTree:
    """Edges parent -> child that never moved in all the transforms shown to ``add``."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, FloatArray]] = {}
        self._moving: dict[str, str] = {}

    def add(self, edges: Iterable[TransformEdge]) -> None:
        """Transforms, latched or not: an edge that moves is forgotten."""
        by_child: dict[str, list[TransformEdge]] = {}
        for edge in edges:
            if edge.parent != edge.child and edge.child not in self._moving:
                by_child.setdefault(edge.child, []).append(edge)
        for child, mine in by_child.items():
            self._add(child, mine)

    def _add(self, child: str, edges: Sequence[TransformEdge]) -> None:
        """All that is said of one frame, in the order in which it was received."""
        positions_m = np.concatenate([edge.positions_m for edge in edges])
        quats_xyzw = np.concatenate([edge.quats_xyzw for edge in edges])
        with np.errstate(over="ignore", invalid="ignore"):
            norms = np.linalg.norm(quats_xyzw, axis=1)
            rigid = is_sound(positions_m) & (np.abs(norms - 1.0) < _UNIT_TOLERANCE)
        rows = np.flatnonzero(rigid)
        rows = rows[np.argsort(_received_ns(edges)[rows], kind="stable")]
        if rows.size == 0:
            return
        parents = [edge.parent for edge in edges for _ in range(edge.stamps_ns.size)]
        first = int(rows[0])
        told = parents[first], _matrix_of(positions_m[first], quats_xyzw[first])
        parent, T_parent_child = self._parents.setdefault(child, told)
        rotations = matrix_from_xyzw(quats_xyzw[rows] / norms[rows, None])
        off = np.maximum(
            np.abs(rotations - T_parent_child[:3, :3]).max(axis=(1, 2)),
            np.abs(positions_m[rows] - T_parent_child[:3, 3]).max(axis=1),
        )
        for row, is_off in zip(rows.tolist(), off > _RIGID_TOLERANCE, strict=True):
            if is_off or parents[row] != parent:
                self._moving[child] = parents[row]
                del self._parents[child]
                return

    def __contains__(self, frame: str) -> bool:
        return frame in self._parents or any(
            frame == parent for parent, _ in self._parents.values()
        )

    def named(self, name: str) -> str:
        """The frame of a usual name, with or without a robot's namespace; empty for none."""
        if name in self:
            return name
        frames = {*self._parents, *(parent for parent, _ in self._parents.values())}
        return min((frame for frame in frames if unqualified(frame) == name), default="")

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


def _received_ns(edges: Sequence[TransformEdge]) -> IntArray:
    """(n,) of all rows; the stamps where it is not known when they were received."""
    received = (edge.stamps_ns if edge.received_ns is None else edge.received_ns for edge in edges)
    return np.concatenate(list(received))
