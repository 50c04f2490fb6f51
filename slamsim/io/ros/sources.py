"""Sources of raw messages, one class per file format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mcap import records

from slamsim.io.bag1.reader import Bag1Index, bag1_messages
from slamsim.io.bag2.metadata import OFFERED_QOS, TYPE_HASH
from slamsim.io.bag2.sqlite import SqliteIndex, sqlite_messages
from slamsim.io.bag2.writer import described
from slamsim.io.mcap.reader import McapIndex, mcap_attachments, mcap_messages
from slamsim.io.ros.foxglove_schemas import Translation, translation
from slamsim.io.ros.layouts import CDR_LITTLE_ENDIAN
from slamsim.io.ros.message_types import WRITTEN_AS, MessageTypes, plain_message


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of one type."""

    topic: str
    type_name: str
    messages: int


@dataclass(frozen=True, slots=True)
class Declaration:
    """One publisher of a topic as its file declares it: all that a faithful copy needs.

    type_name, encoding: of the messages, as written. definition: its text, written_as such as
    ``ros2msg``. md5sum: of a ROS 1 type. metadata: of the channel (rosbag2: QoS and type hash; ROS
    1: callerid and latching).
    """

    topic: str
    type_name: str
    encoding: str
    written_as: str
    definition: bytes
    md5sum: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)


Received = tuple[int, int, int, int, bytes]
"""(number of the declaration, log time, publish time, sequence, serialised message); times in ns"""


class MessageSource(ABC):
    """The messages of a recording; raises whatever its library raises on damage.

    declarations: by number. types: of all topics. translated: topics whose messages are others
    than those of the file.
    """

    def __init__(self) -> None:
        self.declarations: dict[int, Declaration] = {}
        self.translated: set[str] = set()
        self.types = MessageTypes()
        self._counts: Counter[int] = Counter()

    def channels(self) -> list[Channel]:
        """Topics with their number of messages."""
        counts: Counter[str] = Counter()
        for number, declaration in self.declarations.items():
            counts[declaration.topic] += self._counts[number]
        return [Channel(topic, self.types.type_name(topic), n) for topic, n in counts.items()]

    @abstractmethod
    def received(self, numbers: Mapping[int, object]) -> Iterator[Received]:
        """The messages of the declarations of these numbers in the order of recording."""

    def deserialize(self, topic: str, data: bytes) -> Any:
        """The message object, with the fields of its definition."""
        return self.types.deserialize(topic, data)

    def is_cdr(self, topic: str) -> bool:
        """Whether messages are serialised as ROS 2 does, with the standard definition."""
        return self.types.is_cdr(topic)

    def is_ros2(self, topic: str) -> bool:
        """Whether ROS 2 wrote its messages: not ROS 1, nor what is translated."""
        return self.types.encoding(topic) == "cdr" and topic not in self.translated

    def is_latched(self, topic: str) -> bool:
        """Whether a transform of this topic holds until another one comes: of Foxglove's all do."""
        return topic in self.translated or topic.endswith("tf_static")

    def is_untranslated(self, topic: str, data: bytes) -> bool:
        """Whether this message could not be translated, and is as the file has it."""
        return topic in self.translated and not data.startswith(CDR_LITTLE_ENDIAN)


class McapSource(MessageSource):
    """One or more MCAP files that were walked over already."""

    def __init__(self, indexes: Sequence[McapIndex]) -> None:
        super().__init__()
        self._indexes = indexes
        self._numbers: dict[tuple[int, int], int] = {}
        self._translations: dict[int, Translation] = {}
        for file, index in enumerate(indexes):
            for channel in index.channels.values():
                number = self._numbers[file, channel.id] = len(self._numbers)
                self._counts[number] = index.counts[channel.id]
                self._declare(number, channel, index.schemas.get(channel.schema_id))

    def _declare(
        self, number: int, channel: records.Channel, schema: records.Schema | None
    ) -> None:
        name, written_as, definition = "", "", b""
        if schema is not None:
            name, written_as, definition = schema.name, schema.encoding, schema.data
        encoding = channel.message_encoding
        if (translated := translation(name, encoding, definition)) is not None:
            self._translations[number] = translated
            self.translated.add(channel.topic)
            name, encoding = translated.type_name, "cdr"
            written_as, definition = "ros2msg", described(name)[1].encode()
        self.declarations[number] = Declaration(
            channel.topic, name, encoding, written_as, definition, metadata=channel.metadata
        )
        self.types.declare(channel.topic, name, encoding)
        if definition and written_as in WRITTEN_AS:  # protobuf and others are not text
            self.types.define(name, written_as, definition.decode())

    @property
    def unchecked(self) -> Counter[str]:
        """How many of each part of the files carry no checksum."""
        return sum((index.unchecked for index in self._indexes), Counter[str]())

    @property
    def profile(self) -> str:
        """What the messages of the first file follow, such as ``ros2``."""
        return "ros2" if self.translated else self._indexes[0].profile

    def metadata(self) -> list[records.Metadata]:
        """The metadata records of all files."""
        return [each for index in self._indexes for each in index.metadata]

    def attachments(self) -> Iterator[records.Attachment]:
        """Those of all files."""
        for index in self._indexes:
            yield from mcap_attachments(index)

    def received(self, numbers: Mapping[int, object]) -> Iterator[Received]:
        for file, index in enumerate(self._indexes):
            mine = {n: self._numbers[file, n] for n in index.channels}
            wanted = {n: number for n, number in mine.items() if number in numbers}
            for channel, log_ns, published_ns, sequence, data in mcap_messages(index, wanted):
                number, encoding = wanted[channel], index.channels[channel].message_encoding
                turn = self._translations.get(number)
                plain = _translated(turn, data) if turn else plain_message(data, encoding)
                yield number, log_ns, published_ns, sequence, plain

    def deserialize(self, topic: str, data: bytes) -> Any:
        if self.is_untranslated(topic, data):
            for number, turn in self._translations.items():
                if self.declarations[number].topic == topic:
                    data = turn.cdr(data)  # says why it could not be translated
        return super().deserialize(topic, data)


