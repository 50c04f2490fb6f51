"""Floor plans drawn in characters.

A corner is ``+``. Between two corners of a row stands ``--`` for a wall, two blanks for a
passage, or ``D`` with a dash or a blank for a door; between two corners of a column ``|``, a
blank or ``D``. A cell is two characters wide: blank, ``##`` where there is none, or with an
``S`` where the robot starts. Two cells with a door, the left one the start::

    +--+--+
    |S D  |
    +--+--+
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NoReturn

import numpy as np

from slamsim.config.layout import MAX_CELLS, PlanLayout
from slamsim.core.types import BoolArray
from slamsim.guard.errors import SlamsimError
from slamsim.world.cells import CellGrid, Edge
from slamsim.world.floor_plan import FloorPlan

Side = Literal["wall", "open", "door"]

_ACROSS: dict[str, Side] = {"|": "wall", " ": "open", "D": "door"}
_ALONG: dict[str, Side] = {
    "--": "wall",
    "  ": "open",
    **dict.fromkeys(("D-", "-D", "D ", " D", "DD"), "door"),
}


def read_drawing(layout: PlanLayout) -> FloorPlan:
    """The floor plan that the characters show.

    Raises SlamsimError, naming line and column, for anything that is not as above, for a way
    out of the plan, and for cells that no way joins to the start (FloorPlan's own check).
    """
    lines, grid = _squared(layout.drawing)
    present, starts = _cells(lines, grid)
    passages: list[Edge] = []
    doors: list[Edge] = []
    for line, column, side, below, above in _sides(lines, grid):
        inner = [cell for cell in (below, above) if cell is not None and present.flat[cell]]
        if side == "wall" or not inner:
            continue
        if len(inner) == 2:
            passages.append((inner[0], inner[1]))
            doors += [(inner[0], inner[1])] if side == "door" else []
        elif below is None or above is None or side == "door":
            _refuse(lines, line, column, "a wall around the plan must stand")
    start = starts[0] if starts else int(np.flatnonzero(present)[0])
    return FloorPlan(grid, layout.cell_m, present, tuple(sorted(passages)), frozenset(doors), start)


def _squared(drawing: str) -> tuple[list[str], CellGrid]:
    """The lines, the first at the largest y, all of the length that the number of cells needs."""
    lines = [line.rstrip() for line in drawing.strip("\n").split("\n")]
    longest = max(map(len, lines))
    rows, columns = len(lines) // 2, (longest - 1) // 3
    if rows < 1 or columns < 1 or len(lines) != 2 * rows + 1 or longest != 3 * columns + 1:
        raise SlamsimError(
            f"plan.drawing has {len(lines)} lines of at most {longest} characters; m rows of "
            "n cells are drawn in 2 m + 1 lines of 3 n + 1 characters"
        )
    if rows * columns > MAX_CELLS:
        raise SlamsimError(
            f"plan.drawing has {rows * columns} cells, at most {MAX_CELLS} are built"
        )
    lines = [line.ljust(longest) for line in lines]
    for number in range(0, len(lines), 2):
        for column in range(0, longest, 3):
            if lines[number][column] not in "+ ":
                _refuse(lines, number, column, "a corner + must stand")
    return lines, CellGrid(rows, columns)


def _cells(lines: list[str], grid: CellGrid) -> tuple[BoolArray, list[int]]:
    """Which cells there are, and the one in which the robot starts, if it is drawn."""
    present = np.ones((grid.rows, grid.columns), dtype=bool)
    starts = []
    for cell in range(len(grid)):
        row, column = grid.place(cell)
        line, at = 2 * (grid.rows - row) - 1, 3 * column + 1
        text = lines[line][at : at + 2]
        if text == "##":
            present[row, column] = False
        elif text.strip() == "S":
            starts.append(cell)
        elif text != "  ":
            _refuse(lines, line, at + (text[0] == " "), "a cell (two blanks, ## or S) must stand")
    if len(starts) > 1 or not present.any():
        raise SlamsimError(
            f"plan.drawing has {int(present.sum())} cells and {len(starts)} starts S; one cell at "
            "least and one start at most are needed"
        )
    return present, starts


def _sides(
    lines: list[str], grid: CellGrid
) -> Iterator[tuple[int, int, Side, int | None, int | None]]:
    """Line, column and kind of each drawn side, and the cells below or left, and above or right
    of it."""
    for row in range(grid.rows):
        line = 2 * (grid.rows - row) - 1
        for column in range(grid.columns + 1):
            side = _ACROSS.get(lines[line][3 * column])
            if side is None:
                _refuse(lines, line, 3 * column, "a side (| for a wall, blank or D) must stand")
            left = grid.cell(row, column - 1) if column > 0 else None
            right = grid.cell(row, column) if column < grid.columns else None
            yield line, 3 * column, side, left, right
    for row in range(grid.rows + 1):
        line = 2 * (grid.rows - row)
        for column in range(grid.columns):
            at = 3 * column + 1
            side = _ALONG.get(lines[line][at : at + 2])
            if side is None:
                _refuse(lines, line, at, "a side (-- for a wall, blanks or D) must begin")
            below = grid.cell(row - 1, column) if row > 0 else None
            above = grid.cell(row, column) if row < grid.rows else None
            yield line, at, side, below, above


def _refuse(lines: list[str], line: int, column: int, expected: str) -> NoReturn:
    raise SlamsimError(
        f"plan.drawing, line {line + 1}, column {column + 1}: {lines[line][column]!r} where "
        f"{expected}"
    )
