"""What a user is told of a robot elsewhere: each event once, as it begins and as it ends."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.reader import is_read

SILENCE_S = 5.0
"""Without a scan for so long, that is told: every lidar turns at least twice a second."""
_LOOK_S = 5.0
"""How often topics that appeared meanwhile are looked for."""


class Silence:
    """No scans come. is_on: whether that is so."""

    def __init__(self) -> None:
        self._scan_s, self.is_on = time.monotonic(), False

    def scan_came(self) -> None:
        """Just now."""
        self._scan_s = time.monotonic()

    def news(self) -> Iterator[str]:
        """What is to be told since the last call."""
        silent_s = time.monotonic() - self._scan_s
        if self.is_on != (silent_s > SILENCE_S):
            self.is_on = not self.is_on
            yield f"no scan for {silent_s:.0f} s" if self.is_on else "scans come again"


class LateTopics:
    """Topics that appear after the map was begun, which nothing is done with."""

    def __init__(self, topics: Iterable[str]) -> None:
        self._known, self._looked_s = set(topics), time.monotonic()

    def is_due(self) -> bool:
        """Whether it is time to look for topics again."""
        return time.monotonic() - self._looked_s > _LOOK_S

    def news(self, there: Iterable[TopicKind]) -> Iterator[str]:
        """What is to be told since the last call."""
        self._looked_s = time.monotonic()
        late = {t.name for t in there if is_read(t.name, t.type_name)} - self._known
        self._known |= late
        if late:
            names = " and ".join(sorted(late))
            yield f"{names} appeared late: not mapped, checked or recorded until a new start"
