"""Decodes many small messages of one topic at once where their bytes allow it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.logs.bag import Bag
from slamsim.logs.cdr import CDR_LITTLE_ENDIAN, CdrLayout, Rows
from slamsim.types import FloatArray, IntArray

_BATCH = 4096

RowOf = Callable[[Any], tuple[float, ...]]
LayoutOf = Callable[[Any], CdrLayout]
Opened = Callable[[bytes], Any]
"""A message from its bytes; None for one that shall be passed over."""


@dataclass(frozen=True, slots=True, eq=False)
class Alike:
    """Messages of a batch that share one layout.

    places: (k,) where they stand in the batch. example: the first of them. rows: (k,) all of
    them under the names of the layout's columns, None if only the example could be decoded.
    """

    places: IntArray
    example: Any
    rows: Rows | None

    def stamps_ns(self) -> IntArray:
        """(k,) stamps of messages that have a header."""
        if self.rows is None:
            return np.array([stamp_ns_of(self.example.header)], dtype=np.int64)
        return stamps_of(self.rows)

    def numbers(self, row_of: RowOf) -> FloatArray:
        """(k, columns) what row_of takes out of each, in the order of the layout's columns."""
        if self.rows is None:
            return np.array([row_of(self.example)], dtype=np.float64)
        names = [name for name in self.rows.dtype.names or () if not name.startswith("stamp_")]
        columns = [self.rows[name].reshape(self.rows.size, -1) for name in names]
        return np.concatenate([column.astype(np.float64) for column in columns], axis=1)


def alike(batch: list[bytes], opened: Opened, layout_of: LayoutOf, is_cdr: bool) -> Iterator[Alike]:
    """A batch by layouts: messages with the same strings and lengths are viewed as one array.

    layout_of gives the bytes of all messages that share the example's strings and lengths.
    is_cdr: whether the messages are plain ROS 2 serialisations of the type that it describes;
    if not, each is decoded by itself.
    """
    sizes = np.array([len(data) for data in batch])
    for size in np.unique(sizes).tolist():
        places = np.flatnonzero(sizes == size)
        plain = np.frombuffer(b"".join([batch[i] for i in places.tolist()]), dtype=np.uint8)
        plain = plain.reshape(places.size, size)
        while places.size:
            example = opened(batch[int(places[0])])
            group = None
            if example is not None:
                group = _viewed(plain, layout_of(example)) if is_cdr else None
                rows, same = (None, [0]) if group is None else group
                yield Alike(places[same], example, rows)
            rest = np.ones(places.size, dtype=np.bool_)
            rest[[0] if group is None else group[1]] = False
            places, plain = places[rest], plain[rest]


def _viewed(plain: NDArray[np.uint8], layout: CdrLayout) -> tuple[Rows, IntArray] | None:
    """(rows, which ones) of the messages that are shaped as the first, None if it is not so."""
    dtype = layout.rows(0).dtype
    if dtype.itemsize != plain.shape[1] or bytes(plain[0, :4]) != CDR_LITTLE_ENDIAN:
        return None
    shape = layout.shape_bytes()
    same = np.flatnonzero((plain[:, shape] == plain[0, shape]).all(axis=1))
    return plain[same].view(dtype)[:, 0], same


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Messages of one topic. stamps_ns, received_ns: (n,) as written, and when each was received.
    rows: (n, k) what was wanted of each. first: the first message."""

    stamps_ns: IntArray
    received_ns: IntArray
    rows: FloatArray
    first: Any


def read_columns(bag: Bag, topic: str, layout_of: LayoutOf, row_of: RowOf) -> Columns:
    """The messages of a topic whose type has a header, in the order of the recording.

    row_of takes what is wanted out of a message, in the order of the layout's columns. Raises
    InputRefused for a damaged message.
    """
    stamps: list[IntArray] = []
    received: list[IntArray] = []
    rows: list[FloatArray] = []
    first: Any = None
    for received_ns, batch in _batches(bag.received({topic})):
        received.append(received_ns)
        is_cdr = bag.is_cdr(topic)
        groups = list(alike(batch, lambda data: bag.deserialize(topic, data), layout_of, is_cdr))
        order = np.argsort(np.concatenate([group.places for group in groups]))
        stamps.append(np.concatenate([group.stamps_ns() for group in groups])[order])
        rows.append(np.concatenate([group.numbers(row_of) for group in groups])[order])
        if first is None:
            first = min(groups, key=lambda group: int(group.places[0])).example
    return Columns(np.concatenate(stamps), np.concatenate(received), np.concatenate(rows), first)


def stamp_ns_of(header: Any) -> int:
    """The stamp of a std_msgs/Header."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def stamps_of(rows: Rows, name: str = "stamp") -> IntArray:
    """(k,) stamps of viewed messages."""
    seconds = rows[f"{name}_sec"].astype(np.int64)
    return np.asarray(seconds * 1_000_000_000 + rows[f"{name}_nanosec"], dtype=np.int64)


def _batches(
    received: Iterator[tuple[str, int, bytes]],
) -> Iterator[tuple[IntArray, list[bytes]]]:
    """(times of receipt, messages) of some at a time."""
    while some := list(islice(received, _BATCH)):
        times_ns = np.array([received_ns for _, received_ns, _ in some], dtype=np.int64)
        yield times_ns, [bytes(data) for _, _, data in some]
