"""The messages of a robot that runs elsewhere on disk: a rosbag2 folder as any recorder writes."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from slamsim.guard.output import discard, free_bytes, partial_folder
from slamsim.io import LOG
from slamsim.io.bag2.writer import BagFolder, TopicKind
from slamsim.live.hub import Message

RESERVE_BYTES = 128 << 20
"""Left free on the disk, for the index of the recording and the map."""
_LOOK_S = 1.0
"""How often the free space of the disk is looked at."""


class MessageRecording:
    """A recording that is being written, until ``finish``; ``folder`` appears when it is whole.

    latched: messages that were said before it began, and hold on.
    """

    def __init__(
        self, folder: Path, topics: Iterable[TopicKind], latched: Iterable[Message]
    ) -> None:
        self.folder = folder
        kinds = list(topics)
        self._names = {kind.name for kind in kinds}
        self._latched = list(latched)
        self.messages = 0
        folder.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            partial = opened.enter_context(partial_folder(folder))
            bag = BagFolder(partial / LOG, kinds, {"epoch": "unknown"})
            self._bag = opened.enter_context(bag)
            self._open = opened.pop_all()

    def write(self, messages: Iterable[Message]) -> None:
        """What arrived next; of topics that are not recorded nothing is written."""
        arrived = [message for message in messages if message.topic.name in self._names]
        if not arrived:
            return
        began, self._latched = self._latched, []
        batches = []
        for message in (*began, *arrived):
            log_ns = np.array([max(message.log_ns, arrived[0].log_ns)])
            row = np.frombuffer(message.data, np.dtype((np.void, len(message.data))))
            batches.append(self._bag.batch(message.topic.name, log_ns, row))
        self._bag.write(batches)
        self.messages += len(batches)

    def finish(self) -> Path | None:
        """Its folder, whole and sealed; None, and nothing is left, where no message came. Raises
        SlamsimError where the disk does not suffice."""
        if not self.messages:
            self.discard()
            return None
        self._open.close()
        return self.folder

    def discard(self) -> None:
        """Leave nothing behind."""
        discard(self._open)


class Recordings:
    """One after the other. folders: of all, the last perhaps not whole yet."""

    def __init__(self, parent: Path) -> None:
        self._parent = parent
        self._current: MessageRecording | None = None
        self._looked_s = 0.0
        self.folders: list[Path] = []

    @property
    def folder(self) -> Path | None:
        """The one that is being written."""
        return None if self._current is None else self._current.folder

    def begin(self, topics: Iterable[TopicKind], latched: Iterable[Message]) -> Path:
        """The folder that is being written, a new one unless there is one already."""
        if self._current is None:
            folder = self._parent / f"drive_{len(self.folders) + 1}"
            self._current = MessageRecording(folder, topics, latched)
            self.folders.append(folder)
        return self._current.folder

    def write(self, messages: Iterable[Message]) -> Path | None:
        """What arrived next. Its folder where the recording had to end, whole, because the disk is
        nearly full."""
        if self._current is None:
            return None
        self._current.write(messages)
        if time.monotonic() - self._looked_s < _LOOK_S:
            return None
        self._looked_s = time.monotonic()
        return self.end() if free_bytes(self._parent) < RESERVE_BYTES else None

    def end(self) -> Path | None:
        """The folder that is whole now, None if there was none or nothing came. Raises SlamsimError
        where the disk does not suffice."""
        current, self._current = self._current, None
        if current is None:
            return None
        finished = None
        try:
            finished = current.finish()
        finally:
            if finished is None:
                self.folders.remove(current.folder)
        return finished
