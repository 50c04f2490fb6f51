"""Base class of all writers: files are complete at the end, or discarded."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Self


class StagedWriter:
    """Files being written; a context manager.

    When its block ends, ``_finish`` writes what is known only then, and what ``_open`` holds is
    closed. After an exception it is closed alone: the caller discards the files.
    """

    def __init__(self) -> None:
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is not None:
            self._open.__exit__(*error)
            return
        with self._open:
            self._finish()

    def _finish(self) -> None:
        """Write the rest."""
