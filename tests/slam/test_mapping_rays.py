"""Beams through cells against slow geometry, and what one scan may do to a cell."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.ray_walk import evidence_weights
from slamsim.core.types import BoolArray, FloatArray
from slamsim.slam.mapping.raytrace import clear_shares, update_log_odds, walk_beam

WEIGHTS = np.array([0.8, -0.4, -3.0, 3.0])
coordinate = st.floats(0.0, 40.0, allow_nan=False)
near = st.floats(0.0, 12.0, allow_nan=False)


def walked(start: FloatArray, end: FloatArray) -> list[tuple[int, int]]:
    cells = np.empty((200, 2), np.int32)
    count = walk_beam(start, end, cells)
    return [(int(c), int(r)) for c, r in cells[:count]]


def span_in_cell(start: FloatArray, end: FloatArray, cell: tuple[int, int], grow: float) -> float:
    """Length of the segment's piece in a cell grown to all sides; negative if it misses it."""
    first, last = 0.0, 1.0
    for axis in range(2):
        low, high = cell[axis] - grow, cell[axis] + 1.0 + grow
        step = end[axis] - start[axis]
        if abs(step) < 1e-9:
            if not low < start[axis] < high:
                return -1.0
            continue
        near, far = sorted(((low - start[axis]) / step, (high - start[axis]) / step))
        first, last = max(first, near), min(last, far)
    return (last - first) * float(np.hypot(*(end - start)))


@settings(max_examples=300)
@given(near, near, near, near)
def test_a_beam_passes_exactly_the_cells_that_hold_a_piece_of_it(
    x0: float, y0: float, x1: float, y1: float
) -> None:
    start, end = np.array([x0, y0]), np.array([x1, y1])
    found = set(walked(start, end))
    for cell in [(column, row) for column in range(-1, 14) for row in range(-1, 14)]:
        if span_in_cell(start, end, cell, grow=-1e-9) > 1e-6:
            assert cell in found
        if span_in_cell(start, end, cell, grow=1e-9) < 0.0:
            assert cell not in found


@settings(max_examples=300)
@given(coordinate, coordinate, coordinate, coordinate)
def test_a_walk_is_connected_by_edges_and_as_short_as_can_be(
    x0: float, y0: float, x1: float, y1: float
) -> None:
    found = np.array(walked(np.array([x0, y0]), np.array([x1, y1])))
    steps = np.abs(np.diff(found, axis=0))
    assert (steps.sum(axis=1) == 1).all()
    assert len(found) == 1 + np.abs(found[-1] - found[0]).sum()


def test_a_walk_from_corner_to_corner_ends_where_it_should() -> None:
    assert walked(np.array([0.0, 0.0]), np.array([3.0, 3.0]))[-1] == (3, 3)
    assert walked(np.array([5.0, 5.0]), np.array([2.0, 2.0]))[-1] == (2, 2)
    assert walked(np.array([1.5, 1.5]), np.array([1.5, 1.5])) == [(1, 1)]


def drawn(origins: FloatArray, ends: FloatArray, hit: BoolArray, scans: int = 1) -> FloatArray:
    log_odds, seen = np.zeros((60, 60), np.float32), np.zeros((60, 60), np.int32)
    for mark in range(1, scans + 1):
        update_log_odds(log_odds, seen, mark, origins, ends, hit, WEIGHTS)
    return log_odds.astype(np.float64)


def test_a_beam_clears_its_way_and_marks_its_end() -> None:
    log_odds = drawn(np.array([[2.5, 2.5]]), np.array([[20.5, 2.5]]), np.array([True]))
    assert np.isclose(log_odds[2, 20], WEIGHTS[0])
    assert np.allclose(log_odds[2, 2:20], WEIGHTS[1])
    assert np.count_nonzero(log_odds) == 19


def test_a_beam_without_return_clears_its_end_too() -> None:
    log_odds = drawn(np.array([[2.5, 2.5]]), np.array([[20.5, 2.5]]), np.array([False]))
    assert np.allclose(log_odds[2, 2:21], WEIGHTS[1])
    assert np.count_nonzero(log_odds) == 19


