"""Plain values as rosbridge sends them: JSON, JSON inside a PNG, CBOR with typed arrays; and back.

Python's own encoders hold the interpreter's lock for as long as they run, a second for a map of
4096 x 4096 cells, while no scan can be sent. So arrays become text in chunks: those of 8-bit
numbers by NumPy, which gives the lock back, all others a few thousand numbers at a time.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import cbor2
import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.guard.errors import shown
from slamsim.io.ros.values import WrongMessage

_TEXT_CHUNK = 4096
"""Numbers that are written at a time: about a millisecond."""
_TABLE_CHUNK = 1 << 18
"""8-bit numbers that are written at a time: some milliseconds, nearly all without the lock."""
_BYTES_CHUNK = 3 << 17
"""Bytes that become base64 at a time; a multiple of three, so that the pieces fit together."""

_TYPED_ARRAYS: Mapping[str, int] = {
    "<u2": 69,
    "<u4": 70,
    "<u8": 71,
    "|i1": 72,
    "<i2": 77,
    "<i4": 78,
    "<i8": 79,
    "<f4": 85,
    "<f8": 86,
}
"""Tags of RFC 8746, little-endian, by NumPy's names: those that rosbridge_suite writes."""
_ARRAY_TYPES = {tag: np.dtype(name) for name, tag in _TYPED_ARRAYS.items()} | {
    64: np.dtype("u1"),
    68: np.dtype("u1"),
}

_PNG_PIXELS = 64_000_000
"""Most pixels of an image that is decoded; three bytes each."""


def json_text(values: Mapping[str, Any]) -> bytes:
    """As rosbridge_suite writes it: bytes in base64, null for floats that are not finite.

    Raises WrongMessage for what JSON cannot hold.
    """
    try:
        return b"".join(_pieces(values))
    except RecursionError:
        raise WrongMessage("the message is nested too deeply") from None


def _pieces(value: Any) -> Iterator[bytes]:
    if isinstance(value, Mapping):
        separator = b"{"
        for name, one in value.items():
            yield separator + json.dumps(str(name)).encode() + b":"
            yield from _pieces(one)
            separator = b","
        yield b"}" if value else b"{}"
    elif isinstance(value, list | tuple):
        separator = b"["
        for one in value:
            yield separator
            yield from _pieces(one)
            separator = b","
        yield b"]" if value else b"[]"
    elif isinstance(value, np.ndarray):
        yield from _array_pieces(value)
    elif isinstance(value, float) and not math.isfinite(value):
        yield b"null"
    else:
        try:
            yield json.dumps(value).encode()
        except (TypeError, ValueError):  # bytes; integers of thousands of digits
            raise WrongMessage(f"JSON cannot hold {shown(value)}") from None


def _array_pieces(array: NDArray[Any]) -> Iterator[bytes]:
    if array.dtype == np.uint8:
        yield b'"'
        yield from _base64_pieces(array)
        yield b'"'
        return
    small = array.dtype == np.int8
    step = _TABLE_CHUNK if small else _TEXT_CHUNK
    chunks = (array[start : start + step] for start in range(0, array.size, step))
    separator = b"["
    for chunk in chunks:
        yield separator
        yield _int8_text(chunk) if small else _numbers_text(chunk)
        separator = b","
    yield b"]" if array.size else b"[]"


def _base64_pieces(array: NDArray[np.uint8]) -> Iterator[bytes]:
    for start in range(0, array.size, _BYTES_CHUNK):
        yield base64.b64encode(array[start : start + _BYTES_CHUNK].tobytes())


@cache
def _int8_words() -> NDArray[np.uint8]:
    """(256, 5) the text of each 8-bit number, from 0 over 127 and -128 to -1, a comma behind it;
    filled up with zeros."""
    words = np.array([f"{n}," for n in [*range(128), *range(-128, 0)]], "S5")
    return words.view(np.uint8).reshape(256, 5)


