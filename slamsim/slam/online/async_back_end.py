"""The back end in a process of its own, for GTSAM holds Python's lock while it solves.

The session sends key frames and reads news, and waits for neither. Key frames are written to an
unnamed temporary file as well: if the process dies, a new one begins with what is in it and with
the closures known by then, and meanwhile the session drifts with its odometry.
"""

from __future__ import annotations

import tempfile
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.progress import Progress, silent
from slamsim.core.result import Event, GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.process.children import Halted
from slamsim.process.module_process import ModuleProcess
from slamsim.process.pipe import Ended, journal_messages, packed
from slamsim.slam.backend.back_end import BackEnd
from slamsim.slam.backend.correction import Correction
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.online.messages import Done, Finish, News, Task
from slamsim.slam.online.sync_back_end import BackEndOutcome, SyncBackEnd

MAX_RESTARTS = 3
"""A back end that ends more often than this is not begun again."""

_ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": str(1 << 20)}
"""glibc: what a solution takes for a moment goes back to the system. Without this, its limit grows
with the largest array ever freed, and the heap with it."""


class AsyncBackEnd:
    """A ``MapKeeper`` that hands everything to another process.

    ``behind`` tells how many key frames that process has not dealt with yet.
    """

    def __init__(self, config: SlamConfig) -> None:
        self._config = config
        self._journal = tempfile.TemporaryFile(prefix="slamsim-keyframes-")  # noqa: SIM115
        self._kept = array("q")
        self._closures: list[GraphEdge] = []
        self._correction: Correction | None = None
        self._poses: FloatArray | None = None
        self._outcome: BackEndOutcome | None = None
        self._alone: SyncBackEnd | None = None
        self._happened: list[Event] = []
        self._told = 0
        self._last_ns = 0
        self._taken = self._restarts = 0
        self._answered = -1
        self._child: ModuleProcess | None = None
        self._begin()

    @property
    def behind(self) -> int:
        """Key frames sent and not yet answered."""
        return self._taken - 1 - self._answered

    @property
    def taken(self) -> int:
        """Key frames so far."""
        return self._taken

    @property
    def kept(self) -> int:
        """Of them, those that the map is made of."""
        return len(self._kept)

    @property
    def closures(self) -> int:
        """Closures that are known to hold the map together."""
        return len(self._closures)

    @property
    def process_id(self) -> int | None:
        """Of the process, None while there is none."""
        return None if self._child is None else self._child.pid

    def take(self, keyframe: Keyframe) -> None:
        """See ``MapKeeper``."""
        data = packed(keyframe)
        self._journal.write(data)
        self._taken, self._last_ns = self._taken + 1, keyframe.stamp_ns
        if self._child is not None:
            self._child.send(data)

    def correction(self) -> Correction | None:
        """See ``MapKeeper``."""
        self._read(silent)
        return self._correction

    def changed(self) -> tuple[IntArray, FloatArray] | None:
        """See ``MapKeeper``."""
        poses, self._poses = self._poses, None
        return None if poses is None else (np.array(self._kept[: len(poses)], np.int64), poses)

    def events(self) -> tuple[Event, ...]:
        """See ``MapKeeper``."""
        new = tuple(self._happened[self._told :])
        self._told += len(new)
        return new

    def finish(self, progress: Progress) -> BackEndOutcome:
        """See ``MapKeeper``. Waits until the process has dealt with everything."""
        self._ask()
        while self._outcome is None and self._child is not None:
            before = self._restarts
            try:
                self._child.wait()
                self._read(progress)
            except Halted:
                self._begin_again()
            if self._restarts != before:
                self._ask()
        outcome = self._outcome or self._chain_alone(progress)
        return replace(outcome, events=(*outcome.events, *self._happened))

    def keyframes(self) -> Sequence[Keyframe]:
        """See ``MapKeeper``."""
        if self._alone is not None:
            return self._alone.keyframes()
        back_end = BackEnd(self._config)
        back_end.restore(self._journalled(), (), set(self._kept))
        return back_end.keyframes

    def _journalled(self) -> Iterator[Keyframe]:
        self._journal.flush()
        for keyframe in journal_messages(self._journal.fileno(), self._journal.tell()):
            yield cast(Keyframe, keyframe)

    def _chain_alone(self, progress: Progress) -> BackEndOutcome:
        """What is left when no process will stay: all key frames, and no closures."""
        closures = self._config.back_end.closures.model_copy(update={"enabled": False})
        back_end = self._config.back_end.model_copy(update={"closures": closures})
        keeper = SyncBackEnd(self._config.model_copy(update={"back_end": back_end}))
        for keyframe in self._journalled():
            keeper.take(keyframe)
        self._alone = keeper
        return keeper.finish(progress)

    def close(self) -> None:
        """See ``MapKeeper``."""
        self._end()
        self._journal.close()

    def _ask(self) -> None:
        if self._child is not None:
            self._child.send(packed(Finish()))

    def _read(self, progress: Progress) -> None:
        """Take in all news; begin a new process if this one is gone."""
        if self._child is None:
            return
        try:
            for message in self._child.receive():
                self._heed(message, progress)
        except Ended:
            self._begin_again()

    def _heed(self, message: object, progress: Progress) -> None:
        if isinstance(message, News):
            self._answered, self._correction = message.taken, message.correction
            self._kept.extend(message.kept)
            self._closures.extend(message.closures)
            if message.poses is not None:
                self._poses = message.poses
        elif isinstance(message, Done):
            progress(message.share, 1.0)
        else:
            self._outcome = cast(BackEndOutcome, message)

    def _begin(self) -> None:
        self._journal.flush()
        descriptor = self._journal.fileno()
        self._child = ModuleProcess("slamsim.slam.online.worker", _ALLOCATOR, (descriptor,))
        task = Task(
            self._config,
            journal=descriptor,
            journal_bytes=self._journal.tell(),
            taken=self._answered,
            kept=self._kept,
            closures=self._closures,
        )
        self._child.send(packed(task))

    def _begin_again(self) -> None:
        code = self._end()
        self._restarts += 1
        again = self._restarts <= MAX_RESTARTS
        after = f"begun again from {self._taken} key frames" if again else "not begun again"
        words = f"the process that closes loops ended with code {code}: {after}"
        self._happened.append(Event(self._last_ns, self._last_ns, "torn", words))
        if again:
            self._begin()

    def _end(self) -> int | None:
        """End the process, whatever it is doing; its exit code."""
        child, self._child = self._child, None
        return None if child is None else child.end()
