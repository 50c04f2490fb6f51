"""The streams of a recording as they were written, except scans (scan_collector.py).

A collector is given the messages of one topic batch by batch; those that ``opened`` gives None for
are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import IntArray
from slamsim.io.ros.columns import Alike, Opened, alike, at_place, layout_for
from slamsim.io.ros.layouts import CdrLayout, columns_of, message_layout, shape_of
from slamsim.process.children import return_freed_memory
from slamsim.recording import (
    Origin,
    RawJoints,
    RawStream,
    TransformEdge,
)
from slamsim.recording.frames import frame_name
from slamsim.recording.schemas import CLOCK, JOINTS, TRANSFORM, TRANSFORMS, Field, Schema

_Raw = TypeVar("_Raw", bound=RawStream)


@dataclass(slots=True, eq=False)
class _Gathered:
    """Rows that come in groups, put back into the order of the file.

    orders: (k, 2) of each group, as ``Origin`` has them. values: of each field of the groups.
    """

    orders: list[IntArray] = field(default_factory=list)
    stamps: list[IntArray] = field(default_factory=list)
    received: list[IntArray] = field(default_factory=list)
    values: dict[str, list[NDArray[Any]]] = field(default_factory=dict)

    def add(
        self,
        order: IntArray,
        stamps: IntArray,
        received: IntArray,
        values: dict[str, NDArray[Any]],
    ) -> None:
        self.orders.append(order)
        self.stamps.append(stamps)
        self.received.append(received)
        for name, value in values.items():
            self.values.setdefault(name, []).append(value)

    def joined(self) -> tuple[IntArray, IntArray, IntArray, dict[str, Any]]:
        """(messages (n, 2) as in ``Origin``, stamps (n,), when received (n,), values), once."""
        numbers = _whole(self.orders)
        sorting = np.argsort(numbers[:, 0], kind="stable")
        order = None if (np.diff(sorting) == 1).all() else sorting
        joined = (
            _in_order(numbers, order),
            _in_order(_whole(self.stamps), order),
            _in_order(_whole(self.received), order),
            {name: _in_order(_whole(parts), order) for name, parts in self.values.items()},
        )
        return_freed_memory()
        return joined


def _whole(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """All groups; the list is empty then, for hours of an inertial unit are half a gigabyte."""
    whole = np.concatenate(parts)
    parts.clear()
    return whole


def _in_order(values: NDArray[Any], order: IntArray | None) -> NDArray[Any]:
    """None: they are already."""
    return values if order is None else values[order]


class Collector:
    """What all collectors do. taken: how many messages were; without any there is no stream.

    kind: of the stream that it makes, if it makes one.
    """

    kind: type[RawStream] | None = None

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        self.topic, self._opened, self._is_cdr = topic, opened, is_cdr
        self.taken = 0
        self._names: dict[str, dict[str, None]] = {}
        self._slashed: dict[str, None] = {}
        self._seen = 0

    def add(self, received_ns: IntArray, batch: list[bytes]) -> None:
        """The next messages, and when each was received. received_ns: (n,)."""
        for group in self._groups(batch):
            self.taken += group.places.size
            numbers = self._seen + group.places
            order = np.column_stack([numbers, np.zeros_like(numbers)])
            self._take(group, order, received_ns[group.places])
        self._seen += len(batch)

    def _groups(self, batch: list[bytes]) -> Iterator[Alike]:
        return alike(batch, self._opened, self._layout_of, self._is_cdr)

    def _layout_of(self, message: Any) -> CdrLayout:
        raise NotImplementedError

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        """order: (k, 2) which messages of the topic these are, and 0, as ``Origin`` has them."""
        raise NotImplementedError

    def _note_frames(self, message: Any, schema: Schema) -> None:
        for name, place in schema.frames:
            written = at_place(message, place)
            frame = frame_name(written)
            self._names.setdefault(name, {}).setdefault(frame)
            if written.startswith("/"):
                self._slashed.setdefault(frame)

    def _frames(self, schema: Schema) -> dict[str, Any]:
        """What the messages say of their frames, by the field of the stream."""
        names = {name: tuple(self._names[name]) for name, _ in schema.frames}
        return {**names, "slashed": tuple(self._slashed)}


class NumberCollector(Collector, Generic[_Raw]):
    """Messages of a header and so many numbers, as their schema says."""

    kind: type[_Raw]

    def __init__(self, kind: type[_Raw], topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self.kind, self._schema = kind, kind.schema
        self._gathered = _Gathered()
        self._there: set[str] = set()

    def _layout_of(self, message: Any) -> CdrLayout:
        return layout_for(self._schema, message)

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        self._note_frames(group.example, self._schema)
        values = {each.name: group.values(each) for each in self._schema.fields}
        for each in self._schema.fields:
            if each.covariance and group.have(each):
                self._there.add(each.name)
        self._gathered.add(order, group.stamps_ns(), received_ns, values)

    def stream(self) -> _Raw:
        """What all messages say alike, such as the size of wheels, is that of the first one."""
        places, stamps_ns, received_ns, values = self._gathered.joined()
        constants = [values[each.name] for each in self._schema.fields if each.is_constant]
        changed: dict[str, Any] = {}
        if any((each != each[0]).any() for each in constants):
            changed["constants_change"] = True
        return self.kind(
            topic=self.topic,
            stamps_ns=stamps_ns,
            received_ns=received_ns,
            origin=Origin(self.topic, places),
            **self._frames(self._schema),
            **{each.name: self._read(each, values[each.name]) for each in self._schema.fields},
            **changed,
        )

    def _read(self, field: Field, values: NDArray[Any]) -> Any:
        if field.is_constant:
            return values[0].item()
        return None if field.covariance and field.name not in self._there else values


class JointCollector(Collector):
    """sensor_msgs/JointState, whose messages may each name other joints."""

    kind = RawJoints

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._by_names: dict[tuple[str, ...], _Gathered] = {}

    def _layout_of(self, message: Any) -> CdrLayout:
        return layout_for(JOINTS, message)

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        message = group.example
        self._note_frames(message, JOINTS)
        values = {}
        for each in JOINTS.fields:
            found = group.values(each)
            if found.shape[1] != len(message.name):  # the messages give none, as they may
                found = np.full((group.places.size, len(message.name)), np.nan)
            values[each.name] = found
        gathered = self._by_names.setdefault(tuple(message.name), _Gathered())
        gathered.add(order, group.stamps_ns(), received_ns, values)

    def stream(self) -> RawJoints:
        names = tuple(dict.fromkeys(name for names in self._by_names for name in names))
        whole = _Gathered()
        for mine, gathered in self._by_names.items():
            order, stamps_ns, received_ns, values = gathered.joined()
            whole.add(order, stamps_ns, received_ns, _spread(values, mine, names))
        order, stamps_ns, received_ns, values = whole.joined()
        return RawJoints(
            topic=self.topic,
            stamps_ns=stamps_ns,
            received_ns=received_ns,
            origin=Origin(self.topic, order),
            names=names,
            **self._frames(JOINTS),
            **values,
        )


def _spread(
    values: dict[str, NDArray[Any]], mine: Sequence[str], names: Sequence[str]
) -> dict[str, Any]:
    """(n, joints) of some joints as those of all, nan for the others."""
    found = {}
    for name, numbers in values.items():
        found[name] = np.full((len(numbers), len(names)), np.nan)
        found[name][:, [names.index(joint) for joint in mine]] = numbers
    return found


class TransformCollector(Collector):
    """tf2_msgs/TFMessage, taken apart into edges."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._edges: dict[tuple[str, str], _Gathered] = {}

    def _layout_of(self, message: Any) -> CdrLayout:
        places = (f"transforms.{number}." for number in range(len(message.transforms)))
        columns = frozenset().union(*(columns_of(TRANSFORM.paths, at) for at in places))
        return message_layout(TRANSFORMS, columns, shape_of(TRANSFORMS, message))

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        for number, edge in enumerate(group.example.transforms):
            parent, child = (frame_name(at_place(edge, place)) for _, place in TRANSFORM.frames)
            at = f"transforms.{number}."
            values = {each.name: group.values(each, at) for each in TRANSFORM.fields}
            stamps_ns = group.stamps_ns(f"{at}{TRANSFORM.stamp}")
            gathered = self._edges.setdefault((parent, child), _Gathered())
            gathered.add(order + np.array([0, number]), stamps_ns, received_ns, values)

    def edges(self, *, is_latched: bool) -> list[TransformEdge]:
        """In the order of their first appearance in a batch. is_latched: a transform holds until
        another one comes; those that differ are static on /tf_static alone."""
        found = []
        for (parent, child), gathered in self._edges.items():
            places, stamps_ns, received_ns, values = gathered.joined()
            is_at_rest = all((each == each[0]).all() for each in values.values())
            is_static = is_latched and (is_at_rest or self.topic.endswith("tf_static"))
            which = self.topic, parent, child, is_static, stamps_ns, received_ns
            found.append(TransformEdge(*which, origin=Origin(self.topic, places), **values))
        return found


class ClockCollector(Collector):
    """rosgraph_msgs/Clock."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._gathered = _Gathered()

    def _layout_of(self, message: Any) -> CdrLayout:
        return layout_for(CLOCK, message)

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        self._gathered.add(order, group.stamps_ns(CLOCK.stamp), received_ns, {})

    def instants_ns(self) -> IntArray:
        """(n, 2) simulated time and when it was received."""
        return np.column_stack(self._gathered.joined()[1:3])


class TextCollector(Collector):
    """std_msgs/String."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr=False)
        self.text = ""

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        self.text = str(group.example.data)
