"""Perfect labyrinths: each algorithm draws one spanning tree of a cell grid.

The algorithms are folklore or classic; Buck, "Mazes for Programmers" (2015) collects them.
Every function takes a grid and a generator and returns the ``len(grid) - 1`` edges of a tree.
Only ``wilson`` and ``aldous_broder`` draw all trees equally often; the others each have a look
of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from slamsim.config.layout import Algorithm
from slamsim.world.cells import CellGrid, Edge, edge

Grow = Callable[[CellGrid, np.random.Generator], list[Edge]]


def _pick(items: list[int] | tuple[int, ...], rng: np.random.Generator) -> int:
    return items[int(rng.integers(len(items)))]


def backtracker(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Depth-first walk: long winding ways, few dead ends."""
    stack = [int(rng.integers(len(grid)))]
    seen = {stack[0]}
    tree = []
    while stack:
        fresh = [other for other in grid.neighbours(stack[-1]) if other not in seen]
        if not fresh:
            stack.pop()
            continue
        found = _pick(fresh, rng)
        tree.append(edge(stack[-1], found))
        seen.add(found)
        stack.append(found)
    return tree


def wilson(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Loop-erased random walks: every spanning tree equally likely (Wilson 1996)."""
    inside = [False] * len(grid)
    inside[int(rng.integers(len(grid)))] = True
    tree = []
    for first in rng.permutation(len(grid)).tolist():
        leaves_to: dict[int, int] = {}
        cell = first
        while not inside[cell]:
            # Overwriting the way out of a cell that is met again erases the loop.
            leaves_to[cell] = _pick(grid.neighbours(cell), rng)
            cell = leaves_to[cell]
        cell = first
        while not inside[cell]:
            inside[cell] = True
            tree.append(edge(cell, leaves_to[cell]))
            cell = leaves_to[cell]
    return tree


def aldous_broder(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """First entries of a random walk: every spanning tree equally likely (Aldous 1990, Broder
    1989); the walk takes long on large grids."""
    cell = int(rng.integers(len(grid)))
    seen = {cell}
    tree = []
    while len(seen) < len(grid):
        found = _pick(grid.neighbours(cell), rng)
        if found not in seen:
            seen.add(found)
            tree.append(edge(cell, found))
        cell = found
    return tree


def prim(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Grows by a random edge of its rim: many short dead ends."""
    first = int(rng.integers(len(grid)))
    seen = {first}
    rim = [(first, other) for other in grid.neighbours(first)]
    tree = []
    while rim:
        at = int(rng.integers(len(rim)))
        rim[at], rim[-1] = rim[-1], rim[at]
        inner, outer = rim.pop()
        if outer not in seen:
            seen.add(outer)
            tree.append(edge(inner, outer))
            rim += [(outer, other) for other in grid.neighbours(outer) if other not in seen]
    return tree


def kruskal(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """All edges in random order, each kept if it joins two parts."""
    edges = list(grid.edges())
    sets = DisjointSet(range(len(grid)))
    order = rng.permutation(len(edges)).tolist()
    return [edges[at] for at in order if sets.merge(*edges[at])]


def eller(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Row by row: random joins within a row, then at least one way up for each part of it."""
    sets = DisjointSet(range(len(grid)))
    tree = []
    for row in range(grid.rows):
        last = row + 1 == grid.rows
        cells = [grid.cell(row, column) for column in range(grid.columns)]
        for left, right in pairwise(cells):
            if (last or rng.random() < 0.5) and sets.merge(left, right):
                tree.append((left, right))
        if last:
            break
        parts: dict[int, list[int]] = {}
        for cell in cells:
            parts.setdefault(sets[cell], []).append(cell)
        for members in parts.values():
            sure = _pick(members, rng)
            for cell in members:
                if cell == sure or rng.random() < 0.35:
                    sets.merge(cell, cell + grid.columns)
                    tree.append((cell, cell + grid.columns))
    return tree


def hunt_and_kill(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Random walks, each begun at the first unvisited cell beside the visited ones."""
    cell = int(rng.integers(len(grid)))
    seen = {cell}
    tree = []
    # All cells before this one are visited, so the hunt never looks at them again.
    hunted = 0
    while len(seen) < len(grid):
        fresh = [other for other in grid.neighbours(cell) if other not in seen]
        if fresh:
            found = _pick(fresh, rng)
            tree.append(edge(cell, found))
        else:
            while hunted in seen:
                hunted += 1
            found = next(
                c
                for c in range(hunted, len(grid))
                if c not in seen and any(other in seen for other in grid.neighbours(c))
            )
            tree.append(edge(found, _pick([o for o in grid.neighbours(found) if o in seen], rng)))
        seen.add(found)
        cell = found
    return tree


def growing_tree(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Between backtracker and Prim: goes on from the newest cell or, as often, from any."""
    active = [int(rng.integers(len(grid)))]
    seen = {active[0]}
    tree = []
    while active:
        at = len(active) - 1 if rng.random() < 0.5 else int(rng.integers(len(active)))
        fresh = [other for other in grid.neighbours(active[at]) if other not in seen]
        if not fresh:
            active.pop(at)
            continue
        found = _pick(fresh, rng)
        tree.append(edge(active[at], found))
        seen.add(found)
        active.append(found)
    return tree


def recursive_division(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Cuts the field by a wall with one gap, then each half: long straight walls."""
    tree = []
    fields = [(0, 0, grid.rows, grid.columns)]
    while fields:
        row, column, rows, columns = fields.pop()
        if rows == 1 and columns == 1:
            continue
        if columns == 1 or (
            rows > 1 and (rows > columns or (rows == columns and rng.random() < 0.5))
        ):
            cut, gap = int(rng.integers(1, rows)), int(rng.integers(columns))
            below = grid.cell(row + cut - 1, column + gap)
            tree.append((below, below + grid.columns))
            fields += [(row, column, cut, columns), (row + cut, column, rows - cut, columns)]
        else:
            cut, gap = int(rng.integers(1, columns)), int(rng.integers(rows))
            left = grid.cell(row + gap, column + cut - 1)
            tree.append((left, left + 1))
            fields += [(row, column, rows, cut), (row, column + cut, rows, columns - cut)]
    return tree


def binary_tree(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Each cell opens to the north or to the east: all ways lead to one corner."""
    tree = []
    for cell in range(len(grid)):
        onward = [other for other in grid.neighbours(cell) if other > cell]
        if onward:
            tree.append((cell, _pick(onward, rng)))
    return tree


def sidewinder(grid: CellGrid, rng: np.random.Generator) -> list[Edge]:
    """Runs of joined cells in each row, each with one way north; the last row is one run."""
    tree = []
    for row in range(grid.rows):
        run: list[int] = []
        for column in range(grid.columns):
            cell = grid.cell(row, column)
            run.append(cell)
            last_row, last_column = row + 1 == grid.rows, column + 1 == grid.columns
            if not last_column and (last_row or rng.random() < 0.5):
                tree.append((cell, cell + 1))
            elif not last_row:
                above = _pick(run, rng)
                tree.append((above, above + grid.columns))
                run = []
    return tree


ALGORITHMS: dict[Algorithm, Grow] = {
    "backtracker": backtracker,
    "wilson": wilson,
    "aldous_broder": aldous_broder,
    "prim": prim,
    "kruskal": kruskal,
    "eller": eller,
    "hunt_and_kill": hunt_and_kill,
    "growing_tree": growing_tree,
    "recursive_division": recursive_division,
    "binary_tree": binary_tree,
    "sidewinder": sidewinder,
}
