"""Serialises many CDR messages of one shape at once: a template row and columns.

``rosbags`` serialises one message at a time in Python; the log has some 700 per simulated second.
Where all strings and sequences of a topic keep their lengths, every message has the same bytes
but for some numbers at fixed places. Such a topic is a NumPy record array: one row per message,
the constant bytes repeated, the varying fields filled column by column. Tests hold the result
byte for byte against rosbags' ``serialize_cdr``.

CDR (OMG DDS-XTypes 1.3, section 7.4, plain little-endian): a 4-byte header, then every primitive
aligned to its own size, counted from behind the header; strings and sequences begin with their
length in 4 bytes, a string's includes its final NUL.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import IntArray

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
        """The places of the bytes that are equal if and only if two messages have one layout:
        the encoding, all strings and the lengths of all sequences."""
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
    """Seconds are rounded down, so that nanoseconds are never negative."""
    rows[f"{name}_sec"] = stamps_ns // 1_000_000_000
    rows[f"{name}_nanosec"] = stamps_ns % 1_000_000_000
