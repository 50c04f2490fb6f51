"""Rebuilds a CARMEN log from its complete lines."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

from slamsim.core.progress import Progress
from slamsim.guard.errors import Excessive, InputRefused
from slamsim.guard.files import open_as_found
from slamsim.guard.limits import LIMITS
from slamsim.guard.unpacking import require_proportion
from slamsim.io.carmen.lines import MEASURING, LaserLine, OdomLine, parse_line
from slamsim.io.salvage.report import Recovered, RecoveryReport, recovered
from slamsim.io.salvage.source import Damaged
from slamsim.io.salvage.text_pieces import BZIP2_MAGIC, GZIP_MAGIC, Hole, Text, text_pieces

_Out = IO[bytes] | gzip.GzipFile | bz2.BZ2File
_BY_SUFFIX = {".gz": "gz", ".bz2": "bz2"}


def recover_carmen(source: Damaged, folder: Path, progress: Progress) -> Recovered:
    """Into a new file of the same name and compression.

    A line is whole if it ends, and reads as a CARMEN message or a comment. Those that measure
    something are counted.
    """
    (path,) = source.files
    report, target, compression = RecoveryReport(path), folder / path.name, _compression(path)
    with open_as_found(path) as file, _written(target, compression) as out:
        lines = _Lines(out, report)
        for piece in text_pieces(file, compression):
            if isinstance(piece, Hole):
                lines.interrupt(piece)
            else:
                lines.take(piece)
                progress(piece.read, source.bytes)
        lines.finish(source.bytes, is_whole=compression != "")
    report.packed_bytes = source.bytes - sum(loss.bytes for loss in report.losses)
    return recovered(target, [report])


class _Lines:
    """Cuts text into lines and keeps the whole ones."""

    def __init__(self, out: _Out, report: RecoveryReport) -> None:
        self._out, self._report = out, report
        self._rest = b""
        self._is_inside = False
        self._number, self._total = 0, 0

    def take(self, text: Text) -> None:
        """The next piece of text."""
        self._total += len(text.data)
        try:
            require_proportion(self._total, self._number, text.read)
        except Excessive as error:
            raise InputRefused(self._report.path, str(error), limit=error.limit) from None
        *lines, self._rest = (self._rest + text.data).split(b"\n")
        for line in lines:
            self._number += 1
            if self._is_inside:
                self._is_inside = False
            else:
                self._keep(line, text.read)
        if len(self._rest) > LIMITS.text_line_bytes:
            self._drop(text.read, "a line without an end")

    def interrupt(self, hole: Hole) -> None:
        """The line before has no end, the next one no beginning."""
        if hole.is_suspect:
            name = self._report.path.name
            self._report.note(f"{name}: numbers in the lines before the damage may be wrong")
        self._report.lose(hole.first_byte, hole.bytes, hole.reason)
        self._rest, self._is_inside = b"", True

    def finish(self, read: int, *, is_whole: bool) -> None:
        """is_whole: whether the last line needs no end."""
        if self._rest and is_whole and not self._is_inside:
            self._keep(self._rest, read)
        elif self._rest:
            self._drop(read, "the last line has no end")

    def _keep(self, line: bytes, read: int) -> None:
        words = line.decode("utf-8-sig", errors="replace").split()
        try:
            found = _parsed(words, line)
        except ValueError as error:
            gone = {words[0]: 1} if words and words[0] in MEASURING else {}
            self._report.lose(read - len(line), len(line), f"line {self._number}: {error}", gone)
            return
        self._out.write(line + b"\n")
        if found is not None:
            self._report.keep(words[0], 1, len(line), (found.stamp_ns, found.stamp_ns))

    def _drop(self, read: int, reason: str) -> None:
        self._report.lose(read - len(self._rest), len(self._rest), reason, {})
        self._rest, self._is_inside = b"", True


def _parsed(words: list[str], line: bytes) -> LaserLine | OdomLine | None:
    """What a line measures, if it measures anything; ValueError unless it is a whole line."""
    if b"\0" in line or len(line) > LIMITS.text_line_bytes:
        raise ValueError("not a line of text")
    return parse_line(words) if words and not words[0].startswith("#") else None


def _compression(path: Path) -> str:
    """By the first bytes; by the name where they are damaged."""
    with open_as_found(path) as file:
        first = file.read(3)
    by_bytes = {GZIP_MAGIC: "gz", BZIP2_MAGIC: "bz2"}
    return by_bytes.get(first) or _BY_SUFFIX.get(path.suffix.lower(), "")


@contextmanager
def _written(target: Path, compression: str) -> Iterator[_Out]:
    with ExitStack() as files:
        stream = files.enter_context(target.open("xb"))
        if compression == "gz":
            yield files.enter_context(gzip.GzipFile("", "wb", fileobj=stream, mtime=0))
        elif compression == "bz2":
            yield files.enter_context(bz2.BZ2File(stream, "wb"))
        else:
            yield stream
