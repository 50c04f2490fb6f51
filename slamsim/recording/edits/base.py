"""What an edit is, and which messages of a recording it changes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

from slamsim.guard.errors import SlamsimError
from slamsim.recording import (
    KINDS,
    Messages,
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    Recording,
    TransformEdge,
)

ODOMETRY_FRAME = "odom"


class CannotEdit(SlamsimError):
    """The recording lacks what an edit would change, or the edit has no inverse."""


class Edit(ABC):
    """A change of a recording; the recording that is given stays as it was."""

    __slots__ = ()

    @abstractmethod
    def apply(self, recording: Recording) -> Recording:
        """The recording with the change. Raises CannotEdit where there is nothing to change."""

    def inverse(self) -> Edit:
        """The edit that takes this one back: exactly for integers, to rounding for floats.

        Raises CannotEdit for an edit that loses what it overwrites.
        """
        raise CannotEdit(f"{type(self).__name__} cannot be undone: it overwrites what was there")


@dataclass(frozen=True, slots=True)
class Edits(Edit):
    """Several edits, one after the other."""

    edits: tuple[Edit, ...]

    def apply(self, recording: Recording) -> Recording:
        for edit in self.edits:
            recording = edit.apply(recording)
        return recording

    def inverse(self) -> Edits:
        return Edits(tuple(edit.inverse() for edit in reversed(self.edits)))


class MessagesChange(Protocol):
    """From the messages of any topic or transform to others of the same kind."""

    def __call__(self, messages: Messages, /) -> Messages: ...


@dataclass(frozen=True, slots=True)
class Target:
    """Which messages an edit changes: streams of some kinds, on all topics or on some.

    lacking: what to call that which a recording without any of it lacks. subjects: topics, and
    ``edge_subject`` of transforms; None for all. edges: whether moving transforms belong to it;
    without subjects those that the odometry publishes. needs: the kinds of which there must be at
    least one stream; those of ``kinds`` if empty.
    """

    kinds: tuple[type[RawStream], ...]
    lacking: str
    subjects: frozenset[str] | None = None
    edges: bool = False
    needs: tuple[type[RawStream], ...] = ()

    def on(self, *subjects: str) -> Target:
        """The same, of these topics and transforms alone."""
        return replace(self, subjects=frozenset(subjects))

    def holds(self, messages: RawStream | TransformEdge) -> bool:
        """Whether an edit of this target changes these messages."""
        if not isinstance(messages, TransformEdge):
            chosen = self.subjects is None or messages.topic in self.subjects
            return chosen and isinstance(messages, self.kinds)
        if self.subjects is None:
            return self.edges and is_odometry_edge(messages)
        return self.edges and not messages.is_static and edge_subject(messages) in self.subjects

    def of(self, recording: Recording) -> Iterator[RawStream | TransformEdge]:
        """All messages that it holds, kind by kind. Raises CannotEdit without any."""
        self.require(recording)
        for kind in self.kinds:
            yield from (stream for stream in recording.of(kind) if self.holds(stream))
        yield from (edge for edge in recording.transforms if self.holds(edge))

    def require(self, recording: Recording) -> None:
        """Raises CannotEdit for a recording without such messages."""
        if self.subjects is not None:
            streams = any(self.holds(stream) for stream in recording.streams)
            if streams or any(self.holds(edge) for edge in recording.transforms):
                return
            subjects = ", ".join(sorted(self.subjects))
            raise CannotEdit(f"{recording.name} has no {self.lacking} on {subjects!r}")
        there = any(recording.of(kind) for kind in self.needs or self.kinds)
        if not there and (self.kinds or not any(map(self.holds, recording.transforms))):
            raise CannotEdit(f"{recording.name} has no {self.lacking}")

    def changed(self, recording: Recording, change: MessagesChange | Any) -> Recording:
        """The recording with each of its messages changed, kind by kind.

        change: from a stream (or transform) to one of the same kind. Raises as ``require`` does.
        """
        self.require(recording)
        for kind in self.kinds:
            recording = recording.changed(kind, lambda one: change(one) if self.holds(one) else one)
        if not self.edges:
            return recording
        edges = (change(edge) if self.holds(edge) else edge for edge in recording.transforms)
        return replace(recording, transforms=tuple(edges))


SCANS = Target((RawScans,), "scans")
IMUS = Target((RawImu,), "inertial unit")
TICKS = Target((RawTicks,), "wheel counters")
COUNTS = Target((RawTicks, RawJoints), "wheel counters", needs=(RawTicks,))
"""Counters, and the joints that turn with them."""
ODOMETRIES = Target((RawOdometry,), "odometry")
_WHEELS = "odometry or wheel counters"
DRIVEN = Target((RawOdometry,), _WHEELS, edges=True, needs=(RawOdometry, RawTicks))
"""The odometry, and the transform that goes with it."""
WHEELS = replace(DRIVEN, kinds=(RawOdometry, RawTicks, RawJoints))
"""Everything on the clock of the wheels: counters, joints, odometry and its transform."""
ROTATIONS = Target((RawOdometry, RawImu), "rotations", edges=True)
"""All rotations that change; an inertial unit's are its orientations, if it has any."""
STAMPED = Target(KINDS, "messages", edges=True)
"""Everything that has stamps, but for fixed transforms."""


@dataclass(frozen=True, slots=True)
class MessagesEdit(Edit):
    """An edit that changes each stream (or transform) of a target by itself."""

    target: Target

    @abstractmethod
    def changed(self, messages: Any, /) -> Any:
        """The stream or transform in the place of one; raises CannotEdit where it cannot be."""

    def apply(self, recording: Recording) -> Recording:
        return self.target.changed(recording, self.changed)


def is_odometry_edge(edge: TransformEdge) -> bool:
    """Whether this is the moving transform that the wheels publish."""
    return not edge.is_static and edge.parent.strip("/") == ODOMETRY_FRAME


def edge_subject(edge: TransformEdge) -> str:
    """How findings about stamps name a transform: by its topic and its frames."""
    return f"{edge.topic} {edge.name}"


def reciprocal(factor: float) -> float:
    """1 / factor. Raises CannotEdit for 0, after which nothing is left to be scaled back."""
    if factor == 0.0:
        raise CannotEdit("a factor of 0 cannot be undone")
    return 1.0 / factor
