"""Exchanging what a recording says of where a sensor sits: its transforms and its description."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import (
    matrix_from_rpy,
    matrix_from_xyzw,
    se3_from_parts,
    xyzw_from_matrix,
)
from slamsim.core.types import FloatArray
from slamsim.recording import RawStream, Recording, TransformEdge
from slamsim.sensors.faults.base import CannotInject

Moved = Callable[[FloatArray], FloatArray]
"""From a declared 4 x 4 T_parent_sensor to another."""


def with_mount(recording: Recording, streams: Sequence[RawStream], moved: Moved) -> Recording:
    """The sensors of these streams declared elsewhere, in the transforms and the description.

    Raises CannotInject where no fixed transform carries their frames.
    """
    frames = {frame.strip("/") for stream in streams for frame in stream.frame_ids}
    edges = [edge for edge in recording.transforms if _carries(edge, frames)]
    if not edges:
        raise CannotInject(f"{recording.name} has no fixed transform to such a sensor")
    description = recording.robot_description
    if description is not None:
        for frame in sorted(frames):
            description = with_joint_origin(description, frame, moved)
    return replace(
        recording,
        transforms=tuple(
            moved_edge(edge, moved) if _carries(edge, frames) else edge
            for edge in recording.transforms
        ),
        robot_description=description,
    )


def moved_edge(edge: TransformEdge, moved: Moved) -> TransformEdge:
    """The edge with each of its transforms exchanged."""
    transforms = [
        moved(se3_from_parts(matrix_from_xyzw(quat), position))
        for quat, position in zip(edge.quats_xyzw, edge.positions_m, strict=True)
    ]
    return replace(
        edge,
        positions_m=np.array([T[:3, 3] for T in transforms]).reshape(-1, 3),
        quats_xyzw=np.array([xyzw_from_matrix(T[:3, :3]) for T in transforms]).reshape(-1, 4),
    )


def with_joint_origin(urdf: str, child: str, moved: Moved) -> str:
    """The description with the origin of the joint to ``child`` exchanged, if it has one."""
    joint = joint_text(urdf, child)
    if joint is None:
        return urdf
    xyz, rpy = (_numbers(joint, name) for name in ("xyz", "rpy"))
    T = moved(se3_from_parts(matrix_from_rpy(*rpy), np.array(xyz)))
    origin = f'<origin xyz="{_text(T[:3, 3])}" rpy="{_text(_rpy(T[:3, :3]))}"/>'
    bare = re.sub(r"<origin[^>]*/>", "", joint)
    return urdf.replace(joint, bare.replace("<parent", f"{origin}<parent", 1))


def joint_text(urdf: str, child: str) -> str | None:
    """The joint element that carries this link, as it is written."""
    for joint in re.findall(r"<joint\b.*?</joint>", urdf, flags=re.DOTALL):
        if re.search(rf'<child\s+link="{re.escape(child)}"', joint):
            return str(joint)
    return None


def _carries(edge: TransformEdge, frames: set[str]) -> bool:
    return edge.is_static and edge.child.strip("/") in frames


def _numbers(joint: str, name: str) -> list[float]:
    origin = re.search(r"<origin[^>]*/>", joint)
    found = re.search(rf'{name}="([^"]*)"', origin.group()) if origin else None
    return [float(word) for word in found.group(1).split()] if found else [0.0, 0.0, 0.0]


def _rpy(rotation: FloatArray) -> FloatArray:
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0)),
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def _text(values: FloatArray) -> str:
    return " ".join(f"{value:.12g}" for value in values)
