"""Exceptions that a user may cause, each with its exit code."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

LONGEST_PLACE = 200
"""Characters of a key, topic or line that a message names; a hostile one has thousands."""


def shown(value: object, limit: int = 60) -> str:
    """A value as it is quoted in a message: one line, and never a screenful."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # of an integer of thousands of digits; of deep nesting
        text = f"<{type(value).__name__}>"
    return text if len(text) <= limit else f"{text[: limit - 4]}...{text[-1]}"


def printable(text: str) -> str:
    """A line of text, with what a terminal would obey and not show written out: ``\\x1b``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def nearest_name(given: object, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known name most similar to the given one; empty if none is as similar as the cutoff,
    the ratio of ``difflib.SequenceMatcher``, whose usual one is 0.6."""
    return next(iter(difflib.get_close_matches(str(given), list(known), 1, cutoff)), "")


def did_you_mean(given: object, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The end of a sentence about an unknown name: ``; did you mean 'x'?``, or nothing."""
    near = nearest_name(given, known, cutoff)
    return f"; did you mean {near!r}?" if near else ""


class SlamsimError(Exception):
    """Something that is told to the user in one sentence, without a traceback."""

    exit_code = 1

    def __init__(self, message: str = "") -> None:
        super().__init__("\n".join(map(printable, message.split("\n"))))


class InputRefused(SlamsimError):
    """A file from outside that is damaged, foreign, too large or wrong.

    path: the file. where: line, key, topic or byte inside it, as words. reason: what is wrong
    and what would be right. also: further faults found at the same time, a sentence each.
    limit: which of ``slamsim.guard.limits`` it goes beyond, by name, if it is one.
    """

    exit_code = 3

    def __init__(
        self,
        path: Path | str,
        reason: str,
        where: str = "",
        also: tuple[str, ...] = (),
        limit: str = "",
    ) -> None:
        self.path, self.also, self.limit = Path(path), also, limit
        place = where if len(where) <= LONGEST_PLACE else f"{where[:LONGEST_PLACE]}..."
        self.where = printable(place)
        self.reason = printable(" ".join(reason.split()))
        where = f"{path}, {self.where}" if where else f"{path}"
        super().__init__("\n".join((f"{where}: {self.reason}", *also)))


class Excessive(ValueError):
    """Larger than any sane input; the caller, which knows the file, makes an InputRefused of it.

    limit: which of ``slamsim.guard.limits`` it goes beyond, by name.
    """

    def __init__(self, reason: str, limit: str) -> None:
        self.limit = limit
        super().__init__(reason)


class DataDamaged(SlamsimError):
    """A file that slamsim wrote is no longer as it was written.

    path: the file. reason: how that was seen.
    """

    exit_code = 4

    def __init__(self, path: Path | str, reason: str) -> None:
        self.path, self.reason = Path(path), reason
        super().__init__(f"{path}: {reason}")


class OverrideRefused(SlamsimError):
    """An option of the command line whose value the configuration does not take.

    option: as it was typed. reason and also: as for InputRefused.
    """

    exit_code = 2

    def __init__(self, option: str, reason: str, also: tuple[str, ...] = ()) -> None:
        self.option, self.reason, self.also = option, reason, also
        super().__init__("\n".join((f"{option}: {reason}", *also)))


class OutputRefused(SlamsimError):
    """An output that would harm what the same command reads."""

    exit_code = 2


class NotFound(SlamsimError):
    """A file or a bundled name that does not exist."""

    exit_code = 10


class Locked(SlamsimError):
    """Another process is writing to the same folder."""

    exit_code = 11


class StoreFailed(SlamsimError):
    """The place of a data set cannot be read or written: no fault of any sequence."""


class DiskFull(SlamsimError):
    """The disk filled up; what stood under its final name before is untouched."""

    exit_code = 75


def limit_of(error: Exception) -> str:
    """Which limit an exception says was exceeded, or nothing."""
    return error.limit if isinstance(error, Excessive | InputRefused) else ""


def reason_of(error: Exception) -> str:
    """What went wrong, in one line: ours in its own words, any other with its type."""
    if isinstance(error, SlamsimError):
        return str(error)
    return f"{type(error).__name__}: {error}".splitlines()[0]
