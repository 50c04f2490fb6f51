"""Progress reports of a production."""

from __future__ import annotations

from typing import Protocol

from slamsim.dataset.make.shard import Tried


class ProductionWatch(Protocol):
    """A listener; called from the thread that runs the production."""

    def begin(self, total: int, already: int) -> None:
        """So many sequences there are to be; so many of them were there."""

    def made(self, tried: Tried) -> None:
        """One more is there."""

    def tried(self, index: int, reason: str, tries: int) -> None:
        """One did not succeed and will be tried again."""

    def failed(self, index: int, reason: str, command: str) -> None:
        """One is given up."""

    def still(self) -> None:
        """Nothing has happened for a moment."""

    def catalogue(self) -> None:
        """Every sequence is there or given up; now what stands beside them is written."""


class Unwatched:
    """The listener that does nothing."""

    def begin(self, total: int, already: int) -> None: ...

    def made(self, tried: Tried) -> None: ...

    def tried(self, index: int, reason: str, tries: int) -> None: ...

    def failed(self, index: int, reason: str, command: str) -> None: ...

    def still(self) -> None: ...

    def catalogue(self) -> None: ...
