"""Decodes messages with the type definitions stored in the recording, within limits; ROS 2's
standard types (as of Jazzy) and our own.
"""

from __future__ import annotations

import bz2
import re
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from typing import Any

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from slamsim.guard.errors import Excessive
from slamsim.guard.limits import LIMITS

WRITTEN_AS = ("ros2msg", "ros1msg", "ros2idl", "omgidl")
"""The ways of writing a definition that are read."""
_IDL_RULE = "=" * 80 + "\n"


class MessageTypes:
    """The types of a recording's topics; a definition is looked at when it is first needed.

    Each is taken for itself, with the parts that it brings along: what one says of a part holds
    for no other.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, tuple[str, str]] = {}
        self._definitions: dict[str, tuple[str, str, str]] = {}

    def declare(self, topic: str, type_name: str, encoding: str) -> None:
        """How the messages of a topic are serialised: ``cdr`` or ``ros1``.

        A topic of several types is not read.
        """
        kind = normal_type_name(type_name)
        known, _ = self._kinds.get(topic, (kind, encoding))
        self._kinds[topic] = (kind if known == kind else f"{known} and {kind}", encoding)

    def define(self, type_name: str, written_as: str, text: str, known_hash: str = "") -> None:
        """written_as: ``ros1msg``, ``ros2msg``, ``ros2idl`` or ``omgidl``.

        known_hash: what its MD5 (ROS 1) or RIHS01 hash (ROS 2) must be, if the file says.
        """
        self._definitions[normal_type_name(type_name)] = (written_as, text, known_hash)

    def type_name(self, topic: str) -> str:
        """With ``msg`` in the middle; of a topic with several types their names."""
        return self._kinds[topic][0]

    def deserialize(self, topic: str, data: bytes) -> Any:
        """The message object, with the fields of its definition; raises whatever the library
        raises on damage."""
        name, encoding = self._kinds[topic]
        if encoding == "cdr":
            return self._store(name).deserialize_cdr(data, name)
        if encoding == "ros1":
            return self._store(name).deserialize_ros1(data, name)
        raise ValueError(f"messages are encoded as {encoding[:30]!r}; cdr and ros1 are read")

    def serialize(self, topic: str, message: Any) -> bytes:
        """The message as its topic's others are serialised (CDR: little-endian)."""
        name, encoding = self._kinds[topic]
        store = self._store(name)
        if encoding == "ros1":
            return bytes(store.serialize_ros1(message, name))
        return bytes(store.serialize_cdr(message, name))

    def fields(self, topic: str) -> list[tuple[str, str]]:
        """(name, type) of the topic's fields, of what is no plain message the type is empty.

        Raises ValueError for a topic without a known definition.
        """
        name, _ = self._kinds[topic]
        return [
            (field, str(kind[1]) if kind[0] == Nodetype.NAME else "")
            for field, kind in self._store(name).fielddefs[name][1]
        ]

    def encoding(self, topic: str) -> str:
        """``cdr``, ``ros1``, or what the file says else."""
        return self._kinds[topic][1]

    def types(self, topic: str) -> Mapping[str, Any]:
        """The classes of the topic's message and of all its parts, by name."""
        return self._store(self._kinds[topic][0]).types

    def is_cdr(self, topic: str) -> bool:
        """Whether messages are serialised as ROS 2 does, with the standard definition."""
        name, encoding = self._kinds[topic]
        defined, standard = self._store(name).fielddefs, ros2_types().fielddefs
        return encoding == "cdr" and all(standard.get(kind) == of for kind, of in defined.items())

    def _store(self, name: str) -> Typestore:
        definition = self._definitions.get(name)
        if definition is not None and definition[1]:
            return _store_of(name, *definition)
        if name not in ros2_types().fielddefs:
            raise ValueError(f"no definition of {name[:60]!r}")
        return ros2_types()


@lru_cache(maxsize=64)
def _store_of(name: str, written_as: str, text: str, known_hash: str) -> Typestore:
    """One definition; what it generates is kept for the next file that has the very same."""
    check_definitions([(name, text)])
    store = get_typestore(Stores.EMPTY)
    register(store, name, written_as, text)
    if known_hash and known_hash != _hash(store, name, written_as):
        raise ValueError(f"the definition of {name[:60]} does not fit its hash")
    return store


def _hash(store: Typestore, name: str, written_as: str) -> str:
    if written_as == "ros1msg":
        return str(store.generate_msgdef(name)[1])
    return str(store.hash_rihs01(name))


