"""The graph that every labyrinth algorithm works on: a rectangle of square cells."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from scipy.cluster.hierarchy import DisjointSet

from slamsim.guard.numbers import require_whole

Edge = tuple[int, int]
MOST_SIDE_CELLS = 10_000


@dataclass(frozen=True, slots=True)
class CellGrid:
    """``rows`` x ``columns`` cells; cell ``row * columns + column``, row 0 at the smallest y.

    An edge joins two cells that share a side; it is written with the smaller cell first.
    """

    rows: int
    columns: int

    def __post_init__(self) -> None:
        require_whole("the rows of a labyrinth", self.rows, 1, MOST_SIDE_CELLS)
        require_whole("the columns of a labyrinth", self.columns, 1, MOST_SIDE_CELLS)

    def __len__(self) -> int:
        return self.rows * self.columns

    def cell(self, row: int, column: int) -> int:
        return row * self.columns + column

    def place(self, cell: int) -> tuple[int, int]:
        """(row, column) of a cell."""
        return divmod(cell, self.columns)

    def neighbours(self, cell: int) -> tuple[int, ...]:
        """The cells that share a side, always in the order south, west, east, north."""
        row, column = self.place(cell)
        found = []
        if row > 0:
            found.append(cell - self.columns)
        if column > 0:
            found.append(cell - 1)
        if column + 1 < self.columns:
            found.append(cell + 1)
        if row + 1 < self.rows:
            found.append(cell + self.columns)
        return tuple(found)

    def edges(self) -> Iterator[Edge]:
        """Every pair of cells that share a side, once, in ascending order."""
        for cell in range(len(self)):
            for other in self.neighbours(cell):
                if other > cell:
                    yield cell, other


def edge(a: int, b: int) -> Edge:
    """The edge between two cells, the smaller cell first."""
    return (a, b) if a < b else (b, a)


def connected_sets(size: int, edges: Iterable[Edge]) -> DisjointSet[int]:
    """The sets of cells that the given edges join; ``sets[cell]`` stands for that of a cell."""
    sets = DisjointSet(range(size))
    for a, b in edges:
        sets.merge(a, b)
    return sets
