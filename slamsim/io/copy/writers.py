"""Writers of copies: connections as declared, messages as serialised.

ROS 2 recordings, in MCAP and SQLite alike, become a rosbag2 folder with one MCAP file; a ROS 1 bag
stays one. The libraries of both formats write message by message.
"""

from __future__ import annotations

import tempfile
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from os import SEEK_CUR
from pathlib import Path
from types import MappingProxyType

import numpy as np
from mcap import records
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slamsim.io.bag1.reader import HEADER_BYTES, MAGIC
from slamsim.io.bag2.metadata import (
    DISTRO,
    OFFERED_QOS,
    BagFile,
    Topic,
    bag_metadata,
    quality_of_service,
    topic_as_declared,
    with_numbered_policies,
)
from slamsim.io.bag2.writer import MCAP_NAME, described
from slamsim.io.ros.message_types import normal_type_name, ros2_types
from slamsim.io.ros.parts import METADATA
from slamsim.io.ros.sources import Declaration
from slamsim.io.staged_writer import StagedWriter
from slamsim.recording.row_store import IN_MEMORY_BYTES, large_files_folder
from slamsim.recording.schemas import TRANSFORMS

Message = tuple[int, int, int, int, bytes]
"""(number of the publisher, log time, publish time, sequence, serialised message); times in ns"""


class Spool:
    """What grows beyond ``IN_MEMORY_BYTES`` goes to an unnamed file; the caller closes."""

    def __init__(self) -> None:
        folder = str(large_files_folder())
        self._file = tempfile.SpooledTemporaryFile(max_size=IN_MEMORY_BYTES, dir=folder)  # noqa: SIM115
        self._heads: list[tuple[int, int, int, int, int]] = []

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def put(self, number: int, log_ns: int, published_ns: int, sequence: int, data: bytes) -> None:
        self._heads.append((number, log_ns, published_ns, sequence, len(data)))
        self._file.write(data)

    def in_order(self) -> Iterator[Message]:
        """By log time; ties as they were put."""
        sizes = np.array([head[-1] for head in self._heads], dtype=np.int64)
        starts = (np.cumsum(sizes) - sizes).tolist()
        order = np.argsort(np.array([head[1] for head in self._heads]), kind="stable")
        for i in order.tolist():
            number, log_ns, published_ns, sequence, size = self._heads[i]
            self._file.seek(starts[i])
            yield number, log_ns, published_ns, sequence, self._file.read(size)


class Copy(StagedWriter):
    """A copy of a recording; a context manager. first_s, last_s: what its stamps can hold."""

    format: str
    first_s: int
    last_s: int

    @abstractmethod
    def declare(self, declaration: Declaration) -> int:
        """One more publisher; its number for ``put``."""

    @abstractmethod
    def declare_standard(self, topic: str, type_name: str, *, latched: bool) -> Declaration:
        """How a publisher of a type that comes with ROS is declared in this format."""

    @abstractmethod
    def put(self, number: int, log_ns: int, published_ns: int, sequence: int, data: bytes) -> None:
        """One more message."""


