"""Checksums beside everything that slamsim wrote, compared when it is read.

A folder is sealed by ``SHA256SUMS``, a sequence of a data set by its ``sequence.json``: written
last, they hold the hash of every other file, and of themselves.

``sha256sum -c`` reads ``SHA256SUMS``, too. In a data set it tells of the files beside the
sequences, and the ``sequence.json`` of each sequence of its own; both protect themselves.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from slamsim.guard.errors import DataDamaged, InputRefused
from slamsim.guard.limits import LIMITS

WRITTEN_BY_US = ".slamsim"
"""A folder that holds a file of this name is ours."""

_HASHED_TOGETHER = 4
_RECOVERABLE = frozenset((".mcap", ".log", ".clf", ".gz", ".bz2"))
_NEW_NS = 1_000_000_000
_SEALS_KEPT, _DIGESTS_KEPT = 1024, 1 << 16

_Identity = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Seal:
    """hashes: SHA-256 by path, relative to folder. name: of the file that they stand in."""

    folder: Path
    name: str
    hashes: Mapping[str, str]


def seal_folder(folder: Path) -> None:
    """Write ``SHA256SUMS`` of all that is in a folder; raises OSError."""
    paths = [folder / name for name in files_in(folder)]
    with ThreadPoolExecutor(_HASHED_TOGETHER) as threads:
        digests = threads.map(digest, paths)
        hashes = {
            path.relative_to(folder).as_posix(): found
            for path, found in zip(paths, digests, strict=True)
        }
    (folder / SUMS).write_bytes(sums_text(hashes).encode())


def files_in(folder: Path) -> list[str]:
    """Every file below a folder but its own ``SHA256SUMS``, relative to it, sorted."""
    found = [
        (Path(root) / name).relative_to(folder).as_posix()
        for root, _, names in os.walk(folder)
        for name in names
    ]
    return sorted(name for name in found if name != SUMS)


def require_as_written(path: Path) -> None:
    """Raise DataDamaged for a file that a seal tells of and that is not as the seal has it.

    A file without a seal is not slamsim's. One that was found as it is to be is read again
    only after it has changed. Raises InputRefused for a seal that is larger than any.
    """
    for where in names_of(path):
        for folder in where.parents:
            if (seal := seal_in(folder)) is None:
                continue
            name = where.relative_to(folder).as_posix()
            if (sha256 := seal.hashes.get(name)) is not None:
                if where.exists() and _digest(where, _identity(where)) != sha256:
                    raise DataDamaged(path, _altered(seal, where))
                return


def require_complete(folder: Path) -> None:
    """Raise DataDamaged if a seal tells of a file in this folder that is not there."""
    found = seal_over(folder)
    if found is None:
        return
    seal, part = found
    for name in seal.hashes:
        if is_within(part, name) and not (seal.folder / name).exists():
            reason = f"missing; `slamsim verify {seal.folder}` tells what else is"
            raise DataDamaged(seal.folder / name, reason)


def seal_over(path: Path) -> tuple[Seal, str] | None:
    """The nearest seal that tells of a file or of something in a folder, and what it calls that.

    Raises DataDamaged for a damaged seal.
    """
    for where in names_of(path):
        for folder in (where, *where.parents):
            seal, name = seal_in(folder), where.relative_to(folder).as_posix()
            if seal is not None and any(is_within(name, told) for told in seal.hashes):
                return seal, name
    return None


def is_within(folder: str, name: str) -> bool:
    """Whether a file is this one, or lies in this folder; ``.``: the sealed folder itself."""
    return folder in (".", name) or name.startswith(f"{folder}/")


def seal_in(folder: Path) -> Seal | None:
    """The seal of a folder, or nothing if it has none. Raises DataDamaged if it is damaged."""
    for name in (SUMS, SEQUENCE):
        path = folder / name
        with suppress(OSError):
            if seal := _seal(path, _identity(path)):
                return seal
    return None


def digest(path: Path) -> str:
    """SHA-256 of a file in hexadecimal; raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def names_of(path: Path) -> Iterator[Path]:
    """Where a file lies as it was named, and where it lies in truth."""
    named = Path(os.path.abspath(path))  # noqa: PTH100 - resolve would follow the links
    yield named
    if (real := Path(os.path.realpath(path))) != named:
        yield real


def _identity(path: Path) -> _Identity:
    """Another one after any change.

    The clock of a file system stands still for some milliseconds, in which a second change could
    not be told: a file that was changed just now is another one at each look.
    """
    facts = path.stat()
    is_new = abs(time.time_ns() - facts.st_ctime_ns) < _NEW_NS
    return (
        time.monotonic_ns() if is_new else 0,
        facts.st_dev,
        facts.st_ino,
        facts.st_size,
        facts.st_mtime_ns,
        facts.st_ctime_ns,
        facts.st_mode,
    )


@lru_cache(maxsize=_DIGESTS_KEPT)
def _digest(path: Path, _: _Identity) -> str:
    return digest(path)


@lru_cache(maxsize=_SEALS_KEPT)
def _seal(path: Path, _: _Identity) -> Seal | None:
    if not path.is_file():
        return None
    with path.open("rb") as file:
        data = file.read(LIMITS.sums_bytes + 1)
    if len(data) > LIMITS.sums_bytes:
        reason = (
            f"is longer than {LIMITS.sums_bytes:,} bytes, which is too long for this kind of file"
        )
        raise InputRefused(path, reason, limit="sums_bytes")
    if not ((path.parent / WRITTEN_BY_US).is_file() or is_ours(path.name, data)):
        return None
    try:
        return Seal(path.parent, path.name, hashes_in(path.name, data))
    except SumsDamaged as error:
        reason = f"{error}, so there are no checksums of the folder {path.parent}"
        raise DataDamaged(path, reason) from None


def _altered(seal: Seal, path: Path) -> str:
    way_out = "make it again"
    if path.suffix in _RECOVERABLE:
        way_out += f", or `slamsim recover {shlex.quote(str(path))}` gets back what is whole"
    return (
        f"has changed since slamsim wrote it; {way_out}; if it was changed on purpose, copy it out "
        f"of the folder {seal.folder} (`slamsim verify {seal.folder}` tells what else is damaged)"
    )


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
