"""Codecs: what goes in comes out bit for bit, by independent decoders too, and damage is told.

Sizes and times on two frames of 640 x 480 (livingroom of Open3D, made noisy as a D435 is; ms of one
thread to encode and decode): clean PNG 55 kB, 4.9 and 2.2; zstd 50 kB, 1.2 and 2.1; RVL 170 kB,
1.3 and 0.9. Noisy PNG 346 kB, 12.9 and 4.0 (level 6: 334 kB, 60); zstd 310 kB, 1.6 and 2.4; RVL
302 kB, 2.7 and 2.1.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal, get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from lowered_limits import lowered

from slamsim.cameras.codecs.depth import (
    DepthCodec,
    DepthImage,
    decode_compressed_depth,
    decode_depth,
    encode_compressed_depth,
    encode_depth,
)
from slamsim.cameras.codecs.pictures import decode_picture, encode_jpeg, encode_png
from slamsim.cameras.codecs.raw import ENCODINGS, RawImage, decode_raw
from slamsim.cameras.codecs.rvl import decode_rvl, encode_rvl
from slamsim.guard.errors import Excessive
from slamsim.guard.numbers import BadNumbers

RANDOM = np.random.default_rng(7)


def depths() -> st.SearchStrategy[DepthImage]:
    """Images with runs of zeros, smooth parts and any jump."""
    values = st.one_of(st.just(0), st.integers(900, 1100), st.integers(0, 65535))
    shapes = st.tuples(st.integers(1, 9), st.integers(1, 23))
    return arrays.arrays(np.uint16, shapes, elements=values)


@pytest.mark.parametrize("codec", get_args(DepthCodec))
@settings(max_examples=60)
@given(image=depths())
def test_depth_comes_back_bit_for_bit(codec: DepthCodec, image: DepthImage) -> None:
    np.testing.assert_array_equal(decode_depth(encode_depth(image, codec), codec), image)


@settings(max_examples=60)
@given(image=depths())
def test_rvl_is_the_stream_of_the_paper(image: DepthImage) -> None:
    assert encode_rvl(image) == b"".join(_words(list(_nibbles(image.ravel().tolist()))))


def _nibbles(values: list[int]) -> Iterator[int]:
    """Wilson's algorithm, written down in plain Python from the paper."""

    def number(value: int) -> Iterator[int]:
        while value >= 8:
            yield value % 8 + 8
            value //= 8
        yield value

    previous = 0
    while values:
        zeros = next((k for k, v in enumerate(values) if v), len(values))
        values = values[zeros:]
        run = next((k for k, v in enumerate(values) if not v), len(values))
        yield from number(zeros)
        yield from number(run)
        for value in values[:run]:
            change, previous = value - previous, value
            yield from number(2 * change if change >= 0 else -2 * change - 1)
        values = values[run:]


def _words(nibbles: list[int]) -> Iterator[bytes]:
    for begin in range(0, len(nibbles), 8):
        eight = [*nibbles[begin : begin + 8], *[0] * 8][:8]
        yield struct.pack("<I", int("".join(f"{n:x}" for n in eight), 16))


