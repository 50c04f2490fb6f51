"""Finds plug-in modules: in a folder of the package, or by entry point of a distribution.

A distribution names a module of its own in the entry-point group of the folder's dotted name, for
instance ``slamsim.sensors.kinds`` (https://packaging.python.org/specifications/entry-points).
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import entry_points
from types import ModuleType
from typing import TypeVar

from slamsim.guard.errors import SlamsimError

Kind = TypeVar("Kind")


def modules_in(package: str) -> Iterator[ModuleType]:
    """The modules of a package by their names, then those of its entry-point group.

    Raises SlamsimError naming the distribution whose module cannot be imported.
    """
    folder = import_module(package)
    for found in sorted(pkgutil.iter_modules(folder.__path__), key=lambda each: each.name):
        yield import_module(f"{package}.{found.name}")
    for entry in sorted(entry_points(group=package), key=lambda each: each.name):
        try:
            yield entry.load()
        except Exception as error:
            whose = entry.dist.name if entry.dist else "a distribution"
            raise SlamsimError(
                f"{whose} adds {entry.value} to {package}, which cannot be imported: {error}"
            ) from error


def subclasses_in(package: str, parent: type[Kind]) -> tuple[type[Kind], ...]:
    """The classes of a kind, none of them abstract, that these modules define."""
    return tuple(
        found
        for module in modules_in(package)
        for found in vars(module).values()
        if isinstance(found, type)
        and issubclass(found, parent)
        and not inspect.isabstract(found)
        and found.__module__ == module.__name__
    )
