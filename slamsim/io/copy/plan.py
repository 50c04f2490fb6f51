"""Decides which messages of a file a copy keeps, changes, drops or moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from slamsim.core.types import BoolArray, IntArray
from slamsim.io.copy.changes import RowChanges, parts_with_origin
from slamsim.recording import Origin, Recording


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a change, which transform of its message it is (0 in others), and its log time."""

    change: RowChanges
    row: int
    place: int
    log_ns: int


@dataclass(slots=True)
class TopicPlan:
    """What becomes of the messages of one topic; those that are not named stay as they are.

    in_place: by number of message, the rows that stay where they are in the file, of messages in
    which anything is changed or dropped. moved: rows that are written at their own log time.
    dropped: (number, place) of what is no longer there, or moved.
    """

    in_place: dict[int, list[Row]] = field(default_factory=dict)
    moved: dict[int, list[Row]] = field(default_factory=dict)
    dropped: dict[int, set[int]] = field(default_factory=dict)


def plans(read: Recording, changes: Sequence[RowChanges]) -> dict[str, TopicPlan]:
    """A plan for each topic of which anything changes."""
    known: dict[str, list[Origin]] = {}
    for _, origin in parts_with_origin(read):
        known.setdefault(origin.topic, []).append(origin)
    found = {}
    for topic, origins in known.items():
        mine = [change for change in changes if change.origin.topic == topic]
        plan = _plan(Origin(topic, np.concatenate([each.places for each in origins])), mine)
        if plan.in_place or plan.moved or plan.dropped:
            found[topic] = plan
    return found


def _plan(read: Origin, changes: Sequence[RowChanges]) -> TopicPlan:
    """read: everything that was read of a topic."""
    plan, taken = TopicPlan(), np.zeros(0, dtype=np.int64)
    kept: list[tuple[RowChanges, IntArray]] = []
    for change in changes:
        keys = change.origin.keys
        stays = _stays(change, keys) & ~np.isin(keys, taken)
        taken = np.concatenate([taken, keys[stays]])
        kept.append((change, np.flatnonzero(stays)))
        for number, row in _rows(change, np.flatnonzero(~stays)):
            plan.moved.setdefault(number, []).append(row)
    for number, place in read.places[~np.isin(read.keys, taken)].tolist():
        plan.dropped.setdefault(number, set()).add(place)
    for change, rows in kept:
        for number, row in _rows(change, rows[change.differs[rows]]):
            plan.in_place.setdefault(number, []).append(row)
    return plan


def _rows(change: RowChanges, rows: IntArray) -> Iterator[tuple[int, Row]]:
    """(number of the message, row) of each."""
    places, log_ns = change.origin.places[rows].tolist(), change.written_ns[rows].tolist()
    for row, (number, place), at_ns in zip(rows.tolist(), places, log_ns, strict=True):
        yield number, Row(change, row, place, at_ns)


def _stays(change: RowChanges, keys: IntArray) -> BoolArray:
    """(n,) rows that are where they were: on their topic, in order, received as before, once."""
    if change.topic != change.origin.topic or not change.in_order:
        return np.zeros(keys.size, dtype=np.bool_)
    first = np.zeros(keys.size, dtype=np.bool_)
    first[np.unique(keys, return_index=True)[1]] = True
    return np.asarray(first & (change.log_ns == change.read_log_ns))
