"""Checksum files that list other files and protect themselves.

``SHA256SUMS`` tells of the files of a folder; ``sha256sum -c`` reads it, too. In a data set it
tells of those beside the sequences, and the ``sequence.json`` of each sequence of its own.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

SUMS, SEQUENCE = "SHA256SUMS", "sequence.json"
_OWN = "# of the lines above: "
_OWN_WORDS = (b"# of the", b"lines", b"above:")
_SEQUENCE_WORDS = (b'\n "files": [', b'\n "sha256": "')
"""More than damage of a few bytes makes unreadable."""
_LINE = re.compile(r"([0-9a-f]{64})  ([^\n]+)")


class SumsDamaged(ValueError):
    """The file is not as it was written."""


def sha256_of(data: bytes) -> str:
    """In hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sums_text(hashes: Mapping[str, str]) -> str:
    """path -> SHA-256 in hexadecimal. Its last line, a comment, is the checksum of the others."""
    lines = "".join(f"{hashes[path]}  {path}\n" for path in sorted(hashes))
    return f"{lines}{_OWN}{sha256_of(lines.encode())}\n"


def read_sums(data: bytes) -> dict[str, str]:
    """Raises SumsDamaged unless every byte is as ``sums_text`` wrote it."""
    text = data.decode("utf-8", "replace")
    lines = map(_LINE.fullmatch, text.split("\n"))
    hashes = {line[2]: line[1] for line in lines if line is not None}
    if sums_text(hashes).encode() != data or not all(map(_is_below, hashes)):
        raise SumsDamaged(f"{SUMS} is not as it was written")
    return hashes


def sequence_text(told: Mapping[str, Any]) -> str:
    """JSON whose last value, ``sha256``, is the checksum of the others. told: has ``files``."""
    return _dumped({**told, "sha256": sha256_of(_dumped(told).encode())})


def read_sequence(data: bytes) -> dict[str, Any]:
    """Raises SumsDamaged unless every byte is as ``sequence_text`` wrote it."""
    try:
        told = {name: value for name, value in json.loads(data).items() if name != "sha256"}
        if sequence_text(told).encode() == data and _lists_files(told):
            return told
    except (ValueError, TypeError, AttributeError, RecursionError):
        pass
    raise SumsDamaged(f"{SEQUENCE} is not as it was written")


def is_ours(name: str, data: bytes) -> bool:
    """Whether we wrote this, perhaps otherwise, and not another program that uses the same name."""
    if name == SEQUENCE:
        return any(words in data for words in _SEQUENCE_WORDS)
    last = data.rstrip(b"\n").rpartition(b"\n")[2]
    is_hash = _LINE.fullmatch(last.decode("utf-8", "replace")) is not None
    return not is_hash and any(words in last for words in _OWN_WORDS)


def hashes_in(name: str, data: bytes) -> dict[str, str]:
    """SHA-256 by path, of either file. Raises SumsDamaged."""
    if name == SUMS:
        return read_sums(data)
    return {file["path"]: file["sha256"] for file in read_sequence(data)["files"]}


def _lists_files(told: Mapping[str, Any]) -> bool:
    files = told.get("files")
    return isinstance(files, list) and all(
        {"path", "sha256"} <= file.keys() and _is_below(file["path"]) for file in files
    )


def _is_below(path: str) -> bool:
    """Whether this is a path of a file in the same folder, or of one in a folder of it."""
    return not path.startswith("/") and ".." not in path.split("/")


def _dumped(told: Mapping[str, Any]) -> str:
    return json.dumps(told, indent=1, allow_nan=False) + "\n"
