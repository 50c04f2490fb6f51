"""Finds plug-in modules: in a folder of the package, or by entry point of a distribution.

A distribution names a module of its own in the entry-point group of the folder's dotted name, for
instance ``slamsim.sensors.kinds`` (https://packaging.python.org/specifications/entry-points).
One that cannot be used is left out, for commands that need nothing of it shall run; ``left_out``
tells of it where something is missing.
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any, TypeVar, get_args

Kind = TypeVar("Kind")
Value = TypeVar("Value")

_LEFT_OUT: dict[str, dict[str, str]] = {}
"""Why, by package and module."""


def modules_in(package: str) -> Iterator[ModuleType]:
    """The modules of a package of ours by their names."""
    folder = import_module(package)
    for found in sorted(pkgutil.iter_modules(folder.__path__), key=lambda each: each.name):
        yield import_module(f"{package}.{found.name}")


def with_distributions(
    package: str, ours: Value, added: Callable[[Value, ModuleType], Value]
) -> Value:
    """What is ours, and what the modules of a package's entry-point group add to it.

    added: both together; it raises for what does not fit, which is then left out.
    """
    for entry in sorted(entry_points(group=package), key=lambda each: each.name):
        try:
            module = entry.load()
            if not isinstance(module, ModuleType):
                raise TypeError("it is no module")
            ours = added(ours, module)
        except (Exception, SystemExit) as error:
            whose = entry.dist.name if entry.dist else "a distribution"
            why = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            told = f"{entry.value} of the distribution {whose} cannot be used ({why})"
            _LEFT_OUT.setdefault(package, {})[entry.value] = told
    return ours


def left_out(*packages: str) -> str:
    """Which modules of distributions were left out of these packages, and why; "" for none."""
    told = (why for package in packages for why in _LEFT_OUT.get(package, {}).values())
    return "; ".join(dict.fromkeys(told))


def kinds_in(package: str, parent: type[Kind], tag: str) -> Mapping[str, type[Kind]]:
    """The models of a package and of its entry-point group, none of them abstract.

    By their names, which are the literal in the field ``tag``. Raises ValueError where two of ours
    have the same.
    """
    kinds: Mapping[str, type[Kind]] = {}
    for module in modules_in(package):
        kinds = _with_kinds_of(module, kinds, parent, tag)
    return with_distributions(
        package, kinds, lambda ours, module: _with_kinds_of(module, ours, parent, tag)
    )


def _with_kinds_of(
    module: ModuleType, known: Mapping[str, type[Kind]], parent: type[Kind], tag: str
) -> Mapping[str, type[Kind]]:
    found = dict(known)
    for kind in _subclasses(module, parent):
        kind.model_rebuild()  # raises where an annotation cannot be resolved
        names = get_args(kind.model_fields[tag].annotation) if tag in kind.model_fields else ()
        if not names:
            raise ValueError(f"{kind.__name__} has no field {tag!r} that is a literal")
        for name in names:
            if found.setdefault(name, kind) is not kind:
                raise ValueError(f"there is a {tag} {name!r} already")
    return found


def _subclasses(module: ModuleType, parent: type[Any]) -> Iterator[type[Any]]:
    for found in vars(module).values():
        is_kind = isinstance(found, type) and issubclass(found, parent)
        if is_kind and not inspect.isabstract(found) and found.__module__ == module.__name__:
            yield found
