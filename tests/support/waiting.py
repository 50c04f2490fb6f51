"""Tests wait for what must come true, never for a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import count
from typing import Literal, TypeVar

TIMEOUT_S = 180.0
"""Far longer than anything takes on a busy machine: twenty seconds of checking took a minute."""

Found = TypeVar("Found")


def first_of(receive: Callable[[float], Found | None], send: Callable[[int], object]) -> Found:
    """What is received first of things that are sent, each with its number, until one arrives."""
    numbers = count()

    def arrived() -> Found | None:
        send(next(numbers))
        return receive(0.02)

    return wait_for(arrived)


def wait_for(wanted: Callable[[], Found | Literal[False] | None]) -> Found:
    """What it returns, as soon as that counts as true."""
    end_s = time.monotonic() + TIMEOUT_S
    while not (found := wanted()):
        assert time.monotonic() < end_s, f"it did not happen within {TIMEOUT_S:.0f} s"
        time.sleep(0.01)
    return found
