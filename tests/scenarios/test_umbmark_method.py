"""UMBmark on wheels that roll without slip or noise, followed in small steps of their own."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.scenarios.umbmark.method import (
    Clusters,
    Square,
    WheelCorrection,
    classical,
    clusters,
    fitted,
)

TRACK_M, SIDE_M = 0.23, 2.0
STEPS = 60


def rolled_square(left: bool, corner_rad: float) -> FloatArray:
    """(n, 2) by odometry: four sides and corners, each in many equal steps."""
    side = np.full((STEPS, 2), SIDE_M / STEPS)
    turn_m = 0.5 * TRACK_M * corner_rad / STEPS * (1.0 if left else -1.0)
    corner = np.tile([-turn_m, turn_m], (STEPS, 1))
    return np.vstack([side, corner] * 4)


def true_end_m(rolled_m: FloatArray, diameter_ratio: float, track_ratio: float) -> FloatArray:
    """Followed arc by arc about its centre of rotation, an oracle of its own."""
    left_factor = 2.0 / (1.0 + diameter_ratio)
    x = y = yaw = 0.0
    for left, right in rolled_m.tolist():
        true_left, true_right = left * left_factor, right * left_factor * diameter_ratio
        turned = (true_right - true_left) / (TRACK_M * track_ratio)
        forward = 0.5 * (true_left + true_right)
        if abs(turned) < 1e-12:
            x, y = x + forward * math.cos(yaw), y + forward * math.sin(yaw)
        else:
            radius = forward / turned
            x += radius * (math.sin(yaw + turned) - math.sin(yaw))
            y -= radius * (math.cos(yaw + turned) - math.cos(yaw))
        yaw += turned
    return np.array([x, y])


def squares(diameter_ratio: float, track_ratio: float, corner_rad: float) -> list[Square]:
    made = []
    for left in (False, True):
        rolled_m = rolled_square(left, corner_rad)
        made.append(
            Square(left, rolled_m, true_end_m(rolled_m, diameter_ratio, track_ratio), TRACK_M)
        )
    return made


@settings(max_examples=25, deadline=None)
@given(st.floats(0.97, 1.03), st.floats(0.88, 1.15), st.floats(0.9, 1.7))
def test_least_squares_finds_the_wheels_whatever_the_corner(
    diameter_ratio: float, track_ratio: float, corner_rad: float
) -> None:
    found = fitted(squares(diameter_ratio, track_ratio, corner_rad))
    assert found.diameter_ratio == pytest.approx(diameter_ratio, abs=1e-5)
    assert found.track_ratio == pytest.approx(track_ratio, abs=1e-4)


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.004, 0.004), st.floats(-0.015, 0.015))
def test_the_formulas_find_small_faults_of_square_corners(unequal: float, wide: float) -> None:
    driven = squares(1.0 + unequal, 1.0 + wide, 0.5 * math.pi)
    found = classical(clusters(driven), SIDE_M, TRACK_M)
    # They are of first order, and mix the two faults in the second.
    left_over = 0.1 * max(abs(unequal), abs(wide)) + 1e-4
    assert found.diameter_ratio - 1.0 == pytest.approx(unequal, abs=left_over)
    assert found.track_ratio - 1.0 == pytest.approx(wide, abs=left_over)


def test_the_formulas_refuse_what_they_do_not_hold_for() -> None:
    far = Clusters(np.full((1, 2), -90.0), np.full((1, 2), -90.0))
    with pytest.raises(SlamsimError, match="beyond the UMBmark formulas"):
        classical(far, SIDE_M, TRACK_M)


@given(st.floats(0.8, 1.25))
def test_correction_keeps_the_mean_wheel(ratio: float) -> None:
    left, right = WheelCorrection(diameter_ratio=ratio).factors()
    assert left + right == pytest.approx(2.0)
    assert right / left == pytest.approx(ratio)


@given(
    st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=6),
    st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=6),
)
def test_clusters_are_what_the_study_calls_so(
    clockwise: list[tuple[float, float]], counter: list[tuple[float, float]]
) -> None:
    found = Clusters(np.array(clockwise), np.array(counter))

    def centre(points: list[tuple[float, float]]) -> float:
        return math.hypot(*(sum(p[axis] for p in points) / len(points) for axis in (0, 1)))

    pairs = itertools.chain(*(itertools.product(some, some) for some in (clockwise, counter)))
    assert found.largest_m() == pytest.approx(max(centre(clockwise), centre(counter)), abs=1e-12)
    assert found.spread_m() == pytest.approx(max(math.dist(a, b) for a, b in pairs), abs=1e-12)
