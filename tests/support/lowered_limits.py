"""Lower limits for input files, while a test needs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from slamsim.guard.limits import LIMITS


@contextmanager
def lowered(**limits: float) -> Iterator[None]:
    """The fields of ``LIMITS`` with other values in the block, and as before after it."""
    before = {name: getattr(LIMITS, name) for name in limits}
    try:
        for name, value in limits.items():
            object.__setattr__(LIMITS, name, value)
        yield
    finally:
        for name, value in before.items():
            object.__setattr__(LIMITS, name, value)
