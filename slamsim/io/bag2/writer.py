"""Writes a rosbag2 folder, one MCAP file and metadata.yaml: a recording of any format, or one that
grows during a simulation.

The log time of a simulation's file is true time: a message is logged when it arrives, and the file
is in the order of arrival. Stamps inside the messages are acquisition times on each sensor's own
clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from mcap import records

from slamsim.core.types import Float32Array, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.files import read_input
from slamsim.io.bag2.metadata import BagFile, Topic, bag_metadata, quality_of_service
from slamsim.io.mcap.writer import McapFile, MessageBatch
from slamsim.io.ros.encoding import Outgoing, outgoing
from slamsim.io.ros.layouts import Rows
from slamsim.io.ros.message_types import ros2_types
from slamsim.io.staged_writer import StagedWriter
from slamsim.recording import RawScans, Recording
from slamsim.recording.edits.frames import with_odometry_edge


def as_ros(recording: Recording) -> Recording:
    """A CARMEN log in the words of REP 105 and REP 117; anything else as it is.

    Its laser lines carry the pose, which ROS asks the transform tree for, and write their
    maximum where nothing came back, which ROS takes for a wall.
    """
    if recording.format != "carmen":
        return recording
    found = recording.changed(RawScans, _without_maximum)
    for odometry in recording.odometries[:1]:
        found = with_odometry_edge(found, odometry)
    return found


def _without_maximum(scans: RawScans) -> RawScans:
    limits_m = [scans.layout(scan).range_max_m for scan in range(len(scans))]
    rows = [_freed(row, limit) for row, limit in zip(scans.ranges_m, limits_m, strict=True)]
    as_array = isinstance(scans.ranges_m, np.ndarray)
    return replace(scans, ranges_m=np.array(rows) if as_array and rows else rows)


def _freed(ranges_m: Float32Array, limit_m: float) -> Float32Array:
    return np.where(ranges_m >= np.float32(limit_m), np.float32(np.inf), ranges_m)


_WINDOW_BYTES = 32 << 20
_LARGEST_SECOND = 2**31 - 1


def write_recording(recording: Recording, folder: Path, attached: Sequence[Path] = ()) -> None:
    """Write into a folder, new or empty, what a recording holds.

    What ROS says in other words than the recording's format is written in these. attached: files
    that travel along in the MCAP file.

    Every stream keeps its order: a message that was received before the one above it is written
    as received with that one. Of several frames that the messages of one stream name, the
    first is written. Call it inside ``partial_folder``: after an exception the folder is
    unfinished. Raises SlamsimError for stamps that ROS 2 cannot write.
    """
    recording = as_ros(recording)
    streams = _named([o for o in outgoing(recording) if o.log_ns.size])
    _require_stamps(recording)
    kinds = {o.topic: TopicKind(o.topic, o.type_name, o.latched) for o in streams}
    custom = {"epoch": recording.epoch}
    with BagFolder(folder, list(kinds.values()), custom, attached) as bag:
        for begin_ns, end_ns in _windows(streams):
            batches = []
            for stream in streams:
                first, end = np.searchsorted(stream.log_ns, [begin_ns, end_ns]).tolist()
                if first < end:
                    rows = stream.rows(np.arange(first, end))
                    batches.append(bag.batch(stream.topic, stream.log_ns[first:end], rows))
            bag.write(batches)


def _windows(streams: list[Outgoing]) -> Iterator[tuple[int, int]]:
    """(begin, end) of log time, end excluded, that hold about as many bytes each."""
    if not streams:
        return
    log_ns = np.concatenate([stream.log_ns for stream in streams])
    sizes = np.repeat([o.message_bytes for o in streams], [o.log_ns.size for o in streams])
    order = np.argsort(log_ns, kind="stable")
    filled = np.cumsum(sizes[order]) // _WINDOW_BYTES
    first = np.flatnonzero(np.diff(filled, prepend=-1))
    begins = np.unique(log_ns[order][first])
    ends = np.append(begins[1:], int(log_ns.max()) + 1)
    yield from zip(begins.tolist(), ends.tolist(), strict=True)


def _named(streams: list[Outgoing]) -> list[Outgoing]:
    """Topics as ROS names them, each of one type: CARMEN has one line for scan and odometry."""
    taken: dict[str, str] = {}
    named = []
    for stream in streams:
        topic = stream.topic if stream.topic.startswith("/") else f"/{stream.topic}"
        if taken.setdefault(topic, stream.type_name) != stream.type_name:
            topic = f"{topic}/{stream.type_name.rsplit('/', maxsplit=1)[-1].lower()}"
            taken[topic] = stream.type_name
        named.append(replace(stream, topic=topic))
    return named


def _require_stamps(recording: Recording) -> None:
    stamps: list[tuple[str, IntArray]] = [
        (stream.topic, stream.stamps_ns) for stream in recording.streams
    ]
    for topic, stamps_ns in stamps:
        if stamps_ns.size and np.abs(stamps_ns).max() > _LARGEST_SECOND * 1_000_000_000:
            raise SlamsimError(
                f"{topic}: a stamp of {np.abs(stamps_ns).max() / 1e9:.0f} s cannot be written, "
                f"ROS 2 counts to {_LARGEST_SECOND} s"
            )


MCAP_NAME = "log_0.mcap"
METADATA_RECORD = "slamsim"


@dataclass(frozen=True, slots=True)
class TopicKind:
    """latched: a late subscriber still gets the last message."""

    name: str
    type_name: str
    latched: bool = False


@cache
def described(type_name: str) -> tuple[str, str]:
    """(hash, definition) of a message type."""
    store = ros2_types()
    return store.hash_rihs01(type_name), store.generate_msgdef(type_name, ros_version=2)[0]


class BagFolder(StagedWriter):
    """Writes into an existing or new folder; a context manager.

    custom: what else shall stand in the file. attached: files that travel along in it. After an
    exception inside the block the file ends where it stands, without an index: the folder is then
    unfinished, and the caller discards it. A killed writer loses at most the open chunk of
    1 MiB; closed ones reach the disk every second.
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[TopicKind],
        custom: Mapping[str, str],
        attached: Sequence[Path] = (),
    ) -> None:
        super().__init__()
        self._folder, self._custom = folder, custom
        self._topics = [
            Topic(
                kind.name,
                kind.type_name,
                described(kind.type_name)[0],
                quality_of_service(latched=kind.latched),
            )
            for kind in topics
        ]
        folder.mkdir(parents=True, exist_ok=True)
        self._stream = self._open.enter_context((folder / MCAP_NAME).open("xb"))
        self._file = McapFile(self._stream, {METADATA_RECORD: custom})
        for path in attached:
            data = read_input(path, "attachment_bytes")
            self._file.put_attachment(
                records.Attachment(0, 0, path.name, "application/octet-stream", data)
            )
        self._ids = {
            topic.name: self._file.add_channel(
                topic.name,
                topic.type_name,
                described(topic.type_name)[1],
                topic.quality_of_service,
            )
            for topic in self._topics
        }

    def batch(self, topic: str, log_ns: IntArray, rows: Rows) -> MessageBatch:
        """Messages of one topic and one size, to be handed to ``write``. log_ns: (n,)."""
        return MessageBatch(self._ids[topic], log_ns, rows.view(np.uint8).reshape(rows.size, -1))

    def write(self, batches: Sequence[MessageBatch]) -> None:
        """As ``McapFile.write``."""
        self._file.write(batches)

    def _finish(self) -> None:
        """Only what is whole gets an index and metadata.yaml."""
        self._file.finish()
        file = BagFile(MCAP_NAME, self._file.counts, self._file.time_range_ns)
        text = bag_metadata([file], self._topics, self._custom)
        (self._folder / "metadata.yaml").write_text(text, encoding="utf-8")


