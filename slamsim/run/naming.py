"""Names of inputs and outputs, resolved before any heavy library is loaded."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from slamsim.config.bundled import bundled_names
from slamsim.guard.errors import Locked, OutputRefused, SlamsimError
from slamsim.guard.files import noted_inputs, own_file
from slamsim.guard.output import claimed_folder, partial_file, put_away_remains
from slamsim.guard.replaceable import require_apart
from slamsim.guard.unpacking import PACKINGS
from slamsim.io import LOG, TABLES

if TYPE_CHECKING:
    from slamsim.config.base import Config

_Config = TypeVar("_Config", bound="Config")
OUTPUTS = Path("outputs")

_WORLD_SUFFIXES = frozenset((".yaml", ".yml", ".pgm", ".png", ".stl", ".obj", ".ply", ".glb"))


def is_recording(source: str) -> bool:
    """Whether this names a recording; worlds have their own suffixes, or are bundled names.

    A folder that holds no recording does not hide the bundled world of its name.
    """
    path = Path(source)
    if path.is_dir():
        holds_log = (log_of(path) / "metadata.yaml").is_file()
        holds_tables = any((path / name / "scans.parquet").is_file() for name in (".", TABLES))
        return holds_log or holds_tables or source not in bundled_names("worlds")
    return path.suffix != "" and path.suffix.lower() not in _WORLD_SUFFIXES


def recording_name(source: str) -> str:
    """What a run over a recording is called."""
    path = Path(source).resolve()
    if path.name in (LOG, TABLES):
        path = path.parent
    name = path.stem if path.suffix.lower() in PACKINGS else path.name
    return Path(name).stem


def log_of(source: Path) -> Path:
    """The recording itself, where a whole run's folder was named."""
    return own_file(source, LOG) if (source / LOG / "metadata.yaml").is_file() else source


@dataclass(frozen=True, slots=True)
class Loaded(Generic[_Config]):
    """A configuration, and the files that it was read from and those that it names."""

    config: _Config
    files: tuple[Path, ...]


def loaded(load: Callable[[], _Config]) -> Loaded[_Config]:
    """What ``load`` gives, with all files that are read meanwhile."""
    with noted_inputs() as read:
        config = load()
    texts = _texts(config.model_dump())
    named = (Path(text) for text in texts if "/" in text or text.endswith(".yaml"))
    return Loaded(config, (*read, *filter(_is_file, named)))


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


@contextmanager
def output_folder(
    out: Path | None, name: str, *, overwrite: bool, inputs: Iterable[Path | None] = ()
) -> Iterator[Path]:
    """The folder that was asked for, else the first free one of this name under outputs/.

    No other process gets it within the block. inputs: all that the command reads. Raises what
    ``require_apart`` and ``claimed_folder`` raise, and then nothing has been touched.
    """
    read = tuple(inputs)
    with ExitStack() as held:
        if out is not None or overwrite:
            folder = out or _apart(OUTPUTS / _safe(name), read)
            require_apart((folder,), read)
            held.enter_context(claimed_folder(folder, overwrite))
        else:
            folder = _claimed_free(OUTPUTS / _safe(name), read, held)
        yield folder


@contextmanager
def output_file(
    path: Path | None,
    *,
    overwrite: bool,
    inputs: Iterable[Path | None] = (),
    beside: Path | None = None,
) -> Iterator[Path | None]:
    """Where to write a file that was asked for: it has its name after the block.

    beside: the output folder of the same command. Raises as ``output_folder`` does.
    """
    require_apart((path, beside), inputs)
    if path is None:
        yield None
        return
    with partial_file(path, overwrite) as unfinished:
        yield unfinished


def _apart(folder: Path, inputs: tuple[Path | None, ...]) -> Path:
    """The same; where it meets an input, the refusal tells an ``--out`` that would not, if any."""
    try:
        require_apart((folder,), inputs)
    except OutputRefused as refusal:
        free = next(path for path in _numbered(folder) if not os.path.lexists(path))
        try:
            require_apart((free,), inputs)
        except OutputRefused:
            raise refusal from None
        raise OutputRefused(f"{refusal}, such as --out {free}") from None
    return folder


def _claimed_free(first: Path, inputs: tuple[Path | None, ...], held: ExitStack) -> Path:
    """The first of this name, and of it with a number, that no run has or is about to have."""
    for folder in _numbered(first):
        if os.path.lexists(folder):
            put_away_remains(folder)
            continue
        require_apart((folder,), inputs)
        try:
            held.enter_context(claimed_folder(folder))
            return folder
        except SlamsimError as error:  # another process was quicker
            if not isinstance(error, Locked) and not os.path.lexists(folder):
                raise
    raise AssertionError("there are infinitely many numbers")


def _numbered(first: Path) -> Iterator[Path]:
    yield first
    for number in count(2):
        yield first.with_name(f"{first.name}_{number}")


def _safe(name: str) -> str:
    return re.sub(r"[^\w.-]+|^\.+", "_", name)
