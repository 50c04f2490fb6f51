"""Where raw messages come from: our own MCAP walk, or rosbags for the other formats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from slamsim.logs.bag_limits import check_definitions
from slamsim.logs.mcap_read import McapIndex, mcap_messages
from slamsim.logs.ros_types import ros2_types

_IDL_RULE = "=" * 80 + "\n"


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of one type."""

    topic: str
    type_name: str
    messages: int


class MessageSource(Protocol):
    """The messages of a recording; raises whatever its library raises on damage."""

    def channels(self) -> list[Channel]:
        """Topics with their number of messages."""

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        """(topic, when it was received in ns, serialised message) in the order of recording."""

    def deserialize(self, topic: str, data: bytes) -> Any:
        """The message object, with the fields of its definition."""

    def is_cdr(self, topic: str) -> bool:
        """Whether messages are serialised as ROS 2 does, with the standard definition."""


class McapSource:
    """One or more MCAP files that were walked over already."""

    def __init__(self, indexes: Sequence[McapIndex]) -> None:
        self._indexes = indexes
        self._standard = ros2_types()
        self._store = get_typestore(Stores.EMPTY)
        self._kinds: dict[str, tuple[str, str]] = {}
        self._definitions: dict[str, tuple[str, str]] = {}
        for index in indexes:
            for channel in index.channels.values():
                schema = index.schemas.get(channel.schema_id)
                name = normal_type_name(schema.name) if schema is not None else ""
                self._kinds[channel.topic] = (name, channel.message_encoding)
                if schema is not None and schema.data:
                    self._definitions[name] = (schema.encoding, schema.data.decode())

    @property
    def unvouched(self) -> Counter[str]:
        """How many of each part of the files carry no checksum."""
        return sum((index.unvouched for index in self._indexes), Counter[str]())

    def channels(self) -> list[Channel]:
        counts: dict[str, int] = {}
        for index in self._indexes:
            for number, channel in index.channels.items():
                counts[channel.topic] = counts.get(channel.topic, 0) + index.counts[number]
        return [Channel(topic, self._kinds[topic][0], n) for topic, n in counts.items()]

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        for index in self._indexes:
            for channel, log_ns, data in mcap_messages(index, topics):
                yield channel.topic, log_ns, data

    def deserialize(self, topic: str, data: bytes) -> Any:
        name, encoding = self._kinds[topic]
        self._require_type(name)
        if encoding == "cdr":
            return self._store.deserialize_cdr(data, name)
        if encoding == "ros1":
            return self._store.deserialize_ros1(data, name)
        raise ValueError(f"messages are encoded as {encoding[:30]!r}; cdr and ros1 are read")

    def is_cdr(self, topic: str) -> bool:
        name, encoding = self._kinds[topic]
        self._require_type(name)
        known = self._standard.fielddefs.get(name)
        return encoding == "cdr" and self._store.fielddefs[name] == known

    def _require_type(self, name: str) -> None:
        """Register a definition when it is first needed, after a look at what it asks for."""
        if name in self._store.fielddefs:
            return
        encoding, text = self._definitions.get(name, ("", ""))
        if not text:
            if name not in self._standard.fielddefs:
                raise ValueError(f"no definition of {name[:60]!r}")
            known = self._store.fielddefs
            defs = self._standard.fielddefs.items()
            self._store.register({kind: of for kind, of in defs if kind not in known})
            return
        check_definitions([(name, text)])
        register(self._store, name, encoding, text)


def register(store: Typestore, name: str, encoding: str, text: str) -> None:
    """Adds a definition in the ROS 2 .msg, ROS 1 .msg or IDL way of writing."""
    if encoding in ("ros2msg", "ros1msg"):
        store.register(get_types_from_msg(text, name))
    elif encoding in ("ros2idl", "omgidl"):
        for part in text.split(_IDL_RULE):
            _, is_section, body = part.partition("\n") if part.startswith("IDL: ") else ("", "", "")
            idl = body if is_section else part
            if idl.strip():
                store.register(get_types_from_idl(idl))
    else:
        raise ValueError(f"{name[:60]} is defined as {encoding[:30]!r}, which is not known")


class RosbagsSource:
    """A ROS 1 bag or an SQLite recording; each pass opens the file anew."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._standard = ros2_types()
        with self._open() as reader:
            self._cdr = reader.is2
            self._typestore = reader.typestore
            counts: dict[tuple[str, str], int] = {}
            for connection in reader.connections:
                key = (connection.topic, connection.msgtype)
                counts[key] = counts.get(key, 0) + connection.msgcount
        self._channels = [Channel(topic, kind, n) for (topic, kind), n in counts.items()]
        self._kinds = {channel.topic: channel.type_name for channel in self._channels}

    def _open(self) -> AnyReader:
        return AnyReader([self._path], default_typestore=self._standard)

    def channels(self) -> list[Channel]:
        return self._channels

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        with self._open() as reader:
            connections = [c for c in reader.connections if c.topic in topics]
            if connections:
                for connection, log_ns, data in reader.messages(connections):
                    yield connection.topic, log_ns, data

    def deserialize(self, topic: str, data: bytes) -> Any:
        name = self._kinds[topic]
        if self._cdr:
            return self._typestore.deserialize_cdr(data, name)
        return self._typestore.deserialize_ros1(data, name)

    def is_cdr(self, topic: str) -> bool:
        name = self._kinds[topic]
        known = self._standard.fielddefs.get(name)
        return self._cdr and self._typestore.fielddefs.get(name) == known


def normal_type_name(type_name: str) -> str:
    """``pkg/Type`` of ROS 1 as ``pkg/msg/Type``."""
    package, _, name = type_name.partition("/")
    return type_name if "/" in name or not name else f"{package}/msg/{name}"
