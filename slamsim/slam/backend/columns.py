"""Frozen dataclasses of numbers and arrays as plain columns, and back: no code in the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

Columns = dict[str, np.ndarray[Any, Any]]
Shape = tuple[int | None, ...]
"""Of one item's array; None for any length."""

_Item = TypeVar("_Item")


def to_columns(items: Sequence[object], kind: Any, prefix: str = "") -> Columns:
    """One column for each field: numbers as they are, arrays one after the other with the length
    of each, nested dataclasses as further columns; a mask tells where an optional one is there."""
    columns: Columns = {}
    for field, (inner, optional) in _kinds(kind).items():
        name, values = prefix + field, [getattr(item, field) for item in items]
        if optional:
            columns[name + "?"] = np.array([value is not None for value in values], dtype=np.bool_)
            values = [value for value in values if value is not None]
        if is_dataclass(inner):
            columns |= to_columns(values, inner, name + ".")
        elif get_origin(inner) is np.ndarray:
            columns[name + "#"] = np.array([len(value) for value in values], dtype=np.int64)
            columns[name] = np.concatenate(values) if values else np.zeros(0)
        else:
            columns[name] = np.array(values, dtype=_dtype(inner))
    return columns


def from_columns(
    columns: Mapping[str, np.ndarray[Any, Any]],
    kind: Callable[..., _Item],
    count: int,
    shapes: Mapping[str, Shape],
    prefix: str = "",
) -> list[_Item]:
    """The items again. shapes: of every array field, by its name.

    Raises ValueError or KeyError for columns that are not whole, of another type or not finite.
    """
    values: dict[str, Sequence[object]] = {}
    for field, (inner, optional) in _kinds(kind).items():
        name, here = prefix + field, count
        if optional:
            mask = _checked(columns[name + "?"], np.dtype(np.bool_), (count,), name)
            here = int(mask.sum())
        found: Sequence[object]
        if is_dataclass(inner):
            nested: Any = inner
            found = from_columns(columns, nested, here, shapes, name + ".")
        elif get_origin(inner) is np.ndarray:
            found = _split(columns, name, here, shapes[field], _dtype_of_array(inner))
        else:
            found = _checked(columns[name], _dtype(inner), (here,), name).tolist()
        if optional:
            present = iter(found)
            found = [next(present) if there else None for there in mask.tolist()]
        values[field] = found
    return [kind(**{name: column[k] for name, column in values.items()}) for k in range(count)]


def _split(
    columns: Mapping[str, np.ndarray[Any, Any]],
    name: str,
    count: int,
    shape: Shape,
    dtype: np.dtype[Any],
) -> list[np.ndarray[Any, Any]]:
    lengths = _checked(columns[name + "#"], np.dtype(np.int64), (count,), name)
    if (lengths < 0).any() or (shape[0] is not None and (lengths != shape[0]).any()):
        raise ValueError(f"{name} has arrays of a wrong length")
    if not count:
        return []
    whole = _checked(columns[name], dtype, (int(lengths.sum()), *shape[1:]), name)
    return np.split(whole, np.cumsum(lengths)[:-1])


def _checked(
    column: np.ndarray[Any, Any], dtype: np.dtype[Any], shape: Shape, name: str
) -> np.ndarray[Any, Any]:
    if column.dtype != dtype or column.shape != shape:
        raise ValueError(f"{name} is {column.dtype} {column.shape}, not {dtype} {shape}")
    if dtype.kind == "f" and not np.isfinite(column).all():
        raise ValueError(f"{name} is not finite")
    return column


def _kinds(kind: Any) -> dict[str, tuple[Any, bool]]:
    """The type of each field, and whether it may be None."""
    hints = get_type_hints(kind)
    kinds = {}
    for field in fields(kind):
        hint, optional = hints[field.name], False
        if NoneType in get_args(hint):
            hint, optional = next(a for a in get_args(hint) if a is not NoneType), True
        kinds[field.name] = (hint, optional)
    return kinds


def _dtype(kind: type) -> np.dtype[Any]:
    return np.dtype({int: np.int64, float: np.float64, bool: np.bool_}.get(kind, "U16"))


def _dtype_of_array(hint: object) -> np.dtype[Any]:
    kind: type = get_args(get_args(hint)[1])[0]
    return np.dtype(kind)
