"""Where raw messages come from, one class for each format of files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from slamsim.logs.bag1_check import Bag1Index, bag1_messages
from slamsim.logs.mcap_read import McapIndex, mcap_messages
from slamsim.logs.message_types import MessageTypes
from slamsim.logs.sqlite_read import SqliteIndex, sqlite_messages


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
        self._types = MessageTypes()
        for index in indexes:
            for channel in index.channels.values():
                schema = index.schemas.get(channel.schema_id)
                name = "" if schema is None else schema.name
                self._types.declare(channel.topic, name, channel.message_encoding)
                if schema is not None and schema.data:
                    self._types.define(name, schema.encoding, schema.data.decode())

    @property
    def unvouched(self) -> Counter[str]:
        """How many of each part of the files carry no checksum."""
        return sum((index.unvouched for index in self._indexes), Counter[str]())

    def channels(self) -> list[Channel]:
        counts: Counter[str] = Counter()
        for index in self._indexes:
            for number, channel in index.channels.items():
                counts[channel.topic] += index.counts[number]
        return _channels(counts, self._types)

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        for index in self._indexes:
            for channel, log_ns, data in mcap_messages(index, topics):
                yield channel.topic, log_ns, data

    def deserialize(self, topic: str, data: bytes) -> Any:
        return self._types.deserialize(topic, data)

    def is_cdr(self, topic: str) -> bool:
        return self._types.is_cdr(topic)


class Bag1Source:
    """A ROS 1 bag that was walked over already."""

    def __init__(self, index: Bag1Index) -> None:
        self._index = index
        self._types = MessageTypes()
        for connection in index.connections.values():
            self._types.declare(connection.topic, connection.type_name, "ros1")
            definition, md5sum = connection.definition, connection.md5sum
            self._types.define(connection.type_name, "ros1msg", definition, md5sum)

    def channels(self) -> list[Channel]:
        counts: Counter[str] = Counter()
        for number, connection in self._index.connections.items():
            counts[connection.topic] += self._index.counts[number]
        return _channels(counts, self._types)

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        return bag1_messages(self._index, topics)

    def deserialize(self, topic: str, data: bytes) -> Any:
        return self._types.deserialize(topic, data)

    def is_cdr(self, topic: str) -> bool:
        return False


class SqliteSource:
    """The SQLite files of a recording, looked through already, one after the other."""

    def __init__(self, indexes: Sequence[SqliteIndex]) -> None:
        self._indexes = indexes
        self._types = MessageTypes()
        for index in indexes:
            for topic in index.topics.values():
                self._types.declare(topic.name, topic.type_name, topic.encoding)
            for type_name, written_as, text in index.definitions:
                self._types.define(type_name, written_as, text, index.hashes.get(type_name, ""))

    def channels(self) -> list[Channel]:
        counts: Counter[str] = Counter()
        for index in self._indexes:
            for topic in index.topics.values():
                counts[topic.name] += topic.messages
        return _channels(counts, self._types)

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        for index in self._indexes:
            yield from sqlite_messages(index, topics)

    def deserialize(self, topic: str, data: bytes) -> Any:
        return self._types.deserialize(topic, data)

    def is_cdr(self, topic: str) -> bool:
        return self._types.is_cdr(topic)


def _channels(counts: Mapping[str, int], types: MessageTypes) -> list[Channel]:
    return [Channel(topic, types.type_name(topic), n) for topic, n in counts.items()]
