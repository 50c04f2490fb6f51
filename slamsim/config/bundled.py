"""Finds an input by its path, or by the name of a file bundled with the package."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from slamsim.guard.errors import InputRefused, NotFound, nearest_name, shown

Kind = Literal[
    "worlds",
    "configs",
    "configs/robots",
    "configs/drives",
    "configs/sensors",
    "configs/slam",
    "configs/faults",
    "configs/datasets",
    "configs/scenarios",
    "configs/measurements",
]

_WORDS: dict[Kind, str] = {
    "worlds": "world",
    "configs": "run configuration",
    "configs/robots": "robot",
    "configs/drives": "drive",
    "configs/sensors": "sensor",
    "configs/slam": "SLAM configuration",
    "configs/faults": "fault",
    "configs/datasets": "data set recipe",
    "configs/scenarios": "scenario configuration",
    "configs/measurements": "measurements",
}
_PACKAGE = Path(__file__).resolve().parents[1]
_MOST_TOLD = 20
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


def bundled_folder(kind: Kind) -> Path:
    """Inside the package when it is installed from a wheel, beside it in a checkout."""
    installed = _PACKAGE / "bundled"
    return (installed if installed.is_dir() else _PACKAGE.parent) / kind


def bundled_names(kind: Kind) -> tuple[str, ...]:
    """What ``find_input`` knows by name, sorted."""
    return tuple(sorted(path.stem for path in bundled_folder(kind).glob("*.yaml")))


def find_input(kind: Kind, name_or_path: str, folder: Path | None = None) -> Path:
    """The file of that path if there is one, else the bundled one of that name.

    A relative path starts at ``folder``, without one at the working directory. Raises NotFound
    naming the nearest names, InputRefused for a folder.
    """
    path = (folder or Path()) / name_or_path
    try:
        if path.is_file():
            return path
        is_folder = path.is_dir()
        exists = path.exists()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise NotFound(f"{shown(name_or_path)} cannot be looked up: {reason}") from None
    name = name_or_path.removesuffix(".yaml")
    if _NAME.fullmatch(name) and (bundled := bundled_folder(kind) / f"{name}.yaml").is_file():
        return bundled
    if is_folder:
        raise InputRefused(path, f"is a folder, a {_WORDS[kind]} file is needed")
    if exists:
        return path  # a pipe or a device: the loader says why it is not read
    raise NotFound(_missing(kind, name_or_path, path))


def _missing(kind: Kind, name_or_path: str, path: Path) -> str:
    names = bundled_names(kind)
    siblings = []
    if path.parent.is_dir():
        siblings = [other.name for other in path.parent.iterdir() if other.is_file()]
    if near := nearest_name(path.stem, names):
        hint = f"did you mean the bundled {near!r}?"
    elif near := nearest_name(path.name, siblings):
        hint = f"did you mean {str(path.parent / near)!r}?"
    else:
        hint = ""
    known = f"bundled are {', '.join(names)}" if names else "none is bundled"
    if len(names) > _MOST_TOLD:
        known = f"{len(names)} are bundled"
    word = _WORDS[kind]
    text = f"there is no {word} file and no bundled {word} {shown(name_or_path, 200)}"
    return f"{text}; {hint} ({known})" if hint else f"{text}; {known}"
