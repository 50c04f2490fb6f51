"""Opens ROS 1 and ROS 2 recordings, checked before they are read.

A ROS 2 recording is a folder with metadata.yaml, the numbered parts of one without it, a single
.mcap or a single .db3; a ROS 1 recording is a .bag. Topics are found by their type, never by their
name.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any, Self

from slamsim.guard.errors import InputRefused, shown
from slamsim.guard.files import own_file
from slamsim.guard.unpacking import PACKINGS, unpack
from slamsim.guard.yaml import load_yaml
from slamsim.io.bag1.reader import index_bag1, sampled_bag1
from slamsim.io.bag2.sqlite import index_sqlite
from slamsim.io.bag2.writer import METADATA_RECORD
from slamsim.io.input_errors import as_input_errors, damaged
from slamsim.io.mcap.reader import McapIndex, index_mcap
from slamsim.io.mcap.summary import sampled_mcap
from slamsim.io.ros.parts import METADATA, numbered_parts, require_one_recording
from slamsim.io.ros.sources import (
    Bag1Source,
    Channel,
    McapSource,
    MessageSource,
    Received,
    SqliteSource,
)
from slamsim.recording.row_store import large_files_folder


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """A recording whose bytes were found sound; a context manager, in which it can be read.

    metadata: MCAP metadata records by name. unpacked_into: the temporary folder of files that are
    packed, which goes in the end.
    """

    path: Path
    source: MessageSource
    channels: tuple[Channel, ...]
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    unpacked_into: Path | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.unpacked_into is not None:
            rmtree(self.unpacked_into, ignore_errors=True)

    def of_type(self, *type_names: str) -> list[Channel]:
        """The non-empty topics of these types, the one with the most messages first."""
        found = [c for c in self.channels if c.type_name in type_names and c.messages]
        return sorted(found, key=lambda channel: (-channel.messages, channel.topic))

    def deserialize(self, topic: str, data: bytes) -> Any:
        """One message; InputRefused if the bytes are none."""
        with as_input_errors(self.path, f"topic {topic}"):
            return self.source.deserialize(topic, data)

    def is_cdr(self, topic: str) -> bool:
        """Whether its messages are plain ROS 2 serialisations of the standard type; InputRefused
        if its definition is none."""
        with as_input_errors(self.path, f"topic {topic}"):
            return self.source.is_cdr(topic)

    def received(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        """(topic, when it was received in ns, serialised message).

        Raises InputRefused on damage, or if some are missing.
        """
        declared = self.source.declarations
        for number, received_ns, _, _, data in self.everything(topics):
            yield declared[number].topic, received_ns, data

    def everything(self, topics: Container[str] | None = None) -> Iterator[Received]:
        """All messages, or those of some topics, as recorded; raises as ``received`` does."""
        names = {n: each.topic for n, each in self.source.declarations.items()}
        return self._of({n: t for n, t in names.items() if topics is None or t in topics})

    def _of(self, names: Mapping[int, str]) -> Iterator[Received]:
        """names: topics by the number of their declarations."""
        if not names:
            return
        topics = set(names.values())
        expected = sum(c.messages for c in self.channels if c.topic in topics)
        seen = 0
        with as_input_errors(self.path, f"topic {', '.join(sorted(topics))}"):
            for message in self.source.received(names):
                seen += 1
                yield message
            if seen != expected:
                raise ValueError(f"the index leads to {seen} of {expected} messages")


def custom_data(bag: Bag) -> dict[str, str]:
    """What a recording says besides its messages (``ros2 bag record --custom-data``): as its
    metadata.yaml has it, of a file alone what slamsim wrote into it."""
    if not (bag.path / METADATA).is_file():
        return dict(bag.metadata.get(METADATA_RECORD, {}))
    document: Any = load_yaml(bag.path / METADATA).data  # as ``open_bag`` found it
    told = document["rosbag2_bagfile_information"].get("custom_data")
    return {str(n): str(v) for n, v in told.items()} if isinstance(told, dict) else {}


def open_bag(path: Path, *, is_sampled: bool = False) -> Bag:
    """Checks the files and lists the topics; raises InputRefused or NotFound.

    is_sampled: for a first look, whose source gives only some messages of each topic. Packed files
    are unpacked into a temporary folder.
    """
    files, announced = _files(path) if path.is_dir() else ([path], None)
    if files and all(file.suffix.lower() in PACKINGS for file in files):
        return _packed_bag(path, files, announced, is_sampled=is_sampled)
    return _checked_bag(path, files, announced, is_sampled=is_sampled)


def _packed_bag(path: Path, files: list[Path], announced: int | None, *, is_sampled: bool) -> Bag:
    """What is refused is refused in the name of the packed file."""
    folder = Path(mkdtemp(dir=large_files_folder(), prefix="slamsim-unpacked-"))
    plain = {}
    try:
        for number, file in enumerate(files):
            place = folder / str(number)
            place.mkdir()
            plain[place / file.stem] = file
            unpack(file, place / file.stem)
        bag = _checked_bag(path, list(plain), announced, is_sampled=is_sampled)
    except BaseException as error:
        rmtree(folder, ignore_errors=True)
        if isinstance(error, InputRefused) and error.path in plain:
            reason = error.reason.partition("; `slamsim recover")[0]
            named = plain[error.path]
            raise InputRefused(named, reason, error.where, limit=error.limit) from None
        raise
    return replace(bag, unpacked_into=folder)


def _checked_bag(path: Path, files: list[Path], announced: int | None, *, is_sampled: bool) -> Bag:
    kinds = {file.suffix.lower() for file in files}
    if kinds == {".mcap"}:
        found = [sampled_mcap(file) if is_sampled else index_mcap(file) for file in files]
        spans_ns = [index.span_ns for index in found]
        bag = _mcap_bag(path, found)
    elif kinds == {".db3"}:
        indexes = [index_sqlite(file, is_sampled=is_sampled) for file in files]
        spans_ns = [each.span_ns for each in indexes]
        bag = _bag(path, SqliteSource(indexes))
    elif kinds == {".bag"} and len(files) == 1:
        index = sampled_bag1(files[0]) if is_sampled else index_bag1(files[0])
        bag, spans_ns = _bag(path, Bag1Source(index)), [None]
    else:
        names = ", ".join(file.name for file in files) or "no file"
        raise InputRefused(path, f"{names}: .mcap or .db3 files belong into a recording")
    if announced is None:
        require_one_recording(path, files, spans_ns)
    total = sum(channel.messages for channel in bag.channels)
    if announced not in (None, total):
        raise damaged(path, f"{METADATA} announces {announced:,} messages, there are {total:,}")
    return bag


def _mcap_bag(path: Path, indexes: list[McapIndex]) -> Bag:
    metadata = {each.name: each.metadata for index in indexes for each in index.metadata}
    with as_input_errors(path, "channels"):
        source = McapSource(indexes)
    return replace(_bag(path, source), metadata=metadata)


def _bag(path: Path, source: MessageSource) -> Bag:
    channels = tuple(source.channels())
    for channel in channels:
        if not (channel.topic.strip() and f"{channel.topic}{channel.type_name}".isprintable()):
            name = shown(channel.topic)
            raise InputRefused(
                path, f"the topic {name} or its type is not a valid name: damaged or malicious"
            )
    return Bag(path, source, channels)


def _files(folder: Path) -> tuple[list[Path], int | None]:
    """(files, number of messages announced) by metadata.yaml; without one by the names of files."""
    metadata = own_file(folder, METADATA)
    if not metadata.exists():
        return numbered_parts(folder), None
    document = load_yaml(metadata).data
    with as_input_errors(metadata, "rosbag2_bagfile_information"):
        if not isinstance(document, dict):
            raise ValueError("no mapping")
        information = document["rosbag2_bagfile_information"]
        mode = str(information.get("compression_mode") or "").lower()
        announced = int(information["message_count"])
        names = [PurePath(str(name)).name for name in information["relative_file_paths"]]
        if mode == "file":
            names = [_packed_name(folder, name) for name in names]
        files = [own_file(folder, name) for name in names]
        plain = [name for name in names if not name.lower().endswith(PACKINGS)]
        if mode == "file" and plain:
            raise ValueError(f"compression_mode is file, but {plain[0]} is not compressed")
    return files, announced


def _packed_name(folder: Path, name: str) -> str:
    """Of a file that is compressed as a whole; metadata written too early names it without."""
    packed = (f"{name}{suffix}" for suffix in PACKINGS if not (folder / name).exists())
    return next((each for each in packed if (folder / each).exists()), name)
