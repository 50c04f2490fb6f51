"""Schemas against the messages of rosbags: every place, whatever else a message says."""

from __future__ import annotations

import dataclasses
from typing import Any

import foreign_bags
import numpy as np
import pytest

from slamsim.io.ros.columns import Alike, alike, layout_for
from slamsim.io.ros.layouts import columns_of, message_layout, shape_of
from slamsim.io.ros.message_types import ros2_types
from slamsim.recording import KINDS, RawStream, RawTwists, ScanLayout, TransformEdge
from slamsim.recording.schemas import LASER_LAYOUT, TRANSFORM, TRANSFORMS, Schema

STORE = ros2_types()
STREAMS: tuple[type[RawStream], ...] = (*KINDS, RawTwists)
SCHEMAS = [kind.schema for kind in STREAMS]


def bytes_of(message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def viewed(message: Any, data: bytes, layout: Any) -> Alike:
    """The message as its bytes have it at the places of the layout."""
    (group,) = alike([data], lambda _: message, lambda _: layout, is_cdr=True)
    assert group.rows is not None, "the layout does not fit the bytes"
    return group


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.type_name)
@pytest.mark.parametrize("seed", range(12))
def test_bytes_hold_at_each_place_what_the_message_does(schema: Schema, seed: int) -> None:
    """Strings of any length, lists of any length and numbers of any value around them."""
    message = foreign_bags.Author(STORE, seed).any(schema.type_name)

    group = viewed(message, bytes_of(message), layout_for(schema, message))

    by_object = Alike(group.places, message, None)
    assert group.stamps_ns(schema.stamp) == by_object.stamps_ns(schema.stamp)
    for field in schema.fields:
        np.testing.assert_array_equal(group.values(field), by_object.values(field), field.name)
        if field.covariance:
            assert group.have(field) == by_object.have(field)


@pytest.mark.parametrize("edges", range(4))
def test_bytes_of_transforms_hold_each_of_them(edges: int) -> None:
    author = foreign_bags.Author(STORE, edges)
    message = author.any(TRANSFORMS)
    message.transforms = [author.any(TRANSFORM.type_name) for _ in range(edges)]
    places = [f"transforms.{number}." for number in range(edges)]
    columns = frozenset[str]().union(*(columns_of(TRANSFORM.paths, at) for at in places))
    layout = message_layout(TRANSFORMS, columns, shape_of(TRANSFORMS, message))

    group = viewed(message, bytes_of(message), layout)

    by_object = Alike(group.places, message, None)
    for at in places:
        stamp = f"{at}{TRANSFORM.stamp}"
        assert group.stamps_ns(stamp) == by_object.stamps_ns(stamp)
        for field in TRANSFORM.fields:
            np.testing.assert_array_equal(group.values(field, at), by_object.values(field, at))


@pytest.mark.parametrize("kind", [*STREAMS, TransformEdge])
def test_streams_have_the_fields_of_their_schemas(kind: Any) -> None:
    known = {field.name for field in dataclasses.fields(kind)}
    declared = {field.name for field in LASER_LAYOUT}

    assert {field.name for field in kind.schema.fields} - declared <= known
    assert {name for name, _ in kind.schema.frames} <= known
    if kind.schema.parts:
        assert kind.schema.parts in known


def test_a_scan_layout_is_what_a_scan_declares() -> None:
    assert [f.name for f in dataclasses.fields(ScanLayout)] == [f.name for f in LASER_LAYOUT]


def test_columns_of_a_table_have_names_of_their_own() -> None:
    for schema in (*SCHEMAS, TRANSFORM):
        names = [
            field.column.format(part)
            for field in schema.fields
            if field.column
            for part in field.parts or ("",)
        ]
        assert len(set(names)) == len(names), schema.type_name
