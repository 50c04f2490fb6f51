"""Faults of the transform tree: links that are missing, doubled, wrong or not there in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.recording import RawStream, Recording, TransformEdge
from slamsim.recording.edits import kept
from slamsim.sensors.faults.base import CannotInject, Fault
from slamsim.sensors.faults.edit import is_odometry, with_imus, with_scans
from slamsim.sensors.faults.wheel_motion import scaled_edge


class TransformMissing(Fault):
    """Nobody publishes one link of the tree."""

    kind: Literal["transform_missing"]
    child: str
    """The frame that nobody places any more."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        left = tuple(edge for edge in recording.transforms if edge.child != self.child)
        if len(left) == len(recording.transforms):
            raise CannotInject(f"{recording.name} has no transform to {self.child}")
        return replace(recording, transforms=left)


class TransformAdded(Fault):
    """One more link is published: a second parent, or a way back."""

    kind: Literal["transform_added"]
    parent: str
    """The frame it starts at."""
    child: str
    """The frame it leads to."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        edges = recording.transforms
        like = next((edge for edge in edges if is_odometry(edge)), None)
        if like is None or not {self.parent, self.child} <= _frames(edges):
            raise CannotInject(
                f"{recording.name} has no moving transform, or no {self.parent} or {self.child}"
            )
        return replace(
            recording,
            transforms=(*edges, replace(like, parent=self.parent, child=self.child)),
        )


class FrameUnknown(Fault):
    """Messages name a frame that is not in the tree."""

    kind: Literal["frame_unknown"]
    stream: Literal["lidar", "imu"]
    """Whose messages."""
    frame: str
    """What they name instead."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        if not recording.transforms:
            raise CannotInject(f"{recording.name} has no transforms")
        if self.stream == "lidar":
            return with_scans(recording, lambda s: replace(s, frame_ids=(self.frame,)))
        return with_imus(recording, lambda s: replace(s, frame_ids=(self.frame,)))


class StaticChanges(Fault):
    """The fixed transform of the laser is published anew with another place on the way."""

    SIZE: ClassVar[str | None] = "by_m"
    kind: Literal["static_changes"]
    by_m: float = Field(ge=-10.0, le=10.0)
    """By how much further the sensor is said to sit from then on."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        start_ns, end_ns = span_ns(recording)
        middle_ns = (start_ns + end_ns) // 2

        def published_again(edge: TransformEdge) -> TransformEdge:
            count = edge.stamps_ns.size
            again = kept(edge, np.minimum(np.arange(count + 1), count - 1))
            stamps_ns, positions_m = again.stamps_ns.copy(), again.positions_m.copy()
            received_ns = None if again.received_ns is None else again.received_ns.copy()
            stamps_ns[-1] = middle_ns
            positions_m[-1, 0] += self.by_m
            if received_ns is not None:
                received_ns[-1] = middle_ns
            return replace(
                again, stamps_ns=stamps_ns, received_ns=received_ns, positions_m=positions_m
            )

        return _with_laser_edge(recording, published_again)


class StaticNotRigid(Fault):
    """The fixed transform of the laser has a rotation of zeros: nobody has filled it in."""

    kind: Literal["static_not_rigid"]

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return _with_laser_edge(
            recording, lambda edge: replace(edge, quats_xyzw=np.zeros_like(edge.quats_xyzw))
        )


class TransformLate(Fault):
    """The moving transform is missing for a while at the begin, the middle and the end."""

    SIZE: ClassVar[str | None] = "missing_s"
    kind: Literal["transform_uncovered"]
    missing_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def cut(edge: TransformEdge) -> TransformEdge:
            first, last = float(edge.stamps_ns[0]), float(edge.stamps_ns[-1])
            middles = np.array([first, 0.5 * (first + last), last])
            reach_ns = np.array([1.0, 0.5, 1.0]) * self.missing_s * 1e9
            away = np.abs(edge.stamps_ns[:, None] - middles) < reach_ns
            return kept(edge, ~away.any(axis=1))

        return _with_odometry_edge(recording, cut)


class TransformContradicts(Fault):
    """The moving transform shows other distances than the odometry's messages."""

    SIZE: ClassVar[str | None] = "relative_error"
    kind: Literal["transform_contradicts"]
    relative_error: float = Field(gt=-1.0, le=10.0)
    """Of distances and turns in the transform, against those in the messages."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        gain = 1.0 + self.relative_error
        return _with_odometry_edge(recording, lambda edge: scaled_edge(edge, gain, gain))


def span_ns(recording: Recording) -> tuple[int, int]:
    """The first and the last stamp of all streams."""
    streams: tuple[RawStream, ...] = (
        *recording.scans,
        *recording.imus,
        *recording.odometries,
        *recording.ticks,
    )
    stamps = [stream.stamps_ns for stream in streams if len(stream)]
    if not stamps:
        raise CannotInject(f"{recording.name} holds no messages")
    return min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)


def _frames(edges: tuple[TransformEdge, ...]) -> set[str]:
    return {frame for edge in edges for frame in (edge.parent, edge.child)}


def _with_laser_edge(
    recording: Recording, change: Callable[[TransformEdge], TransformEdge]
) -> Recording:
    frames = {frame.strip("/") for scans in recording.scans for frame in scans.frame_ids}
    return _with_edges(
        recording, lambda edge: edge.is_static and edge.child.strip("/") in frames, change
    )


def _with_odometry_edge(
    recording: Recording, change: Callable[[TransformEdge], TransformEdge]
) -> Recording:
    return _with_edges(recording, is_odometry, change)


def _with_edges(
    recording: Recording,
    chosen: Callable[[TransformEdge], bool],
    change: Callable[[TransformEdge], TransformEdge],
) -> Recording:
    edges = recording.transforms
    if not any(chosen(edge) and edge.stamps_ns.size for edge in edges):
        raise CannotInject(f"{recording.name} has no such transform")
    return replace(
        recording, transforms=tuple(change(edge) if chosen(edge) else edge for edge in edges)
    )
