"""Read access to a data set in a folder or behind a URL (fsspec)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import RLock
from typing import Any, BinaryIO, cast

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.guard.files import leads_outside, open_as_found
from slamsim.guard.seal import require_as_written

_PART_BYTES = 1 << 20
_ONE_AT_A_TIME = RLock()


@dataclass(frozen=True, slots=True)
class Location:
    """The files of a data set; paths are relative to it, with ``/``. It can be pickled.

    All raise SlamsimError when the place cannot be read, InputRefused for a path out of it.
    """

    address: str

    @contextmanager
    def open(self, path: str) -> Iterator[BinaryIO]:
        """A file that can be searched. Raises FileNotFoundError if there is none."""
        files, whole = self._at(path)
        with self._told(), turn(files), _opened(files, whole) as file:
            yield file

    def read(self, path: str) -> bytes | None:
        """The whole file, or nothing if there is none."""
        try:
            with self.open(path) as file:
                return file.read()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            return None

    def sealed(self, path: str) -> bytes:
        """The whole file. Raises NotFound where it is missing, DataDamaged as below."""
        self.require_as_written(path)
        if (data := self.read(path)) is None:
            raise NotFound(f"{self.address} has no {path}")
        return data

    def require_as_written(self, path: str) -> None:
        """Raise DataDamaged for a file of a folder that is not as its seal has it.

        Behind a URL nothing is compared: whole files would be fetched for the sake of a few rows.
        """
        if "://" not in self.address:
            require_as_written(Path(self._at(path)[1]))

    def digest(self, path: str) -> tuple[int, str] | None:
        """Size and SHA-256 of a file, part by part, or nothing if there is none."""
        total, size = hashlib.sha256(), 0
        try:
            with self.open(path) as file:
                while part := file.read(_PART_BYTES):
                    total.update(part)
                    size += len(part)
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            return None
        return size, total.hexdigest()

    def names(self, folder: str) -> frozenset[str]:
        """Names of the files and folders in a folder; none if it is not there."""
        files, where = self._at(folder)
        try:
            with self._told(), turn(files):
                found = files.ls(where, detail=False)
        except (FileNotFoundError, NotADirectoryError):
            return frozenset()
        names = (path.rstrip("/").rpartition("/")[2] for path in found if path != where)
        return frozenset(names)

    def files(self, folder: str) -> tuple[str, ...]:
        """Every file below a folder, relative to it, sorted."""
        files, where = self._at(folder)
        with self._told(), turn(files):
            found = files.find(where)
        return tuple(sorted(path[len(where) + 1 :] for path in found))

    def _at(self, path: str) -> tuple[Any, str]:
        """The file system, and what it calls a path: a catalogue may come from anyone."""
        files, root = _reached(self.address)
        is_local = isinstance(files, LocalFileSystem)
        if ".." in path.split("/") or (is_local and leads_outside(Path(root), path)):
            raise InputRefused(f"{self.address}/{path}", "lies outside of the data set")
        return files, f"{root}/{path}".rstrip("/")

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except (SlamsimError, FileNotFoundError, IsADirectoryError, NotADirectoryError):
            raise
        except OSError as error:
            raise SlamsimError(f"{self.address} cannot be read: {error}") from error


def _opened(files: Any, whole: str) -> BinaryIO:
    """A pipe or device in a folder is refused: it would be waited for without end."""
    if not isinstance(files, LocalFileSystem):
        return cast(BinaryIO, files.open(whole, "rb"))
    if Path(whole).is_dir():
        raise IsADirectoryError(whole)
    try:
        return open_as_found(Path(whole))
    except NotFound:
        raise FileNotFoundError(whole) from None


def _reached(address: str) -> tuple[Any, str]:
    """The file system of an address, and what it calls the place."""
    if "://" in address:
        return _connected(address)
    try:
        return LocalFileSystem(), str(Path(address).resolve())
    except (OSError, ValueError, RuntimeError) as error:
        raise SlamsimError(f"{address!r} cannot be read: {error}") from None


def turn(files: Any) -> AbstractContextManager[Any]:
    """Held while a file system is used: threads that share an SSH connection wait for ever."""
    is_shared = files.async_impl or isinstance(files, LocalFileSystem)
    return nullcontext() if is_shared else _ONE_AT_A_TIME


@lru_cache(maxsize=8)
def _connected(address: str) -> tuple[Any, str]:
    try:
        files, root = url_to_fs(address)
    except ImportError as error:
        raise SlamsimError(f"{address}: {error}; try: pip install 'slamsim[cloud]'") from None
    except (OSError, ValueError, RuntimeError) as error:
        raise SlamsimError(f"{address!r} cannot be read: {error}") from None
    return files, root.rstrip("/")
