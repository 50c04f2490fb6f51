"""Destinations of the messages of a simulation: a file, viewers, other programs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from slamsim.io.ros.encoding import Outgoing


class Sink(AbstractContextManager[Any], Protocol):
    """Takes messages of declared topics in the order of their arrival, until its block ends."""

    def add(self, streams: Sequence[Outgoing]) -> None:
        """The next messages of some topics, to be kept until their time has come."""
        ...

    def release(self, until_ns: int | None) -> None:
        """Pass on what has arrived by then, or all of it."""
        ...
