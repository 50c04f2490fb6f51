"""CDR layout of a message type, derived from its definition, for serialising and parsing many
messages of one shape at once: a template row and columns.

``rosbags`` serialises one message at a time in Python; the log has some 700 per simulated second.
Where all strings and sequences of a topic keep their lengths, every message has the same bytes but
for some numbers at fixed places. Such a topic is a NumPy record array: one row per message, the
constant bytes repeated, the varying fields filled column by column. Tests hold the result byte for
byte against rosbags' ``serialize_cdr``.

CDR (OMG DDS-XTypes 1.3, section 7.4, plain little-endian): a 4-byte header, then every primitive
aligned to its own size, counted from behind the header; strings and sequences begin with their
length in 4 bytes, a string's includes its final NUL.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache, lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from slamsim.core.types import IntArray
from slamsim.io.ros.message_types import ros2_types

Shape = tuple[tuple[str, str | int], ...]
"""(place, text or number of elements) of all strings and sequences of a message that are not
empty. Messages of one type and shape have the same bytes but for their numbers."""

Constants = tuple[tuple[str, tuple[float, ...]], ...]
"""(place, numbers) that all messages say alike."""

_TIME = "builtin_interfaces/msg/Time"


@lru_cache(maxsize=512)
def message_layout(
    type_name: str, columns: frozenset[str], shape: Shape = (), constants: Constants = ()
) -> CdrLayout:
    """Of messages of a type that comes with ROS, or is our own, and of one shape.

    columns: places of the numbers that vary, each a column of that name: a number, a list or array
    of them, or a part whose members are all of one kind. Times are filled by ``set_stamps``.
    Numbers that are neither columns nor constants are zero.
    """
    layout = CdrLayout()
    made = _Layout(layout, columns, dict(shape), dict(constants))
    made.add_members(type_name, "")
    return layout


def shape_of(type_name: str, message: Any) -> Shape:
    """The shape of a message object. Raises AttributeError for one of another definition."""
    return tuple(_shape(type_name, message, ""))


def _shape(type_name: str, message: Any, at: str) -> Iterator[tuple[str, str | int]]:
    for name, (kind, of) in _members(type_name):
        place, value = f"{at}{name}", getattr(message, name)
        if kind == Nodetype.NAME:
            yield from _shape(of, value, f"{place}.")
        elif kind == Nodetype.BASE and of[0] == "string":
            yield place, value
        elif kind == Nodetype.SEQUENCE:
            yield place, len(value)
            inner, of_inner = of[0]
            for number, each in enumerate(value) if inner != Nodetype.BASE else ():
                yield from _shape(of_inner, each, f"{place}.{number}.")
            if inner == Nodetype.BASE and of_inner[0] == "string":
                yield from ((f"{place}.{number}", each) for number, each in enumerate(value))


class _Layout:
    """A layout being made, member by member."""

    def __init__(
        self,
        layout: CdrLayout,
        columns: frozenset[str],
        shape: dict[str, str | int],
        constants: dict[str, tuple[float, ...]],
    ) -> None:
        self._layout, self._columns = layout, columns
        self._shape, self._constants = shape, constants

    def add_members(self, type_name: str, at: str) -> None:
        for name, (kind, of) in _members(type_name):
            self._add(kind, of, f"{at}{name}")

    def _add(self, kind: Nodetype, of: Any, place: str) -> None:
        if kind == Nodetype.SEQUENCE:
            self._add_sequence(of[0], place)
        elif kind == Nodetype.BASE and of[0] == "string":
            self._layout.string(str(self._shape.get(place, "")))
        elif kind == Nodetype.NAME and of == _TIME:
            self._layout.stamp(place)
        elif kind == Nodetype.NAME and place not in self._columns and place not in self._constants:
            self.add_members(of, f"{place}.")
        else:
            dtype, count = _alike(kind, of)
            self._add_numbers(place, dtype, count)

    def _add_sequence(self, inner: tuple[Nodetype, Any], place: str) -> None:
        count, (kind, of) = int(self._shape.get(place, 0)), inner
        self._layout.length(count)
        if kind == Nodetype.BASE and of[0] != "string":
            if count:
                self._add_numbers(place, of[0], count)
            return
        for number in range(count):
            if kind == Nodetype.NAME:
                self.add_members(of, f"{place}.{number}.")
            else:
                self._add(kind, of, f"{place}.{number}")

    def _add_numbers(self, place: str, dtype: str, count: int | None) -> None:
        if place in self._columns:
            self._layout.column(place, dtype, count)
        else:
            self._layout.constant(dtype, *self._constants.get(place, (0.0,) * (count or 1)))


@cache
def _members(type_name: str) -> tuple[tuple[str, tuple[Nodetype, Any]], ...]:
    return tuple(ros2_types().fielddefs[type_name][1])


def _alike(kind: Nodetype, of: Any) -> tuple[str, int | None]:
    """(kind of number, how many or None for a plain one) of a number, an array or a part."""
    if kind == Nodetype.BASE:
        return of[0], None
    if kind == Nodetype.ARRAY:
        return of[0][1][0], int(of[1])
    kinds = {_alike(*member)[0] for _, member in _members(of)}
    if len(kinds) != 1:
        raise ValueError(f"the members of {of} are not of one kind")
    return kinds.pop(), sum(_alike(*member)[1] or 1 for _, member in _members(of))


def columns_of(paths: Iterable[str], at: str = "") -> frozenset[str]:
    """The places of fields in a message, which itself is at a place in another one."""
    return frozenset(f"{at}{path}" for path in paths)


Rows = NDArray[np.void]

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class CdrLayout:
    """Declares a message field by field in the order of its definition; methods chain."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._formats: list[Any] = []
        self._offsets: list[int] = []
        self._constant = bytearray(CDR_LITTLE_ENDIAN)
        self._shape = [(0, len(CDR_LITTLE_ENDIAN))]

    def _align(self, size: int) -> None:
        behind_header = len(self._constant) - len(CDR_LITTLE_ENDIAN)
        self._constant.extend(bytes(-behind_header % size))

    def column(self, name: str, dtype: str, count: int | None = None) -> Self:
        """A field that varies: one number, or a fixed number of them without a length."""
        item = np.dtype(dtype).newbyteorder("<")
        self._align(item.itemsize)
        self._names.append(name)
        self._formats.append(item if count is None else (item, (count,)))
        self._offsets.append(len(self._constant))
        self._constant.extend(bytes(item.itemsize * (1 if count is None else count)))
        return self

    def constant(self, dtype: str, *values: float) -> Self:
        """Numbers that are the same in all messages."""
        item = np.dtype(dtype).newbyteorder("<")
        self._align(item.itemsize)
        self._constant.extend(np.array(values, dtype=item).tobytes())
        return self

    def length(self, count: int) -> Self:
        """The length that precedes a sequence."""
        self.constant("u4", count)
        self._shape.append((len(self._constant) - 4, len(self._constant)))
        return self

    def string(self, text: str) -> Self:
        """A string that is the same in all messages."""
        data = text.encode() + b"\0"
        self.length(len(data))
        self._shape.append((len(self._constant), len(self._constant) + len(data)))
        self._constant.extend(data)
        return self

    def stamp(self, name: str = "stamp") -> Self:
        """builtin_interfaces/Time: filled by ``set_stamps``."""
        return self.column(f"{name}_sec", "i4").column(f"{name}_nanosec", "u4")

    def header(self, frame_id: str) -> Self:
        """std_msgs/Header."""
        return self.stamp().string(frame_id)

    def shape_bytes(self) -> IntArray:
        """The places of the bytes that are equal if and only if two messages have one layout: the
        encoding, all strings and the lengths of all sequences.

        (k,) of them.
        """
        return np.concatenate([np.arange(start, end) for start, end in self._shape])

    def rows(self, count: int) -> Rows:
        """(count,) messages, constants set and columns zero."""
        dtype = np.dtype(
            {
                "names": self._names,
                "formats": self._formats,
                "offsets": self._offsets,
                "itemsize": len(self._constant),
            }
        )
        one = np.frombuffer(bytes(self._constant), dtype=np.uint8)
        return np.tile(one, count).view(dtype)


def set_stamps(rows: Rows, stamps_ns: IntArray, name: str = "stamp") -> None:
    """Seconds are rounded down, so that nanoseconds are never negative. stamps_ns: (n,)."""
    rows[f"{name}_sec"] = stamps_ns // 1_000_000_000
    rows[f"{name}_nanosec"] = stamps_ns % 1_000_000_000
