"""How many key frames a place is worth that the robot drives through again and again."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
