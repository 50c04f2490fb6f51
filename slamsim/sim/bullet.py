"""PyBullet without the line that it prints to standard error when it is imported."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from slamsim.guard.errors import SlamsimError

STANDARD_ERROR = 2


@contextmanager
def _quiet() -> Iterator[None]:
    """PyBullet's library writes to the file descriptor, past ``sys.stderr``."""
    kept = os.dup(STANDARD_ERROR)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, STANDARD_ERROR)
        yield
    finally:
        os.dup2(kept, STANDARD_ERROR)
        os.close(kept)
        os.close(nowhere)


with _quiet():
    import pybullet

__all__ = ["physics_client", "pybullet"]


@contextmanager
def physics_client() -> Iterator[int]:
    """A PyBullet world of its own; gone when the block ends.

    Raises SlamsimError if there can be none.
    """
    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise SlamsimError("PyBullet could not start a physics world")
    try:
        yield client
    finally:
        pybullet.disconnect(client)
