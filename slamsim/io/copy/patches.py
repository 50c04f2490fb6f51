"""Fields that an edited row sets in its decoded message, by the schema of its kind.

A row is compared with the one that was read, bit by bit; only what differs is set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import BoolArray, IntArray
from slamsim.io.copy.images import ImagesPart
from slamsim.io.ros.columns import at_place
from slamsim.recording.frames import frame_name
from slamsim.recording.schemas import Field

Patch = Callable[[Any, int], None]
"""Sets what differs in row i in its message, or in its transform of a message."""
Patches = list[tuple[BoolArray, Patch]]
"""(where, how): (k,) rows of a pair, and what is set there."""

_BLOCK = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """An edited part beside one that was read from the same messages.

    rows: (k,) of the edited one; read_rows: (k,) the ones they were read as.
    """

    edited: Any
    read: Any
    rows: IntArray
    read_rows: IntArray

    def everywhere(self) -> BoolArray:
        """(k,) of all rows."""
        return np.ones(self.rows.size, dtype=np.bool_)

    def unequal(self, mine: Any, theirs: Any) -> BoolArray:
        """(k,) where what the edited part has for each message differs in any bit."""
        if mine is theirs and np.array_equal(self.rows, self.read_rows):
            return np.zeros(self.rows.size, dtype=np.bool_)
        if isinstance(mine, np.ndarray) and isinstance(theirs, np.ndarray):
            if mine.shape[1:] != theirs.shape[1:]:
                return self.everywhere()
            blocks = [  # for ranges may be on the disk, and larger than the memory
                _bits_differ(
                    mine[self.rows[start : start + _BLOCK]],
                    theirs[self.read_rows[start : start + _BLOCK]],
                )
                for start in range(0, self.rows.size, _BLOCK)
            ]
            return np.concatenate(blocks)
        pairs = zip(self.rows.tolist(), self.read_rows.tolist(), strict=True)
        return np.array([not _same_bits(mine[i], theirs[j]) for i, j in pairs], dtype=np.bool_)

    def renamed(self, name: str) -> Callable[[str], str] | None:
        """From the frame that a message names to another; None where none is renamed, and none
        loses its slash."""
        before, after = _names(self.read, name), _names(self.edited, name)
        slashes = getattr(self.read, "slashed", ()) != getattr(self.edited, "slashed", ())
        if not after or (before == after and not slashes):
            return None
        known = dict(zip(before, after, strict=True)) if len(before) == len(after) else {}
        return lambda frame: known.get(frame_name(frame), after[0])


def _names(part: Any, name: str) -> tuple[str, ...]:
    """The frames of a stream, or the one of an edge."""
    found = getattr(part, name)
    return (found,) if isinstance(found, str) else found


def patches_of(pair: Pair) -> Patches:
    """(where, how) for everything that a message of this kind says."""
    schema, stamps_ns = pair.edited.schema, pair.edited.stamps_ns

    def set_stamp(message: Any, row: int) -> None:
        stamp = at_place(message, schema.stamp)
        stamp.sec, stamp.nanosec = divmod(int(stamps_ns[row]), 1_000_000_000)

    found: Patches = [(pair.unequal(stamps_ns, pair.read.stamps_ns), set_stamp)]
    for name, place in schema.frames:
        found += _frame_patch(pair, name, place)
    for field in schema.fields:
        found += _field_patch(pair, field)
    if isinstance(pair.edited, ImagesPart) and pair.edited.camera.changes:
        found.append((pair.everywhere(), pair.edited.repaint))
    return found


def _frame_patch(pair: Pair, name: str, place: str) -> Patches:
    renamed = pair.renamed(name)
    if renamed is None:
        return []

    def rename(message: Any, _: int) -> None:
        _set(message, place, renamed(at_place(message, place)))

    return [(pair.everywhere(), rename)]


def _field_patch(pair: Pair, field: Field) -> Patches:
    before, after = pair.read.values(field), pair.edited.values(field)
    if before is None and (after is None or not field.covariance):
        return []
    if before is None or after is None:
        return [(pair.everywhere(), _setter(pair, field, after))]
    if field.is_constant:
        return [(pair.everywhere(), _setter(pair, field, after))] if after != before else []
    return [(pair.unequal(after, before), _setter(pair, field, after))]


def _setter(pair: Pair, field: Field, values: Any) -> Patch:
    """Writes a field of a row where its messages have it; values: None to take it away."""
    of_parts = pair.edited.schema.parts

    def set_field(message: Any, row: int) -> None:
        if field.covariance:
            _say_whether(message, field.covariance, values is not None)
        if values is None:
            if field.is_list:
                _set(message, field.paths[0], np.zeros(0, dtype=field.dtype))
            return
        value = values if field.is_constant else values[row]
        if of_parts:
            _set_parts(message, field, getattr(pair.edited, of_parts), value)
        else:
            _set_numbers(message, field, value)

    return set_field


def _say_whether(message: Any, place: str, is_there: bool) -> None:
    """A first covariance of -1 says that there is no orientation (sensor_msgs/Imu)."""
    covariance = np.array(at_place(message, place))
    if not is_there:
        covariance[0] = -1.0
    elif covariance[0] == -1.0:
        covariance[0] = 0.0
    _set(message, place, covariance)


def _set_numbers(message: Any, field: Field, value: Any) -> None:
    """Of a row: a list, the members of a vector, or one number for each place."""
    if field.is_list:
        _set(message, field.paths[0], np.ascontiguousarray(value, dtype=field.dtype))
    elif field.axes:
        for axis, number in zip(field.axes, value.tolist(), strict=True):
            _set(message, f"{field.paths[0]}.{axis}", number)
    else:
        for place, number in zip(field.paths, np.atleast_1d(value).tolist(), strict=True):
            with np.errstate(over="ignore"):
                _set(message, place, float(np.float32(number)) if field.is_single else number)


def _set_parts(message: Any, field: Field, names: Sequence[str], value: Any) -> None:
    """The numbers of the parts that this message names, if it gives any."""
    place = field.paths[0]
    if len(at_place(message, place)) == len(message.name):
        mine = [value[names.index(name)] for name in message.name]
        _set(message, place, np.array(mine, dtype=np.float64))


def _set(message: Any, place: str, value: Any) -> None:
    parent, _, name = place.rpartition(".")
    setattr(at_place(message, parent) if parent else message, name, value)


def _bits_differ(one: NDArray[Any], other: NDArray[Any]) -> BoolArray:
    """(n,) where rows differ in any bit, so that -0 is not 0 and nan is nan."""
    one, other = (np.ascontiguousarray(each) for each in (one, other))
    if one.dtype != other.dtype:
        return np.asarray((one != other).reshape(len(one), -1).any(axis=1))
    bits = np.dtype(f"u{one.dtype.itemsize}")
    unequal = one.view(bits) != other.view(bits)
    return np.asarray(unequal.reshape(len(one), -1).any(axis=1))


def _same_bits(one: Any, other: Any) -> bool:
    return len(one) == len(other) and np.asarray(one).tobytes() == np.asarray(other).tobytes()
