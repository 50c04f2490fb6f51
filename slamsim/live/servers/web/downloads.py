"""Finished recordings of a live robot, each as one zip file that is made while it is sent."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from io import RawIOBase
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile, ZipInfo

from slamsim.guard.files import open_as_found

_CHUNK_BYTES = 1 << 18


class Recordings:
    """Folders that the controls named since the server started. Others cannot be asked for: a
    client knows them by random identifiers alone."""

    def __init__(self) -> None:
        self._folders: dict[str, Path] = {}
        self._current: Path | None = None

    def note(self, current: Path | None) -> None:
        """The folder that is being written by now, if any."""
        self._current = current
        if current is not None and current not in self._folders.values():
            self._folders[secrets.token_urlsafe(16)] = current

    def finished(self) -> dict[str, Path]:
        """By identifier, the newest first. A folder has its name when it is whole."""
        whole = {
            key: folder
            for key, folder in self._folders.items()
            if folder != self._current and folder.is_dir()
        }
        return dict(reversed(whole.items()))


def zipped(folder: Path) -> Iterator[bytes]:
    """A zip file of a folder, piece by piece, with no more than a piece in memory.

    Its files are stored as they are: recordings are compressed already. Links are left out, so that
    nothing from outside the folder is in it.
    """
    sink = _Pieces()
    with ZipFile(sink, "w", ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_symlink() or not path.is_file():
                continue
            place = Path(folder.name) / path.relative_to(folder)
            info = ZipInfo.from_file(path, place.as_posix(), strict_timestamps=False)
            with open_as_found(path) as source, archive.open(info, "w", force_zip64=True) as entry:
                while piece := source.read(_CHUNK_BYTES):
                    entry.write(piece)
                    yield sink.taken()  # never empty: it holds the piece
    yield sink.taken()


class _Pieces(RawIOBase):
    """A stream that cannot be sought, whose bytes are taken from it as they come."""

    def __init__(self) -> None:
        self._held = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes | bytearray | memoryview) -> int:  # type: ignore[override]
        self._held += data
        return len(data)

    def taken(self) -> bytes:
        taken = bytes(self._held)
        self._held.clear()
        return taken