@pytest.mark.parametrize("codec", get_args(DepthCodec))
def test_what_is_cut_off_is_told(codec: DepthCodec) -> None:
    image = RANDOM.integers(500, 5000, (12, 16), dtype=np.uint16)
    data = encode_depth(image, codec)
    for kept in (0, 3, 9, len(data) // 2, len(data) - 5):
        with pytest.raises(ValueError, match=r"cut|empty|damaged|neither|begin"):
            decode_depth(data[:kept], codec)


@settings(max_examples=200)
@given(data=st.binary(max_size=200), codec=st.sampled_from(get_args(DepthCodec)))
def test_any_bytes_give_an_image_or_a_reason(data: bytes, codec: DepthCodec) -> None:
    try:
        with lowered(image_pixels=100):
            decode_depth(data, codec)
    except ValueError as error:
        assert str(error)


@settings(max_examples=200)
@given(data=st.binary(max_size=120), count=st.integers(0, 300))
def test_any_bytes_are_read_as_rvl_or_refused(data: bytes, count: int) -> None:
    try:
        assert decode_rvl(data, count).shape == (count,)
    except ValueError as error:
        assert "RVL" in str(error)


def test_a_size_is_looked_at_before_anything_is_made() -> None:
    for codec in ("rvl", "zstd"):
        head = struct.pack("<II", 1 << 31, 1 << 31)
        with pytest.raises(Excessive, match="pixels, at most"):
            decode_depth(head + bytes(8), codec)
    with pytest.raises(ValueError, match="empty"):
        decode_depth(struct.pack("<II", 0, 4) + bytes(8), "rvl")
    bomb = encode_png(np.zeros((40, 40), np.uint16))
    with pytest.raises(Excessive, match="40 x 40 pixels, at most 100"), lowered(image_pixels=100):
        decode_picture(bomb)
    with pytest.raises(Excessive, match="40 x 40 pixels, at most 100"), lowered(image_pixels=100):
        decode_picture(encode_jpeg(np.zeros((40, 40), np.uint8)))


def test_a_png_of_gigabytes_is_refused_by_its_header() -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", 60_000, 60_000, 16, 0, 0, 0, 0)
    pixels = zlib.compress(bytes(1000))
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels)
    with pytest.raises(Excessive, match="60000 x 60000"):
        decode_picture(data + chunk(b"IEND", b""))
    small = chunk(b"IHDR", struct.pack(">IIBBBBB", 60, 60, 16, 0, 0, 0, 0))
    cut = b"\x89PNG\r\n\x1a\n" + small + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    with pytest.raises(ValueError, match="cannot be decoded"):
        decode_picture(cut)


@pytest.mark.parametrize("encode", [encode_jpeg, encode_png])
@pytest.mark.parametrize("channels", [1, 3])
def test_pictures_are_what_opencv_reads(encode: Callable[[Any], bytes], channels: int) -> None:
    pixels = np.kron(RANDOM.integers(0, 255, (3, 4, channels)), np.ones((16, 16, 1)))
    pixels = np.squeeze(pixels.astype(np.uint8))
    data = encode(pixels)
    found = decode_picture(data)
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert seen is not None
    np.testing.assert_array_equal(found, seen if channels == 1 else seen[:, :, ::-1])
    assert np.abs(found.astype(int) - pixels).mean() < (1e-9 if encode is encode_png else 6.0)


