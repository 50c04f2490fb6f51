"""What a run reads and where it goes, by names alone: told before any library is loaded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path

from slamsim.config.bundled import bundled_names
from slamsim.safe.errors import Locked, SlamsimError
from slamsim.safe.files import own_file
from slamsim.safe.output import claimed_folder

OUTPUTS = Path("outputs")
LOG, TABLES = "log", "parquet"

_WORLD_SUFFIXES = frozenset((".yaml", ".yml", ".pgm", ".png", ".stl", ".obj", ".ply", ".glb"))
_COMPRESSIONS = frozenset((".gz", ".bz2"))


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
    name = path.stem if path.suffix.lower() in _COMPRESSIONS else path.name
    return Path(name).stem


def log_of(source: Path) -> Path:
    """The recording itself, where a whole run's folder was named."""
    return own_file(source, LOG) if (source / LOG / "metadata.yaml").is_file() else source


@contextmanager
def output_folder(out: Path | None, name: str, *, overwrite: bool) -> Iterator[Path]:
    """The folder that was asked for, else the first free one of this name under outputs/.

    Nobody else gets it within the block. Raises what ``claimed_folder`` raises.
    """
    with ExitStack() as held:
        if out is not None or overwrite:
            folder = out or OUTPUTS / _safe(name)
            held.enter_context(claimed_folder(folder, overwrite))
        else:
            folder = _claimed_free(OUTPUTS / _safe(name), held)
        yield folder


def _claimed_free(first: Path, held: ExitStack) -> Path:
    """The first of this name, and of it with a number, that nobody has or is about to have."""
    for number in count(1):
        folder = first if number == 1 else first.with_name(f"{first.name}_{number}")
        if folder.exists():
            continue
        try:
            held.enter_context(claimed_folder(folder))
            break
        except SlamsimError as error:  # somebody was quicker
            if not isinstance(error, Locked) and not folder.exists():
                raise
    return folder


def _safe(name: str) -> str:
    return re.sub(r"[^\w.-]+|^\.+", "_", name)
