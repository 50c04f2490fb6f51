"""Opens ROS 1 and ROS 2 recordings, checked before they are read.

A ROS 2 recording is a folder with metadata.yaml, a single .mcap or a single .db3; a ROS 1
recording is a .bag. Topics are found by their type, never by their name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from slamsim.logs.bag1_check import check_bag1
from slamsim.logs.bag_limits import check_definitions, check_qos
from slamsim.logs.bag_sources import Channel, McapSource, MessageSource, RosbagsSource
from slamsim.logs.mcap_read import index_mcap
from slamsim.logs.refusing import refusing
from slamsim.logs.sqlite_check import check_sqlite
from slamsim.safe.errors import InputRefused
from slamsim.safe.files import own_file
from slamsim.safe.yaml import load_yaml

_METADATA = "metadata.yaml"


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """A recording whose bytes were found sound. metadata: MCAP metadata records by name."""

    path: Path
    source: MessageSource
    channels: tuple[Channel, ...]
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def of_type(self, *type_names: str) -> list[Channel]:
        """The non-empty topics of these types, the one with the most messages first."""
        found = [c for c in self.channels if c.type_name in type_names and c.messages]
        return sorted(found, key=lambda channel: (-channel.messages, channel.topic))

    def raw(self, topic: str) -> Iterator[bytes]:
        """The serialised messages of one topic; InputRefused on damage or if some are missing."""
        for _, _, data in self.received({topic}):
            yield data

    def messages(self, topics: Iterable[str]) -> Iterator[Any]:
        """The messages of the topics in the order of recording; raises as ``raw`` does."""
        wanted = set(topics)
        where = f"topic {', '.join(sorted(wanted))}"
        for topic, _, data in self.received(wanted) if wanted else ():
            with refusing(self.path, where):
                message = self.source.deserialize(topic, data)
            yield message

    def deserialize(self, topic: str, data: bytes) -> Any:
        """One message; InputRefused if the bytes are none."""
        with refusing(self.path, f"topic {topic}"):
            return self.source.deserialize(topic, data)

    def received(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        """(topic, when it was received in ns, serialised message); raises as ``raw`` does."""
        expected = sum(c.messages for c in self.channels if c.topic in topics)
        seen = 0
        with refusing(self.path, f"topic {', '.join(sorted(topics))}"):
            for topic, received_ns, data in self.source.raw(topics):
                seen += 1
                yield topic, received_ns, data
            if seen != expected:
                raise ValueError(f"the index leads to {seen} of {expected} messages")


def open_bag(path: Path) -> Bag:
    """Checks the files and lists the topics; raises InputRefused or NotFound."""
    files, announced, compressed = _files(path) if path.is_dir() else ([path], None, False)
    kinds = {file.suffix.lower() for file in files}
    if kinds == {".mcap"}:
        if compressed:
            raise InputRefused(path, "messages compressed one by one in an MCAP are not read")
        bag = _mcap_bag(path, files)
    elif kinds in ({".db3"}, {".bag"}):
        bag = _rosbags_bag(path, files, compressed)
    else:
        names = ", ".join(file.name for file in files) or "no file"
        raise InputRefused(path, f"{names}: .mcap or .db3 files belong into a recording")
    found = sum(channel.messages for channel in bag.channels)
    if announced not in (None, found):
        raise InputRefused(
            path / _METADATA, f"announces {announced:,} messages, the files hold {found:,}"
        )
    return bag


def _mcap_bag(path: Path, files: list[Path]) -> Bag:
    indexes = [index_mcap(file) for file in files]
    metadata = {name: entries for index in indexes for name, entries in index.metadata.items()}
    with refusing(path, "channels"):
        source = McapSource(indexes)
        return Bag(path, source, tuple(source.channels()), metadata)


def _rosbags_bag(path: Path, files: list[Path], compressed: bool) -> Bag:
    facts = [
        check_bag1(file) if file.suffix.lower() == ".bag" else check_sqlite(file, compressed)
        for file in files
    ]
    with refusing(path, "message definitions"):
        check_definitions(definition for fact in facts for definition in fact.definitions)
    with refusing(path, "index"):
        source = RosbagsSource(path)
    indexed, found = sum(c.messages for c in source.channels()), sum(f.messages for f in facts)
    if indexed != found:
        raise InputRefused(path, f"the index knows {indexed:,} messages, {found:,} are there")
    return Bag(path, source, tuple(source.channels()))


def _files(folder: Path) -> tuple[list[Path], int, bool]:
    """(files, number of messages announced, whether each is compressed) by metadata.yaml."""
    metadata = own_file(folder, _METADATA)
    document = load_yaml(metadata).data
    with refusing(metadata, "rosbag2_bagfile_information"):
        if not isinstance(document, dict):
            raise ValueError("no mapping")
        information = document["rosbag2_bagfile_information"]
        mode = str(information.get("compression_mode") or "").lower()
        announced = int(information["message_count"])
        names = [PurePath(str(name)).name for name in information["relative_file_paths"]]
        files = [own_file(folder, name) for name in names]
        for topic in information["topics_with_message_count"]:
            check_qos(str(topic["topic_metadata"].get("offered_qos_profiles", "")))
    if mode == "file":
        raise InputRefused(metadata, "its files are compressed as a whole: unpack them first")
    return files, announced, mode == "message"
