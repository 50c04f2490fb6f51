"""Decodes many messages of one topic at once where their layout is fixed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import IntArray
from slamsim.io.ros.layouts import (
    CDR_LITTLE_ENDIAN,
    CdrLayout,
    Rows,
    columns_of,
    message_layout,
    shape_of,
)
from slamsim.recording.schemas import Field, Schema

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

    def stamps_ns(self, place: str = "header.stamp") -> IntArray:
        """(k,) stamps at a place of the messages."""
        if self.rows is None:
            stamp = at_place(self.example, place)
            return np.array([_instant_ns(int(stamp.sec), int(stamp.nanosec))], dtype=np.int64)
        return np.asarray(
            _instant_ns(self.rows[f"{place}_sec"].astype(np.int64), self.rows[f"{place}_nanosec"]),
            dtype=np.int64,
        )

    def values(self, field: Field, at: str = "") -> NDArray[Any]:
        """(k,) or (k, columns) of a field. at: the place of a part, ended by a dot."""
        if self.rows is None:
            return np.array([_value(self.example, field, at)], dtype=field.dtype)
        names = self.rows.dtype.names or ()
        paths = [f"{at}{path}" for path in field.paths]
        if paths[0] not in names:  # an empty list
            return np.zeros((self.rows.size, 0), dtype=field.dtype)
        with np.errstate(invalid="ignore"):  # of a signalling NaN, which becomes a quiet one
            if len(paths) == 1:
                return np.ascontiguousarray(self.rows[paths[0]], dtype=field.dtype)
            return np.stack([self.rows[path].astype(field.dtype) for path in paths], axis=1)

    def have(self, field: Field) -> bool:
        """Whether any of the messages says that it has the field, by its covariance."""
        if self.rows is None:
            first = np.array([at_place(self.example, field.covariance)[0]])
        else:
            first = self.rows[field.covariance][:, 0]
        return bool((first != -1.0).any())


def at_place(message: Any, place: str) -> Any:
    """What stands at a place of a message object."""
    for name in place.split("."):
        message = message[int(name)] if name.isdigit() else getattr(message, name)
    return message


def _value(message: Any, field: Field, at: str) -> Any:
    parts = [at_place(message, f"{at}{path}") for path in field.paths]
    if field.axes:
        return [getattr(parts[0], axis) for axis in field.axes]
    return parts[0] if len(parts) == 1 else parts


def layout_for(schema: Schema, message: Any) -> CdrLayout:
    """The layout of all messages of a kind that share a message's strings and lengths."""
    shape = shape_of(schema.type_name, message)
    return message_layout(schema.type_name, columns_of(schema.paths), shape)


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


def _instant_ns(seconds: Any, nanoseconds: Any) -> Any:
    return seconds * 1_000_000_000 + nanoseconds
