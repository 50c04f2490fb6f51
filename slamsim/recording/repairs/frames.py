"""Repairs of the transform tree and of the names of frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts, xyzw_from_matrix
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawOdometry, RawStream, Recording, TransformEdge
from slamsim.recording.edits.base import ROTATIONS, Edit
from slamsim.recording.edits.frames import (
    AddTransform,
    ChangeTransforms,
    InvertTransform,
    PublishOdometry,
    RenameFrame,
    RollQuaternions,
    SetMount,
    TurnFrame,
    frozen_edge,
)
from slamsim.recording.edits.messages import select
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair


def add_odometry_transform(recording: Recording, repair: Repair) -> Edit:
    """Publish an odometry's poses as the transform of its frames, in place of what there is."""
    return PublishOdometry(repair.subject)


def drop_transform(recording: Recording, repair: Repair) -> Edit:
    """Leave a transform out."""
    return ChangeTransforms(_named(repair), lambda _: None, _lacking(repair))


def freeze_static_transform(recording: Recording, repair: Repair) -> Edit:
    """Keep, of a transform that should never move, the pose that it mostly has."""
    return ChangeTransforms(_named(repair), frozen_edge, _lacking(repair))


def rename_frame(recording: Recording, repair: Repair) -> Edit:
    """Let the messages of a topic name another frame."""
    return RenameFrame(repair.target(RawStream), str(repair.parameters["frame"]))


def rename_child_frame(recording: Recording, repair: Repair) -> Edit:
    """Let the messages of an odometry give the pose of another frame."""
    return RenameFrame(repair.target(RawOdometry), str(repair.parameters["frame"]), child=True)


def reorder_quaternions(recording: Recording, repair: Repair) -> Edit:
    """Write the rotations of a topic or transform as x, y, z, w that are written as w, x, y, z."""
    return RollQuaternions(ROTATIONS.on(repair.subject), -1)


def invert_transform(recording: Recording, repair: Repair) -> Edit:
    """Exchange parent and child of a transform; poses: "invert" its poses too, or "keep" them."""
    return InvertTransform(repair.subject, repair.parameters.get("poses") != "keep")


def turn_frame(recording: Recording, repair: Repair) -> Edit:
    """Turn a frame about its own axes: z by yaw_rad, then y by pitch_rad, then x by roll_rad."""
    turn = matrix_from_rpy(*map(repair.number, ("roll_rad", "pitch_rad", "yaw_rad")))
    if any(edge.child == repair.subject for edge in recording.transforms):
        return TurnFrame(repair.subject, turn)
    return AddTransform(_mount(recording, repair, se3_from_parts(turn, np.zeros(3))))


def set_mounting(recording: Recording, repair: Repair) -> Edit:
    """Put a frame at x_m, y_m, yaw_rad of the frame parent; height, roll and pitch stay."""
    graph = FrameGraph(recording.transforms)
    declared = graph.between(_base(recording, repair), repair.subject)
    T_base_frame = np.eye(4) if declared is None else declared.copy()
    now_yaw = np.arctan2(T_base_frame[1, 0], T_base_frame[0, 0])
    turn = matrix_from_rpy(0.0, 0.0, repair.number("yaw_rad") - float(now_yaw))
    T_base_frame[:3, :3] = turn @ T_base_frame[:3, :3]
    T_base_frame[:2, 3] = repair.number("x_m"), repair.number("y_m")
    return SetMount(_mount(recording, repair, T_base_frame))


def set_height(recording: Recording, repair: Repair) -> Edit:
    """Put a frame z_m above the origin of the frame parent; all else stays."""
    declared = FrameGraph(recording.transforms).between(_base(recording, repair), repair.subject)
    T_base_frame = np.eye(4) if declared is None else declared.copy()
    T_base_frame[2, 3] = repair.number("z_m")
    return SetMount(_mount(recording, repair, T_base_frame))


def _base(recording: Recording, repair: Repair) -> str:
    parent = str(repair.parameters.get("parent", ""))
    return parent or FrameGraph(recording.transforms).base(recording.base_frames)


def _mount(recording: Recording, repair: Repair, T_base_frame: FloatArray) -> TransformEdge:
    """A static transform to the subject, from the parent that it has if that is fixed."""
    base = _base(recording, repair)
    graph = FrameGraph(recording.transforms)
    above = [edge for edge in recording.transforms if edge.child == repair.subject]
    parent, T_base_parent = base, np.eye(4)
    if above and (known := graph.between(base, above[0].parent)) is not None:
        parent, T_base_parent = above[0].parent, known
    T_parent_frame = np.linalg.inv(T_base_parent) @ T_base_frame
    pose = T_parent_frame[None, :3, 3], xyzw_from_matrix(T_parent_frame[:3, :3])[None]
    if above and above[0].is_static and above[0].parent == parent:
        published = select(above[0], np.array([0]))  # its message stays, with a new pose
        return replace(published, positions_m=pose[0], quats_xyzw=pose[1])
    begin_ns = _begin_ns(recording)
    return TransformEdge("/tf_static", parent, repair.subject, True, begin_ns, None, *pose)


def _begin_ns(recording: Recording) -> IntArray:
    streams = (*recording.scans, *recording.odometries, *recording.imus)
    firsts = [int(stream.stamps_ns.min()) for stream in streams if len(stream)]
    return np.array([min(firsts, default=0)], dtype=np.int64)


def _named(repair: Repair) -> Callable[[TransformEdge], bool]:
    return lambda edge: edge.name == repair.subject


def _lacking(repair: Repair) -> str:
    return f"transform {repair.subject!r}"
