"""Compiled kernels: numba with a disk cache that may fail without stopping the program.

``kernel`` is the one decorator for hot loops in this package. Results are the same bytes for
the same input: no fast-math, no parallel reductions. The cache differs from numba's own in
four ways: it lives in a folder of the user (mode 0700, for a cache is code); an entry is named
after the sources of its module and of the modules with kernels that this imports, so that a kernel
in one file never runs with a stale callee from another, and an edit costs only the kernels that
depend on it; a damaged entry is recognised by its checksum, thrown away and compiled again; a full
or read-only disk costs the cache, not the run; and compiling is told to the log.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import logging
import os
import pickle
import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import caching as numba_caching
from numba.core import config as numba_config
from numba.core import event as numba_event
from numba.core import types as numba_types

# These modules are half typed: as far as mypy goes, they are not typed at all.
caching: Any = numba_caching
config: Any = numba_config
event: Any = numba_event
types: Any = numba_types

_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])
_PACKAGE = Path(__file__).parents[1]
_DIGEST_BYTES = hashlib.sha256().digest_size

_IMPORTS = re.compile(rb"^from slamsim\.([\w.]+) import", re.MULTILINE)
"""How modules with kernels import each other; a test holds that their kernels take nothing from
others of the package."""

_read_ns: dict[Path, int] = {}
"""When the sources that were read were last changed, as of their first reading."""


@cache
def _source(path: Path, changed_ns: int) -> tuple[bytes, bool, tuple[Path, ...]]:
    """Digest of a source as it was changed at that time, whether it has kernels, and what it then
    imports from the package."""
    _read_ns.setdefault(path, changed_ns)
    text = path.read_bytes()
    has_kernels = b"@kernel" in text
    names = _IMPORTS.findall(text) if has_kernels else []
    imported = (_PACKAGE.joinpath(*name.decode().split(".")).with_suffix(".py") for name in names)
    return (
        hashlib.sha256(text).digest(),
        has_kernels,
        tuple(one for one in imported if one.is_file()),
    )


def _source_stamp(module: Path) -> bytes:
    """A digest of the sources that the kernels of a module are made of: its own, and those of the
    modules with kernels that it imports, and that these import, and so on."""
    digests: dict[str, bytes] = {}
    seen, waiting = {module}, [module]
    while waiting:
        path = waiting.pop()
        digest, has_kernels, imported = _source(path, path.stat().st_mtime_ns)
        if has_kernels or path == module:
            digests[_place(path)] = digest
        waiting += set(imported) - seen
        seen.update(imported)
    return hashlib.sha256(repr((_place(module), sorted(digests.items()))).encode()).digest()


def _place(path: Path) -> str:
    """Of a module of the package, its place in it, which all checkouts share; else its path."""
    return str(path.relative_to(_PACKAGE)) if path.is_relative_to(_PACKAGE) else str(path)


def _libraries() -> str:
    """What makes code differ between the environments of a machine: where numba finds Intel's
    vector library, code calls it, which cannot run without and gives other bytes."""
    return f"{numba.__version__} {np.__version__} {config.USING_SVML}"


@cache
def _cache_folder() -> Path | None:
    """A private, writable folder for these libraries; none where nothing is writable.

    A cache is code: one that another user could have written to is not used.
    """
    digest = hashlib.sha256(_libraries().encode())
    root = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        parent = Path(root) if root else Path.home() / ".cache"
        folder = parent / "slamsim" / f"kernels-{digest.hexdigest()[:16]}"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        found = folder.stat()
        if found.st_uid != os.getuid() or found.st_mode & 0o022:
            raise PermissionError(f"{folder} can be written to by other users")
    except (OSError, RuntimeError) as error:
        return _passing_folder(error)
    return folder


def _passing_folder(why: Exception) -> Path | None:
    """A folder that goes with this process, not with those that it forks."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="slamsim-kernels-"))
    except OSError:
        _log.warning("kernels are not cached: %s", why)
        return None
    _log.warning("kernels are cached for this run only, in %s: %s", folder, why)
    ours = os.getpid()

    def remove() -> None:
        if os.getpid() == ours:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


class _Locator(caching.UserProvidedCacheLocator):  # type: ignore[misc]
    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file
        self._lineno = py_func.__code__.co_firstlineno
        self._cache_path = str(_cache_folder())
        self._stamp = _source_stamp(Path(py_file))

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def get_source_stamp(self) -> bytes:
        """Of the text: numba 0.61 asks when a file was written, which no two checkouts share."""
        return self._stamp


