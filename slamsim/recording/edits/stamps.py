"""Edits of clocks: stamps and times of receipt shifted, scaled, replaced."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np

from slamsim.core.types import IntArray
from slamsim.recording import Messages, RawScans, Recording
from slamsim.recording.edits.base import STAMPED, CannotEdit, MessagesEdit, Target, edge_subject
from slamsim.recording.edits.beams import beam_counts

_COPIED_NS = 1_000
_TOGETHER = 0.9
"""Of the stamps of one topic that are stamps of another, where one clock makes both."""


@dataclass(frozen=True, slots=True)
class StampsEdit(MessagesEdit):
    """An edit of stamps alone.

    receipt_follows: whether times of receipt that are mere copies of the stamps stay copies.
    """

    receipt_follows: bool = field(default=False, kw_only=True)

    @abstractmethod
    def stamps(self, stamps_ns: IntArray, /) -> IntArray:
        """(n,) stamps in the place of those (n,) of one topic or transform, ns; n is not 0."""

    def changed(self, messages: Messages) -> Messages:
        if messages.stamps_ns.size == 0:
            return messages
        stamps_ns, received_ns = self.stamps(messages.stamps_ns), messages.received_ns
        if self.receipt_follows and are_copies(received_ns, messages.stamps_ns):
            received_ns = received_ns + (stamps_ns - messages.stamps_ns)
        return replace(messages, stamps_ns=stamps_ns, received_ns=received_ns)


@dataclass(frozen=True, slots=True)
class Restamp(StampsEdit):
    """Stamps replaced. change: from (n,) stamps of one topic or transform to (n,) others, ns."""

    change: Callable[[IntArray], IntArray]

    def stamps(self, stamps_ns: IntArray) -> IntArray:
        return self.change(stamps_ns)


@dataclass(frozen=True, slots=True)
class ShiftStamps(StampsEdit):
    """All stamps later by ``offset_ns``."""

    offset_ns: int

    def stamps(self, stamps_ns: IntArray) -> IntArray:
        return stamps_ns + self.offset_ns

    def inverse(self) -> ShiftStamps:
        return replace(self, offset_ns=-self.offset_ns)


@dataclass(frozen=True, slots=True)
class ScaleStamps(StampsEdit):
    """A clock that gains ``gain`` seconds a second since ``origin_ns``.

    origin_ns: None for the first stamp of each topic. taken_back: the gain was there and is taken
    off; what either rounds, the other rounds back.
    """

    gain: float
    origin_ns: int | None = None
    taken_back: bool = False

    def stamps(self, stamps_ns: IntArray) -> IntArray:
        origin_ns = stamps_ns[:1] if self.origin_ns is None else self.origin_ns
        since_ns = stamps_ns - origin_ns
        if self.taken_back:
            since_ns = np.rint(since_ns * (1.0 / (1.0 + self.gain))).astype(np.int64)
            return np.asarray(origin_ns + since_ns)
        return np.asarray(stamps_ns + np.rint(since_ns * self.gain).astype(np.int64))

    def inverse(self) -> ScaleStamps:
        if self.gain <= -1.0:
            raise CannotEdit("a clock that stands still, or runs backward, cannot be undone")
        return replace(self, taken_back=not self.taken_back)


@dataclass(frozen=True, slots=True)
class ShiftWithinScan(MessagesEdit):
    """Stamps of scans later by ``share`` of the time from the first beam to the last."""

    share: float

    def changed(self, scans: RawScans) -> RawScans:
        declared_s = np.array([layout.beam_dt_s for layout in scans.layouts])
        steps = self.share * (beam_counts(scans) - 1)
        later_ns = np.rint(steps * declared_s[scans.layout_of] * 1e9).astype(np.int64)
        return replace(scans, stamps_ns=scans.stamps_ns + later_ns)

    def inverse(self) -> ShiftWithinScan:
        return replace(self, share=-self.share)


@dataclass(frozen=True, slots=True)
class ShiftReceipt(MessagesEdit):
    """All times of receipt later by ``offset_ns``."""

    offset_ns: int

    def changed(self, messages: Messages) -> Messages:
        if messages.received_ns is None:
            raise CannotEdit(f"{messages.topic} does not say when messages were received")
        return replace(messages, received_ns=messages.received_ns + self.offset_ns)

    def inverse(self) -> ShiftReceipt:
        return replace(self, offset_ns=-self.offset_ns)


def are_copies(received_ns: IntArray | None, stamps_ns: IntArray) -> TypeGuard[IntArray]:
    """Whether times of receipt (n,) are those stamps (n,), as converters write them."""
    if received_ns is None:
        return False
    return bool(np.abs(received_ns - stamps_ns).max(initial=0) <= _COPIED_NS)


def clock_of(recording: Recording, subject: str) -> Target:
    """Everything that is stamped together with this topic or transform, itself included.

    Wheels have one clock for counters, joints, odometry and its transform, and a camera one for all
    its imagers: these belong together where nearly all stamps of one are stamps of the other.
    """
    images = {camera.topic: camera.stamps_ns for camera in recording.cameras}
    if subject in images:
        return STAMPED.on(*(name for name, each in images.items() if _share(images[subject], each)))
    wheels = (*recording.odometries, *recording.ticks, *recording.joints)
    stamps = {stream.topic: stream.stamps_ns for stream in wheels}
    stamps |= {edge_subject(edge): edge.stamps_ns for edge in recording.moving}
    if subject not in stamps:
        return STAMPED.on(subject)
    shared = (name for name, values in stamps.items() if _share(stamps[subject], values))
    return STAMPED.on(subject, *shared)


def _share(one: IntArray, other: IntArray) -> bool:
    """Whether nearly all stamps of one are stamps of the other."""
    small, large = sorted((one, other), key=lambda values: values.size)
    return bool(small.size and np.isin(small, large).mean() >= _TOGETHER)
