"""Changes that know words and lines, and archives of text packed again after."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable

import numpy as np
from fault_changes import PLAIN
from fault_seeds import Change, Unfit

WORDS = (
    *("nan", "inf", "-inf", "-1", "0", "-0.0", "1e999", "-1e308", "1e308", "1e-320", "1_000"),
    *("9" * 400, "9223372036854775807", "9223372036854775808", "18446744073709551616", "1e18"),
    *("0x10", "+5", "٣", "１", "1e5", "00012", "1.7e9", "1", "2", "3.5", "", "#", "é", "\u202e"),
    *("FLASER", "ODOM", "PARAM", "ROBOTLASER1", "RAWLASER2", "true", "null", "~", "\t", "'", "{"),
)


def change_words(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four words replaced, lost, doubled or exchanged."""
    lines = _lines(data)
    for _ in range(int(rng.integers(1, 5))):
        line = int(rng.integers(len(lines)))
        words = lines[line].split(" ")
        place, other = (int(i) for i in rng.integers(0, len(words), 2))
        kind = int(rng.integers(6))
        if kind == 0:
            del words[place]
        elif kind == 1:
            words.insert(place, words[other])
        elif kind == 2:
            words[place], words[other] = words[other], words[place]
        else:
            words[place] = WORDS[int(rng.integers(len(WORDS)))]
        lines[line] = " ".join(words)
    return _joined(lines)


def change_column(data: bytes, rng: np.random.Generator) -> bytes:
    """The same word of all lines that begin alike, counted from either end."""
    lines = _lines(data)
    first = lines[int(rng.integers(len(lines)))].split(" ")
    place = int(rng.integers(-len(first), len(first)))
    word = WORDS[int(rng.integers(len(WORDS)))]
    for i, line in enumerate(lines):
        words = line.split(" ")
        if words[0] == first[0] and -len(words) <= place < len(words):
            words[place] = word
            lines[i] = " ".join(words)
    return _joined(lines)


def change_lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Lines lost, doubled, exchanged, all in another order."""
    lines, kind = _lines(data), int(rng.integers(5))
    a, b = (int(i) for i in rng.integers(0, len(lines), 2))
    if kind == 0:
        del lines[min(a, b) : max(a, b) + 1]
    elif kind == 1:
        lines[a:a] = [lines[b]] * int(rng.integers(1, 50))
    elif kind == 2:
        lines[a], lines[b] = lines[b], lines[a]
    elif kind == 3:
        lines = lines[::-1]
    else:
        lines = [lines[i] for i in rng.permutation(len(lines)).tolist()]
    return _joined(lines)


TEXT: tuple[Change, ...] = (change_words, change_column, change_lines)


def packed_again(
    pack: Callable[[bytes], bytes], unpack: Callable[[bytes], bytes], changes: tuple[Change, ...]
) -> Change:
    """The content of an archive changed; or the archive in several parts, or packed twice."""

    def repack(data: bytes, rng: np.random.Generator) -> bytes:
        content = unpack(data)
        kind = int(rng.integers(8))
        if kind == 0:
            cut = int(rng.integers(0, len(content)))
            return pack(content[:cut]) + pack(content[cut:])
        if kind == 1:
            return pack(pack(content))
        return pack(changes[int(rng.integers(len(changes)))](content, rng))

    return repack


in_gzip = packed_again(gzip.compress, gzip.decompress, (*TEXT, *PLAIN))
in_bzip2 = packed_again(bz2.compress, bz2.decompress, (*TEXT, *PLAIN))


def _lines(data: bytes) -> list[str]:
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise Unfit from error
    if not text:
        raise Unfit
    return text.split("\n")


def _joined(lines: list[str]) -> bytes:
    return "\n".join(lines).encode()