class Bag2Copy(Copy):
    """rosbag2: one MCAP file with all CRCs, metadata.yaml once it is whole.

    profile: of the MCAP file. custom, distro, topics: of metadata.yaml; topics that it does not
    announce are announced as they are declared.
    """

    format = "ROS 2"
    first_s, last_s = -(2**31), 2**31 - 1

    def __init__(
        self,
        folder: Path,
        profile: str,
        custom: Mapping[str, str],
        distro: str = DISTRO,
        topics: Mapping[str, Topic] = MappingProxyType({}),
    ) -> None:
        super().__init__()
        self._folder, self._custom, self._distro = folder, custom, distro
        self._topics = topics
        self._declared: dict[int, Declaration] = {}
        self._counts: Counter[str] = Counter()
        self._first_ns, self._last_ns = 0, 0
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        folder.mkdir(parents=True, exist_ok=True)
        stream = self._open.enter_context((folder / MCAP_NAME).open("xb"))
        self._writer = Writer(stream, enable_data_crcs=True)
        self._writer.start(profile=profile, library="slamsim")

    def put_metadata(self, record: records.Metadata) -> None:
        self._writer.add_metadata(record.name, record.metadata)

    def put_attachment(self, record: records.Attachment) -> None:
        self._writer.add_attachment(
            record.create_time, record.log_time, record.name, record.media_type, record.data
        )

    def declare(self, declaration: Declaration) -> int:
        definition = declaration.definition
        known = declaration.type_name in ros2_types().fielddefs
        if known and not definition and declaration.encoding == "cdr":  # older than ROS 2 Iron
            definition = described(declaration.type_name)[1].encode()
        metadata = with_numbered_policies(declaration.metadata)
        number = self._writer.register_channel(
            declaration.topic,
            declaration.encoding,
            self._schema(declaration.type_name, declaration.written_as, definition),
            metadata,
        )
        self._declared[number] = replace(declaration, metadata=metadata)
        return int(number)

    def _schema(self, name: str, written_as: str, definition: bytes) -> int:
        if not name:
            return 0  # a channel without a schema
        key = name, written_as, definition
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(name, written_as, definition)
        return self._schemas[key]

    def declare_standard(self, topic: str, type_name: str, *, latched: bool) -> Declaration:
        metadata = {OFFERED_QOS: quality_of_service(latched=latched)}
        definition = described(type_name)[1].encode()
        return Declaration(topic, type_name, "cdr", "ros2msg", definition, metadata=metadata)

    def put(self, number: int, log_ns: int, published_ns: int, sequence: int, data: bytes) -> None:
        if not self._counts:
            self._first_ns = log_ns
        self._first_ns, self._last_ns = min(self._first_ns, log_ns), max(self._last_ns, log_ns)
        self._counts[self._declared[number].topic] += 1
        self._writer.add_message(number, log_ns, data, published_ns, sequence)

    def _finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        topics = {each.topic: self._announced(each) for each in self._declared.values()}
        file = BagFile(MCAP_NAME, self._counts, (self._first_ns, self._last_ns))
        text = bag_metadata([file], list(topics.values()), self._custom, self._distro)
        (self._folder / METADATA).write_text(text, encoding="utf-8")

    def _announced(self, each: Declaration) -> Topic:
        declared = topic_as_declared(each.topic, each.type_name, each.metadata, each.encoding)
        return self._topics.get(each.topic, declared)


class _Bag1Writer(Bag1Writer):
    """With a header as long as that of ``rosbag``, 8 bytes longer than that of rosbags.

    ``rosbag`` writes it anew, at its own length, when it appends to a bag or reindexes one, and
    would overwrite the beginning of the first chunk.
    """

    def open(self) -> None:
        super().open()
        assert self.bio is not None
        self.bio.write(b" " * (len(MAGIC) + 8 + HEADER_BYTES - self.bio.tell()))

    def close(self) -> None:
        super().close()
        with self.path.open("r+b") as file:
            file.seek(len(MAGIC))
            length = int.from_bytes(file.read(4), "little")
            file.seek(length, SEEK_CUR)
            file.write((HEADER_BYTES - length).to_bytes(4, "little"))


class Bag1Copy(Copy):
    """A ROS 1 bag of this name in a folder."""

    format = "ROS 1"
    first_s, last_s = 0, 2**31 - 1  # rosbags has the times of messages as signed numbers

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__()
        folder.mkdir(parents=True, exist_ok=True)
        self._writer = self._open.enter_context(_Bag1Writer(folder / name))
        self._declared: list[Declaration] = []

    def declare(self, declaration: Declaration) -> int:
        if declaration in self._declared:  # the format has each publisher once
            return self._declared.index(declaration)
        latching = declaration.metadata.get("latching", "")
        self._writer.add_connection(
            declaration.topic,
            normal_type_name(declaration.type_name),
            msgdef=declaration.definition.decode(),
            md5sum=declaration.md5sum or "*",
            callerid=declaration.metadata.get("callerid"),
            latching=int(latching) if latching.isdigit() else None,
        )
        self._declared.append(declaration)
        return len(self._declared) - 1

    def declare_standard(self, topic: str, type_name: str, *, latched: bool) -> Declaration:
        store = get_typestore(Stores.ROS1_NOETIC)
        if type_name == TRANSFORMS:  # which rosbags does not count among them
            text = "geometry_msgs/TransformStamped[] transforms"
            store.register(get_types_from_msg(text, type_name))
        definition, md5sum = store.generate_msgdef(type_name)
        metadata = {"latching": "1"} if latched else {}
        ros1 = "ros1", "ros1msg", definition.encode(), md5sum
        return Declaration(topic, type_name, *ros1, metadata)

    def put(self, number: int, log_ns: int, published_ns: int, sequence: int, data: bytes) -> None:
        self._writer.write(self._writer.connections[number], log_ns, data)