def _translated(turn: Translation, data: bytes) -> bytes:
    """A message that cannot be translated stays as it is, which is no CDR: it is found when it is
    decoded, and the others are read."""
    try:
        return turn.cdr(data)
    except Exception:  # of many types, for damage of any kind
        return data


class Bag1Source(MessageSource):
    """A ROS 1 bag that was walked over already."""

    def __init__(self, index: Bag1Index) -> None:
        super().__init__()
        self._index = index
        self._counts = index.counts
        for number, connection in index.connections.items():
            topic, type_name, definition = (
                connection.topic,
                connection.type_name,
                connection.definition,
            )
            told = {"callerid": connection.callerid, "latching": connection.latching}
            self.declarations[number] = Declaration(
                topic,
                type_name,
                "ros1",
                "ros1msg",
                definition.encode(),
                connection.md5sum,
                {name: text for name, text in told.items() if text is not None},
            )
            self.types.declare(topic, type_name, "ros1")
            self.types.define(type_name, "ros1msg", definition, connection.md5sum)

    def received(self, numbers: Mapping[int, object]) -> Iterator[Received]:
        for number, received_ns, data in bag1_messages(self._index, numbers):
            yield number, received_ns, received_ns, 0, data


class SqliteSource(MessageSource):
    """The SQLite files of a recording, looked through already, one after the other."""

    def __init__(self, indexes: Sequence[SqliteIndex]) -> None:
        super().__init__()
        self._indexes = indexes
        self._numbers: dict[tuple[int, int], int] = {}
        for file, index in enumerate(indexes):
            defined = {name: (written_as, text) for name, written_as, text in index.definitions}
            for at, topic in index.topics.items():
                number = self._numbers[file, at] = len(self._numbers)
                self._counts[number] = topic.messages
                written_as, text = defined.get(topic.type_name, ("ros2msg", ""))
                told = {OFFERED_QOS: topic.qos, TYPE_HASH: index.hashes.get(topic.type_name, "")}
                self.declarations[number] = Declaration(
                    topic.name,
                    topic.type_name,
                    topic.encoding,
                    written_as,
                    text.encode(),
                    metadata={name: value for name, value in told.items() if value},
                )
                self.types.declare(topic.name, topic.type_name, topic.encoding)
            for type_name, written_as, text in index.definitions:
                self.types.define(type_name, written_as, text, index.hashes.get(type_name, ""))

    def received(self, numbers: Mapping[int, object]) -> Iterator[Received]:
        for file, index in enumerate(self._indexes):
            mine = {n: self._numbers[file, n] for n in index.topics}
            wanted = {n: number for n, number in mine.items() if number in numbers}
            for at, received_ns, data in sqlite_messages(index, wanted):
                plain = plain_message(data, index.topics[at].encoding)
                yield wanted[at], received_ns, received_ns, 0, plain


class HeldSource(MessageSource):
    """Messages in memory, serialised as ROS 2 does with standard definitions.

    messages: (topic, type, when received in ns, message).
    """

    def __init__(self, messages: Iterable[tuple[str, str, int, bytes]]) -> None:
        super().__init__()
        self._messages: list[tuple[int, int, bytes]] = []
        numbers: dict[str, int] = {}
        for topic, type_name, received_ns, data in messages:
            number = numbers.setdefault(topic, len(numbers))
            if number not in self.declarations:
                self.declarations[number] = Declaration(topic, type_name, "cdr", "ros2msg", b"")
                self.types.declare(topic, type_name, "cdr")
            self._counts[number] += 1
            self._messages.append((number, received_ns, data))

    def received(self, numbers: Mapping[int, object]) -> Iterator[Received]:
        for number, received_ns, data in self._messages:
            if number in numbers:
                yield number, received_ns, received_ns, 0, data
