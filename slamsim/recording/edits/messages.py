"""Edits that select, repeat or reorder messages, or change them without an inverse."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slamsim.core.types import BoolArray, IntArray
from slamsim.recording import Messages, Origin, RawStream, Recording
from slamsim.recording.edits.base import Edit, MessagesChange, MessagesEdit, Target

_BESIDE_FIELDS = ("stamps_ns", "received_ns", "samples", "origin", "layout_of", "yaws_rad")
"""What streams have of each message besides the fields of their schema."""


@dataclass(frozen=True, slots=True)
class ChangeMessages(MessagesEdit):
    """A change of a target's messages that no other edit describes, such as random readings."""

    change: MessagesChange | Callable[[Any], Any]

    def changed(self, messages: Any) -> Any:
        return self.change(messages)


@dataclass(frozen=True, slots=True)
class SelectMessages(MessagesEdit):
    """Messages dropped, duplicated or reordered, each with all that it carries.

    rows: from a stream or transform of n messages to (n,) which of them to keep, or to (k,)
    numbers of messages in their new order.
    """

    rows: Callable[[Any], BoolArray | IntArray]

    def changed(self, messages: Messages) -> Messages:
        return select(messages, self.rows(messages))


@dataclass(frozen=True, slots=True, eq=False)
class AddStream(Edit):
    """One stream more, after those of its kind."""

    stream: RawStream

    def apply(self, recording: Recording) -> Recording:
        kind = type(self.stream)
        return recording.with_streams(kind, (*recording.of(kind), self.stream))

    def inverse(self) -> DropStreams:
        return DropStreams(Target((type(self.stream),), "stream").on(self.stream.topic))


@dataclass(frozen=True, slots=True)
class DropStreams(Edit):
    """Streams left out with all their messages."""

    target: Target

    def apply(self, recording: Recording) -> Recording:
        self.target.require(recording)
        left = (stream for stream in recording.streams if not self.target.holds(stream))
        return replace(recording, streams=tuple(left))


def select(messages: Messages, which: BoolArray | IntArray) -> Messages:
    """Some of n messages of a topic or transform, or all in another order.

    which: (n,) of bool, or (k,) numbers of messages.
    """
    rows = np.arange(messages.stamps_ns.size)[which]
    per_message: dict[str, object] = {}
    fields = (field.name for field in messages.schema.fields if not field.is_constant)
    for name in (*_BESIDE_FIELDS, *fields):
        value = getattr(messages, name, None)
        if isinstance(value, np.ndarray | Origin):
            per_message[name] = value[rows]
        elif value is not None:
            per_message[name] = [value[row] for row in rows]
    return replace(messages, **per_message)  # type: ignore[arg-type]


def copies(messages: Messages) -> BoolArray:
    """(n,) which messages say in every field, and at the same stamp, what an earlier one says."""
    found = np.zeros(messages.stamps_ns.size, dtype=np.bool_)
    found[[row for row, is_copy in _with_one_stamp(messages) if is_copy]] = True
    return found


def repeats_are_copies(messages: Messages) -> bool:
    """Whether all messages that carry the stamp of an earlier one are copies of it."""
    return all(is_copy for _, is_copy in _with_one_stamp(messages))


def _with_one_stamp(messages: Messages) -> Iterator[tuple[int, bool]]:
    """Numbers of messages with the stamp of an earlier one, and whether they are its copy."""
    _, first, which = np.unique(messages.stamps_ns, return_index=True, return_inverse=True)
    earlier = first[which]
    fields = (field.name for field in messages.schema.fields if not field.is_constant)
    held = (getattr(messages, name, None) for name in (*fields, "layout_of"))
    values = [value for value in held if value is not None]
    for row in np.flatnonzero(earlier != np.arange(earlier.size)).tolist():
        one = earlier[row]
        yield row, all(np.array_equal(each[row], each[one], equal_nan=True) for each in values)


def with_sequence_numbers(recording: Recording) -> Recording:
    """With the number of each message, which it keeps when others are lost."""
    return recording.changed(RawStream, lambda one: replace(one, samples=np.arange(len(one))))
