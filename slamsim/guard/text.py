"""Reads text logs of users, plain or compressed, line by line within limits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from slamsim.guard.errors import Excessive, InputRefused
from slamsim.guard.files import open_input
from slamsim.guard.limits import LIMITS, Limits
from slamsim.guard.unpacking import Damaged, blocks

_BOM = b"\xef\xbb\xbf"


def open_lines(path: Path, limits: Limits = LIMITS) -> Iterator[tuple[int, str]]:
    """(1-based line number, line without its end) of a plain, gzip, bzip2 or zstd file.

    The first bytes decide which it is, not the name. Bytes that are not UTF-8 arrive as
    ``\\xNN``. Raises NotFound or InputRefused when the file cannot be opened, and InputRefused
    naming the line reached for a cut or damaged archive, a bomb, or a file that is not text.
    All whole lines before the damage are yielded first.
    """
    file = open_input(path)
    return _lines(path, file, limits)


def _lines(path: Path, file: BinaryIO, limits: Limits) -> Iterator[tuple[int, str]]:
    number, rest, total = 0, b"", 0
    with file:
        try:
            for block in blocks(file):
                total += len(block)
                require_proportion(total, number, file.tell(), limits)
                joined = rest + block
                suspect = b"\0" in joined or len(joined) > limits.text_line_bytes
                pieces = joined.split(b"\n")
                rest = pieces.pop()
                for piece in pieces:
                    if suspect:
                        _check_line(piece, limits)
                    number += 1
                    yield number, _decode(piece, number)
                if suspect:
                    _check_line(rest, limits)
        except (Damaged, Excessive) as damage:
            where = f"line {number + 1}"
            raise InputRefused(path, str(damage), where, limit=damage.limit) from None
        except OSError as error:
            reason = f"cannot be read: {error.strerror or error}"
            raise InputRefused(path, reason, f"line {number + 1}") from None
        if rest:
            yield number + 1, _decode(rest, number + 1)


def _decode(piece: bytes, number: int) -> str:
    if number == 1:
        piece = piece.removeprefix(_BOM)
    return piece.rstrip(b"\r").decode("utf-8", errors="backslashreplace")


def _check_line(piece: bytes, limits: Limits) -> None:
    if len(piece) > limits.text_line_bytes:
        reason = f"the line is longer than {limits.text_line_bytes:,} bytes"
        raise Damaged(reason, "text_line_bytes")
    if b"\0" in piece:
        raise Damaged("holds a NUL byte: this is not a text file")


def require_proportion(total: int, lines: int, packed: int, limits: Limits = LIMITS) -> None:
    """Raise Excessive for more text than belongs into this many bytes of a file, packed or not.

    total: bytes of text so far, in this many lines.
    """
    if total > limits.text_total_bytes:
        reason = f"more than {limits.text_total_bytes:,} bytes of text"
        raise Excessive(reason, "text_total_bytes")
    bomb = "unpacks to more text than a log of this size can hold"
    if lines > limits.text_lines_floor and lines > limits.text_lines_per_byte * packed:
        raise Excessive(bomb, "text_lines_per_byte")
    if total > limits.text_ratio_floor_bytes and total > limits.text_ratio * packed:
        raise Excessive(bomb, "text_ratio")