def register(store: Typestore, name: str, encoding: str, text: str) -> None:
    """Adds a definition in the ROS 2 .msg, ROS 1 .msg or IDL way of writing.

    Raises ValueError for another.
    """
    if encoding in ("ros2msg", "ros1msg"):
        # Until 2011 (ROS Diamondback) the header was a type of roslib; its fields were the same.
        if encoding == "ros1msg":
            text = re.sub(r"\broslib/Header\b", "std_msgs/Header", text)
        store.register(get_types_from_msg(text, name))
    elif encoding in ("ros2idl", "omgidl"):
        for part in text.split(_IDL_RULE):
            _, is_section, body = part.partition("\n") if part.startswith("IDL: ") else ("", "", "")
            idl = body if is_section else part
            if idl.strip():
                store.register(get_types_from_idl(idl))
    else:
        raise ValueError(f"{name[:60]} is defined as {encoding[:30]!r}, which is not known")


def normal_type_name(type_name: str) -> str:
    """``pkg/Type`` of ROS 1 as ``pkg/msg/Type``."""
    package, _, name = type_name.partition("/")
    return type_name if "/" in name or not name else f"{package}/msg/{name}"


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def plain_message(data: bytes, encoding: str) -> bytes:
    """A message as it was before rosbag2 compressed it by itself (``compression_mode: message``).

    It is known by its first bytes, with which no CDR message begins: an MCAP file alone does not
    tell. Raises Excessive for one that unpacks to too much, and what zstandard raises.
    """
    if encoding != "cdr" or data[:4] != ZSTD_MAGIC:
        return data
    most = LIMITS.bag_record_bytes
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
        content = reader.read(most + 1)
    if len(content) > most:
        raise Excessive(f"a message unpacks to more than {most:,} bytes", "bag_record_bytes")
    if zstandard.frame_content_size(data) not in (-1, len(content)):
        raise ValueError("a compressed message is cut off")
    return content


_ARRAY = re.compile(
    r"\[[ \t]*(?:<=[ \t]*)?(\d+)[ \t]*\]|sequence[ \t]*<[^<>\n]*,[ \t]*(\d+)[ \t]*>"
)
_FIELD = re.compile(r"^[ \t]*([A-Za-z]\w*(?:/\w+)*)(?:\[[^\]\n]*\]|<=\d+)*[ \t]+\w+", re.MULTILINE)
_NEXT_TYPE = re.compile(r"^=+[ \t]*\nMSG:[ \t]*(\S+)[ \t]*$", re.MULTILINE)


def inflate(data: bytes | memoryview, compression: str, size: int) -> bytes:
    """The content of a chunk that is announced to be ``size`` bytes long.

    Never makes more than one byte beyond that. Raises Excessive when the announcement is
    out of all proportion, ValueError when the content does not keep to it.
    """
    if size > LIMITS.bag_chunk_bytes:
        reason = f"a chunk of {size:,} bytes, at most {LIMITS.bag_chunk_bytes:,} are read"
        raise Excessive(reason, "bag_chunk_bytes")
    if size > max(LIMITS.bag_ratio_floor_bytes, LIMITS.bag_ratio * len(data)):
        reason = f"a chunk unpacks to more than {LIMITS.bag_ratio} times its size"
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


def check_definitions(definitions: Iterable[tuple[str, str]]) -> None:
    """Refuses message definitions that would blow up the code generated from them.

    rosbags unrolls fixed arrays and executes what it generates; a type that holds itself
    recurses without end. Raises Excessive, and ValueError for such a type.
    """
    holds: dict[str, set[str]] = {}
    for name, text in definitions:
        if len(text) > LIMITS.bag_definition_characters:
            reason = f"the definition of {name[:60]} is {len(text):,} characters long"
            raise Excessive(reason, "bag_definition_characters")
        if len(_FIELD.findall(text)) > LIMITS.bag_definition_fields:
            reason = f"{name[:60]} has more than {LIMITS.bag_definition_fields} fields"
            raise Excessive(reason, "bag_definition_fields")
        for match in _ARRAY.finditer(text):
            digits = match[1] or match[2]
            if len(digits) > 9 or int(digits) > LIMITS.bag_array_elements:
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


ENCODER_TICKS = "slamsim_msgs/msg/EncoderTicks"

_ENCODER_TICKS_DEFINITION = """\
std_msgs/Header header
int64 left
int64 right
uint32 ticks_per_revolution
float64 wheel_radius_m
float64 track_m
"""

FRAME_TRUTH = "slamsim_msgs/msg/FrameTruth"

_FRAME_TRUTH_DEFINITION = """\
std_msgs/Header header
int64 instant_ns
float64 exposure_s
float64 gain
int64[] row_instants_ns
float64[] positions_m
float64[] quats_xyzw
"""


@cache
def ros2_types() -> Typestore:
    """The standard types and two of our own, to which nothing is ever added: what a file defines
    is put into a store of its own.

    EncoderTicks: cumulative ticks, and what turns them into metres. FrameTruth: of an image, true
    instants and poses of its rows in the map (one row for all with a global shutter).
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_FRAME_TRUTH_DEFINITION, FRAME_TRUTH))
    store.register(get_types_from_msg(_ENCODER_TICKS_DEFINITION, ENCODER_TICKS))
    return store