class GrowingBag(StagedWriter):
    """A recording being written into an existing or new folder; a context manager.

    custom: what else shall stand in the file. After an exception inside the block the file ends
    where it stands, without an index: the folder is then unfinished, and the caller discards
    it. A killed writer loses at most the open chunk of 1 MiB; closed ones reach the disk every
    second.
    """

    def __init__(
        self, folder: Path, topics: Sequence[TopicKind], custom: Mapping[str, str]
    ) -> None:
        super().__init__()
        self._bag = self._open.enter_context(BagFolder(folder, topics, custom))
        self._held: dict[str, list[MessageBatch]] = {topic.name: [] for topic in topics}

    def add(self, streams: Sequence[Outgoing]) -> None:
        """The next messages of some topics."""
        for stream in streams:
            if stream.log_ns.size:
                rows = stream.rows(slice(None))
                self._held[stream.topic].append(self._bag.batch(stream.topic, stream.log_ns, rows))

    def release(self, until_ns: int | None) -> None:
        """Write what has arrived by then, or all of it, and keep the rest until its time comes."""
        ready = []
        for topic, batches in self._held.items():
            late = []
            for batch in batches:
                count = batch.log_ns.size
                if until_ns is not None:
                    count = int(np.searchsorted(batch.log_ns, until_ns, side="right"))
                ready.append(batch.select(slice(0, count)))
                late.append(batch.select(slice(count, None)))
            self._held[topic] = [batch for batch in late if batch.log_ns.size]
        self._bag.write(ready)

    def _finish(self) -> None:
        self.release(None)
