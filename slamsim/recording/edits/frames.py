"""Edits of transforms, of the names of frames, and of the robot description as text."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from slamsim.core.geometry import (
    matrix_from_rpy,
    matrix_from_xyzw,
    se3_from_parts,
    xyzw_from_matrix,
)
from slamsim.core.types import FloatArray
from slamsim.recording import RawImu, RawOdometry, Recording, TransformEdge
from slamsim.recording.edits.base import CannotEdit, Edit, MessagesEdit
from slamsim.recording.edits.messages import select

EdgeFilter = Callable[[TransformEdge], bool]


@dataclass(frozen=True, slots=True)
class RenameFrame(MessagesEdit):
    """All messages of a target name ``frame``; of odometry as the child, if ``child`` says so."""

    frame: str
    child: bool = False

    def changed(self, stream: Any) -> Any:
        names = "child_frame_ids" if self.child else "frame_ids"
        return replace(stream, slashed=(), **{names: (self.frame,)})


@dataclass(frozen=True, slots=True)
class ChangeTransforms(Edit):
    """Some transforms changed.

    chosen: which of them. change: to the transform in its place, None for none. lacking: what to
    call them where there are none.
    """

    chosen: EdgeFilter
    change: Callable[[TransformEdge], TransformEdge | None]
    lacking: str = "such transform"

    def apply(self, recording: Recording) -> Recording:
        edges = recording.transforms
        if not any(self.chosen(edge) and edge.stamps_ns.size for edge in edges):
            raise CannotEdit(f"{recording.name} has no {self.lacking}")
        changed = (self.change(edge) if self.chosen(edge) else edge for edge in edges)
        return replace(recording, transforms=tuple(e for e in changed if e is not None))


@dataclass(frozen=True, slots=True)
class AddTransform(Edit):
    """One transform more, after those that there are."""

    edge: TransformEdge

    def apply(self, recording: Recording) -> Recording:
        return replace(recording, transforms=(*recording.transforms, self.edge))

    def inverse(self) -> ChangeTransforms:
        """Leaves out what has the topic and the frames of this one."""
        mine = self.edge.topic, self.edge.name
        return ChangeTransforms(lambda edge: (edge.topic, edge.name) == mine, lambda _: None)


@dataclass(frozen=True, slots=True, eq=False)
class MoveMount(Edit):
    """Sensors declared elsewhere, in the fixed transforms and in the robot's description.

    frames: of the sensors. T: (4, 4) from the sensor as it was declared to where it is declared
    now, in the axes of the frame that carries it ("parent") or in its own ("sensor").
    """

    frames: frozenset[str]
    T: FloatArray
    axes: Literal["parent", "sensor"]

    def apply(self, recording: Recording) -> Recording:
        frames = {frame.strip("/") for frame in self.frames}
        description = recording.robot_description
        if description is not None:
            for frame in sorted(frames):
                description = with_joint_origin(description, frame, self.moved)
        edges = ChangeTransforms(
            lambda edge: edge.is_static and edge.child.strip("/") in frames,
            lambda edge: moved_edge(edge, self.moved),
            "fixed transform to such a sensor",
        )
        return replace(edges.apply(recording), robot_description=description)

    def inverse(self) -> MoveMount:
        return replace(self, T=np.asarray(np.linalg.inv(self.T), dtype=np.float64))

    def moved(self, T_parent_sensor: FloatArray) -> FloatArray:
        """(4, 4) what is declared instead."""
        if self.axes == "parent":
            return np.asarray(self.T @ T_parent_sensor)
        return np.asarray(T_parent_sensor @ self.T)


@dataclass(frozen=True, slots=True)
class SetMount(Edit):
    """One transform in the place of all that lead to its child."""

    edge: TransformEdge

    def apply(self, recording: Recording) -> Recording:
        others = (edge for edge in recording.transforms if edge.child != self.edge.child)
        return replace(recording, transforms=(*others, self.edge))


@dataclass(frozen=True, slots=True, eq=False)
class TurnFrame(Edit):
    """A frame turned about its own axes by ``R`` (3, 3), in all transforms that lead to it."""

    frame: str
    R: FloatArray

    def apply(self, recording: Recording) -> Recording:
        def turned(edge: TransformEdge) -> TransformEdge:
            quats = [xyzw_from_matrix(R @ self.R) for R in matrix_from_xyzw(edge.quats_xyzw)]
            return replace(edge, quats_xyzw=np.array(quats))

        chosen = ChangeTransforms(lambda edge: edge.child == self.frame, turned)
        return chosen.apply(recording)

    def inverse(self) -> TurnFrame:
        return replace(self, R=self.R.T)


@dataclass(frozen=True, slots=True)
class PublishOdometry(Edit):
    """The poses of the odometry on ``topic`` replace the transform between its frames."""

    topic: str

    def apply(self, recording: Recording) -> Recording:
        for odometry in recording.odometries:
            if odometry.topic == self.topic and odometry.frame_ids and odometry.child_frame_ids:
                return with_odometry_edge(recording, odometry)
        raise CannotEdit(f"there is no odometry with frames on {self.topic!r}")


def with_odometry_edge(recording: Recording, odometry: RawOdometry) -> Recording:
    """The transform between an odometry's frames says what the odometry does."""
    parent, child = odometry.frame_ids[0], odometry.child_frame_ids[0]
    moving = recording.moving
    edge = TransformEdge(
        moving[0].topic if moving else "/tf",
        parent,
        child,
        False,
        odometry.stamps_ns,
        odometry.received_ns,
        odometry.positions_m,
        odometry.quats_xyzw,
    )
    for old in moving:  # published together: its messages stay, with new poses
        if (old.parent, old.child) == (parent, child) and np.array_equal(
            old.stamps_ns, odometry.stamps_ns
        ):
            edge = replace(old, positions_m=odometry.positions_m, quats_xyzw=odometry.quats_xyzw)
    others = [e for e in recording.transforms if e.child != child or e.is_static]
    return replace(recording, transforms=(*others, edge))


