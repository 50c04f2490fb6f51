"""Compares an edited recording with its source: the changes per message, and what a copy does with
each.

Rows know the messages they came from (``Origin``). A row is compared with the one that was read,
bit by bit; what differs is set in the decoded message, and every other field of it, also those
that a ``Recording`` does not hold, stays as the publisher wrote it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slamsim.core.types import BoolArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.io.copy.images import ImagesPart
from slamsim.io.copy.patches import Pair, Patch, patches_of
from slamsim.io.ros.message_types import MessageTypes
from slamsim.recording import Origin, RawStream, Recording, TransformEdge


def transform_messages(
    types: MessageTypes, edge: TransformEdge, first_ns: int
) -> Iterator[tuple[int, bytes]]:
    """(log time in ns, message) of each transform of an edge, as its topic has them.

    first_ns: log time for an edge that does not say
    when it was received: such a one holds from the begin.
    """
    topic, known = edge.topic, types.types(edge.topic)
    log_ns = edge.received_ns
    if log_ns is None:
        log_ns = np.full(edge.stamps_ns.size, first_ns)
    for row, at_ns in enumerate(np.maximum.accumulate(np.maximum(log_ns, 0)).tolist()):
        message = _part(known, types.type_name(topic), transforms=[_stamped(known, edge, row)])
        yield at_ns, types.serialize(topic, message)


def _stamped(known: Mapping[str, Any], edge: TransformEdge, row: int) -> Any:
    seconds, nanoseconds = divmod(int(edge.stamps_ns[row]), 1_000_000_000)
    stamp = _part(known, "builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    x, y, z = edge.positions_m[row].tolist()
    qx, qy, qz, qw = edge.quats_xyzw[row].tolist()
    return _part(
        known,
        "geometry_msgs/msg/TransformStamped",
        header=_part(known, "std_msgs/msg/Header", stamp=stamp, frame_id=edge.parent, seq=row),
        child_frame_id=edge.child,
        transform=_part(
            known,
            "geometry_msgs/msg/Transform",
            translation=_part(known, "geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            rotation=_part(known, "geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        ),
    )


def _part(known: Mapping[str, Any], name: str, **values: Any) -> Any:
    """An instance with those of the values that the recording's definition has: ROS 2 has no
    ``seq``."""
    kind = known[name]
    return kind(**{n: v for n, v in values.items() if n in kind.__dataclass_fields__})


@dataclass(frozen=True, slots=True, eq=False)
class RowChanges:
    """One edited stream or edge against the messages that it was read from.

    topic: on which it is to be published; origin: where it was read. stamps_ns, log_ns: (n,) after
    the edit, read_stamps_ns, read_log_ns before. in_order: whether its rows are in the order of
    the file. differs: (n,) which messages change.
    """

    topic: str
    origin: Origin
    stamps_ns: IntArray
    read_stamps_ns: IntArray
    log_ns: IntArray
    read_log_ns: IntArray
    in_order: bool
    differs: BoolArray
    patch: Patch

    @property
    def written_ns(self) -> IntArray:
        """(n,) log times in which the rows keep their order; MCAP has none before 0."""
        return np.maximum.accumulate(np.maximum(self.log_ns, 0))

    @property
    def restamped(self) -> bool:
        return not np.array_equal(self.stamps_ns, self.read_stamps_ns)


def changes_between(read: Recording, edited: Recording) -> list[RowChanges]:
    """One for each stream and edge of ``edited`` that came from messages of the file.

    Raises SlamsimError for a change of scans that the file does not hold as such.
    """
    for scans in edited.scans:
        if scans.note and not any(scans is each for each in read.scans):
            raise SlamsimError(
                f"the scans of {scans.topic} are {scans.note}; into such messages a change of "
                "scans cannot be written: record them as sensor_msgs/LaserScan"
            )
    published: dict[str, list[Any]] = {}
    for part, origin in parts_with_origin(read):
        published.setdefault(origin.topic, []).append(part)
    return [
        _change(part, origin, published.get(origin.topic, []))
        for part, origin in parts_with_origin(edited)
    ]


def parts_with_origin(
    recording: Recording,
) -> list[tuple[RawStream | TransformEdge | ImagesPart, Origin]]:
    """Its streams, edges and images that came from messages of a file, and from which."""
    images = (ImagesPart(camera) for camera in recording.cameras if len(camera.numbers))
    parts: list[RawStream | TransformEdge | ImagesPart] = list(recording.streams)
    parts += [*recording.transforms, *images]
    return [(part, part.origin) for part in parts if part.origin is not None]


def new_edges(recording: Recording) -> list[TransformEdge]:
    """The transforms that came from no message, so that some must be made for them."""
    return [e for e in recording.transforms if e.origin is None and e.stamps_ns.size]


def _change(edited: Any, origin: Origin, read: Sequence[Any]) -> RowChanges:
    """edited: a stream or edge; read: all that was read of the same topic."""
    if len(origin.places) != edited.stamps_ns.size:
        raise AssertionError(f"{origin.topic}: rows were edited without their origin")
    count = edited.stamps_ns.size
    read_stamps_ns, read_log_ns = (np.zeros(count, dtype=np.int64) for _ in range(2))
    differs = np.zeros(count, dtype=np.bool_)
    setters: list[tuple[BoolArray, Patch]] = []
    for pair in _pairs(edited, read):
        read_stamps_ns[pair.rows] = pair.read.stamps_ns[pair.read_rows]
        read_log_ns[pair.rows] = pair.read.received_ns[pair.read_rows]
        for unequal, patch in patches_of(pair):
            whole = np.zeros(count, dtype=np.bool_)
            whole[pair.rows] = unequal
            if whole.any():
                differs |= whole
                setters.append((whole, patch))

    def patched(message: Any, row: int) -> None:
        for which, patch in setters:
            if which[row]:
                patch(message, row)

    in_order = bool((np.diff(origin.places[:, 0]) >= 0).all())
    times = edited.stamps_ns, read_stamps_ns, edited.received_ns, read_log_ns
    return RowChanges(edited.topic, origin, *times, in_order, differs, patched)


def _pairs(edited: Any, read: Sequence[Any]) -> list[Pair]:
    """The edited rows beside the rows that were read from the same messages."""
    wanted = edited.origin.keys
    pairs = []
    for part in read:
        known = part.origin.keys  # never empty: a topic without a row is no stream
        order = np.argsort(known)
        at = np.minimum(np.searchsorted(known, wanted, sorter=order), known.size - 1)
        found = order[at]
        rows = np.flatnonzero(known[found] == wanted)
        if rows.size:
            pairs.append(Pair(edited, part, rows, found[rows]))
    return pairs


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
