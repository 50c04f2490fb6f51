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
from slamsim.slam.closures.visits import CELL_M, ENOUGH_PASSES, MOST_TRAVEL_M, PASS_M, Visits

STEP_M = 0.5
LAP_M = 60.0


def kept_by_lap(laps: int, lap_m: float = LAP_M) -> list[int]:
    """Key frames kept on each lap of a circle that is driven round and round."""
    visits, kept, last_m = Visits(), [0] * laps, -np.inf
    for number in range(int(laps * lap_m / STEP_M)):
        path_m = number * STEP_M
        angle = 2.0 * np.pi * path_m / lap_m
        radius_m = lap_m / (2.0 * np.pi)
        pose = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), angle + np.pi / 2])
        if path_m - last_m >= visits.spacing_m(pose, path_m):
            kept[int(path_m / lap_m)] += 1
            last_m = path_m
    return kept


@given(st.floats(40.0, 200.0))
def test_all_are_kept_until_a_place_was_seen_often_enough(lap_m: float) -> None:
    kept = kept_by_lap(ENOUGH_PASSES, lap_m)
    assert sum(kept) == int(ENOUGH_PASSES * lap_m / STEP_M)


def test_further_laps_need_few_and_in_the_end_hardly_any() -> None:
    kept = kept_by_lap(12)
    assert max(kept[ENOUGH_PASSES:]) < 0.25 * kept[0]
    assert min(kept) > 0 and max(kept[6:]) <= 2.0 * LAP_M / MOST_TRAVEL_M


def test_a_place_is_known_after_enough_passes_the_same_way_round() -> None:
    visits, here = Visits(), np.array([0.3, 0.4, 0.1])
    for number in range(ENOUGH_PASSES):
        path_m = number * 3.0 * PASS_M
        assert visits.spacing_m(here, path_m) == 0.0
        assert visits.spacing_m(here, path_m + 0.3) == 0.0  # the same pass
    path_m = ENOUGH_PASSES * 3.0 * PASS_M
    assert visits.spacing_m(here, path_m) > 0.0
    assert visits.spacing_m(here + np.array([0.0, 0.0, np.pi]), path_m) == 0.0
    assert visits.spacing_m(here + np.array([CELL_M, 0.0, 0.0]), path_m) == 0.0


def test_the_other_way_through_a_corridor_shows_other_things() -> None:
    visits = Visits()
    for lap in range(5):
        for way, yaw in enumerate((0.0, np.pi)):
            spacing_m = visits.spacing_m(np.array([0.5, 0.5, yaw]), 100.0 * lap + 50.0 * way)
            assert (spacing_m > 0.0) == (lap >= ENOUGH_PASSES)


def test_standing_about_is_one_pass() -> None:
    visits = Visits()
    spacings = [visits.spacing_m(np.array([0.5, 0.5, 0.0]), 0.01 * step) for step in range(200)]
    assert spacings == [0.0] * 200


def room(wide_m: float, deep_m: float) -> FloatArray:
    """(k, 4) walls of a room about the origin with two things in its corners."""
    x_m, y_m = 0.5 * wide_m, 0.5 * deep_m
    things = [box(-x_m, -y_m, 0.5 - x_m, 1.5 - y_m), box(x_m - 1.0, y_m - 0.7, x_m, y_m)]
    return np.concatenate([box(-x_m, -y_m, x_m, y_m), *things])


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_place_is_known_only_where_the_robot_is_found_again(elsewhere: bool) -> None:
    """After drift, a place where nobody was yet may seem to lie where the robot has been."""
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
    assert kept >= each - 6 if elsewhere else kept <= each // 2  # the first 3 m may still be spared
    assert len(end.kept) == kept + each
