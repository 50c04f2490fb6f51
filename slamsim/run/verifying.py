"""``slamsim verify``: compares files with their checksums; read-only."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from slamsim.console.reporter import Reporter
from slamsim.core.progress import Progress, silent
from slamsim.guard.errors import DataDamaged, InputRefused, NotFound
from slamsim.guard.files import leads_outside
from slamsim.guard.quantities import as_count, as_size
from slamsim.guard.seal import (
    SUMS,
    WRITTEN_BY_US,
    Seal,
    digest,
    files_in,
    is_within,
    seal_in,
    seal_over,
)

_READ_TOGETHER = 4
_MOST_TOLD = 20


@dataclass(frozen=True, slots=True)
class Damage:
    """path: relative to what was looked at, where it lies in there."""

    path: str
    reason: str


@dataclass(frozen=True, slots=True)
class Verified:
    """What was read. checked_against: the checksums it was compared with, in words.

    files, size_bytes: read. extra: files without a checksum beside them. sealed: whether slamsim
    wrote it, so that its command can do so again.
    """

    path: str
    checked_against: str
    files: int
    size_bytes: int
    damaged: tuple[Damage, ...] = ()
    extra: tuple[str, ...] = ()
    sealed: bool = True

    @property
    def whole(self) -> bool:
        """Whether all files with a checksum are as they were written."""
        return not self.damaged


def verify_and_tell(place: str, reporter: Reporter) -> bool:
    """Whether all is as it was written, of a data set too. Raises what ``verify_path`` raises."""
    if "://" in place or _is_dataset(Path(place)):
        from slamsim.run.dataset.telling import run_verify

        return run_verify(place, reporter)
    with reporter.stage("verify", "files/s") as progress:
        found = verify_path(Path(place), progress)
    _tell(found, reporter)
    reporter.result({**asdict(found), "whole": found.whole})
    return found.whole


def verify_path(path: Path, progress: Progress = silent) -> Verified:
    """A sealed folder, something in one, or a recording without checksums.

    Raises NotFound where nothing tells how it must be, and InputRefused for a recording that
    goes beyond the limits.
    """
    if not path.exists():
        raise NotFound(f"{path}: there is no such file or folder")
    try:
        sealed = seal_over(path)
    except DataDamaged as damage:
        return Verified(
            str(path), damage.path.name, 1, 0, (Damage(str(damage.path), damage.reason),)
        )
    if sealed is not None:
        return _compared(path, *sealed, progress)
    if (path / WRITTEN_BY_US).is_file():
        reason = "missing, or never written: there is no checksum of anything in this folder"
        return Verified(str(path), SUMS, 0, 0, (Damage(SUMS, reason),))
    return _recording(path)


def _is_dataset(path: Path) -> bool:
    from slamsim.dataset.make.identity import IDENTITY

    try:
        seal = seal_in(path)
    except DataDamaged:
        seal = None
    return (path / IDENTITY).is_file() or (seal is not None and IDENTITY in seal.hashes)


def _compared(path: Path, seal: Seal, part: str, progress: Progress) -> Verified:
    told = sorted(name for name in seal.hashes if is_within(part, name))
    damaged, size_bytes = list[Damage](), 0
    with ThreadPoolExecutor(_READ_TOGETHER) as readers:
        judged = readers.map(lambda name: _judged(seal, name), told)
        for number, (name, (reason, size)) in enumerate(zip(told, judged, strict=True), start=1):
            if reason:
                damaged.append(Damage(name, reason))
            size_bytes += size
            progress(number, len(told))
    extra = tuple(name for name in _others(seal) if is_within(part, name))
    by = f"{seal.name} in {seal.folder}"
    return Verified(str(path), by, len(told), size_bytes, tuple(damaged), extra)


def _judged(seal: Seal, name: str) -> tuple[str, int]:
    """(what is wrong with a file, or nothing; its size in bytes)."""
    path = seal.folder / name
    if leads_outside(seal.folder, name):
        return "a link that leads out of the folder", 0
    if not path.is_file():
        return "missing", 0
    try:
        fits = digest(path) == seal.hashes[name]
    except OSError as error:
        return f"cannot be read: {error.strerror}", 0
    return "" if fits else "its bytes are not those that were written", path.stat().st_size


def _others(seal: Seal) -> Iterator[str]:
    """Files that the seal does not tell of, but for hidden ones."""
    for name in files_in(seal.folder):
        is_hidden = any(part.startswith(".") for part in name.split("/"))
        if name not in seal.hashes and name != seal.name and not is_hidden:
            yield name


def _recording(path: Path) -> Verified:
    from slamsim.io.open import checked_recording, recording_at

    try:
        recording = recording_at(path)
    except InputRefused as refusal:
        reason = f"slamsim sealed nothing here, and it is no recording: {refusal.reason}"
        raise NotFound(f"{path}: {reason}") from None
    names = [recording / name for name in files_in(recording)] or [recording]
    size_bytes = sum(name.stat().st_size for name in names)
    try:
        checked_against = checked_recording(recording)
    except InputRefused as refusal:
        if refusal.limit:
            raise
        place = ", ".join(filter(None, (str(refusal.path), refusal.where)))
        damage = Damage(place, refusal.reason)
        checksums = "its own checksums"
        return Verified(str(path), checksums, len(names), size_bytes, (damage,), sealed=False)
    return Verified(str(path), checked_against, len(names), size_bytes, sealed=False)


def _tell(found: Verified, reporter: Reporter) -> None:
    rows = {
        "compared with": found.checked_against,
        "read": f"{as_count(found.files, 'file')}, {as_size(found.size_bytes)}",
        "not as written": f"{len(found.damaged):,} of the files" if found.damaged else "nothing",
        "no checksum": f"{len(found.extra):,} more files" if found.extra else "no other file",
    }
    reporter.table(f"Verified {found.path}", rows)
    for damage in found.damaged[:_MOST_TOLD]:
        reporter.say(f"{damage.path}: {damage.reason}")
    for name in found.extra[:_MOST_TOLD]:
        reporter.say(f"{name}: it has no checksum, so slamsim did not write it")
    if max(len(found.damaged), len(found.extra)) > _MOST_TOLD:
        reporter.say("There are more; --json lists all.")
    if found.sealed and not found.whole:
        reporter.say("Run the command again, or recover intact messages with slamsim recover.")
