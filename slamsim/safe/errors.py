"""The exceptions that a user may cause, each with its exit code."""

from __future__ import annotations

from pathlib import Path


class SlamsimError(Exception):
    """Something that is told to the user in one sentence, without a traceback."""

    exit_code = 1


class InputRefused(SlamsimError):
    """A file from outside that is damaged, foreign, too large or wrong.

    path: the file. where: line, key, topic or byte inside it, as words. reason: what is wrong
    and what would be right.
    """

    exit_code = 3

    def __init__(self, path: Path | str, reason: str, where: str = "") -> None:
        self.path, self.where, self.reason = Path(path), where, reason
        place = f"{path}, {where}" if where else f"{path}"
        super().__init__(f"{place}: {reason}")


class NotFound(SlamsimError):
    """A file or a bundled name that does not exist."""

    exit_code = 10


class Locked(SlamsimError):
    """Another process is writing to the same folder."""

    exit_code = 11


class DiskFull(SlamsimError):
    """The disk filled up; what stood under its final name before is untouched."""

    exit_code = 75
