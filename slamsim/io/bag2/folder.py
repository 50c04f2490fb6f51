"""Writes a rosbag2 folder: one MCAP file, and metadata.yaml when it is complete."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from mcap import records

from slamsim.core.types import IntArray
from slamsim.guard.files import read_input
from slamsim.io.bag2.metadata import BagFile, Topic, bag_metadata, dump_yaml, quality_of_service
from slamsim.io.mcap.writer import McapFile, MessageBatch
from slamsim.io.ros.cdr import Rows
from slamsim.io.ros.standard_types import ros2_types
from slamsim.io.staged_writer import StagedWriter

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
                dump_yaml(topic.quality_of_service),
            )
            for topic in self._topics
        }

    def batch(self, topic: str, log_ns: IntArray, rows: Rows) -> MessageBatch:
        """Messages of one topic and one size, to be handed to ``write``."""
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
