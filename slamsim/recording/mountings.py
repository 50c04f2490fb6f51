"""Where a recording says that its sensors sit."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace

from slamsim.core.types import FloatArray
from slamsim.io.ros.bag_log import laser_mounting_of
from slamsim.recording import Recording, TransformEdge
from slamsim.recording.frames import FrameTree

BASE_FRAME = "base_footprint"
"""What odometry is taken to move where there is none."""


def tree_of(edges: Iterable[TransformEdge]) -> FrameTree:
    """The transforms that a recording declares to be fixed."""
    tree = FrameTree()
    tree.add([SimpleNamespace(transforms=_messages(edge)) for edge in edges if edge.is_static])
    return tree


def declared_laser_mounting(recording: Recording) -> FloatArray:
    """4 x 4 T_base_laser of the first lidar, as SLAM reads it; the identity if nothing tells."""
    base, laser = BASE_FRAME, ""
    for odometry in recording.odometries[:1]:
        base = odometry.child_frame_ids[0]
    for scans in recording.scans[:1]:
        laser = scans.frame_ids[0]
    return laser_mounting_of(tree_of(recording.transforms), base, laser, [])


def _messages(edge: TransformEdge) -> list[SimpleNamespace]:
    return [
        SimpleNamespace(
            header=SimpleNamespace(frame_id=edge.parent),
            child_frame_id=edge.child,
            transform=SimpleNamespace(
                translation=SimpleNamespace(**dict(zip("xyz", position_m, strict=True))),
                rotation=SimpleNamespace(**dict(zip("xyzw", quat_xyzw, strict=True))),
            ),
        )
        for position_m, quat_xyzw in zip(edge.positions_m, edge.quats_xyzw, strict=True)
    ]
