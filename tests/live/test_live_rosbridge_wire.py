"""Messages as plain values, JSON, PNG and CBOR, against Python's own encoders."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from slamsim.io.ros.message_types import ros2_types
from slamsim.io.ros.values import WrongMessage, cdr_of, plain_values
from slamsim.live.rosbridge import (
    Fragments,
    cbor_bytes,
    json_text,
    parsed,
    png_content,
    png_text,
    split,
)

TYPES = sorted(ros2_types().fielddefs)


def plain_json(value: Any) -> Any:
    """What JSON holds of a message, value by value."""
    if isinstance(value, dict):
        return {name: plain_json(one) for name, one in value.items()}
    if isinstance(value, list):
        return [plain_json(one) for one in value]
    if isinstance(value, np.ndarray):
        if value.dtype == np.uint8:
            return base64.b64encode(bytes(value)).decode()
        return [plain_json(one) for one in value.tolist()]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def values_of(type_name: str, draw: Any) -> dict[str, Any]:
    """Random values of a message type, all fields given."""
    return {name: drawn(node, draw) for name, node in ros2_types().fielddefs[type_name][1]}


RANGES = {
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{"byte": (-128, 127), "char": (0, 255)},
}


def drawn(node: Any, draw: Any) -> Any:
    kind, spec = node
    if kind == Nodetype.NAME:
        return values_of(spec, draw)
    if kind != Nodetype.BASE:
        count = spec[1] if kind == Nodetype.ARRAY else draw(st.integers(0, spec[1] or 3))
        return [drawn(spec[0], draw) for _ in range(count)]
    name = spec[0]
    if name == "bool":
        return draw(st.booleans())
    if name.startswith("float"):
        return draw(st.floats(width=32, allow_nan=False) | st.integers(-5, 5) | st.just(math.nan))
    if name in RANGES:
        return draw(st.integers(*RANGES[name]))
    return draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=5))


@settings(max_examples=100, deadline=None)
@given(st.data(), st.sampled_from(TYPES))
def test_values_survive_cdr_json_and_cbor(data: st.DataObject, type_name: str) -> None:
    given_values = values_of(type_name, data.draw)
    cdr = cdr_of(type_name, given_values, 0)
    values = plain_values(type_name, cdr, ros1=False)
    text = json_text(values)
    assert json.loads(text) == plain_json(values)
    assert cdr_of(type_name, parsed(cbor_bytes({"msg": values}))["msg"], 0) == cdr
    finite = cdr_of(type_name, json.loads(text), 0)  # what is infinite comes back as NaN
    assert json_text(plain_values(type_name, finite, ros1=False)) == text


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u4", "i8", "f4", "f8", "?"])
@pytest.mark.parametrize("count", [0, 1, 4096, 4097, 300_001])
def test_long_arrays_are_whole(dtype: str, count: int) -> None:
    numbers = np.random.default_rng(count).integers(0, 2**62, count).astype(np.int64)
    array = numbers.view(np.uint8)[: count * np.dtype(dtype).itemsize].view(dtype)[:count]
    if dtype == "?":
        array = numbers % 2 == 0
    assert json.loads(json_text({"data": array})) == plain_json({"data": array})


def test_what_json_cannot_hold_is_refused() -> None:
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    for value in (deep, b"bytes", 10**5000, {1, 2}):
        with pytest.raises(WrongMessage, match=r"nested too deeply|JSON cannot hold"):
            json_text({"value": value})


@given(st.binary(min_size=1, max_size=300))
def test_a_png_holds_any_text(text: bytes) -> None:
    text = text.hex().encode()
    assert png_content(png_text(text).decode()).rstrip("\n").encode() == text


@given(st.binary(max_size=300), st.integers(1, 50), st.randoms())
def test_fragments_join_in_any_order(text: bytes, size: int, random: Any) -> None:
    text = json.dumps(text.decode("latin-1")).encode()
    parts = list(split(text, size, "some"))
    if len(text) <= size:
        assert parts == [text]
        return
    joined = Fragments()
    random.shuffle(parts)
    wholes = [joined.add(json.loads(part), 0.0) for part in parts]
    assert wholes[-1] == text.decode() and not any(wholes[:-1])


@pytest.mark.parametrize(
    ("type_name", "values", "reason"),
    [
        ("std_msgs/msg/UInt8", {"data": 256}, "cannot be made"),
        ("std_msgs/msg/UInt8", {"data": -1}, "cannot be made"),
        ("std_msgs/msg/UInt8", {"data": True}, "data: uint8 is needed, not True"),
        ("std_msgs/msg/Float32", {"data": 1e300}, "cannot be made"),
        ("std_msgs/msg/Float64", {"data": 10**400}, "cannot be made"),
        ("std_msgs/msg/Bool", {"data": 1}, "bool is needed"),
        ("std_msgs/msg/String", {"data": "\ud800"}, "cannot be made"),
        ("std_msgs/msg/String", ["x"], "std_msgs/msg/String is needed"),
        ("std_msgs/msg/Header", {"frame": ""}, "only frame_id, stamp"),
        ("nav_msgs/msg/OccupancyGrid", {"data": [128]}, "cannot be made"),
        ("nav_msgs/msg/OccupancyGrid", {"data": [0.5]}, "a list of int8"),
        ("nav_msgs/msg/OccupancyGrid", {"data": [[1]]}, "a list of int8"),
        ("nav_msgs/msg/OccupancyGrid", {"data": np.zeros(3, np.float32)}, "a list of int8"),
        ("sensor_msgs/msg/PointCloud2", {"data": "?"}, "not base64"),
        ("geometry_msgs/msg/PoseWithCovariance", {"covariance": [0.0] * 35}, "36 values"),
        ("tf2_msgs/msg/TFMessage", {"transforms": {}}, "a list is needed"),
        ("tf2_msgs/msg/TFMessage", {"transforms": [{"header": 1}]}, r"transforms\[0\].header"),
    ],
)
def test_values_of_another_type_are_refused(type_name: str, values: Any, reason: str) -> None:
    with pytest.raises(WrongMessage, match=reason):
        cdr_of(type_name, values, 0)


def test_a_header_without_a_stamp_is_of_now() -> None:
    values = plain_values(
        "std_msgs/msg/Header", cdr_of("std_msgs/msg/Header", {"seq": 3}, 5_000_000_007), ros1=True
    )
    assert values["stamp"] == {"sec": 5, "nanosec": 7, "secs": 5, "nsecs": 7}
    assert values["seq"] == 0


@pytest.mark.parametrize(
    "data", ["", "?", "aGVsbG8=", None, png_text(b"{}")[:40].decode(), "iVBORw0KGgo=" * 9]
)
def test_what_is_no_png_is_refused(data: Any) -> None:
    with pytest.raises(WrongMessage, match="PNG"):
        png_content(data)
