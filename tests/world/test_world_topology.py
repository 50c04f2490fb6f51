"""Labyrinth algorithms: what they draw is a spanning tree, and some draw all trees alike."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from slamsim.config.layout import MazeLayout, RoomsLayout
from slamsim.config.world import DoorsConfig
from slamsim.world.cells import CellGrid, Edge, connected_sets
from slamsim.world.floor_plan import FloorPlan, grow_maze, grow_rooms, unreachable_cells
from slamsim.world.topology import ALGORITHMS

NO_DOORS = DoorsConfig(share=0.0)


def degrees(plan: FloorPlan) -> Counter[int]:
    return Counter(cell for edge in plan.passages for cell in edge)


def maze(seed: int = 0, **keys: object) -> FloorPlan:
    return grow_maze(MazeLayout.model_validate(keys), NO_DOORS, seed)


@pytest.mark.parametrize("name", ALGORITHMS)
@settings(max_examples=25)
@given(rows=st.integers(1, 9), columns=st.integers(1, 9), seed=st.integers(0, 2**32))
def test_every_algorithm_draws_a_spanning_tree(
    name: str, rows: int, columns: int, seed: int
) -> None:
    grid = CellGrid(rows, columns)
    tree = ALGORITHMS[name](grid, np.random.default_rng(seed))  # type: ignore[index]
    assert len(tree) == len(grid) - 1
    assert set(tree) <= set(grid.edges())
    sets = connected_sets(len(grid), tree)
    assert len({sets[cell] for cell in range(len(grid))}) == 1


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_seed_decides_and_nothing_else(name: str) -> None:
    grow = ALGORITHMS[name]  # type: ignore[index]
    grid = CellGrid(6, 7)
    first, again, other = (grow(grid, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first == again
    assert set(first) != set(other)


def spanning_trees(grid: CellGrid) -> int:
    """Kirchhoff's theorem: any cofactor of the graph's Laplacian."""
    laplacian = np.zeros((len(grid), len(grid)))
    for a, b in grid.edges():
        laplacian[a, b] = laplacian[b, a] = -1.0
    np.fill_diagonal(laplacian, -laplacian.sum(axis=1))
    return round(float(np.linalg.det(laplacian[1:, 1:])))


@pytest.mark.parametrize("name", ["wilson", "aldous_broder"])
def test_all_trees_are_drawn_equally_often(name: str) -> None:
    grid = CellGrid(2, 3)
    assert spanning_trees(grid) == 15
    rng = np.random.default_rng(7)
    drawn: Counter[tuple[Edge, ...]] = Counter(
        tuple(sorted(ALGORITHMS[name](grid, rng)))  # type: ignore[index]
        for _ in range(6000)
    )
    assert len(drawn) == 15
    assert stats.chisquare(list(drawn.values())).pvalue > 1e-3


@pytest.mark.parametrize("name", ["backtracker", "kruskal", "binary_tree", "sidewinder"])
def test_the_same_test_tells_biased_algorithms(name: str) -> None:
    rng = np.random.default_rng(7)
    drawn: Counter[tuple[Edge, ...]] = Counter(
        tuple(sorted(ALGORITHMS[name](CellGrid(2, 3), rng)))  # type: ignore[index]
        for _ in range(6000)
    )
    counts = list(drawn.values()) + [0] * (15 - len(drawn))
    assert stats.chisquare(counts).pvalue < 1e-3


def test_dead_ends_are_opened_as_far_as_asked() -> None:
    def dead_ends(share: float) -> int:
        plan = maze(rows=12, columns=12, dead_ends_opened=share, walls_removed=0.0)
        return sum(ways == 1 for ways in degrees(plan).values())

    none, half, all_opened = dead_ends(0.0), dead_ends(0.5), dead_ends(1.0)
    assert none > 8
    assert 0 < half <= none - none // 2
    assert all_opened == 0


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_share_of_walls_is_removed(share: float) -> None:
    plan = maze(rows=9, columns=7, dead_ends_opened=0.0, walls_removed=share)
    sides = 9 * 6 + 8 * 7
    assert len(plan.passages) == 62 + round(share * (sides - 62))


def test_a_tree_without_braiding_has_no_loop_and_with_it_has() -> None:
    assert len(maze(dead_ends_opened=0.0, walls_removed=0.0).passages) == 63
    assert len(maze(dead_ends_opened=0.6, walls_removed=0.0).passages) > 63


def test_halls_have_no_inner_walls() -> None:
    plan = maze(rows=4, columns=4, dead_ends_opened=0, walls_removed=0, halls=1, hall_cells=[4, 4])
    assert set(plan.passages) == set(plan.grid.edges())


def test_the_share_of_passages_are_doors() -> None:
    layout = MazeLayout(walls_removed=0.0)
    for share in (0.0, 0.3, 1.0):
        plan = grow_maze(layout, DoorsConfig(share=share), 3)
        assert plan.doors <= set(plan.passages)
        assert len(plan.doors) == round(share * len(plan.passages))


def test_turning_doors_on_moves_no_wall() -> None:
    layout = MazeLayout()
    with_doors = grow_maze(layout, DoorsConfig(share=0.5), 3)
    assert with_doors.passages == grow_maze(layout, NO_DOORS, 3).passages


@settings(max_examples=60)
@given(
    length=st.integers(1, 30),
    width=st.integers(1, 3),
    depth=st.integers(1, 4),
    room=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    linked=st.floats(0, 1),
    seed=st.integers(0, 2**32),
)
def test_every_room_has_a_door_to_the_corridor(
    length: int, width: int, depth: int, room: tuple[int, int], linked: float, seed: int
) -> None:
    layout = RoomsLayout(
        length_cells=length,
        corridor_cells=width,
        depth_cells=depth,
        room_cells=(min(room), max(room)),
        linked=linked,
    )
    plan = grow_rooms(layout, seed)
    assert unreachable_cells(plan) == []
    sets = connected_sets(len(plan.grid), set(plan.passages) - plan.doors)
    corridor = sets[plan.start]
    rooms = {sets[cell] for cell in range(len(plan.grid))} - {corridor}
    with_door = {
        sets[cell]
        for edge in plan.doors
        for cell in edge
        if corridor in (sets[edge[0]], sets[edge[1]])
    }
    assert rooms == with_door - {corridor}


@pytest.mark.long
def test_linked_rooms_make_loops() -> None:
    def doors(linked: float) -> int:
        return len(grow_rooms(RoomsLayout(linked=linked), 1).doors)

    assert doors(0.0) < doors(0.5) < doors(1.0)
