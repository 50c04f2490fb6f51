"""Searches the keys of nested models: where an error is, and which key was probably meant."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from slamsim.guard.errors import did_you_mean, shown
from slamsim.guard.yaml import KeyPath, key_text

_UNIONS = (Union, types.UnionType)
_SEQUENCES = (list, tuple, set, frozenset)
_NEAR_HERE, _PERHAPS_HERE, _NEAR_ELSEWHERE = 0.85, 0.6, 0.75
"""Likeness of two words (``difflib``): a slip of the finger keeps 0.85 of a word; what is proposed
from elsewhere must be nearer than what is proposed here, for there is more to choose from."""
_MAX_ALTERNATIVES = 3


@dataclass(frozen=True, slots=True)
class Spot:
    """The place in the models that an error speaks of.

    keys: path in the data. owner: the model that has, or lacks, the last key. annotation and
    metadata: of the value there, as far as they are known.
    """

    keys: KeyPath
    owner: type[BaseModel] | None
    annotation: Any
    metadata: tuple[Any, ...]

    @property
    def length(self) -> int | None:
        """Of a list that has a fixed number of values."""
        arguments = get_args(_present(self.annotation))
        if get_origin(_present(self.annotation)) is not tuple or Ellipsis in arguments:
            return None
        return len(arguments)

    def range_text(self) -> str:
        """``greater than 0 and at most 10``, from the bounds of the field."""
        words = {"gt": "greater than", "ge": "at least", "lt": "less than", "le": "at most"}
        parts = [
            f"{text} {bound:g}" if isinstance(bound, float) else f"{text} {bound}"
            for name, text in words.items()
            for entry in self.metadata
            if (bound := getattr(entry, name, None)) is not None
        ]
        return " and ".join(parts)

    def choices_text(self) -> str:
        """``'a', 'b' or 'c'`` as one text."""
        choices = [repr(choice) for choice in self.choices]
        return " or ".join(filter(None, (", ".join(choices[:-1]), *choices[-1:])))

    @property
    def choices(self) -> tuple[Any, ...]:
        """Of a literal or an enumeration."""
        annotation = _present(self.annotation)
        if isinstance(annotation, type) and issubclass(annotation, Enum):
            return tuple(member.value for member in annotation)
        return get_args(annotation) if get_origin(annotation) is Literal else ()

    def meant_choice(self, given: object) -> str:
        """Which choice was probably meant, as the end of a sentence, or an empty text."""
        return did_you_mean(given, map(str, self.choices), _PERHAPS_HERE)


def find_spot(root: type[BaseModel], loc: tuple[int | str, ...], data: object) -> Spot:
    """Follow pydantic's ``loc``, which names union members too, through models and data."""
    keys: KeyPath = ()
    owner: type[BaseModel] | None = None
    annotation: Any = root
    metadata: tuple[Any, ...] = ()
    for element in loc:
        annotation, metadata = _unwrapped(annotation, metadata)
        if get_origin(annotation) in _UNIONS:
            annotation = _member(annotation, element)
            continue
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            owner = annotation
            field = annotation.model_fields.get(str(element))
            annotation = Any if field is None else field.annotation
            metadata = () if field is None else tuple(field.metadata)
        elif annotation is Any and not _has(data, element):
            continue
        else:
            annotation, metadata, owner = _item(annotation, element), (), None
        keys = (*keys, element)
        data = data[element] if _has(data, element) else None  # type: ignore[index]
    annotation, metadata = _unwrapped(annotation, metadata)
    return Spot(keys, owner, annotation, metadata)


