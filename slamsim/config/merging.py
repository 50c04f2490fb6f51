"""Merges configuration data from files and ``--set``, keeping the origin of each value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeGuard, cast

from slamsim.guard.errors import InputRefused, OverrideRefused, SlamsimError, shown
from slamsim.guard.files import leads_outside
from slamsim.guard.yaml import KeyPath, YamlDocument, key_text, parse_yaml

Data = dict[str, object]


@dataclass(frozen=True, slots=True)
class Place:
    """Where a value was written: a line of a file, or an option of the command line.

    mount: the key path under which the file's own top level lies.
    """

    path: Path | None
    line: int = 0
    option: str = ""
    mount: KeyPath = ()

    def refusal(self, key_path: KeyPath, reason: str, also: tuple[str, ...] = ()) -> SlamsimError:
        """The exception for one fault of the value at ``key_path``."""
        if self.path is None:
            return OverrideRefused(self.option, reason, also)
        key = key_text(key_path[len(self.mount) :])
        where = f"line {self.line}, {key}" if key else f"line {self.line}"
        return InputRefused(self.path, reason, where, also)

    @property
    def folder(self) -> Path:
        """Where relative paths start that were written here."""
        return Path.cwd() if self.path is None else self.path.parent

    def require_own(self, key_path: KeyPath, name: str) -> None:
        """Raise if this file names one that lies outside of its folder.

        Only who types a name may mean any file of the machine; a file may come from anyone.
        """
        if self.path is not None and leads_outside(self.folder, name):
            raise self.refusal(
                key_path,
                f"the file {shown(name)} must lie inside the folder {self.folder}; put it there, "
                f"or name it on the command line",
            )


@dataclass(frozen=True, slots=True)
class Tree:
    """Nested mappings, and the place of each key path in them. Never changed, only replaced."""

    data: Data = field(default_factory=dict)
    places: Mapping[KeyPath, Place] = field(default_factory=dict)

    def place_of(self, key_path: KeyPath) -> Place:
        """The place of the key, or else of its nearest parent that was written somewhere."""
        while key_path and key_path not in self.places:
            key_path = key_path[:-1]
        return self.places.get(key_path, Place(None, option="the defaults"))

    def option_below(self, key_path: KeyPath) -> KeyPath | None:
        """The last key path below that an option of the command line has set."""
        found = (path for path, place in self.places.items() if place.path is None)
        return next((p for p in reversed(list(found)) if _below(p, key_path)), None)

    def get(self, key_path: KeyPath) -> object:
        """The value at the path, None where there is none."""
        value: object = self.data
        for key in key_path:
            if isinstance(value, dict):
                value = value.get(key)
            elif isinstance(value, list) and isinstance(key, int) and key < len(value):
                value = value[key]
            else:
                return None
        return value

    def replaced(self, key_path: KeyPath, part: Tree) -> Tree:
        """With everything at the path replaced by what ``part`` has there."""
        kept = {path: place for path, place in self.places.items() if not _below(path, key_path)}
        return Tree(
            cast(Data, _put(self.data, key_path, part.get(key_path))), {**kept, **part.places}
        )

    def texts(self, at: KeyPath = ()) -> Iterator[tuple[KeyPath, str]]:
        """Every text in it, with its key path."""
        value = self.get(at)
        if isinstance(value, str):
            yield at, value
        elif isinstance(value, dict | list):
            for key in value if isinstance(value, dict) else range(len(value)):
                yield from self.texts((*at, key))

    def section(self, at: KeyPath, leaving_out: str = "") -> Tree:
        """What stands below ``at``, and nothing else; without one of its keys if one is named."""
        value = self.get(at)
        kept = {k: v for k, v in value.items() if k != leaving_out} if _is_data(value) else value
        below = {path: place for path, place in self.places.items() if _below(path, at)}
        below.pop((*at, leaving_out), None)
        return Tree(cast(Data, _put({}, at, kept)), below)

    def overlaid(self, key_path: KeyPath, value: object, place: Place) -> Tree:
        """With one value set; a mapping is laid over the mapping that is there.

        Unless it starts from a preset: what the old one said is then of no account.
        """
        if _is_data(value) and value and "preset" not in value and _is_data(self.get(key_path)):
            tree = self
            for key, inner in value.items():
                tree = tree.overlaid((*key_path, key), inner, place)
            return tree
        made = (key_path[:end] for end in range(1, len(key_path)))
        places = {path: place for path in made if not isinstance(self.get(path), dict | list)}
        part = Tree(cast(Data, _put({}, key_path, value)), {**places, key_path: place})
        return self.replaced(key_path, part)

    def with_indices(self, parts: tuple[str, ...], place: Place) -> KeyPath:
        """The parts of a dotted path, numbers where this tree has a list there."""
        path: KeyPath = ()
        for part in parts:
            inner = self.get(path)
            if not isinstance(inner, list):
                path = (*path, part)
            elif part.isdecimal() and int(part) < len(inner):
                path = (*path, int(part))
            else:
                reason = f"{key_text(path)} is a list of {len(inner)}: {part!r} is not an index"
                raise place.refusal(path, f"{reason} from 0 to {len(inner) - 1}")
        return path

    def merged(self, top: Tree) -> Tree:
        """With ``top`` laid over it: mappings key by key, all else as a whole."""
        gone: list[KeyPath] = []
        data = cast(Data, _merge(self.data, top.data, (), gone))
        kept = {
            path: place
            for path, place in self.places.items()
            if not any(_below(path, root) for root in gone)
        }
        return Tree(data, {**kept, **top.places})


def mount(document: YamlDocument, at: KeyPath = ()) -> Tree:
    """The document's mapping under ``at``; InputRefused if it is anything but a mapping."""
    if document.data is None:
        raise InputRefused(document.path, "is empty; {} stands for all defaults")
    if not isinstance(document.data, dict):
        what = "a list" if isinstance(document.data, list) else shown(document.data)
        reason = f"holds {what}; a mapping (key: value) is needed"
        raise InputRefused(document.path, reason, f"line {document.line_of(())}")
    places = {
        (*at, *path): Place(document.path, line, mount=at) for path, line in document.lines.items()
    }
    return Tree(cast(Data, _put({}, at, document.data)), places)


