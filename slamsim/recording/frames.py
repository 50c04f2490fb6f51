"""The transform tree of a recording: the pose of each sensor on the robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.types import FloatArray, ImuStream, IntArray
from slamsim.guard.errors import printable
from slamsim.guard.numbers import is_sound
from slamsim.recording import Recording, TransformEdge

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


BASE_FRAMES = ("base_footprint", "base_link", "base")
ODOM_FRAME = "odom"
SAME_PLACE = 1e-3
"""Metres, or of an element of the rotation: no two lidars are as close."""
MOST_TILT_RAD = np.deg2rad(45.0)
"""A further lidar tilted by more scans floor and ceiling; upside down it is level again."""
BASE_FRAME = BASE_FRAMES[0]
"""What odometry is taken to move where there is none."""


def tree_of(edges: Iterable[TransformEdge]) -> FrameTree:
    """The transforms that a recording declares to be fixed."""
    tree = FrameTree()
    tree.add(edge for edge in edges if edge.is_static)
    return tree


def base_frame_of(recording: Recording) -> str:
    """The frame whose path SLAM estimates: that which a user names, or which the odometry that is
    read (the first) moves, or the transforms; else the usual one."""
    moved = recording.base_frames[:1]
    if moved:
        return moved[0] or likely_base(tree_of(recording.transforms))
    tree = FrameTree()
    tree.add(recording.transforms)
    lasers = [scans.frame_ids[0] for scans in recording.scans[:1]]
    edges = odometry_chain(tree, lasers[0] if lasers else "")
    return edges[-1][1] if edges else likely_base(tree)


def declared_laser_mounting(recording: Recording) -> FloatArray:
    """4 x 4 T_base_laser of the first lidar, as SLAM reads it; the identity if nothing tells."""
    laser = ""
    for scans in recording.scans[:1]:
        laser = scans.frame_ids[0]
    return laser_mounting_of(tree_of(recording.transforms), base_frame_of(recording), laser, [])


def known_mounting(
    tree: FrameTree, base_frame: str, laser_frame: str
) -> tuple[FloatArray, str] | None:
    """(4 x 4 T_base_laser, the base frame that it starts from: another one if need be)."""
    for frame in (base_frame, *filter(None, map(tree.named, BASE_FRAMES))):
        T_base_laser = tree.between(frame, laser_frame)
        if T_base_laser is not None:
            return T_base_laser, frame
    return None


def in_one_place(T_base_laser: FloatArray, T_base_other: FloatArray) -> bool:
    """Whether two lidars (4 x 4 each) sit in one place: then they are one lidar under two names,
    as RAWLASER1 and ROBOTLASER1 of CARMEN."""
    return bool(np.allclose(T_base_laser, T_base_other, rtol=0.0, atol=SAME_PLACE))


def mounting_beside(
    tree: FrameTree, base_frame: str, frame: str, others: Mapping[str, FloatArray]
) -> FloatArray | str:
    """4 x 4 T_base_laser of one more lidar, or why its scans cannot be used with those of others.

    others: by topic, 4 x 4 each.
    """
    known = known_mounting(tree, base_frame, frame)
    if known is None:
        return f"no fixed transform from {base_frame!r} to {frame!r}"
    T_base_laser, _ = known
    for topic, T_base_other in others.items():
        if in_one_place(T_base_laser, T_base_other):
            return f"their lidar sits where that of {topic} does, or is the same one"
    if abs(T_base_laser[2, 2]) < np.cos(MOST_TILT_RAD):
        return f"the frame {frame!r} is not level"
    return T_base_laser


FOOTPRINT = "base_footprint"
"""On the floor below the robot (REP 120)."""


def footprint_height_m(tree: FrameTree, base_frame: str) -> float | None:
    """Height of the floor in the base frame by ``base_footprint``; None where there is none."""
    if unqualified(base_frame) == FOOTPRINT:
        return 0.0
    T_base_footprint = tree.between(base_frame, tree.named(FOOTPRINT))
    return None if T_base_footprint is None else float(T_base_footprint[2, 3])


AT_BASE = "the laser is taken to sit at the base"
"""How a warning ends that the mount of the laser, which the map depends on, is not known."""


def laser_mounting_of(
    tree: FrameTree, base_frame: str, laser_frame: str, warnings: list[str]
) -> FloatArray:
    """4 x 4 T_base_laser; from another base frame, or the identity, with a warning, if need be."""
    known = known_mounting(tree, base_frame, laser_frame)
    missing = f"no fixed transform from {base_frame!r} to {laser_frame!r}"
    if known is None:
        warnings.append(f"{missing} in /tf_static or /tf: {AT_BASE}")
        return np.eye(4)
    T_base_laser, frame = known
    if frame != base_frame:
        warnings.append(f"{missing}: the one from {frame!r} is used")
    return T_base_laser


def imu_mounting_of(
    tree: FrameTree, base_frame: str, imu: ImuStream, warnings: list[str]
) -> FloatArray | None:
    """4 x 4 T_base_imu; None, with a warning, where no fixed transform tells."""
    T_base_imu = tree.between(base_frame, imu.frame_id)
    if T_base_imu is None:
        warnings.append(f"no fixed transform from {base_frame!r} to {imu.frame_id!r}")
    return T_base_imu


def likely_base(tree: FrameTree) -> str:
    """The frame of the robot where nothing names it."""
    return next(filter(None, map(tree.named, BASE_FRAMES)), BASE_FRAMES[0])


def odometry_chain(tree: FrameTree, laser_frame: str) -> list[tuple[str, str]]:
    """Edges from ``odom`` down to the robot's base: the lowest frame that moves, if any does."""
    start = laser_frame if laser_frame in tree else likely_base(tree)
    path = tree.path_up(start)
    below_odom = [i for i, (parent, _, _) in enumerate(path) if unqualified(parent) == ODOM_FRAME]
    if not below_odom:
        return []
    top = below_odom[0]
    moving = [i for i in range(top + 1) if path[i][2]]
    return [(parent, child) for parent, child, _ in path[moving[0] if moving else top : top + 1]][
        ::-1
    ]
