"""Decodes many small messages of one topic at once where their bytes allow it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from slamsim.logs.bag import Bag
from slamsim.logs.cdr import CDR_LITTLE_ENDIAN, CdrLayout
from slamsim.types import FloatArray, IntArray

_BATCH = 4096
_HEADER_AND_STAMP = 12

RowOf = Callable[[Any], tuple[float, ...]]
LayoutOf = Callable[[Any], CdrLayout]


def read_columns(
    bag: Bag, topic: str, layout_of: LayoutOf, row_of: RowOf
) -> tuple[IntArray, FloatArray, Any]:
    """(stamps in ns (n,), rows (n, k), the first message) of a topic whose type has a header.

    row_of takes what is wanted out of a message. layout_of gives, for a message, the bytes of
    all that share its strings, with the same columns in the same order; where messages are such
    (plain ROS 2 serialisation, equal length, equal strings) whole batches are viewed as arrays.
    """
    stamps: list[IntArray] = []
    rows: list[FloatArray] = []
    first: Any = None
    for batch in _batches(bag.raw(topic)):
        example = bag.deserialize(topic, batch[0])
        first = example if first is None else first
        decoded = None
        if bag.source.is_cdr(topic):
            decoded = _viewed(batch, layout_of(example))
        if decoded is None:
            messages = [bag.deserialize(topic, data) for data in batch]
            decoded = (
                np.array([stamp_ns_of(message.header) for message in messages], dtype=np.int64),
                np.array([row_of(message) for message in messages], dtype=np.float64),
            )
        stamps.append(decoded[0])
        rows.append(decoded[1])
    return np.concatenate(stamps), np.concatenate(rows), first


def stamp_ns_of(header: Any) -> int:
    """The stamp of a std_msgs/Header."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _batches(raw: Iterator[bytes]) -> Iterator[list[bytes]]:
    batch: list[bytes] = []
    for data in raw:
        batch.append(bytes(data))
        if len(batch) == _BATCH:
            yield batch
            batch = []
    if batch:
        yield batch


def _viewed(batch: list[bytes], layout: CdrLayout) -> tuple[IntArray, FloatArray] | None:
    empty = layout.rows(0)
    names = [name for name in empty.dtype.names or () if not name.startswith("stamp_")]
    size = empty.dtype.itemsize
    if any(len(data) != size for data in batch):
        return None
    plain = np.frombuffer(b"".join(batch), dtype=np.uint8).reshape(-1, size)
    strings = plain[:, _HEADER_AND_STAMP : layout.strings_end]
    if batch[0][:4] != CDR_LITTLE_ENDIAN or (plain[:, :4] != plain[0, :4]).any():
        return None
    if (strings != strings[0]).any():
        return None
    viewed = plain.view(empty.dtype)[:, 0]
    stamps_ns = viewed["stamp_sec"].astype(np.int64) * 1_000_000_000 + viewed["stamp_nanosec"]
    columns = [viewed[name].reshape(len(batch), -1).astype(np.float64) for name in names]
    return stamps_ns, np.concatenate(columns, axis=1)
