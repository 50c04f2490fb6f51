"""How many key frames a place is worth that the robot drives through again and again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closure_scene import keyframes
from hypothesis import given
from hypothesis import strategies as st
from simulated import box

from slamsim.config.slam import SlamConfig
from slamsim.core.types import FloatArray
from slamsim.slam.backend.back_end import BackEnd
from slamsim.slam.closures.visits import (
    CELL_M,
    ENOUGH_PASSES,
    KNOWN_PASSES,
    MOST_TRAVEL_M,
    PASS_M,
    Visits,
    spacing_m,
)

STEP_M = 0.5
LAP_M = 60.0


def kept_by_lap(laps: int, found: bool, lap_m: float = LAP_M) -> list[int]:
    """Key frames kept on each lap of a circle that is driven round and round."""
    visits, kept, last_m = Visits(), [0] * laps, -np.inf
    for number in range(int(laps * lap_m / STEP_M)):
        path_m = number * STEP_M
        angle = 2.0 * np.pi * path_m / lap_m
        radius_m = lap_m / (2.0 * np.pi)
        pose = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), angle + np.pi / 2])
        if path_m - last_m >= spacing_m(visits.passes(pose, path_m), found):
            kept[int(path_m / lap_m)] += 1
            last_m = path_m
    return kept


@given(st.floats(40.0, 200.0), st.booleans())
def test_all_are_kept_until_a_place_was_seen_often_enough(lap_m: float, found: bool) -> None:
    passes = KNOWN_PASSES if found else ENOUGH_PASSES
    kept = kept_by_lap(passes, found, lap_m)
    assert sum(kept) == int(passes * lap_m / STEP_M)


@pytest.mark.parametrize("found", [False, True])
def test_further_laps_need_few_and_in_the_end_hardly_any(found: bool) -> None:
    kept = kept_by_lap(12, found)
    assert max(kept[KNOWN_PASSES if found else ENOUGH_PASSES :]) < 0.25 * kept[0]
    assert min(kept) > 0 and max(kept[6:]) <= 2.0 * LAP_M / MOST_TRAVEL_M


def test_passes_are_counted_for_each_place_and_way_round() -> None:
    visits, here = Visits(), np.array([0.3, 0.4, 0.1])
    for number in range(4):
        path_m = number * 3.0 * PASS_M
        assert visits.passes(here, path_m) == number
        assert visits.passes(here, path_m + 0.3) == number  # the same pass
    assert visits.passes(here + np.array([0.0, 0.0, np.pi]), path_m) == 0
    assert visits.passes(here + np.array([CELL_M, 0.0, 0.0]), path_m) == 0


def test_standing_about_is_one_pass() -> None:
    visits = Visits()
    assert not any(visits.passes(np.array([0.5, 0.5, 0.0]), 0.01 * step) for step in range(200))


def room(wide_m: float, deep_m: float) -> FloatArray:
    """(k, 4) walls of a room about the origin with two things in its corners."""
    x_m, y_m = 0.5 * wide_m, 0.5 * deep_m
    things = [box(-x_m, -y_m, 0.5 - x_m, 1.5 - y_m), box(x_m - 1.0, y_m - 0.7, x_m, y_m)]
    return np.concatenate([box(-x_m, -y_m, x_m, y_m), *things])


@pytest.mark.parametrize("elsewhere", [False, True])
def test_after_one_pass_a_place_is_known_only_where_the_robot_is_found_again(
    elsewhere: bool,
) -> None:
    """After drift, a place that is new may seem to lie where the robot has been."""
    each = 50
    angles = np.linspace(0.0, 2.0 * np.pi, each, endpoint=False)
    circle = 4.0 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    circle[:, 2] = angles + 0.5 * np.pi
    frames = keyframes(room(14.0, 12.0), circle)
    lap_m = frames[-1].path_m + 0.5
    again = keyframes(room(11.0, 17.0) if elsewhere else room(14.0, 12.0), circle, each)
    frames += [replace(k, index=k.index + each, path_m=k.path_m + lap_m) for k in again]
    end = BackEnd(SlamConfig())
    for frame in frames:
        end.take(frame)
    kept = sum(index >= each for index in end.kept)
    # Some 3 m are spared after each closure: of the end of the first lap, and of the second alone.
    assert kept >= 35 if elsewhere else kept <= 20
    assert len(end.kept) == kept + each