def test_one_scan_changes_a_cell_once_however_many_beams_it_sends_there() -> None:
    origins = np.repeat([[2.5, 2.5]], 50, axis=0)
    ends = np.column_stack([np.full(50, 20.5), np.linspace(2.05, 2.95, 50)])
    log_odds = drawn(origins, ends, np.ones(50, np.bool_))
    assert np.isclose(log_odds[2, 20], WEIGHTS[0])
    assert np.isclose(log_odds[2, 10], WEIGHTS[1])


def test_within_a_scan_a_hit_wins_over_beams_that_pass() -> None:
    origins = np.repeat([[2.5, 2.5]], 2, axis=0)
    ends = np.array([[30.5, 2.6], [15.5, 2.5]])
    assert np.isclose(drawn(origins, ends, np.ones(2, np.bool_))[2, 15], WEIGHTS[0])


def test_evidence_stops_at_its_bounds() -> None:
    origins, ends = np.array([[2.5, 2.5]]), np.array([[20.5, 2.5]])
    log_odds = drawn(origins, ends, np.array([True]), scans=50)
    assert np.isclose(log_odds[2, 20], WEIGHTS[3])
    assert np.isclose(log_odds[2, 10], WEIGHTS[2])


def grazing_scan(angles: FloatArray, height: float) -> tuple[FloatArray, FloatArray]:
    """Beams from (2, 2) to a wall that runs along x at some height above them."""
    ends = np.column_stack([2.0 + (height - 2.0) / np.tan(angles), np.full(angles.size, height)])
    return np.repeat([[2.0, 2.0]], angles.size, axis=0), ends


def test_beams_that_graze_a_wall_do_not_wear_it_away() -> None:
    angles = np.linspace(np.deg2rad(6.0), np.deg2rad(40.0), 40)
    origins, ends = grazing_scan(angles, height=7.9)
    log_odds = drawn(origins, ends, np.ones(40, np.bool_))
    wall = log_odds[7, int(ends[-1, 0]) : int(ends[0, 0]) + 1]
    assert (wall >= 0.0).all()
    assert (log_odds[:6] <= 0.0).all()
    assert np.count_nonzero(log_odds[3:6]) > 40


def test_free_space_is_shown_up_to_one_cell_from_the_surface_measured_square_to_it() -> None:
    angles = np.linspace(np.deg2rad(10.0), np.deg2rad(60.0), 60)
    origins, ends = grazing_scan(angles, height=20.0)
    shares = clear_shares(origins, ends, np.ones(60, np.bool_))
    below = (1.0 - shares) * (ends[:, 1] - origins[:, 1])
    assert np.allclose(below, 1.0, atol=1e-6)


def test_a_lone_return_is_taken_to_face_the_lidar() -> None:
    origins, ends = np.array([[0.0, 0.0]]), np.array([[10.0, 0.0]])
    assert np.allclose(clear_shares(origins, ends, np.array([True])), 0.9)
    assert np.allclose(clear_shares(origins, ends, np.array([False])), 1.0)


def test_a_beam_of_no_length_clears_nothing_and_breaks_nothing() -> None:
    same = np.array([[3.5, 3.5]])
    assert np.allclose(clear_shares(same, same, np.array([True])), 0.0)
    assert np.isclose(drawn(same, same, np.array([True]))[3, 3], WEIGHTS[0])


def test_evidence_of_rays_adds_up_as_bayes_says() -> None:
    """Three hits and a miss, by the product of odds; limits are probabilities too."""
    hit, miss, *limits = evidence_weights(0.64, 0.43, 0.02, 0.98)
    odds = (0.64 / 0.36) ** 3 * (0.43 / 0.57)
    assert np.isclose(np.exp(3.0 * hit + miss), odds)
    assert np.allclose(1.0 / (1.0 + np.exp(-np.array(limits))), [0.02, 0.98])