class _Impl(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = [_Locator]  # noqa: RUF012 - a name of theirs

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Checkouts and environments with the same sources share what they compile, and those with
        others leave it alone."""
        stamp = self._locator.get_source_stamp().hex()[:16]
        return f"{super().get_filename_base(fullname, abiflags)}-{stamp}"


class _CheckedFile(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Numba's cache file with a checksum in front, read before anything is unpickled."""

    def _dump(self, obj: object) -> bytes:
        data: bytes = super()._dump(obj)
        return hashlib.sha256(data).digest() + data

    @staticmethod
    def _checked(data: bytes) -> bytes:
        body = data[_DIGEST_BYTES:]
        if hashlib.sha256(body).digest() != data[:_DIGEST_BYTES]:
            raise ValueError("checksum does not match")
        return body

    def _save_index(self, overloads: dict[Any, str]) -> None:
        with self._open_for_write(self._index_path) as file:
            file.write(self._dump((self._version, self._source_stamp, overloads)))

    def _load_index(self) -> dict[Any, str]:
        try:
            data = Path(self._index_path).read_bytes()
        except FileNotFoundError:
            return {}
        version, stamp, overloads = pickle.loads(self._checked(data))
        fresh = version == self._version and stamp == self._source_stamp
        return cast(dict[Any, str], overloads) if fresh else {}

    def save(self, key: Any, data: Any) -> None:
        """With what it is for: of two processes that save at once, one may write over a file that
        the other's index names."""
        super().save(key, (self._source_stamp, key, data))

    def load(self, key: Any) -> Any:
        found = super().load(key)
        return found[2] if found and found[:2] == (self._source_stamp, key) else None

    def _load_data(self, name: str) -> object:
        return pickle.loads(self._checked(Path(self._data_path(name)).read_bytes()))


class _ForgivingCache(caching.FunctionCache):  # type: ignore[misc]
    """A cache whose every failure means "not cached"."""

    _impl_class = _Impl

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        self._cache_file: Any = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            found = super().load_overload(sig, target_context)
        except Exception as error:  # whatever a damaged pickle may raise
            _log.warning(
                "kernel cache of %s is damaged and made anew: %s", self._py_func.__name__, error
            )
            self._discard()
            found = None
        if found is None:
            _announce_compilation(_package_of(self._py_func))
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            if _are_as_read():
                super().save_overload(sig, data)
        except Exception as error:  # a full disk, a folder taken away
            _log.warning("kernel %s could not be cached: %s", self._py_func.__name__, error)

    def _discard(self) -> None:
        try:
            Path(self._cache_file._index_path).unlink(missing_ok=True)
        except OSError as error:
            _log.warning("damaged kernel cache stays: %s", error)


def _are_as_read() -> bool:
    """Whether the sources are still those that entries are named after. Of what is edited while
    a program runs, it may have imported either state."""
    return all(path.stat().st_mtime_ns == then for path, then in _read_ns.items())


def _package_of(function: Callable[..., Any]) -> str:
    return function.__module__.rpartition(".")[0] or function.__module__


@cache
def _announce_compilation(package: str) -> None:
    words = package.removeprefix("slamsim.").replace(".", " ").replace("_", " ")
    _log.info("compiling the numeric code of %s for its first use", words)


class _NoCollections(event.Listener):  # type: ignore[misc]
    """No garbage collection while a kernel compiles: what numba makes then stays, and searching
    it for cycles again and again took a seventh of the time (248 kernels of ``map tiny``)."""

    def __init__(self) -> None:
        self._depth = 0
        self._was_enabled = False

    def on_start(self, event: Any) -> None:
        """A kernel begins to compile, perhaps for another that does."""
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """It is compiled, or cannot be."""
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


event.register("numba:compile", _NoCollections())


def kernel(function: _Function) -> _Function:
    """Compile a function of numbers and arrays on its first call, or take it from the cache.

    C never calls it, so that entry is left out.
    """
    compiled: Any = numba.njit
    dispatcher = compiled(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    dispatcher.get_call_template = partial(_call_template, dispatcher.get_call_template)
    if _cache_folder() is not None:
        dispatcher._cache = _ForgivingCache(function)
    return cast(_Function, dispatcher)


def _call_template(template: Callable[..., Any], args: Sequence[Any], kws: dict[str, Any]) -> Any:
    """How another kernel calls one: a number that its source names is of the type of any other,
    else numba compiles the same code once for ``at(0)`` and once for ``at(k)``."""
    plain = {name: types.unliteral(kind) for name, kind in kws.items()}
    return template(tuple(map(types.unliteral, args)), plain)
