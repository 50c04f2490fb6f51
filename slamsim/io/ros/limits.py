"""Size limits of foreign recordings, checked before a library reads them."""

from __future__ import annotations

import bz2
import re
from collections.abc import Iterable, Mapping

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from slamsim.guard.errors import Excessive
from slamsim.guard.limits import LIMITS, Limits

_ARRAY = re.compile(
    r"\[[ \t]*(?:<=[ \t]*)?(\d+)[ \t]*\]|sequence[ \t]*<[^<>\n]*,[ \t]*(\d+)[ \t]*>"
)
_FIELD = re.compile(r"^[ \t]*([A-Za-z]\w*(?:/\w+)*)(?:\[[^\]\n]*\]|<=\d+)*[ \t]+\w+", re.MULTILINE)
_NEXT_TYPE = re.compile(r"^=+[ \t]*\nMSG:[ \t]*(\S+)[ \t]*$", re.MULTILINE)


def inflate(
    data: bytes | memoryview, compression: str, size: int, limits: Limits = LIMITS
) -> bytes:
    """The content of a chunk that is announced to be ``size`` bytes long.

    Never makes more than one byte beyond that. Raises Excessive when the announcement is
    out of all proportion, ValueError when the content does not keep to it.
    """
    if size > limits.bag_chunk_bytes:
        reason = f"a chunk of {size:,} bytes, at most {limits.bag_chunk_bytes:,} are read"
        raise Excessive(reason, "bag_chunk_bytes")
    if size > max(limits.bag_ratio_floor_bytes, limits.bag_ratio * len(data)):
        reason = f"a chunk unpacks to more than {limits.bag_ratio} times its size"
        raise Excessive(reason, "bag_ratio")
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


def check_definitions(definitions: Iterable[tuple[str, str]], limits: Limits = LIMITS) -> None:
    """Refuses message definitions that would blow up the code generated from them.

    rosbags unrolls fixed arrays and executes what it generates; a type that holds itself
    recurses without end. Raises Excessive, and ValueError for such a type.
    """
    holds: dict[str, set[str]] = {}
    for name, text in definitions:
        if len(text) > limits.bag_definition_characters:
            reason = f"the definition of {name[:60]} is {len(text):,} characters long"
            raise Excessive(reason, "bag_definition_characters")
        if len(_FIELD.findall(text)) > limits.bag_definition_fields:
            reason = f"{name[:60]} has more than {limits.bag_definition_fields} fields"
            raise Excessive(reason, "bag_definition_fields")
        for match in _ARRAY.finditer(text):
            digits = match[1] or match[2]
            if len(digits) > 9 or int(digits) > limits.bag_array_elements:
                reason = f"{name[:60]} has an array of {digits[:20]} elements"
                raise Excessive(reason, "bag_array_elements")
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
            raise ValueError(f"message type {min(open_types)[:60]} contains itself")
        open_types = {n: kinds - finite for n, kinds in open_types.items() if n not in finite}