@dataclass(frozen=True, slots=True)
class InvertTransform(Edit):
    """A transform with parent and child exchanged. poses: whether its poses are inverted too."""

    name: str
    poses: bool = True

    def apply(self, recording: Recording) -> Recording:
        def inverted(edge: TransformEdge) -> TransformEdge:
            other = inverted_edge(edge)
            return other if self.poses else replace(edge, parent=other.parent, child=other.child)

        chosen = ChangeTransforms(lambda edge: edge.name == self.name, inverted, self.name)
        return chosen.apply(recording)

    def inverse(self) -> InvertTransform:
        parent, child = self.name.split(" -> ")
        return replace(self, name=f"{child} -> {parent}")


def inverted_edge(edge: TransformEdge) -> TransformEdge:
    """The same transform seen from the child."""
    seen = moved_edge(edge, lambda T: np.asarray(np.linalg.inv(T), dtype=np.float64))
    return replace(seen, parent=edge.child, child=edge.parent)


@dataclass(frozen=True, slots=True)
class RollQuaternions(MessagesEdit):
    """The numbers of each rotation moved on by ``places``: 1 writes x, y, z, w as w, x, y, z."""

    places: int

    def changed(self, messages: Any) -> Any:
        name = "orientation_xyzw" if isinstance(messages, RawImu) else "quats_xyzw"
        quats = getattr(messages, name)
        if quats is None:
            return messages
        return replace(messages, **{name: np.roll(quats, self.places, axis=1)})

    def inverse(self) -> RollQuaternions:
        return replace(self, places=-self.places)


def moved_edge(edge: TransformEdge, moved: Callable[[FloatArray], FloatArray]) -> TransformEdge:
    """The transform with each of its poses exchanged. moved: from (4, 4) to (4, 4)."""
    transforms = [
        moved(se3_from_parts(matrix_from_xyzw(quat), position))
        for quat, position in zip(edge.quats_xyzw, edge.positions_m, strict=True)
    ]
    return replace(
        edge,
        positions_m=np.array([T[:3, 3] for T in transforms]).reshape(-1, 3),
        quats_xyzw=np.array([xyzw_from_matrix(T[:3, :3]) for T in transforms]).reshape(-1, 4),
    )


def frozen_edge(edge: TransformEdge) -> TransformEdge:
    """One message with the pose that is nearest to the median of all of them."""
    poses = np.column_stack([edge.positions_m, edge.quats_xyzw])
    off = np.abs(poses - np.median(poses, axis=0)).sum(axis=1)
    usual = np.array([int(np.argmin(off))])
    return replace(
        select(edge, np.array([0])),
        positions_m=edge.positions_m[usual],
        quats_xyzw=edge.quats_xyzw[usual],
    )


@dataclass(frozen=True, slots=True)
class ChangeDescription(Edit):
    """The robot description (URDF) changed; a text that stays as it was cannot be meant."""

    change: Callable[[str], str]

    def apply(self, recording: Recording) -> Recording:
        if recording.robot_description is None:
            raise CannotEdit(f"{recording.name} has no robot description")
        changed = self.change(recording.robot_description)
        if changed == recording.robot_description:
            raise CannotEdit(f"the robot description of {recording.name} has no such part")
        return replace(recording, robot_description=changed)


def with_joint_origin(urdf: str, child: str, moved: Callable[[FloatArray], FloatArray]) -> str:
    """The description with the origin of the joint to ``child`` exchanged, if it has one.

    moved: from its (4, 4) T_parent_child to another.
    """
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
