"""CDR layout of a message type, derived from its definition, for serialising and parsing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache, lru_cache
from typing import Any

from rosbags.interfaces import Nodetype

from slamsim.io.ros.cdr import CdrLayout
from slamsim.io.ros.standard_types import ros2_types

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
