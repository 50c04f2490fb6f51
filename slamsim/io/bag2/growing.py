"""Writes a recording during a simulation: a rosbag2 folder with one MCAP file.

The file's log time is true time: a message is logged when it arrives, and the file is in the
order of arrival. Stamps inside the messages are acquisition times on each sensor's own clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from slamsim.io.bag2.folder import BagFolder, TopicKind
from slamsim.io.mcap.writer import MessageBatch
from slamsim.io.ros.encoding import Outgoing
from slamsim.io.staged_writer import StagedWriter


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
                ready.append(_part(batch, slice(0, count)))
                late.append(_part(batch, slice(count, None)))
            self._held[topic] = [batch for batch in late if batch.log_ns.size]
        self._bag.write(ready)

    def _finish(self) -> None:
        self.release(None)


def _part(batch: MessageBatch, which: slice) -> MessageBatch:
    return MessageBatch(batch.channel, batch.log_ns[which], batch.data[which])
