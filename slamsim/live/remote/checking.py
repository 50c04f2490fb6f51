"""The checker beside a live robot, in a process of its own.

The child is ``python -m slamsim.live.remote.checking_worker``. It is sent messages as they arrive,
keeps the newest of them, and every half a minute asks all questions about those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self, cast

from slamsim.guard.errors import SlamsimError
from slamsim.io.selection import Selection
from slamsim.live.hub import Message
from slamsim.process.module_process import ModuleProcess
from slamsim.process.pipe import Ended, packed

PERIOD_NS = 30_000_000_000
"""Between two checks: faults of mounts and clocks show after half a minute with turns."""
KEPT_NS = 120_000_000_000
"""What a check looks at: a minute or two settles nearly every question, in seconds."""
KEPT_BYTES = 256 << 20
LARGEST_BACKLOG = 64 << 20
"""Bytes that wait for a checker that does not keep up."""


@dataclass(frozen=True, slots=True)
class CheckBegin:
    """name: of the robot, for messages. wanted: the topics that are checked."""

    name: str
    wanted: Selection


@dataclass(frozen=True, slots=True)
class LiveFinding:
    """A fault of the last minutes. key: the same for the same fault of the same subject."""

    key: tuple[str, str]
    fault: str
    words: str


class CheckingProcess:
    """A context manager: the process ends with its block. findings: the faults of the last check.

    A checker that fails costs no map: that is told, and nothing is checked any more.
    """

    def __init__(self, name: str, wanted: Selection) -> None:
        self._child = ModuleProcess("slamsim.live.remote.checking_worker")
        self._child.send(packed(CheckBegin(name, wanted)))
        self._told: set[object] = set()
        self._is_over = self._has_gap = False
        self.checks = 0
        self.findings: tuple[LiveFinding, ...] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._child.end()

    def take(self, messages: Sequence[Message]) -> None:
        """What arrived since the last call; returns at once. A checker that does not keep up begins
        anew once it has caught up, for messages left out would look like a fault of the robot."""
        if not messages or self._is_over:
            return
        unsent_bytes = self._child.unsent_bytes
        if unsent_bytes > LARGEST_BACKLOG:
            self._has_gap = True
        elif not (self._has_gap and unsent_bytes):
            if self._has_gap:
                self.begin_anew()
            self._child.send(packed(tuple(messages)))

    def begin_anew(self) -> None:
        """Forget what was taken, but for latched topics: messages are missing or time went back."""
        self._has_gap = False
        if not self._is_over:
            self._child.send(packed(()))

    def news(self) -> list[str]:
        """Sentences on what was found since the last call, each fault once."""
        try:
            answers = [] if self._is_over else self._child.receive()
        except Ended:
            self._is_over = True
            return ["the checker ended, so this robot is not checked any more"]
        news = []
        for answer in answers:
            if isinstance(answer, SlamsimError):
                words = f"not checked: {answer}"
                news += [words] if words not in self._told else []
                self._told.add(words)
                continue
            self.checks += 1
            self.findings = cast(tuple[LiveFinding, ...], answer)
            news += [one.words for one in self.findings if one.key not in self._told]
            self._told |= {one.key for one in self.findings}
        return news