@pytest.mark.parametrize("mode", ["whole", "cut", "end", "head", "text", "none"])
def test_damaged_pictures_are_told(mode: str) -> None:
    grey = RANDOM.integers(0, 255, (32, 32), dtype=np.uint8)
    for data in (encode_jpeg(grey), encode_png(grey)):
        damaged = {
            "whole": data + bytes(20),
            "cut": data[: len(data) // 2],
            "end": data[:-3],
            "head": data[:12],
            "text": b"not an image at all",
            "none": b"",
        }[mode]
        if mode == "whole":  # some cameras pad
            assert decode_picture(damaged).shape == (32, 32)
            continue
        with pytest.raises(ValueError, match=r"cut off|neither|is empty"):
            decode_picture(damaged)


def test_a_damaged_byte_of_a_png_is_told() -> None:
    data = bytearray(encode_png(RANDOM.integers(0, 255, (32, 32), dtype=np.uint8)))
    data[60] ^= 1
    with pytest.raises(ValueError, match="wrong checksum"):
        decode_picture(bytes(data))


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_compressed_depth_keeps_millimetres(codec: Literal["png", "rvl"]) -> None:
    image = RANDOM.integers(0, 9000, (12, 16), dtype=np.uint16)
    told, data = encode_compressed_depth(image, codec)
    assert told == f"16UC1; compressedDepth {codec}"
    np.testing.assert_array_equal(decode_compressed_depth(told, data), image)
    if codec == "png":  # of before 2021
        old = decode_compressed_depth("16UC1; compressedDepth", data)
        np.testing.assert_array_equal(old, image)
        plain = cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(plain, image)


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_compressed_depth_quantises_the_inverse(codec: Literal["png", "rvl"]) -> None:
    image = RANDOM.uniform(0.3, 9.9, (20, 30)).astype(np.float32)
    image[0, :4] = np.nan, 0.0, 10.5, np.inf
    told, data = encode_compressed_depth(image, codec)
    found = decode_compressed_depth(told, data)
    assert told.startswith("32FC1") and np.isnan(found[0, :4]).all()
    rest, known = found.ravel()[4:], image.ravel()[4:]
    assert (np.abs(rest - known) <= known**2 / 10_100.0 * 1.01).all()
    # As depth_image_transport decodes it, number by number.
    _, quotient, shift = struct.unpack_from("<iff", data)
    words = decode_depth(data[12:], codec).ravel()[4:].tolist()
    by_hand = [quotient / (word - shift) for word in words]
    np.testing.assert_allclose(rest, by_hand, rtol=1e-5)


@pytest.mark.parametrize(
    ("told", "data", "why"),
    [
        ("16UC1; jpeg", bytes(40), "such as"),
        ("8UC1; compressedDepth png", bytes(40), "16UC1 or 32FC1"),
        ("16UC1; compressedDepth h264", bytes(40), "png and rvl are"),
        ("16UC1; compressedDepth png", bytes(12), "head of 12"),
        ("16UC1; compressedDepth png", bytes(40), "neither"),
        (
            "32FC1; compressedDepth png",
            struct.pack("<iff", 0, float("nan"), 1.0) + encode_png(np.ones((2, 2), np.uint16)),
            "parameters",
        ),
        (
            "16UC1; compressedDepth png",
            bytes(12) + encode_png(np.ones((2, 2), np.uint8)),
            "16 bits",
        ),
    ],
)
def test_what_is_no_compressed_depth_is_told(told: str, data: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        decode_compressed_depth(told, data)


@pytest.mark.parametrize(
    "wrong", [np.zeros((2, 2)), np.zeros(4, np.uint16), np.zeros((0, 2), np.uint16)]
)
def test_only_16_bit_images_are_encoded(wrong: Any) -> None:
    for codec in get_args(DepthCodec):
        with pytest.raises(BadNumbers):
            encode_depth(wrong, codec)


def raw(encoding: str, pixels: Any, big: bool = False, padding: int = 0) -> RawImage:
    """As a message holds them; padding: bytes after each row."""
    dtype = pixels.dtype.newbyteorder(">" if big else "<")
    plain = np.ascontiguousarray(pixels.astype(dtype)).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(plain, ((0, 0), (0, padding)), constant_values=99)
    height, width = pixels.shape[:2]
    return RawImage(height, width, encoding, big, rows.shape[1], rows.ravel())


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("big", "padding"), [(False, 0), (True, 4), (False, 5)])
def test_each_encoding_has_its_kind_and_size(encoding: str, big: bool, padding: int) -> None:
    about = ENCODINGS[encoding]
    shape = (6, 8) if about.channels == 1 else (6, 8, about.channels)
    stored = (200.0 * RANDOM.random(shape)).astype(about.dtype)
    kind, pixels = decode_raw(raw(encoding, stored, big, padding))
    again = decode_raw(raw(encoding, stored))[1]
    np.testing.assert_array_equal(pixels, again)
    assert kind == about.kind
    assert pixels.shape == ((6, 8, 3) if kind == "colour" else (6, 8))
    assert pixels.dtype == (np.uint8 if kind != "depth" else stored.dtype)


ORDERS = {"rgb": [0, 1, 2], "bgr": [2, 1, 0], "rgba": [0, 1, 2], "bgra": [2, 1, 0]}


@pytest.mark.parametrize("encoding", [e for e in ENCODINGS if e.rstrip("168") in ORDERS])
def test_colours_come_out_red_first(encoding: str) -> None:
    about = ENCODINGS[encoding]
    stored = (60_000.0 * RANDOM.random((4, 6, about.channels))).astype(about.dtype)
    stored = stored if about.dtype == "u2" else stored % 250
    kind, pixels = decode_raw(raw(encoding, stored))
    eight = stored >> 8 if about.dtype == "u2" else stored
    np.testing.assert_array_equal(pixels, eight[:, :, ORDERS[encoding.rstrip("168")]])
    assert kind == "colour"


@pytest.mark.parametrize("bits", ["8", "16"])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_mosaic_of_one_colour_is_that_colour(pattern: str, bits: str) -> None:
    """Each pixel of the mosaic holds the value of its filter, as the name spells them."""
    colour = {"r": 200, "g": 90, "b": 30}
    square = np.array([colour[c] for c in pattern], dtype=np.uint16).reshape(2, 2)
    mosaic = np.tile(square, (5, 6))
    stored = (mosaic << 8) if bits == "16" else mosaic.astype(np.uint8)
    kind, pixels = decode_raw(raw(f"bayer_{pattern}{bits}", stored))
    assert kind == "colour"
    np.testing.assert_array_equal(pixels, np.broadcast_to([200, 90, 30], pixels.shape))


@pytest.mark.parametrize(
    ("encoding", "order"), [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv")]
)
def test_yuv_is_what_bt601_says(encoding: str, order: str) -> None:
    """Grey ramp and one strong colour, by the equations of ITU-R BT.601 (studio range)."""
    luma = RANDOM.integers(80, 200, (4, 8))
    u, v = 100, 150
    stored = np.zeros((4, 8, 2), dtype=np.uint8)
    at = order.index("y")
    stored[:, :, at] = luma
    stored[:, 0::2, 1 - at], stored[:, 1::2, 1 - at] = u, v
    _, pixels = decode_raw(raw(encoding, stored))
    red = 1.164 * (luma - 16) + 1.596 * (v - 128)
    green = 1.164 * (luma - 16) - 0.813 * (v - 128) - 0.391 * (u - 128)
    blue = 1.164 * (luma - 16) + 2.018 * (u - 128)
    expected = np.stack([red, green, blue], axis=2)
    assert np.abs(pixels - expected).max() <= 1.5


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (RawImage(2, 2, "rgb9", False, 6, np.zeros(12, np.uint8)), "did you mean 'rgb8'"),
        (RawImage(2, 2, "64FC4", False, 6, np.zeros(12, np.uint8)), "Known are rgb8"),
        (RawImage(0, 2, "rgb8", False, 6, np.zeros(12, np.uint8)), "empty"),
        (RawImage(2, 2, "rgb8", False, 5, np.zeros(12, np.uint8)), "cannot hold 2 pixels"),
        (RawImage(2, 2, "rgb8", False, 6, np.zeros(11, np.uint8)), "cut off: 11 of 12"),
        (RawImage(2, 3, "yuv422", False, 6, np.zeros(12, np.uint8)), "even"),
        (RawImage(1 << 20, 1 << 20, "rgb8", False, 3 << 20, np.zeros(1, np.uint8)), "at most"),
    ],
)
def test_what_is_no_image_is_told(image: RawImage, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        decode_raw(image)


@pytest.mark.parametrize("big", [False, True])
def test_floats_that_are_called_integers_are_told(big: bool) -> None:
    """Metres in 16UC1: rows are twice as long; integers with padding as long stay integers."""
    metres = RANDOM.uniform(0.4, 9.0, (6, 8)).astype(np.float32)
    metres[2, 3], metres[4, 1] = np.nan, 0.0
    floats = replace(raw("32FC1", metres, big), encoding="16UC1")
    with pytest.raises(ValueError, match="four bytes a pixel, which are floats in metres"):
        decode_raw(floats)
    millimetres = (1000.0 * RANDOM.uniform(0.4, 9.0, (6, 8))).astype(np.uint16)
    for padded in (raw("16UC1", millimetres, big, 16), raw("16UC1", 0 * millimetres, big, 16)):
        assert decode_raw(padded)[1].max() in (0, millimetres.max())
    empty = replace(raw("32FC1", 0.0 * np.ones((6, 8), np.float32), big), encoding="16UC1")
    assert not decode_raw(empty)[1].any()


def test_the_last_row_need_not_be_padded() -> None:
    image = RawImage(2, 2, "mono8", False, 5, np.arange(7, dtype=np.uint8))
    np.testing.assert_array_equal(decode_raw(image)[1], [[0, 1], [5, 6]])
