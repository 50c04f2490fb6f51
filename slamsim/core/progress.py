"""Progress of a long stage, reported through a callback."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, float], None]
"""Called with (done, total) in the stage's own unit, as often as the stage likes; an infinite total
is one that is not known."""


def silent(done: float, total: float) -> None:
    """The listener that does nothing."""
