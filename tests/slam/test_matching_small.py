"""Three-by-three algebra and the median against NumPy; the local map against pooling all points."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.matching.local_map import PER_CELL, SIDE, LocalMap
from slamsim.slam.matching.small import eigen, median, sandwich, solve, times
from slamsim.slam.matching.surfaces import (
    BEAMS,
    SCATTER_XX,
    SCATTER_XY,
    SCATTER_YY,
    X,
    Y,
    surface_pieces,
)

MATRICES = arrays(np.float64, (3, 3), elements=st.floats(-10.0, 10.0, allow_subnormal=False))


@settings(max_examples=100)
@given(matrix=MATRICES)
def test_eigen_agrees_with_numpy(matrix: FloatArray) -> None:
    symmetric = matrix + matrix.T
    values, axes = np.empty(3), np.empty((3, 3))
    eigen(symmetric, values, axes)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(symmetric), atol=1e-10)
    np.testing.assert_allclose(symmetric @ axes, axes * values, atol=1e-9)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)


@settings(max_examples=100)
@given(matrix=MATRICES, right=arrays(np.float64, 3, elements=st.floats(-10.0, 10.0)))
def test_solve_agrees_with_numpy(matrix: FloatArray, right: FloatArray) -> None:
    positive = matrix @ matrix.T + 0.1 * np.eye(3)
    out = np.empty(3)
    solve(positive, right, out)
    np.testing.assert_allclose(positive @ out, right, atol=1e-8)


def test_solve_of_what_is_not_positive_is_nan() -> None:
    out = np.empty(3)
    solve(-np.eye(3), np.ones(3), out)
    assert np.isnan(out).any()


@settings(max_examples=50)
@given(matrix=MATRICES, inner=MATRICES)
def test_products_agree_with_numpy(matrix: FloatArray, inner: FloatArray) -> None:
    outer = matrix + matrix.T
    result, vector = inner.copy(), np.empty(3)
    sandwich(outer, result)
    np.testing.assert_allclose(result, outer @ inner @ outer, atol=1e-8)
    times(matrix, inner[0], vector)
    np.testing.assert_allclose(vector, matrix @ inner[0], atol=1e-10)


@settings(max_examples=100)
@given(values=arrays(np.float64, st.integers(1, 60), elements=st.floats(-5.0, 5.0)))
def test_median_is_the_lower_middle(values: FloatArray) -> None:
    expected = np.sort(values)[(values.size - 1) // 2]
    assert median(values.copy(), values.size) == expected


def _wall_cloud(rng: np.random.Generator, turn: float) -> Cloud:
    """A short wall ahead, seen from the origin, a little different each time."""
    along = np.linspace(-0.1, 0.1, 30)
    points = np.column_stack([1.1 + rng.normal(0.0, 0.002, 30), 1.125 + along])
    cos, sin = np.cos(-turn), np.sin(-turn)
    seen = points @ np.array([[cos, sin], [-sin, cos]])
    return Cloud(0, seen, np.zeros((30, 2)), np.ones(30, np.bool_))


def test_merging_scans_is_fitting_all_their_points_at_once() -> None:
    rng = np.random.default_rng(0)
    local_map = LocalMap(0.25, 30.0)
    beams, means, scatters = [], [], []
    for turn in (0.0, 0.4, -0.7):
        pieces = surface_pieces(_wall_cloud(rng, turn), 0.005, 0.25, 60.0)
        local_map.insert(pieces, np.array([0.0, 0.0, turn]), 0.005)
        cos, sin = np.cos(turn), np.sin(turn)
        rotation = np.array([[cos, -sin], [sin, cos]])
        (piece,) = pieces
        xx, xy, yy = piece[[SCATTER_XX, SCATTER_XY, SCATTER_YY]]
        beams.append(piece[BEAMS])
        means.append(rotation @ piece[[X, Y]])
        scatters.append(rotation @ np.array([[xx, xy], [xy, yy]]) @ rotation.T)
    used = local_map.surfaces[local_map.surfaces[:, BEAMS] > 0.0]
    assert len(used) == 1 and used[0, BEAMS] == sum(beams)
    mean = np.average(means, axis=0, weights=beams)
    np.testing.assert_allclose(used[0, [X, Y]], mean, atol=1e-9)
    apart = [n * np.outer(m - mean, m - mean) for n, m in zip(beams, means, strict=True)]
    whole = np.sum(scatters, axis=0) + np.sum(apart, axis=0)
    np.testing.assert_allclose(
        used[0, [SCATTER_XX, SCATTER_XY, SCATTER_YY]],
        [whole[0, 0], whole[0, 1], whole[1, 1]],
        atol=1e-9,
    )


def test_what_is_far_away_or_long_ago_is_overwritten_and_memory_stays() -> None:
    rng = np.random.default_rng(0)
    local_map = LocalMap(0.25, 5.0)
    size = local_map.surfaces.nbytes
    assert local_map.surfaces.shape[0] == SIDE * SIDE * PER_CELL
    pieces = surface_pieces(_wall_cloud(rng, 0.0), 0.005, 0.25, 60.0)
    around_m = SIDE * 0.25
    for lap in range(4):
        local_map.insert(pieces, np.array([lap * around_m, 0.0, 0.0]), 0.005)
        used = local_map.surfaces[local_map.surfaces[:, BEAMS] > 0.0]
        assert len(used) == 1
        assert used[0, X] > lap * around_m
    assert local_map.surfaces.nbytes == size
