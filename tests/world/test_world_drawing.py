"""Floor plans drawn in characters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.config.layout import MazeLayout, PlanLayout
from slamsim.config.loading import load_world_config
from slamsim.config.world import DoorsConfig, WorldConfig
from slamsim.guard.errors import SlamsimError
from slamsim.world.build import build_world
from slamsim.world.drawing import read_drawing
from slamsim.world.floor_plan import FloorPlan, grow_maze


def drawn(plan: FloorPlan) -> str:
    """The inverse of reading, as plain as possible."""
    rows, columns = plan.grid.rows, plan.grid.columns
    lines = [[" "] * (3 * columns + 1) for _ in range(2 * rows + 1)]
    for line in lines[::2]:
        line[::3] = ["+"] * (columns + 1)
    sides = {(a, b): "D" if (a, b) in plan.doors else " " for a, b in plan.passages}
    for row in range(rows):
        content = lines[2 * (rows - row) - 1]
        for column in range(columns + 1):
            cell = plan.grid.cell(row, column)
            inner = 0 < column < columns
            content[3 * column] = sides.get((cell - 1, cell), "|") if inner else "|"
    for row in range(rows + 1):
        border = lines[2 * (rows - row)]
        for column in range(columns):
            cell = plan.grid.cell(row, column)
            side = sides.get((cell - columns, cell), "-") if 0 < row < rows else "-"
            border[3 * column + 1 : 3 * column + 3] = [side, " " if side == " " else "-"]
    start_row, start_column = plan.grid.place(plan.start)
    lines[2 * (rows - start_row) - 1][3 * start_column + 1] = "S"
    return "\n".join("".join(line) for line in lines)


@settings(max_examples=50)
@given(
    rows=st.integers(1, 6),
    columns=st.integers(1, 6),
    doors=st.floats(0, 1),
    walls=st.floats(0, 1),
    seed=st.integers(0, 2**32),
)
def test_reading_gives_back_what_was_drawn(
    rows: int, columns: int, doors: float, walls: float, seed: int
) -> None:
    layout = MazeLayout(rows=rows, columns=columns, walls_removed=walls)
    plan = grow_maze(layout, DoorsConfig(share=doors), seed)
    again = read_drawing(PlanLayout(drawing=drawn(plan)))
    assert again.passages == plan.passages
    assert again.doors == plan.doors
    assert again.start == plan.start
    assert again.present.all()


def test_the_top_line_is_the_largest_y_and_blocks_are_no_cells() -> None:
    plan = read_drawing(
        PlanLayout(
            drawing="""
+--+--+
|S    |
+  +--+
|  |##|
+--+--+
""",
            cell_m=3.0,
        )
    )
    assert plan.present.tolist() == [[True, False], [True, True]]
    assert plan.passages == ((0, 2), (2, 3))
    assert plan.centre_m(plan.start) == (1.5, 4.5)


def test_blocks_are_solid() -> None:
    config = load_world_config("loop")
    world = build_world(config, 0)
    grid = world.grid(0.05, 0.3)
    middle = np.round((np.array([6.0, 8.0]) - grid.origin_m[::-1]) / 0.05).astype(int)
    assert grid.occupancy[tuple(middle)] == 1.0
    assert len(world.visit_points_m) == 24


def test_the_symmetric_world_is_its_own_quarter_turn() -> None:
    world = build_world(load_world_config("symmetric"), 0)
    grid = world.grid(0.05, 0.3).occupancy
    for turns in (1, 2, 3):
        assert np.count_nonzero(np.rot90(grid, turns) != grid) <= 0.002 * grid.size


def test_the_corridor_gives_nothing_to_hold_on_to() -> None:
    world = build_world(load_world_config("corridor"), 0)
    grid = world.grid(0.05, 0.3).occupancy
    inner = grid[:, 8:-8]
    assert (inner == inner[:, :1]).all(), "every place along it looks the same"


@pytest.mark.parametrize(
    ("drawing", "says"),
    [
        ("+--+\n|  |", "2 lines"),
        ("+--+\n|  |\n---+", "corner"),
        ("+--+\n|  x\n+--+", "line 2, column 4"),
        ("+--+\n| x|\n+--+", "line 2, column 3: 'x'"),
        ("+-x+\n|  |\n+--+", "line 1, column 2"),
        ("+  +\n|  |\n+--+", "wall around the plan"),
        ("+--+\n|  D\n+--+", "wall around the plan"),
        ("+--+--+\n|S  S |\n+--+--+", "2 starts"),
        ("+--+\n|##|\n+--+", "0 cells"),
        ("+--+--+\n|  |  |\n+--+--+", "1 of 2 cells cannot be reached"),
        ("+--+--+\n|  D##|\n+--+--+", "wall around the plan"),
        ("+", "1 lines"),
    ],
)
def test_bad_drawings_are_refused_with_line_and_column(drawing: str, says: str) -> None:
    with pytest.raises(SlamsimError, match=says):
        build_world(WorldConfig(plan=PlanLayout(drawing=drawing)), 0)


@settings(max_examples=200)
@given(st.text(alphabet="+-| D#S\n", max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        plan = read_drawing(PlanLayout(drawing=text or " "))
    except SlamsimError:
        return
    assert plan.is_present(plan.start)