def suggest(
    root: type[BaseModel], owner: type[BaseModel] | None, keys: KeyPath, within: KeyPath
) -> str:
    """What to say of an unknown key.

    within: the path at which the file is mounted that has it; what lies outside belongs into
    another file.
    """
    key, parent = str(keys[-1]), keys[:-1]
    valid = tuple(owner.model_fields) if owner is not None else ()
    here = max(valid, key=lambda name: _likeness(key, name), default="")
    likeness = _likeness(key, here)
    if likeness >= _NEAR_HERE:
        return f"unknown key {shown(key)}; did you mean {here!r}?"
    known = list(key_paths(root))
    homes = [path[:-1] for path in known if path[-1] == key and path[:-1] != parent]
    if homes:
        return f"unknown key {shown(key)} here; it belongs {_under(homes, parent, within)}"
    if likeness >= _PERHAPS_HERE:
        return f"unknown key {shown(key)}; did you mean {here!r}?"
    below = [path for path in known if path[: len(parent)] == parent]  # what was meant to be set
    elsewhere = max(below or known, key=lambda path: _likeness(key, str(path[-1])))
    if _likeness(key, str(elsewhere[-1])) >= _NEAR_ELSEWHERE:
        place = _under([elsewhere[:-1]], parent, within)
        return f"unknown key {shown(key)} here; did you mean {elsewhere[-1]!r} {place}?"
    return f"unknown key {shown(key)}; the keys here are {', '.join(valid)}"


def key_paths(
    model: type[BaseModel], at: KeyPath = (), around: tuple[type[BaseModel], ...] = ()
) -> Iterator[KeyPath]:
    """Every key path of a model and of the models in it; around: models that it stands in.

    A model that holds itself is not followed again.
    """
    for name, field in model.model_fields.items():
        yield (*at, name)
        for inner in _models(field.annotation):
            if inner not in (*around, model):
                yield from key_paths(inner, (*at, name), (*around, model))


def _under(homes: list[KeyPath], parent: KeyPath, within: KeyPath) -> str:
    nearest = sorted(homes, key=lambda home: -_common(home, parent))[:_MAX_ALTERNATIVES]
    inside = [home for home in nearest if home[: len(within)] == within]
    if not inside:
        places = (f"under {key_text(home)!r}" if home else "at the top level" for home in nearest)
        return f"{' or '.join(places)} of a run configuration"
    shorter = [home[len(within) :] for home in inside]
    if () in shorter:
        return "at the top level"
    return "under " + " or ".join(repr(key_text(home)) for home in shorter)


def _common(one: KeyPath, other: KeyPath) -> int:
    return sum(a == b for a, b in zip(one, other, strict=False))


def _likeness(given: str, name: str) -> float:
    """1 for equal; words in another order count little less."""
    straight = difflib.SequenceMatcher(None, given.lower(), name.lower()).ratio()
    given_words, name_words = sorted(given.lower().split("_")), sorted(name.lower().split("_"))
    shuffled = difflib.SequenceMatcher(None, "_".join(given_words), "_".join(name_words)).ratio()
    return max(straight, 0.95 * shuffled)


def _has(data: object, key: int | str) -> bool:
    if isinstance(data, dict):
        return key in data
    return isinstance(data, list) and isinstance(key, int) and 0 <= key < len(data)


def _unwrapped(annotation: Any, metadata: tuple[Any, ...]) -> tuple[Any, tuple[Any, ...]]:
    """Without Annotated and Optional around it."""
    while True:
        if get_origin(annotation) is Annotated:
            annotation, *entries = get_args(annotation)
            metadata = (*metadata, *(e for entry in entries for e in _bounds(entry)))
        elif (present := _present(annotation)) is not annotation:
            annotation = present
        else:
            return annotation, metadata


def _bounds(entry: Any) -> tuple[Any, ...]:
    return tuple(entry.metadata) if isinstance(entry, FieldInfo) else (entry,)


def _present(annotation: Any) -> Any:
    """``X`` for ``X | None``, anything else as it is."""
    if get_origin(annotation) not in _UNIONS:
        return annotation
    members = [member for member in get_args(annotation) if member is not type(None)]
    return members[0] if len(members) == 1 else annotation


def _member(annotation: Any, label: int | str) -> Any:
    """The member of a union that pydantic calls by this label."""
    for member in get_args(annotation):
        inner = _unwrapped(member, ())[0]
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            continue
        tags = (get_args(field.annotation) for field in inner.model_fields.values())
        if inner.__name__ == label or any(label in tag for tag in tags):
            return inner
    return Any


def _item(annotation: Any, key: int | str) -> Any:
    arguments = get_args(annotation)
    origin = get_origin(annotation)
    if origin is tuple and isinstance(key, int) and Ellipsis not in arguments:
        return arguments[key] if key < len(arguments) else Any
    if origin in _SEQUENCES and arguments:
        return arguments[0]
    return arguments[1] if origin is dict and len(arguments) > 1 else Any


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
