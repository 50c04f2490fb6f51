"""Sensor poses that a recording declares."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from slamsim.core.types import FloatArray, ImuStream
from slamsim.recording import Recording, TransformEdge
from slamsim.recording.frames import FrameTree, unqualified

BASE_FRAMES = ("base_footprint", "base_link", "base")
ODOM_FRAME = "odom"
SAME_PLACE = 1e-3
"""Metres, or of an element of the rotation: no two lidars are as close."""
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


def laser_mounting_of(
    tree: FrameTree, base_frame: str, laser_frame: str, warnings: list[str]
) -> FloatArray:
    """4 x 4 T_base_laser; from another base frame, or the identity, with a warning, if need be."""
    known = known_mounting(tree, base_frame, laser_frame)
    missing = f"no fixed transform from {base_frame!r} to {laser_frame!r}"
    if known is None:
        warnings.append(f"{missing} in /tf_static or /tf: the laser is taken to sit at the base")
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
