"""Faults of the transform tree: missing, duplicate, wrong or late transforms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.recording import Recording, TransformEdge
from slamsim.recording.edits.base import (
    DRIVEN,
    IMUS,
    ODOMETRIES,
    SCANS,
    CannotEdit,
    Edit,
    Target,
    is_odometry_edge,
)
from slamsim.recording.edits.frames import (
    AddTransform,
    ChangeTransforms,
    InvertTransform,
    RenameFrame,
    RollQuaternions,
)
from slamsim.recording.edits.messages import select
from slamsim.recording.edits.motion import scaled_edge
from slamsim.recording.edits.stamps import ShiftStamps
from slamsim.sensors.faults.base import Fault, span_ns


class TransformMissing(Fault):
    """One link of the tree is not published."""

    kind: Literal["transform_missing"]
    child: str
    """The frame that has no parent any more."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ChangeTransforms(
            lambda edge: edge.child == self.child, lambda _: None, f"transform to {self.child}"
        )


class TransformAdded(Fault):
    """One more link is published: a second parent, or a loop."""

    kind: Literal["transform_added"]
    parent: str
    """The frame it starts at."""
    child: str
    """The frame it leads to."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        edges = recording.transforms
        like = next((edge for edge in edges if is_odometry_edge(edge)), None)
        if like is None or not {self.parent, self.child} <= _frames(edges):
            raise CannotEdit(
                f"{recording.name} has no moving transform, or no {self.parent} or {self.child}"
            )
        return AddTransform(replace(like, parent=self.parent, child=self.child))


class FrameUnknown(Fault):
    """Messages name a frame that is not in the tree."""

    kind: Literal["frame_unknown"]
    stream: Literal["lidar", "imu", "odometry"]
    """Whose messages; of odometry the child is meant."""
    frame: str
    """What they name instead."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        if not recording.transforms:
            raise CannotEdit(f"{recording.name} has no transforms")
        target = {"lidar": SCANS, "imu": IMUS, "odometry": ODOMETRIES}[self.stream]
        return RenameFrame(target, self.frame, child=self.stream == "odometry")


class StaticChanges(Fault):
    """The fixed transform of the laser is published anew with another position during the drive."""

    kind: Literal["static_changes"]
    by_m: float = Field(ge=-10.0, le=10.0)
    """By how much further the sensor is said to sit from then on."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        start_ns, end_ns = span_ns(recording)
        middle_ns = (start_ns + end_ns) // 2

        def published_again(edge: TransformEdge) -> TransformEdge:
            count = edge.stamps_ns.size
            again = select(edge, np.minimum(np.arange(count + 1), count - 1))
            stamps_ns, positions_m = again.stamps_ns.copy(), again.positions_m.copy()
            received_ns = None if again.received_ns is None else again.received_ns.copy()
            stamps_ns[-1] = middle_ns
            positions_m[-1, 0] += self.by_m
            if received_ns is not None:
                received_ns[-1] = middle_ns
            return replace(
                again, stamps_ns=stamps_ns, received_ns=received_ns, positions_m=positions_m
            )

        return ChangeTransforms(_carries_laser(recording), published_again)


class StaticNotRigid(Fault):
    """The fixed transform of the laser has a rotation of zeros: it was never filled in."""

    kind: Literal["static_not_rigid"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ChangeTransforms(
            _carries_laser(recording),
            lambda edge: replace(edge, quats_xyzw=np.zeros_like(edge.quats_xyzw)),
        )


class TransformLate(Fault):
    """The moving transform is missing for a while at the begin, the middle and the end."""

    kind: Literal["transform_uncovered"]
    missing_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def cut(edge: TransformEdge) -> TransformEdge:
            first, last = float(edge.stamps_ns[0]), float(edge.stamps_ns[-1])
            middles = np.array([first, 0.5 * (first + last), last])
            reach_ns = np.array([1.0, 0.5, 1.0]) * self.missing_s * 1e9
            away = np.abs(edge.stamps_ns[:, None] - middles) < reach_ns
            return select(edge, ~away.any(axis=1))

        return ChangeTransforms(is_odometry_edge, cut)


class TransformContradicts(Fault):
    """The moving transform shows other distances than the odometry's messages."""

    kind: Literal["transform_contradicts"]
    relative_error: float = Field(gt=-1.0, le=10.0)
    """Of distances and turns in the transform, against those in the messages."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        gain = 1.0 + self.relative_error
        return ChangeTransforms(is_odometry_edge, lambda edge: scaled_edge(edge, gain, gain))


class TransformInverted(Fault):
    """The moving transform is published with parent and child exchanged."""

    kind: Literal["transform_inverted"]
    poses: bool
    """Whether its poses are inverted with the names, so that lookups still give the right pose."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        edge = next((edge for edge in recording.transforms if is_odometry_edge(edge)), None)
        if edge is None:
            raise CannotEdit(f"{recording.name} has no moving transform")
        return InvertTransform(edge.name, self.poses)


class TransformShifted(Fault):
    """The moving transform alone is stamped too late; the odometry's messages are not."""

    kind: Literal["transform_shifted"]
    offset_s: float = Field(ge=-10.0, le=10.0)
    """Stamp less the right one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ShiftStamps(Target((), "moving transform", edges=True), round(1e9 * self.offset_s))


class QuaternionOrder(Fault):
    """Rotations are written as w, x, y, z where x, y, z, w is read."""

    kind: Literal["quaternion_order"]
    stream: Literal["odometry", "imu"]
    """Whose: those of the odometry and its transform, or the orientations of the inertial unit."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        if self.stream == "imu" and all(imu.orientation_xyzw is None for imu in recording.imus):
            raise CannotEdit(f"{recording.name} has no orientation of an inertial unit")
        return RollQuaternions(DRIVEN if self.stream == "odometry" else IMUS, 1)


def _frames(edges: tuple[TransformEdge, ...]) -> set[str]:
    return {frame for edge in edges for frame in (edge.parent, edge.child)}


def _carries_laser(recording: Recording) -> Callable[[TransformEdge], bool]:
    frames = {frame.strip("/") for scans in recording.scans for frame in scans.frame_ids}
    return lambda edge: edge.is_static and edge.child.strip("/") in frames
