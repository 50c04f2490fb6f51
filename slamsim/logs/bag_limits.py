"""What a foreign recording may ask for before any library believes it."""

from __future__ import annotations

import bz2
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

CHUNK_BYTES = 256 << 20
RECORD_BYTES = 64 << 20
_RATIO = 1000
_RATIO_FLOOR_BYTES = 64 << 20
_DEFINITION_BYTES = 256 << 10
_DEFINITION_FIELDS = 1000
_FIXED_ARRAY = 10_000
_QOS_CHARACTERS = 100_000
_ARRAY = re.compile(
    r"\[[ \t]*(?:<=[ \t]*)?(\d+)[ \t]*\]|sequence[ \t]*<[^<>\n]*,[ \t]*(\d+)[ \t]*>"
)
_FIELD = re.compile(r"^[ \t]*([A-Za-z]\w*(?:/\w+)*)(?:\[[^\]\n]*\]|<=\d+)*[ \t]+\w+", re.MULTILINE)
_NEXT_TYPE = re.compile(r"^=+[ \t]*\nMSG:[ \t]*(\S+)[ \t]*$", re.MULTILINE)


class Excessive(ValueError):
    """Larger than any sane recording; the sentence says what and which limit."""


@dataclass(frozen=True, slots=True)
class BagFacts:
    """What a walk over the bytes of a recording found, independent of its index.

    messages: how many there are. definitions: (type name, text of its definition).
    """

    messages: int
    definitions: tuple[tuple[str, str], ...]


def inflate(data: bytes | memoryview, compression: str, size: int) -> bytes:
    """The content of a chunk that is announced to be ``size`` bytes long.

    Never makes more than one byte beyond that. Raises Excessive when the announcement is
    out of all proportion, ValueError when the content does not keep to it.
    """
    if size > CHUNK_BYTES:
        raise Excessive(f"a chunk of {size:,} bytes, at most {CHUNK_BYTES:,} are read")
    if size > max(_RATIO_FLOOR_BYTES, _RATIO * len(data)):
        raise Excessive(f"a chunk unpacks to more than {_RATIO} times its size")
    if compression in ("", "none"):
        content = bytes(data)
    elif compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            content = reader.read(size + 1)
    elif compression == "lz4":
        decoder = LZ4FrameDecompressor()
        content = decoder.decompress(bytes(data), max_length=size + 1)
        if len(content) <= size and (not decoder.eof or decoder.unused_data):
            raise ValueError("the lz4 data of a chunk do not end where they should")
    elif compression == "bz2":
        content = bz2.BZ2Decompressor().decompress(bytes(data), max_length=size + 1)
    else:
        raise ValueError(f"a chunk is compressed with {compression[:20]!r}, which is not known")
    if len(content) != size:
        more = "more" if len(content) > size else "fewer"
        raise ValueError(f"a chunk unpacks to {more} than the {size:,} bytes announced")
    return content


def check_definitions(definitions: Iterable[tuple[str, str]]) -> None:
    """Refuses message definitions that would blow up the code generated from them.

    rosbags unrolls fixed arrays and executes what it generates; a type that holds itself
    recurses without end. Raises Excessive.
    """
    holds: dict[str, set[str]] = {}
    for name, text in definitions:
        if len(text) > _DEFINITION_BYTES:
            raise Excessive(f"the definition of {name[:60]} is {len(text):,} characters long")
        if len(_FIELD.findall(text)) > _DEFINITION_FIELDS:
            raise Excessive(f"{name[:60]} has more than {_DEFINITION_FIELDS} fields")
        for match in _ARRAY.finditer(text):
            digits = match[1] or match[2]
            if len(digits) > 9 or int(digits) > _FIXED_ARRAY:
                raise Excessive(f"{name[:60]} has an array of {digits[:20]} elements")
        parts = _NEXT_TYPE.split(text)
        for part_name, part in zip([name, *parts[1::2]], parts[::2], strict=True):
            short = part_name.replace("/msg/", "/")
            holds.setdefault(short, set()).update(_held_types(short, part))
    _require_no_cycle(holds)


def _held_types(name: str, definition: str) -> set[str]:
    """The types of the fields, with the package of ``name`` where they state none."""
    package = name.split("/", maxsplit=1)[0]
    types = (kind.replace("/msg/", "/") for kind in _FIELD.findall(definition))
    return {kind if "/" in kind else f"{package}/{kind}" for kind in types}


def _require_no_cycle(holds: Mapping[str, set[str]]) -> None:
    """Takes away types that hold only known finite ones until none is left (Kahn 1962)."""
    open_types = {name: {kind for kind in kinds if kind in holds} for name, kinds in holds.items()}
    while open_types:
        finite = {name for name, kinds in open_types.items() if not kinds}
        if not finite:
            raise Excessive(f"message type {min(open_types)[:60]} contains itself")
        open_types = {n: kinds - finite for n, kinds in open_types.items() if n not in finite}


def check_qos(text: str) -> None:
    """Refuses the YAML of a quality of service that no ROS writes: anchors, aliases, endless."""
    if len(text) > _QOS_CHARACTERS or re.search(r"[&*]|<<|\[{9}", text):
        raise Excessive("a quality of service with YAML anchors, deep nesting or endless length")