def _int8_text(values: NDArray[np.int8]) -> bytes:
    text = np.take(_int8_words(), values.view(np.uint8), axis=0).ravel()
    return bytes(text[text != 0][:-1].tobytes())


def _numbers_text(values: NDArray[Any]) -> bytes:
    numbers = values.tolist()
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        numbers = [number if math.isfinite(number) else None for number in numbers]
    return json.dumps(numbers, separators=(",", ":"))[1:-1].encode()


def png_text(text: bytes) -> bytes:
    """JSON as the pixels of a PNG, in base64; spaces of JSON fill up the last line."""
    width = max(math.isqrt(len(text) // 3), 1)
    height = -(-len(text) // (3 * width))
    pixels = np.full(3 * width * height, ord("\n"), np.uint8)
    pixels[: len(text)] = np.frombuffer(text, np.uint8)
    # OpenCV writes what stands last as red, the first of a PNG.
    image = cv2.cvtColor(pixels.reshape(height, width, 3), cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    return b"".join(_base64_pieces(data.ravel()))


def cbor_bytes(values: Mapping[str, Any]) -> bytes:
    """Arrays of numbers as typed arrays, those of bytes as a string of bytes."""
    return cbor2.dumps(values, default=_cbor_array)


def _cbor_array(encoder: Any, value: object) -> None:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"a {type(value).__name__} has no place in a message")
    if value.dtype == np.uint8:
        encoder.encode(value.tobytes())
    elif (tag := _TYPED_ARRAYS.get(value.dtype.str)) is not None:
        encoder.encode(cbor2.CBORTag(tag, value.tobytes()))
    else:
        encoder.encode(value.tolist())


MOST_VALUES = 10_000
"""Objects, arrays and values of a message that a client sends; a typed array and a text are one. To
make a ROS message of as many takes 0.1 s at most, in which no other client is served."""
_LARGEST_CBOR = 256 << 10
"""Each of its bytes may become a dictionary of 64."""
_TOO_MANY = f"a message of more than {MOST_VALUES:,} values is not read; bytes may come as base64"


def request_of(frame: str | bytes) -> dict[str, Any]:
    """What a client asks of a server that has others to serve: `parsed`, but of no more values than
    it can read meanwhile; raises WrongMessage."""
    if isinstance(frame, bytes) and len(frame) > _LARGEST_CBOR:
        raise WrongMessage(f"CBOR of more than {_LARGEST_CBOR:,} bytes is not read")
    if isinstance(frame, str) and sum(map(frame.count, ",[{")) > 10 * MOST_VALUES:
        raise WrongMessage(_TOO_MANY)  # some may be part of a text, but not so many
    operation = parsed(frame)
    _refuse_many_values(operation)
    return operation


def parsed(frame: str | bytes) -> dict[str, Any]:
    """An operation that came in, text as JSON and bytes as CBOR; raises WrongMessage."""
    try:
        if isinstance(frame, bytes):
            operation = cbor2.loads(frame, tag_hook=_typed_array)
        else:
            operation = json.loads(frame)
    except RecursionError:
        raise WrongMessage("the message is nested too deeply") from None
    except (ValueError, cbor2.CBORError) as error:
        name = "CBOR" if isinstance(frame, bytes) else "JSON"
        raise WrongMessage(f"this is not {name}: {error}") from None
    if not isinstance(operation, dict):
        raise WrongMessage(f"an object with an 'op' is needed, not {shown(operation)}")
    if any(isinstance(value, np.ndarray) for value in operation.values()):
        raise WrongMessage("a typed array may only stand inside a message")
    return operation


def _refuse_many_values(operation: dict[str, Any]) -> None:
    count = 0
    unseen: list[Iterable[Any]] = [operation.values()]
    while unseen:
        for value in unseen.pop():
            count += 1
            if isinstance(value, dict):
                unseen.append(value.values())
            elif isinstance(value, list):
                unseen.append(value)
            if count > MOST_VALUES:
                raise WrongMessage(_TOO_MANY)


def _typed_array(tag: cbor2.CBORTag, immutable: bool) -> object:
    dtype = _ARRAY_TYPES.get(tag.tag)
    if dtype is None or not isinstance(tag.value, bytes):
        return tag
    return np.frombuffer(tag.value, dtype)


def png_content(data: object) -> str:
    """The JSON inside a PNG in base64; raises WrongMessage."""
    try:
        image = np.frombuffer(base64.b64decode(data, validate=True), np.uint8)  # type: ignore[arg-type]
        width, height = (int.from_bytes(image[at : at + 4].tobytes(), "big") for at in (16, 20))
        if not 0 < width * height <= _PNG_PIXELS:
            raise ValueError(f"{width} x {height} pixels")
        pixels = cv2.imdecode(image, cv2.IMREAD_COLOR)
        if pixels is None:
            raise ValueError("this is no image")
        return bytes(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB).tobytes()).decode()
    except (ValueError, TypeError, cv2.error) as error:
        raise WrongMessage(f"the PNG cannot be read: {error}") from None


LARGEST_MESSAGE = 4 << 20
"""Bytes of a message that a client may send, in one frame or in fragments. Parsing that much JSON
holds the interpreter's lock for some 40 ms, and no client shall delay another by more."""
MOST_OPEN = 16
"""Fragmented messages of one client that may be incomplete at a time."""
MOST_PARTS = 10_000
LONGEST_AGE_S = 60.0
"""How long parts of a message may take to arrive after its first one."""


@dataclass(slots=True)
class _Open:
    total: int
    since_s: float
    parts: dict[int, str] = field(default_factory=dict)
    size: int = 0


class Fragments:
    """Joins the fragments of one connection. largest: bytes of all that are incomplete."""

    def __init__(self, largest: int = LARGEST_MESSAGE) -> None:
        self._largest = largest
        self._open: dict[str | int, _Open] = {}

    def add(self, operation: Mapping[str, Any], now_s: float) -> str | None:
        """The whole text once its last part is here. now_s: any steady clock.

        Raises WrongMessage for a part that does not fit, and forgets the message it belongs to.
        """
        self._open = {
            k: one for k, one in self._open.items() if now_s - one.since_s < LONGEST_AGE_S
        }
        key, number, total, data = (operation.get(k) for k in ("id", "num", "total", "data"))
        if type(number) is not int or type(total) is not int or not isinstance(key, str | int):
            raise WrongMessage("a fragment needs an 'id', and whole numbers as 'num' and 'total'")
        if not isinstance(data, str):
            raise WrongMessage("the 'data' of a fragment must be a string")
        if not 0 <= number < total <= MOST_PARTS:
            self._open.pop(key, None)
            raise WrongMessage(f"fragment {number} of {total}; at most {MOST_PARTS} are read")
        if key not in self._open and len(self._open) >= MOST_OPEN:
            raise WrongMessage(f"{MOST_OPEN} fragmented messages are incomplete already")
        message = self._open.setdefault(key, _Open(total, now_s))
        if message.total != total or message.parts.get(number, data) != data:
            del self._open[key]
            raise WrongMessage(f"fragment {number} contradicts those before it")
        if number not in message.parts:
            message.parts[number] = data
            message.size += len(data)
        if sum(one.size for one in self._open.values()) > self._largest:
            del self._open[key]
            raise WrongMessage(f"fragments of more than {self._largest:,} bytes")
        if len(message.parts) < total:
            return None
        del self._open[key]
        return "".join(message.parts[n] for n in range(total))


def split(text: bytes, size: int, name: str) -> Iterator[bytes]:
    """ASCII text of one operation as operations of at most ``size`` bytes of it each; as it is
    where it is no longer."""
    if len(text) <= size:
        yield text
        return
    total = -(-len(text) // size)
    for number in range(total):
        data = text[number * size : (number + 1) * size].decode("ascii")
        part = {"op": "fragment", "id": name, "data": data, "num": number, "total": total}
        yield json.dumps(part).encode()
