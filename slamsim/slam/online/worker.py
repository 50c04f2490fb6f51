"""The process that solves beside a session: ``python -m slamsim.slam.online.worker``.

It is sent its task and then key frames on standard input, and answers with news on standard
output. When its parent is gone, standard input ends, and so does it.
"""

from __future__ import annotations

import os
from queue import SimpleQueue
from typing import BinaryIO, cast

from slamsim.process.module_process import answers, listen, requests, tell
from slamsim.process.pipe import journal_messages
from slamsim.slam.backend.back_end import BackEnd
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.online.messages import Done, Finish, News, Task
from slamsim.slam.online.sync_back_end import Changes, outcome_of

_YIELDING = 10
"""Niceness: where cores are few, the session's next scan comes before the next solution."""


def serve(messages: SimpleQueue[object], stream: BinaryIO) -> None:
    """Do as told, one message after the other, until the outcome is delivered."""

    def take(keyframe: Keyframe) -> None:
        kept = len(back_end.kept)
        back_end.take(keyframe)
        correction = back_end.correction()
        assert correction is not None
        new = tuple(back_end.kept[kept:])
        closures = back_end.new_closures()
        moved = changes.of(back_end.poses)
        tell(stream, News(keyframe.index, new, correction, closures, moved))

    task = cast(Task, messages.get())
    back_end, changes = BackEnd(task.config), Changes()
    journal = [cast(Keyframe, k) for k in journal_messages(task.journal, task.journal_bytes)]
    earlier = [keyframe for keyframe in journal if keyframe.index <= task.taken]
    back_end.restore(earlier, task.closures, set(task.kept))
    for keyframe in journal[len(earlier) :]:
        take(keyframe)
    while not isinstance(message := messages.get(), Finish):
        take(cast(Keyframe, message))

    def progress(done: float, total: float) -> None:
        tell(stream, Done(done / max(total, 1.0)))

    tell(stream, outcome_of(back_end, progress))


def main() -> None:
    """Entry point of the process."""
    os.nice(_YIELDING)
    stream = answers()
    messages: SimpleQueue[object] = SimpleQueue()
    listen(requests(), messages.put)
    try:
        serve(messages, stream)
    except BrokenPipeError:
        return


if __name__ == "__main__":
    main()
