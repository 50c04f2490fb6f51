"""Decides, by reading alone, which names an output may take and what it may replace.

An output never is, contains or lies in what the same command reads, and never replaces what
slamsim cannot tell to be its own. Nothing on the disk is changed here.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from slamsim.guard.errors import DataDamaged, NotFound, OutputRefused, SlamsimError, shown
from slamsim.guard.lock import staging_of
from slamsim.guard.seal import SEQUENCE, SUMS, WRITTEN_BY_US, seal_in, seal_over

_MOST_NAMED = 3
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")

_Identity = tuple[int, int] | str
"""Device and inode of what is there, the name of what is not."""


def require_replaceable_folder(final: Path, overwrite: bool) -> None:
    """Raise SlamsimError unless a folder may get this name, or take the place of what has it."""
    if not os.path.lexists(final):
        return
    if final.is_symlink() or not final.is_dir():
        raise SlamsimError(f"{final} is there already and is not a folder; choose another name")
    if not any(final.iterdir()):
        return
    if not (final / WRITTEN_BY_US).is_file():
        raise SlamsimError(
            f"{final} holds files that slamsim did not write, which --overwrite does not replace; "
            "choose another name for the output"
        )
    if not overwrite:
        raise SlamsimError(
            f"{final} is there already; choose another name, or replace it by --overwrite"
        )
    if others := _unlisted(final):
        raise SlamsimError(
            f"{final} is not replaced: {_named(others)} in it, which its {SUMS} does not list, "
            "would be lost; move them away, or choose another name for the output"
        )


def require_replaceable_file(final: Path, overwrite: bool) -> None:
    """Raise SlamsimError unless a file may get this name, or take the place of the one there."""
    if os.path.lexists(final):
        if not stat.S_ISREG(final.lstat().st_mode):
            raise SlamsimError(f"{final} is there already and is not a file; choose another name")
        if not overwrite:
            raise SlamsimError(
                f"{final} is there already; choose another name, or replace it by --overwrite"
            )
    is_seal = final.name in (SUMS, SEQUENCE) and seal_in(final.parent) is not None
    if is_seal or seal_over(final) is not None:
        raise SlamsimError(f"{final} belongs to what slamsim sealed; choose another name")


def require_apart(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Raise OutputRefused for an output that is, contains or lies in an input of its command.

    Files and folders are told by device and inode, along every folder above them: links, other
    spellings and file systems that ignore case make no difference. What a killed process left of
    an output goes when that is written, and counts as part of it. Raises NotFound for an input
    that is not there.
    """
    read = [path for path in inputs if path is not None]
    written = [path for path in outputs if path is not None]
    for out in written:
        if _URL.match(str(out)):
            raise OutputRefused(f"{shown(str(out))} is a URL; this is written to folders only")
    for path in read:
        if not _exists(path):
            raise NotFound(f"{path}: no such file or folder")
    for number, out in enumerate(written):
        for path in (*read, *written[:number]):
            left = staging_of(out) if out.name else None
            for place in (out, left):
                if place is not None and (how := _touches(place, path)):
                    kind = "input" if path in read else "other output"
                    raise OutputRefused(
                        f"the output {out} {how} the {kind} {path}; choose another name for it"
                    )


def _unlisted(folder: Path) -> list[str]:
    """The files and links below a folder that its ``SHA256SUMS`` does not tell of, sorted.

    Raises SlamsimError if that is not there or damaged: nothing then tells whose they are.
    """
    try:
        seal = seal_in(folder)
    except DataDamaged:
        seal = None
    if seal is None or seal.name != SUMS:
        raise SlamsimError(
            f"{folder} is not replaced: without a whole {SUMS} nothing tells what in it is yours; "
            "remove it yourself, or choose another name for the output"
        )
    found = list[str]()
    for root, folders, names in os.walk(folder):
        links = (name for name in folders if Path(root, name).is_symlink())
        found += (Path(root, name).relative_to(folder).as_posix() for name in (*names, *links))
    return sorted(set(found) - seal.hashes.keys() - {SUMS})


def _named(files: list[str]) -> str:
    more = len(files) - _MOST_NAMED
    names = [shown(name) for name in files[:_MOST_NAMED]]
    return ", ".join(names) + (f" and {more:,} more" if more > 0 else "")


def _touches(out: Path, path: Path) -> str:
    """How an output meets an input, in words, or nothing."""
    outs, paths = list(_with_parents(out)), list(_with_parents(path))
    here, there = ({own for own, is_itself in one if is_itself} for one in (outs, paths))
    if here & there or _is_linked_in(out, path):
        return "is"
    if there & {own for own, _ in outs}:
        return "lies in"
    return "contains" if here & {own for own, _ in paths} else ""


def _with_parents(path: Path) -> Iterator[tuple[_Identity, bool]]:
    """(identity, whether it is the path itself) of a path and all above it.

    The path is followed as it is spelled, and to where it truly leads.
    """
    spelled = [Path.cwd() / path] if ".." not in path.parts else []
    with suppress(OSError, ValueError):  # a name that cannot be
        spelled.append(Path(os.path.realpath(path)))
    for one in spelled:
        for folder in (one, *one.parents):
            try:
                found = folder.stat()
            except (OSError, ValueError):
                yield str(folder), folder == one
            else:
                yield (found.st_dev, found.st_ino), folder == one


def _is_linked_in(out: Path, folder: Path) -> bool:
    """Whether an output file is a hard link to a file of an input folder."""
    with suppress(OSError, ValueError):
        found = out.stat()
        if stat.S_ISREG(found.st_mode) and found.st_nlink > 1 and folder.is_dir():
            files = (Path(root, name) for root, _, names in os.walk(folder) for name in names)
            return any(os.path.samestat(found, file.lstat()) for file in files)
    return False


def _exists(path: Path) -> bool:
    try:
        return os.path.lexists(path)
    except ValueError:
        return False
