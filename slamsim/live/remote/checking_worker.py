"""The process that checks beside a live robot: ``python -m slamsim.live.remote.checking_worker``.

When its parent is gone, standard input ends, and so does it.
"""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path
from threading import Condition
from typing import cast

from slamsim.check.check import check_recording
from slamsim.check.wording import warning
from slamsim.guard.errors import SlamsimError
from slamsim.io.selection import selected
from slamsim.live.hub import Message
from slamsim.live.remote.checking import (
    KEPT_BYTES,
    KEPT_NS,
    PERIOD_NS,
    CheckBegin,
    LiveFinding,
)
from slamsim.live.remote.received import BACK_NS, recording_of
from slamsim.process.module_process import answers, listen, requests, tell
from slamsim.process.pipe import read_message

_NICENESS = 10
"""The map comes first."""


class _Kept:
    """The newest messages, and the last one of each topic that is said once. Those that wait count
    too while a check goes on, so that memory stays bounded."""

    def __init__(self) -> None:
        self._messages: deque[Message] = deque()
        self._latched: dict[str, Message] = {}
        self._bytes = 0
        self._checked_ns = 0
        self._changed = Condition()

    def take(self, messages: tuple[Message, ...]) -> None:
        """What arrived next; nothing stands for a gap, before which nothing counts any more."""
        with self._changed:
            if not messages:
                self._clear()
            for message in messages:
                self._add(message)
            self._changed.notify()

    def due(self) -> list[Message]:
        """All that is kept, once a period has passed."""
        with self._changed:
            self._changed.wait_for(self._is_due)
            self._checked_ns = self._messages[-1].log_ns
            return [*self._latched.values(), *self._messages]

    def _is_due(self) -> bool:
        newest = self._messages[-1] if self._messages else None
        return newest is not None and newest.log_ns - self._checked_ns >= PERIOD_NS

    def _clear(self) -> None:
        self._messages.clear()
        self._bytes = self._checked_ns = 0

    def _add(self, message: Message) -> None:
        if message.topic.latched:
            self._latched[message.topic.name] = message
            return
        if self._messages and message.log_ns < self._messages[-1].log_ns - BACK_NS:
            self._clear()  # the clock of arrival was set back
        self._checked_ns = self._checked_ns or message.log_ns
        self._messages.append(message)
        self._bytes += len(message.data)
        oldest_ns = message.log_ns - KEPT_NS
        while self._bytes > KEPT_BYTES or self._messages[0].log_ns < oldest_ns:
            self._bytes -= len(self._messages.popleft().data)


def main() -> None:
    """Until standard input ends."""
    os.nice(_NICENESS)
    incoming = requests()
    begin, kept, stream = cast(CheckBegin, read_message(incoming)), _Kept(), answers()
    listen(incoming, kept.take)
    while True:
        tell(stream, _checked(begin, kept.due()))


def _checked(begin: CheckBegin, messages: list[Message]) -> tuple[LiveFinding, ...] | SlamsimError:
    try:
        recording = recording_of(begin.name, messages)
        report = check_recording(selected(recording, begin.wanted, Path(begin.name)))
    except SlamsimError as error:
        return error
    return tuple(
        LiveFinding((f.check, f.subject), f.fault or "", warning(f)) for f in report.faults
    )


if __name__ == "__main__":
    main()
