"""Floor plan: the cells of a world, their passages and doors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.layout import MazeLayout, RoomsLayout
from slamsim.config.world import DoorsConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray
from slamsim.world.cells import CellGrid, Edge, connected_sets
from slamsim.world.topology import ALGORITHMS


@dataclass(frozen=True, slots=True, eq=False)
class FloorPlan:
    """Cells of side ``cell_m`` and the ways between them.

    present: (rows, columns) False where there is no cell but solid. passages: ascending edges
    between present cells. doors: those of them that are doors. start: the cell to start in.
    """

    grid: CellGrid
    cell_m: float
    present: BoolArray
    passages: tuple[Edge, ...]
    doors: frozenset[Edge]
    start: int

    def is_present(self, cell: int) -> bool:
        return bool(self.present.flat[cell])

    def centre_m(self, cell: int) -> tuple[float, float]:
        """The middle of a cell in the map frame."""
        row, column = self.grid.place(cell)
        return (column + 0.5) * self.cell_m, (row + 0.5) * self.cell_m


def grow_maze(layout: MazeLayout, doors: DoorsConfig, seed: int) -> FloorPlan:
    """A spanning tree of the cells, braided, with halls and doors."""
    grid = CellGrid(layout.rows, layout.columns)
    tree = ALGORITHMS[layout.algorithm](grid, random_stream(seed, "world", "topology"))
    passages = set(tree)
    passages |= _halls(grid, layout, random_stream(seed, "world", "halls"))
    rng = random_stream(seed, "world", "braid")
    _open_dead_ends(grid, passages, layout.dead_ends_opened, rng)
    _remove_walls(grid, passages, layout.walls_removed, rng)
    ordered = tuple(sorted(passages))
    rng = random_stream(seed, "world", "doors")
    chosen = rng.permutation(len(ordered))[: round(doors.share * len(ordered))]
    return FloorPlan(
        grid,
        layout.cell_m,
        np.ones((grid.rows, grid.columns), dtype=bool),
        ordered,
        frozenset(ordered[at] for at in chosen.tolist()),
        start=0,
    )


def _halls(grid: CellGrid, layout: MazeLayout, rng: np.random.Generator) -> set[Edge]:
    """All edges within randomly placed rectangles of cells."""
    low, high = layout.hall_cells
    opened: set[Edge] = set()
    for _ in range(layout.halls):
        rows = int(rng.integers(low, min(high, grid.rows) + 1))
        columns = int(rng.integers(low, min(high, grid.columns) + 1))
        row = int(rng.integers(grid.rows - rows + 1))
        column = int(rng.integers(grid.columns - columns + 1))
        opened |= _inner_edges(grid, range(row, row + rows), range(column, column + columns))
    return opened


def _inner_edges(grid: CellGrid, rows: range, columns: range) -> set[Edge]:
    """All edges between cells of one rectangle."""
    across = {
        (grid.cell(row, column), grid.cell(row, column + 1))
        for row in rows
        for column in columns[:-1]
    }
    along = {
        (grid.cell(row, column), grid.cell(row + 1, column))
        for row in rows[:-1]
        for column in columns
    }
    return across | along


def _open_dead_ends(
    grid: CellGrid, passages: set[Edge], share: float, rng: np.random.Generator
) -> None:
    """Give the share of the cells with one way a second one; a neighbour may profit as well."""
    degree = [0] * len(grid)
    for a, b in passages:
        degree[a] += 1
        degree[b] += 1
    dead_ends = [cell for cell in range(len(grid)) if degree[cell] == 1]
    for at in rng.permutation(len(dead_ends))[: round(share * len(dead_ends))].tolist():
        cell = dead_ends[at]
        walled = [
            (min(cell, other), max(cell, other))
            for other in grid.neighbours(cell)
            if (min(cell, other), max(cell, other)) not in passages
        ]
        if degree[cell] > 1 or not walled:
            continue
        opened = walled[int(rng.integers(len(walled)))]
        passages.add(opened)
        degree[opened[0]] += 1
        degree[opened[1]] += 1


def _remove_walls(
    grid: CellGrid, passages: set[Edge], share: float, rng: np.random.Generator
) -> None:
    """Take away the share of the inner walls that are left."""
    walls = [edge for edge in grid.edges() if edge not in passages]
    for at in rng.permutation(len(walls))[: round(share * len(walls))].tolist():
        passages.add(walls[at])


def grow_rooms(layout: RoomsLayout, seed: int) -> FloorPlan:
    """A corridor along x with a row of rooms on either side, a door from each to the corridor."""
    rng = random_stream(seed, "world", "topology")
    depth, width = layout.depth_cells, layout.corridor_cells
    grid = CellGrid(2 * depth + width, layout.length_cells)
    corridor = range(depth, depth + width)
    passages = _inner_edges(grid, corridor, range(grid.columns))
    doors: set[Edge] = set()
    for rows, inside, beside in (
        (range(depth), depth - 1, depth),
        (range(depth + width, grid.rows), depth + width, depth + width - 1),
    ):
        left = 0
        while left < grid.columns:
            right = min(
                left + int(rng.integers(layout.room_cells[0], layout.room_cells[1] + 1)),
                grid.columns,
            )
            passages |= _inner_edges(grid, rows, range(left, right))
            column = int(rng.integers(left, right))
            a, b = sorted((grid.cell(inside, column), grid.cell(beside, column)))
            doors.add((a, b))
            if right < grid.columns and rng.random() < layout.linked:
                row = int(rng.integers(rows[0], rows[-1] + 1))
                doors.add((grid.cell(row, right - 1), grid.cell(row, right)))
            left = right
    return FloorPlan(
        grid,
        layout.cell_m,
        np.ones((grid.rows, grid.columns), dtype=bool),
        tuple(sorted(passages | doors)),
        frozenset(doors),
        start=grid.cell(depth + width // 2, 0),
    )


def unreachable_cells(plan: FloorPlan) -> list[int]:
    """Present cells that no way joins to the start."""
    sets = connected_sets(len(plan.grid), plan.passages)
    home = sets[plan.start]
    return [cell for cell in range(len(plan.grid)) if plan.is_present(cell) and sets[cell] != home]