def parse_override(text: str) -> tuple[tuple[str, ...], object, Place]:
    """``key.path=value`` as path, YAML value and place; raises OverrideRefused."""
    typed = text if text.isprintable() and len(text) <= 100 else shown(text, 100)
    place = Place(None, option=f"--set {typed}")
    key, equals, value = text.partition("=")
    parts = tuple(part.strip() for part in key.split("."))
    if not equals:
        raise place.refusal((), "has no '='; write key.path=value")
    if not all(parts):
        raise place.refusal((), f"the key path {shown(key)} has an empty part")
    try:
        return parts, parse_yaml(value, Path("value")).data, place
    except InputRefused as error:
        raise place.refusal((), f"the value {error.reason}") from None


def _is_data(value: object) -> TypeGuard[Data]:
    return isinstance(value, dict)


def _below(path: KeyPath, root: KeyPath) -> bool:
    return path[: len(root)] == root


def _put(data: object, key_path: KeyPath, value: object) -> object:
    if not key_path:
        return value
    if isinstance(data, list) and isinstance(index := key_path[0], int):
        return [*data[:index], _put(data[index], key_path[1:], value), *data[index + 1 :]]
    inner = data if isinstance(data, dict) else {}
    return {**inner, key_path[0]: _put(inner.get(key_path[0]), key_path[1:], value)}


def _merge(base: object, top: object, at: KeyPath, gone: list[KeyPath]) -> object:
    if not isinstance(base, dict) or not isinstance(top, dict):
        gone.append(at)
        return top
    shared = {
        key: _merge(base[key], value, (*at, key), gone) if key in base else value
        for key, value in top.items()
    }
    return {**base, **shared}
