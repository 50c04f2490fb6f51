"""Mends of the transform tree and of the names of frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.check.findings import Mend
from slamsim.check.frame_graph import FrameGraph
from slamsim.check.mend_subjects import number, with_edges
from slamsim.core.geometry import (
    matrix_from_rpy,
    matrix_from_xyzw,
    se3_from_parts,
    xyzw_from_matrix,
)
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.recording import RawStream, Recording, TransformEdge
from slamsim.recording.edits import kept, with_odometry_edge


def add_odometry_transform(recording: Recording, mend: Mend) -> Recording:
    """Publish an odometry's poses as the transform of its frames, in place of what there is."""
    for odometry in recording.odometries:
        if odometry.topic == mend.subject and odometry.frame_ids and odometry.child_frame_ids:
            return with_odometry_edge(recording, odometry)
    raise SlamsimError(f"there is no odometry with frames on {mend.subject!r}")


def drop_transform(recording: Recording, mend: Mend) -> Recording:
    """Leave an edge out."""
    _require_edge(recording, mend)
    return with_edges(recording, lambda edge: None if edge.name == mend.subject else edge)


def freeze_static_transform(recording: Recording, mend: Mend) -> Recording:
    """Keep, of an edge that should never move, the pose that it mostly has."""
    _require_edge(recording, mend)

    def frozen(edge: TransformEdge) -> TransformEdge:
        if edge.name != mend.subject:
            return edge
        poses = np.column_stack([edge.positions_m, edge.quats_xyzw])
        off = np.abs(poses - np.median(poses, axis=0)).sum(axis=1)
        usual = np.array([int(np.argmin(off))])
        return replace(
            kept(edge, np.array([0])),
            positions_m=edge.positions_m[usual],
            quats_xyzw=edge.quats_xyzw[usual],
        )

    return with_edges(recording, frozen)


def rename_frame(recording: Recording, mend: Mend) -> Recording:
    """Let the messages of a topic name another frame."""
    frame = str(mend.parameters["frame"])

    def renamed(stream: RawStream) -> RawStream:
        return replace(stream, frame_ids=(frame,)) if stream.topic == mend.subject else stream

    return recording.changed(RawStream, renamed)


def roll_frame(recording: Recording, mend: Mend) -> Recording:
    """Turn a frame about its own x axis by roll_rad."""
    turn = matrix_from_rpy(number(mend, "roll_rad"), 0.0, 0.0)

    def rolled(edge: TransformEdge) -> TransformEdge:
        if edge.child != mend.subject:
            return edge
        quats = [xyzw_from_matrix(R @ turn) for R in matrix_from_xyzw(edge.quats_xyzw)]
        return replace(edge, quats_xyzw=np.array(quats))

    if not any(edge.child == mend.subject for edge in recording.transforms):
        upside_down = se3_from_parts(turn, np.zeros(3))
        return replace(
            recording, transforms=(*recording.transforms, _mount(recording, mend, upside_down))
        )
    return with_edges(recording, rolled)


def set_mounting(recording: Recording, mend: Mend) -> Recording:
    """Put a frame at x_m, y_m, yaw_rad of the frame parent; height, roll and pitch stay."""
    graph = FrameGraph(recording.transforms)
    declared = graph.between(_base(recording, mend), mend.subject)
    T_base_frame = np.eye(4) if declared is None else declared.copy()
    now_yaw = np.arctan2(T_base_frame[1, 0], T_base_frame[0, 0])
    turn = matrix_from_rpy(0.0, 0.0, number(mend, "yaw_rad") - float(now_yaw))
    T_base_frame[:3, :3] = turn @ T_base_frame[:3, :3]
    T_base_frame[:2, 3] = number(mend, "x_m"), number(mend, "y_m")
    mount = _mount(recording, mend, T_base_frame)
    others = [edge for edge in recording.transforms if edge.child != mend.subject]
    return replace(recording, transforms=(*others, mount))


def _base(recording: Recording, mend: Mend) -> str:
    parent = str(mend.parameters.get("parent", ""))
    children = recording.odometries[0].child_frame_ids if recording.odometries else ()
    return parent or FrameGraph(recording.transforms).base(children)


def _mount(recording: Recording, mend: Mend, T_base_frame: FloatArray) -> TransformEdge:
    """A static edge to the mend's frame, from the parent that it has if that is fixed."""
    base = _base(recording, mend)
    graph = FrameGraph(recording.transforms)
    above = [edge for edge in recording.transforms if edge.child == mend.subject]
    parent, T_base_parent = base, np.eye(4)
    if above and (known := graph.between(base, above[0].parent)) is not None:
        parent, T_base_parent = above[0].parent, known
    T_parent_frame = np.linalg.inv(T_base_parent) @ T_base_frame
    pose = T_parent_frame[None, :3, 3], xyzw_from_matrix(T_parent_frame[:3, :3])[None]
    if above and above[0].is_static and above[0].parent == parent:
        published = kept(above[0], np.array([0]))  # its message stays, with a new pose
        return replace(published, positions_m=pose[0], quats_xyzw=pose[1])
    return TransformEdge(
        "/tf_static",
        parent,
        mend.subject,
        True,
        _begin_ns(recording),
        None,
        *pose,
    )


def _begin_ns(recording: Recording) -> IntArray:
    streams = (*recording.scans, *recording.odometries, *recording.imus)
    firsts = [int(stream.stamps_ns.min()) for stream in streams if len(stream)]
    return np.array([min(firsts, default=0)], dtype=np.int64)


def _require_edge(recording: Recording, mend: Mend) -> None:
    if not any(edge.name == mend.subject for edge in recording.transforms):
        raise SlamsimError(f"the mend {mend.operation} finds no transform {mend.subject!r}")
