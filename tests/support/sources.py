"""Modules as text: parsed once for all tests that look at one."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def tree_of(path: Path) -> ast.Module:
    """What Python makes of a module, of which nothing is to be changed.

    Garbage is not looked for among the million of nodes that stay: that takes twice as long as to
    make them.
    """
    gc.disable()
    try:
        return ast.parse(path.read_text())
    finally:
        gc.freeze()
        gc.enable()


@cache
def imports_of(path: Path) -> frozenset[str]:
    """The libraries that a module imports, wherever in its text."""
    names: set[str] = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.partition(".")[0])
    return frozenset(names)
