"""A data set behind a URL: object stores, SFTP, WebDAV, whatever fsspec has a driver for."""

from __future__ import annotations

import json
import os
import socket
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, TypeVar

from fsspec.core import url_to_fs

from slamsim.dataset.store.place import turn
from slamsim.guard.errors import Locked, SlamsimError, StoreFailed
from slamsim.guard.seal import SEQUENCE

LOCK = ".slamsim-lock.json"
_KIND = "lock of a data set"
RENEWED_EVERY_S = 20.0
FORGOTTEN_AFTER_S = 90.0
"""A lock that was not renewed for so long belongs to a run that was killed."""

_PAUSES_S = (1.0, 5.0)
"""Before a second and a third attempt: networks fail for a moment."""
_Result = TypeVar("_Result")


class RemoteStore:
    """Sequences are made in this machine's temporary folder and uploaded."""

    def __init__(self, address: str) -> None:
        if ".." in address.split("/"):
            raise SlamsimError(f"{address} has '..' in it; name the place itself")
        self.address, self.staging = address.rstrip("/"), ""
        try:
            self._files, self._root = url_to_fs(self.address)
        except ImportError as error:
            raise SlamsimError(f"{address}: {error}; try: pip install 'slamsim[cloud]'") from None
        except Exception as error:
            raise self._failed(error) from error
        self._folders: set[str] = set()

    def read(self, path: str) -> bytes | None:
        def get() -> bytes | None:
            try:
                data: bytes = self._files.cat_file(self._at(path))
            except FileNotFoundError:
                return None
            return data

        return self._tried(get)

    def write(self, path: str, data: bytes) -> None:
        """What is cut on the way does not parse, and so counts for nothing."""
        self._make_folder(path)
        self._tried(lambda: self._files.pipe_file(self._at(path), data))

    def remove(self, path: str) -> None:
        def rm() -> None:
            with suppress(FileNotFoundError):
                self._files.rm_file(self._at(path))

        self._tried(rm)

    def append(self, path: str, text: str) -> None:
        self.write(path, (self.read(path) or b"") + text.encode())

    def names(self, folder: str) -> frozenset[str]:
        def ls() -> frozenset[str]:
            self._files.invalidate_cache()
            where = self._at(folder).rstrip("/")
            try:
                found = self._files.ls(where, detail=False)
            except FileNotFoundError:
                return frozenset()
            names = {
                path.rstrip("/").rpartition("/")[2]
                for path in found
                if path.strip("/") != where.strip("/")
            }
            return frozenset(names if folder else names - {LOCK})

        return self._tried(ls)

    @contextmanager
    def working_folder(self, name: str) -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix=f"slamsim-{name.replace('/', '-')}-") as folder:
            yield Path(folder)

    def publish(self, folder: Path, name: str) -> None:
        paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        for path in sorted(paths, key=lambda path: path == folder / SEQUENCE):
            target = f"{name}/{path.relative_to(folder).as_posix()}"
            self._make_folder(target)
            self._upload(path, target)

    def free_bytes(self) -> int | None:
        return None

    @contextmanager
    def owned(self) -> Iterator[None]:
        owner = f"process {os.getpid()} on {socket.gethostname()}"
        me = {"slamsim": _KIND, "owner": owner, "key": uuid.uuid4().hex}
        self._take_lock(me)
        over = threading.Event()
        renewal = threading.Thread(target=self._renew, args=(me, over), daemon=True)
        renewal.start()
        try:
            yield
        finally:
            over.set()
            renewal.join()
            self._tried(lambda: self._files.rm_file(self._at(LOCK)))

    def used(self) -> AbstractContextManager[None]:
        """Two workers at one sequence upload the same bytes: they cannot harm each other."""
        return nullcontext()

    def _take_lock(self, me: dict[str, str]) -> None:
        found = self._lock()
        if found is not None and not _forgotten(found):
            raise Locked(
                f"{self.address} is being written by {found.get('owner')}; if that was killed, "
                f"try again in {FORGOTTEN_AFTER_S:.0f} seconds"
            )
        self._write_lock(me)
        if (self._lock() or {}).get("key") != me["key"]:
            raise Locked(f"{self.address} was taken by another run at the same moment")

    def _renew(self, me: dict[str, str], over: threading.Event) -> None:
        while not over.wait(RENEWED_EVERY_S):
            try:
                self._write_lock(me)
            except SlamsimError:
                continue  # writing data fails alike, and is reported

    def _write_lock(self, me: dict[str, str]) -> None:
        self.write(LOCK, json.dumps({**me, "renewed_s": time.time()}).encode())

    def _lock(self) -> dict[str, Any] | None:
        """Nothing for one that was cut on the way. Raises SlamsimError if it is not ours."""
        data = self.read(LOCK) or b""
        begin = json.dumps({"slamsim": _KIND})[:-1].encode()
        if not data.startswith(begin[: len(data)]):
            raise SlamsimError(
                f"{self.address}/{LOCK} has the name of slamsim's lock, and slamsim did not write "
                "it; choose another place"
            )
        try:
            found: dict[str, Any] = json.loads(data)
        except (ValueError, RecursionError):
            return None
        return found

    def _at(self, path: str) -> str:
        return f"{self._root}/{path}" if path else self._root

    def _make_folder(self, path: str) -> None:
        """Object stores have none; elsewhere another worker may make it at the same moment."""
        folder = self._at(path).rpartition("/")[0]
        if folder in self._folders:
            return

        def make() -> None:
            try:
                self._files.makedirs(folder, exist_ok=True)
            except Exception:
                if not self._files.isdir(folder):
                    raise

        self._tried(make)
        self._folders.add(folder)

    def _upload(self, path: Path, target: str) -> None:
        self._tried(lambda: self._files.put_file(str(path), self._at(target)))

    def _tried(self, act: Callable[[], _Result]) -> _Result:
        for pause_s in _PAUSES_S:
            try:
                with turn(self._files):
                    return act()
            except Exception:
                time.sleep(pause_s)
        try:
            with turn(self._files):
                return act()
        except Exception as error:
            raise self._failed(error) from error

    def _failed(self, error: Exception) -> StoreFailed:
        told = str(error).strip().splitlines() or [type(error).__name__]
        return StoreFailed(f"{self.address} cannot be reached or written: {told[0]}")


def _forgotten(lock: dict[str, Any]) -> bool:
    """Whether its owner was killed: here we can look, elsewhere only wait."""
    process, _, host = str(lock.get("owner", "")).removeprefix("process ").partition(" on ")
    if host == socket.gethostname() and process.isdigit():
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            return True
    renewed_s = lock.get("renewed_s")
    return not isinstance(renewed_s, int | float) or time.time() - renewed_s > FORGOTTEN_AFTER_S
