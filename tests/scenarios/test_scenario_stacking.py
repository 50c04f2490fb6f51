"""How many boxes stand, and how a stack collapses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_small import STACKS, holds, plain, run_all

from slamsim.core.geometry import matrix_from_rpy, xyzw_from_matrix
from slamsim.scenarios.base import Outcome
from slamsim.scenarios.physics import stacking
from slamsim.scenarios.physics.stack_run import StackRun, leaving_of, run_stack, sway_of
from slamsim.scenarios.physics.stacking import IN_A_ROW


def _leaning_stack(
    slips_m: Sequence[float], tilts_rad: Sequence[float], height_m: float
) -> StackRun:
    """Two instants of a stack in the plane x-z: upright, and as told, built up box by box."""
    count = len(slips_m)
    upright = np.column_stack([np.zeros((count, 2)), (np.arange(count) + 0.5) * height_m])
    centres, quats = np.zeros((count, 3)), np.zeros((count, 4))
    foot = np.zeros(3)
    for k, (slip_m, tilt_rad) in enumerate(zip(slips_m, tilts_rad, strict=True)):
        axis = np.array([math.sin(tilt_rad), 0.0, math.cos(tilt_rad)]) * height_m
        foot = foot + np.array([slip_m, 0.0, 0.0])
        centres[k] = foot + axis / 2
        quats[k] = xyzw_from_matrix(matrix_from_rpy(0.0, tilt_rad, 0.0))
        foot = foot + axis
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    nothing = np.zeros(2)
    return StackRun(
        1.0,
        np.array([0.0, 1.0]),
        np.array([upright, centres]),
        np.array([identity, quats]),
        nothing,
        nothing,
        burst=False,
    )


@given(
    st.lists(
        st.tuples(st.floats(0.0, 0.1), st.floats(0.001, 0.1)),
        min_size=2,
        max_size=12,
    ),
    st.floats(0.5, 2.0),
)
def test_the_way_of_the_top_is_the_sum_of_its_parts(
    boxes: list[tuple[float, float]], height_m: float
) -> None:
    slips_m, tilts_rad = zip(*boxes, strict=True)
    sway = sway_of(_leaning_stack(slips_m, tilts_rad, height_m), height_m)
    assert sway.slid_m[1] == pytest.approx(sum(slips_m), abs=1e-9)
    tilted_m = math.sin(tilts_rad[0]) * height_m * (len(boxes) - 0.5)
    assert sway.tilted_m[1] == pytest.approx(tilted_m, abs=1e-9)
    whole_m = sway.slid_m[1] + sway.tilted_m[1] + sway.bent_m[1]
    assert whole_m == pytest.approx(sway.top_m[1], abs=1e-9)


@pytest.mark.parametrize(
    ("slips_m", "tilts_rad", "expected"),
    [
        ([0.0] * 10, [0.1] * 10, (0.0, 1.0, 0.0)),  # as one rigid piece
        ([0.1] * 10, [0.0] * 10, (1.0, 0.0, 0.0)),  # neighbour off neighbour
        ([0.0] * 10, [0.02 * k for k in range(10)], (0.0, 0.0, 1.0)),  # bends over a still foot
    ],
)
def test_each_way_to_collapse_is_told_from_the_others(
    slips_m: list[float], tilts_rad: list[float], expected: tuple[float, float, float]
) -> None:
    run = _leaning_stack(slips_m, tilts_rad, 1.0)
    late = StackRun(
        run.collapsed_s,
        np.array([0.0, 1.0, 2.0]),
        np.stack(
            [run.centres_m[0], 0.9 * run.centres_m[0] + 0.1 * run.centres_m[1], run.centres_m[1]]
        ),
        run.quats_xyzw[[0, 0, 1]],
        np.zeros(3),
        np.zeros(3),
        burst=False,
    )
    leaving = leaving_of(late, sway_of(late, 1.0), 1.0)
    assert leaving is not None
    assert (leaving.slid, leaving.tilted, leaving.bent) == pytest.approx(expected, abs=0.01)
    assert leaving.growth_per_s == pytest.approx(math.log(10.0), rel=1e-6)
    if expected[2] == 0.0:
        assert leaving.straight == pytest.approx(1.0, abs=0.05)


@pytest.fixture(scope="module")
def stacks() -> list[Outcome]:
    return run_all(stacking.SCENARIO, STACKS)


@pytest.mark.long
def test_a_stack_stands_below_the_smallest_that_falls(stacks: list[Outcome]) -> None:
    """The row of a time step is held against stacks that are run again, one by one."""
    values = stacks[1].values
    assert values["kind"] == "smallest" and values["step_s"] == 0.03
    boxes = cast(int, values["boxes"])
    again = run_stack(STACKS, boxes, 0.03, STACKS.solver, seed=0)
    assert again.collapsed_s == values["collapsed_after_s"]
    for fewer in range(boxes - IN_A_ROW, boxes):
        assert run_stack(STACKS, fewer, 0.03, STACKS.solver, seed=0).collapsed_s is None


def test_what_stacks_say(stacks: list[Outcome]) -> None:
    findings = stacking.SCENARIO.conclude(STACKS, stacks)
    assert plain(findings)
    assert holds(findings, "as one piece") is True
    assert holds(findings, "offsets between neighbours") is False
    assert holds(findings, "bears the weight") is True
    assert holds(findings, "more energy") is True
    assert holds(findings, "Smaller time steps") is None  # two steps cannot tell
    (shown,) = (outcome for outcome in stacks if outcome.motions)
    assert len(shown.motions) == shown.values["boxes"]
    fallen_m = np.array([motion.T_map_body.positions_m[-1, 2] for motion in shown.motions])
    assert fallen_m[-1] < len(fallen_m) / 2  # the top box, seen until it is down


def test_no_collapse_up_to_the_cap_is_said(stacks: list[Outcome]) -> None:
    config = STACKS.model_copy(update={"max_boxes": 2, "other_solvers": {}})
    outcomes = [stacking.smallest_stack(config, "standard", 0.02, seed=0)]
    assert outcomes[0].values["boxes"] is None and outcomes[0].values["standing_boxes"] == 2
    findings = stacking.SCENARIO.conclude(config, outcomes)
    assert "No stack of up to 2 boxes collapsed" in findings.summary and plain(findings)
    assert findings.tables[0].rows[0][1] == "> 2"


def test_few_sweeps_stack_lower(stacks: list[Outcome]) -> None:
    smallest = {
        (outcome.values["solver"], outcome.values["step_s"]): outcome.values["boxes"]
        for outcome in stacks
        if outcome.values["kind"] == "smallest"
    }
    assert cast(int, smallest["few", 0.03]) < cast(int, smallest["standard", 0.03])
