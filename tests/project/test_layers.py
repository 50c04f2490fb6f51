"""Which of our packages may import which, without cycles; what breaks the rules is listed by name.

Imports inside functions count as those at the top of a module do. A list of exceptions may only
become shorter: one that is not needed any more fails here too.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

from sources import tree_of

PACKAGE = Path(__file__).parents[2] / "slamsim"

TOP_LEVEL: Mapping[str, str] = {
    "__init__": "version",
    "__main__": "cli",
    "api": "api",
    "entry": "cli",
    "opened_run": "api",
}
"""Modules beside the packages, and the layer that each belongs to."""

_FOUNDATION = ("models", "core", "guard", "version")
_DATA = ("recording", "config", *_FOUNDATION)
ALLOWED: Mapping[str, tuple[str, ...]] = {
    "version": (),
    "guard": (),
    "core": ("guard",),
    "models": ("core", "guard"),
    "process": ("guard",),
    "console": ("core", "guard"),
    "config": ("guard",),
    "cameras": ("config", *_FOUNDATION),
    "recording": ("cameras", *_FOUNDATION),
    "io": ("recording", "cameras", "process", *_FOUNDATION),
    "perception": ("cameras", "io", *_DATA),
    "world": ("config", *_FOUNDATION),
    "sim": ("world", "config", "process", *_FOUNDATION),
    "sensors": ("cameras", *_DATA),
    "slam": ("process", *_DATA),
    "check": ("slam", "sim", "cameras", *_DATA),
    "evaluate": ("sensors", "io", "process", *_DATA),
    "simulation": ("io", "sensors", "cameras", "sim", "world", *_DATA),
    "scenarios": (
        *("simulation", "check", "evaluate", "slam", "sensors", "sim", "io", "process"),
        *_DATA,
    ),
    "report": ("scenarios", "check", "evaluate", "process", "cameras", *_DATA),
    "dataset": (
        *("report", "simulation", "evaluate", "slam", "sensors", "sim", "world", "io"),
        *("cameras", "process", *_DATA),
    ),
    "live": (
        *("report", "simulation", "check", "slam", "sensors", "sim", "world", "io", "process"),
        *_DATA,
    ),
    "gym": (
        *("live", "simulation", "slam", "sensors", "sim", "world"),
        *_DATA,
    ),
    "run": (
        *("live", "report", "dataset", "scenarios", "simulation", "check", "evaluate", "slam"),
        *("perception", "cameras", "sensors", "sim", "world", "io", "console", "process", *_DATA),
    ),
    "bench": (
        *("run", "live", "dataset", "simulation", "check", "evaluate", "slam", "sensors", "sim"),
        *("cameras", "perception"),
        *("world", "io", "console", "process", *_DATA),
    ),
    "cli": (
        *("bench", "run", "live", "report", "dataset", "scenarios", "io", "console", "process"),
        "config",
        *_FOUNDATION,
    ),
    "ros": ("cli", "run", "live", "io", "console", *_FOUNDATION),
    "api": (
        *("cli", "run", "report", "dataset", "check", "slam", "world", "io", "console"),
        *_FOUNDATION,
    ),
}
"""From the lowest layer to the highest: a layer imports from those that it names alone."""

EXCEPTIONS: frozenset[tuple[str, str]] = frozenset({})
"""(module, what it imports against ``ALLOWED``)."""

FILE_CYCLES: frozenset[frozenset[str]] = frozenset()

MOST_MODULES = 20
LARGER: Mapping[str, int] = {}
"""Folders with more modules, and how many they may have."""


@cache
def modules() -> Mapping[str, Path]:
    """All of the package by their names below it; that of a package is the name of its folder."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if len(parts) > 1 and parts[-1] == "__init__":
            parts = parts[:-1]
        found[".".join(parts)] = path
    return found


@cache
def imports() -> Mapping[str, frozenset[str]]:
    """The modules that each module imports, wherever in its text."""
    known = modules()
    return {
        name: frozenset(_imported(tree_of(path), known)) - {name} for name, path in known.items()
    }


def _imported(tree: ast.Module, known: Mapping[str, Path]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, "a relative import"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [n if n.removeprefix("slamsim.") in known else node.module for n in whole]
        else:
            continue
        for name in names:
            if name == "slamsim":
                yield "__init__"
            elif (own := name.removeprefix("slamsim.")) != name:
                yield own


def layer_of(module: str) -> str:
    """The package of a module, or the layer of one that is beside the packages."""
    first, _, rest = module.partition(".")
    if rest or (modules()[module].name == "__init__.py" and module != "__init__"):
        return first
    return TOP_LEVEL[module]


def cycles(arrows: Mapping[str, Iterable[str]]) -> set[frozenset[str]]:
    """The strongly connected components of more than one node, by what reaches what."""
    reached = {node: _reached(arrows, node) for node in arrows}
    found = set()
    for node, others in reached.items():
        cycle = frozenset(each for each in others if node in reached.get(each, ()))
        if len(cycle) > 1:
            found.add(cycle)
    return found


def _reached(arrows: Mapping[str, Iterable[str]], start: str) -> set[str]:
    found, left = set[str](), [start]
    while left:
        for each in arrows.get(left.pop(), ()):
            if each not in found:
                found.add(each)
                left.append(each)
    return found


def _in_order(edges: Iterable[Sequence[str]]) -> list[str]:
    return sorted(" -> ".join(edge) for edge in edges)


def test_the_table_of_layers_has_no_cycle() -> None:
    """So there is none among the packages either, but for the listed exceptions."""
    order = list(ALLOWED)
    assert [
        (layer, lower)
        for layer, lowers in ALLOWED.items()
        for lower in lowers
        if order.index(lower) >= order.index(layer)
    ] == []


def test_modules_import_from_lower_layers_alone() -> None:
    breaking = {
        (module, other)
        for module, others in imports().items()
        for other in others
        if layer_of(other) not in (layer_of(module), *ALLOWED[layer_of(module)])
    }

    assert _in_order(breaking) == _in_order(EXCEPTIONS)


def test_files_import_each_other_in_one_direction() -> None:
    assert cycles(imports()) == FILE_CYCLES


def test_cycles_are_found() -> None:
    arrows = {"a": "b", "b": "cd", "c": "a", "d": "e", "e": "", "f": "g", "g": "f"}

    assert cycles(arrows) == {frozenset("abc"), frozenset("fg")}


def test_folders_do_not_grow() -> None:
    counts = Counter(
        path.parent.relative_to(PACKAGE).as_posix()
        for path in modules().values()
        if path.name != "__init__.py"
    )

    too_large = {
        folder: f"{count} modules, at most {LARGER.get(folder, MOST_MODULES)}"
        for folder, count in counts.items()
        if count > LARGER.get(folder, MOST_MODULES)
    }
    assert too_large == {}
    assert [folder for folder in LARGER if counts[folder] <= MOST_MODULES] == []
