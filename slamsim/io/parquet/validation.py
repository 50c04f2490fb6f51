"""Validates Parquet tables of ``ParquetLog``: types, values, bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Epoch
from slamsim.guard.numbers import MOST_NS
from slamsim.recording import ScanLayout
from slamsim.recording.schemas import IMU, ODOMETRY, SCANS, TICKS, TRANSFORM

_TYPES: dict[str, str] = {
    **dict.fromkeys(("stamp_ns", "received_ns", "sample", "sequence"), "int64"),
    **dict.fromkeys(("topic", "parent", "child"), "object"),
    "layout": "uint8",
    "is_static": "bool",
    **{
        field.column.format(part): field.dtype
        for schema in (SCANS, IMU, ODOMETRY, TICKS, TRANSFORM)
        for field in schema.fields
        if field.column
        for part in field.parts or ("",)
    },
}
_LISTS = tuple(field.column for field in SCANS.fields if field.is_list)
_NUMBER = "float64"
"""Of all other columns, whose names depend on those of joints."""


def require_sound(facts: Mapping[str, Any], cells: Mapping[str, NDArray[Any]]) -> None:
    """Raises ValueError saying what is wrong, KeyError for a fact that is missing."""
    for name, column in cells.items():
        dtype = _TYPES.get(name, _NUMBER)
        if column.dtype != dtype or column.ndim != 1 + (name in _LISTS):
            raise ValueError(f"the column {name!r} holds {column.dtype}, not {dtype}")
        if dtype == "object" and not all(_is_name(text) for text in column):
            raise ValueError(f"the column {name!r} holds an invalid name")
    for name in ("stamp_ns", "received_ns"):
        if (np.abs(cells[name]) > MOST_NS).any() or (cells[name] == np.iinfo("i8").min).any():
            raise ValueError(f"the column {name!r} holds an invalid time")
    if not _is_name(facts["recording"]) or facts["epoch"] not in get_args(Epoch):
        raise ValueError("its name or its epoch is none")
    if "topic" in facts:
        _require_stream(facts, cells)
    elif not isinstance(facts["robot_description"], str | None):
        raise ValueError("its robot description is not text")


def _require_stream(facts: Mapping[str, Any], cells: Mapping[str, NDArray[Any]]) -> None:
    for names in ([facts["topic"]], facts["frame_ids"], facts.get("child_frame_ids", ["base"])):
        if not names or not all(map(_is_name, names)):
            raise ValueError("its topic or frame name is invalid")
    if not facts["topic"].strip():
        raise ValueError("its topic has no name")
    if not len(cells["stamp_ns"]):
        raise ValueError("there is no row in it")
    if "layouts" in facts:
        _require_layouts(facts["layouts"], cells["layout"])
    for name in ("ticks_per_revolution", "wheel_radius_m", "track_m"):
        if not isinstance(facts.get(name, 1), int | float):
            raise ValueError(f"{name!r} is no number")


def _require_layouts(layouts: Any, used: NDArray[Any]) -> None:
    expected = {field.name for field in fields(ScanLayout)}
    for layout in layouts:
        if layout.keys() != expected or not all(type(v) is float for v in layout.values()):
            raise ValueError("a layout of the beams is not one of numbers")
    if used.max() >= len(layouts):
        raise ValueError(f"a scan is of layout {used.max()}, there are {len(layouts)}")


def _is_name(text: object) -> bool:
    return isinstance(text, str) and text.isprintable()
