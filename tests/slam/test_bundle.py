"""Final refinement against a dense system, against drawn samples, and against what must not be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from slamsim.core.geometry import between, compose, transform_points
from slamsim.core.result import GraphEdge
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.evaluate.consistency import nees_band
from slamsim.guard.numbers import NoSolution
from slamsim.models.blocks import factorise
from slamsim.models.line_bundle import (
    Seen,
    add_surfaces,
    fit_lines,
    pose_rows,
    pull_to_lines,
    residuals,
    to_map,
)
from slamsim.models.supernodes import add_block, empty_system, make_panels
from slamsim.slam.backend.association import SURE_SIGMA_M, _firm, share_surfaces
from slamsim.slam.backend.bundle import NotRefined, Refined, refine
from slamsim.slam.matching.surfaces import (
    BEAMS,
    HALF_LENGTH,
    NORMAL_X,
    NORMAL_Y,
    PIECE_FIELDS,
    SCATTER_XX,
    SCATTER_XY,
    SCATTER_YY,
    X,
    Y,
)

ComplexArray = NDArray[np.complex128]

TINY = 1e-30
"""A complex step: the imaginary part of a value over it is the derivative, to the last digit
(Squire & Trapp 1998), since no difference is taken; its square vanishes beside any number."""

NOISE_M = 0.01
BEAMS_PER_PIECE = 40.0
SPREAD_M = 0.08
WALLS = [(-3.0, 0.0, 1.0, 0.0), (3.0, 0.0, -1.0, 0.0), (0.0, -2.0, 0.0, 1.0), (0.0, 2.0, 0.0, -1.0)]
"""A room: a point on each wall, and its normal into the room."""


@dataclass(frozen=True)
class Scene:
    """Key frames in a room, what they saw, and how they were joined."""

    truth: FloatArray
    start: FloatArray
    views: list[Float32Array]
    odometry: list[GraphEdge]
    edges: list[GraphEdge]


def piece(middle: FloatArray, normal: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A piece of wall of BEAMS_PER_PIECE noisy beams."""
    along = np.array([-normal[1], normal[0]])
    count = int(BEAMS_PER_PIECE)
    points = middle + np.linspace(-1.5, 1.5, count)[:, None] * SPREAD_M * along
    points = points + rng.normal(0.0, NOISE_M, count)[:, None] * normal
    mean = points.mean(axis=0)
    scatter = (points - mean).T @ (points - mean)
    row = np.zeros(PIECE_FIELDS)
    row[[X, Y, NORMAL_X, NORMAL_Y, BEAMS, HALF_LENGTH]] = [*mean, *normal, count, 1.5 * SPREAD_M]
    row[[SCATTER_XX, SCATTER_XY, SCATTER_YY]] = scatter[0, 0], scatter[0, 1], scatter[1, 1]
    return row


def view(T_map_base: FloatArray, rng: np.random.Generator) -> Float32Array:
    """Pieces every half metre along all walls of the room, in the base frame."""
    rows = []
    for x, y, nx, ny in WALLS:
        for step in np.arange(-1.75, 1.8, 0.5):
            middle = np.array([x - ny * step, y + nx * step])
            in_base = transform_points(between(T_map_base, np.zeros(3)), middle)
            cos, sin = np.cos(T_map_base[2]), np.sin(T_map_base[2])
            normal = np.array([cos * nx + sin * ny, -sin * nx + cos * ny])
            rows.append(piece(in_base, normal, rng))
    return np.array(rows, dtype=np.float32)


def scene(seed: int, count: int = 8) -> Scene:
    rng = np.random.default_rng(seed)
    turns = np.linspace(0.0, 2.0, count)
    truth = np.column_stack([np.linspace(-1.5, 1.5, count), np.sin(turns), turns])
    off = rng.normal(size=(count, 3)) * [0.01, 0.01, 0.003]
    off[0] = 0.0
    covariance = np.diag([4e-4, 4e-4, 1e-4])
    odometry, edges = [], []
    for k in range(count - 1):
        T = between(truth[k], truth[k + 1])
        drawn = compose(T, rng.normal(size=3) * [0.02, 0.02, 0.01])
        odometry.append(GraphEdge(k, k + 1, drawn, covariance, "odometry"))
        edges.append(GraphEdge(k, k + 1, T, 0.1 * covariance, "match"))
    views = [view(pose, rng) for pose in truth]
    return Scene(truth, compose(truth, off), views, odometry, edges)


def refined(one: Scene) -> Refined:
    return refine(one.views, one.start, one.odometry, NOISE_M, one.edges)


def test_poses_come_far_nearer_to_the_truth_than_they_began() -> None:
    one = scene(1)
    before, after = (between(one.truth[1:], poses[1:]) for poses in (one.start, refined(one).poses))
    assert np.abs(after[:, :2]).max() < 0.2 * np.abs(before[:, :2]).max()
    assert np.array_equal(refined(one).poses[0], one.start[0])


@pytest.mark.parametrize("rooms", [25, pytest.param(100, marks=pytest.mark.slow)])
def test_errors_are_as_large_as_the_covariances_say(rooms: int) -> None:
    """NEES over many drawn rooms: mean 3 for three degrees of freedom, give or take chance."""
    nees = []
    for seed in range(rooms):
        one = scene(100 + seed)
        result = refined(one)
        covariances = result.information.covariances()
        error = between(one.truth[1:], result.poses[1:])
        information = np.linalg.inv(covariances[1:])
        nees.append(np.einsum("ki,kij,kj->k", error, information, error))
    low, high = nees_band(rooms)
    assert low < np.mean(nees) < high
    assert np.array_equal(covariances[0], np.zeros((3, 3)))


def test_the_same_input_gives_the_same_bytes() -> None:
    assert refined(scene(3)).poses.tobytes() == refined(scene(3)).poses.tobytes()


def test_slipping_wheels_do_not_pull() -> None:
    one = scene(4)
    slipped = list(one.odometry)
    T = compose(slipped[3].T_source_target, np.array([0.5, 0.0, 0.3]))
    slipped[3] = GraphEdge(3, 4, T, slipped[3].covariance, "odometry")
    with_slip = refine(one.views, one.start, slipped, NOISE_M, one.edges)
    assert np.abs(between(refined(one).poses, with_slip.poses)[:, :2]).max() < 0.001


def test_the_odometry_of_a_long_loop_does_not_give_way_in_one_place() -> None:
    """Steps that are wrong by several of their sigmas each, between two ends that see the room."""
    one, ends = scene(8, count=40), 6
    rng = np.random.default_rng(8)
    views, odometry = list(one.views), []
    for k in range(ends, len(views) - ends):
        views[k] = views[k][:0]
    for edge in one.odometry:
        T = compose(between(*one.truth[[edge.source, edge.target]]), np.array([0.01, 0.0, 0.0]))
        T = compose(T, rng.normal(size=3) * [0.003, 0.003, 0.0003])
        odometry.append(replace(edge, T_source_target=T, covariance=np.diag([1e-6, 1e-6, 1e-7])))
    closure = GraphEdge(
        0, 39, between(one.truth[0], one.truth[-1]), np.diag([1e-6, 1e-6, 1e-8]), "closure"
    )
    result = refine(views, one.truth, odometry, NOISE_M, [*one.edges, closure])
    bent = between(
        between(one.truth[:-1], one.truth[1:]), between(result.poses[:-1], result.poses[1:])
    )
    assert np.hypot(bent[:, 0], bent[:, 1]).max() < 0.03


def test_the_two_faces_of_a_thin_wall_are_not_one() -> None:
    rng = np.random.default_rng(5)
    one_side = [piece(np.array([1.0, y]), np.array([-1.0, 0.0]), rng) for y in (0.0, 0.2)]
    other_side = [piece(np.array([1.02, y]), np.array([1.0, 0.0]), rng) for y in (0.0, 0.2)]
    views = [np.array(rows, dtype=np.float32) for rows in (one_side, other_side)]
    edge = GraphEdge(0, 1, np.zeros(3), np.diag([1e-6, 1e-6, 1e-8]), "match")
    assert len(share_surfaces(views, np.zeros((2, 3)), 0.06, [edge]).pieces) == 0


@pytest.mark.parametrize(("sigma_m", "shared"), [(0.01, True), (1.0, False)])
def test_views_that_nothing_holds_together_share_no_surface(sigma_m: float, shared: bool) -> None:
    """A false overlap must not bring back what was withdrawn."""
    rng = np.random.default_rng(6)
    views = [view(np.zeros(3), rng) for _ in range(2)]
    edges = [
        GraphEdge(0, 1, np.zeros(3), np.diag([sigma_m**2, sigma_m**2, 1e-6]), "odometry"),
        GraphEdge(0, 1, np.zeros(3), np.diag([1e-6, 1e-6, 1e-8]), "closure", weight=0.0),
    ]
    found = share_surfaces(views, np.zeros((2, 3)), 0.06, edges)
    assert (len(found.pieces) > 0) == shared
    assert (np.diff(found.starts) >= 2).all()


def test_a_closure_too_loose_for_common_surfaces_still_holds() -> None:
    """Odometry that is a metre wrong, and a metre unsure, does not open the loop again."""
    one, half = scene(9), 4
    odometry, edges = list(one.odometry), list(one.edges)
    T = compose(odometry[half - 1].T_source_target, np.array([1.0, 0.0, 0.0]))
    odometry[half - 1] = GraphEdge(half - 1, half, T, np.diag([1.0, 1.0, 0.01]), "odometry")
    edges[half - 1] = odometry[half - 1]
    T = between(one.truth[0], one.truth[-1])
    edges.append(GraphEdge(0, 7, T, np.diag([0.01, 0.01, 0.0004]), "closure"))
    result = refine(one.views, one.truth, odometry, NOISE_M, edges)
    assert np.abs(between(one.truth[-1], result.poses[-1])[:2]).max() < 0.03
    sigmas = np.sqrt(np.diag(result.information.covariances()[-1]))
    np.testing.assert_allclose(sigmas, [0.1, 0.1, 0.02], rtol=0.15)


@pytest.mark.parametrize(("sigma_m", "may"), [(10.0, True), (0.3, False)])
def test_only_parts_between_which_the_robot_was_carried_may_move_apart(
    sigma_m: float, may: bool
) -> None:
    one, half = scene(9), 4
    odometry, edges = list(one.odometry), list(one.edges)
    T = compose(odometry[half - 1].T_source_target, np.array([0.9, 0.0, 0.0]))
    covariance = np.diag([sigma_m**2, sigma_m**2, 0.1])
    odometry[half - 1] = GraphEdge(half - 1, half, T, covariance, "odometry")
    edges[half - 1] = odometry[half - 1]
    if not may:
        with pytest.raises(NotRefined, match="moved neighbouring") as refusal:
            refine(one.views, one.truth, odometry, NOISE_M, edges)
        assert refusal.value.bent_after == half - 1
        return
    result = refine(one.views, one.truth, odometry, NOISE_M, edges)
    step = between(result.poses[half - 1], result.poses[half])
    assert np.hypot(*(step - between(*one.truth[half - 1 : half + 1]))[:2]) > 0.5
    for part in (slice(0, half), slice(half, None)):
        apart = between(result.poses[part][0], result.poses[part])
        true = between(one.truth[part][0], one.truth[part])
        assert np.abs((apart - true)[:, :2]).max() < 0.01


def test_views_without_a_common_surface_are_left_alone() -> None:
    one = scene(7)
    empty = [np.zeros((0, PIECE_FIELDS), dtype=np.float32)] * len(one.views)
    with pytest.raises(NotRefined, match="no surface"):
        refine(empty, one.start, one.odometry, NOISE_M, one.edges)


def test_numbers_that_are_not_finite_are_refused() -> None:
    one = scene(8)
    odometry = [*one.odometry[:-1], GraphEdge(6, 7, np.full(3, np.nan), np.eye(3), "odometry")]
    with pytest.raises(NoSolution, match="finite"):
        refine(one.views, one.start, odometry, NOISE_M, one.edges)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_the_reduced_system_is_the_dense_one_with_surfaces_eliminated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, surfaces = 4, 5
    views = np.concatenate([np.sort(rng.integers(0, count, 6)) for _ in range(surfaces)])
    starts = np.arange(0, 6 * surfaces + 1, 6, dtype=np.int64)
    poses = rng.normal(size=(count, 3))
    points = to_map(rng.normal(size=(len(views), 2, 2)) * 3.0, views, poses)
    weights = rng.uniform(0.5, 2.0, len(views))
    lines = fit_lines(points, weights, starts)
    number = np.append(count - 1, np.arange(count - 1))
    everyone = np.array([(a, b) for a in range(count) for b in range(a)])
    panels = make_panels(everyone, count - 1)
    system = empty_system(panels)
    rows = pose_rows(points, starts, lines, views, poses)
    seen = Seen(points, weights, starts, lines, rows, number[views][:, None])
    add_surfaces(seen, panels, system)
    ridge = 1e-3 * np.eye(3)
    for k in range(count - 1):
        add_block(panels, system, k, k, ridge)
    right = np.zeros((count, 3))
    pull_to_lines(seen, right)

    own = (number[views], np.roll(poses, -1, axis=0))
    dense, dense_right = dense_system(points, weights, own, starts, lines)
    size = 3 * (count - 1)
    dense[:size, :size] += 1e-3 * np.eye(size)
    dense_inverse = np.linalg.inv(dense)[:size, :size]
    found = factorise(panels, system, np.arange(1, count))
    expected = (dense_inverse @ dense_right[:size]).reshape(-1, 3)
    # The condition of the system, 1.4e6 at worst of 3,000 seeds, times double precision is 3e-10.
    off = 1e-9 * np.abs(expected).max()
    assert np.allclose(found.solve(right[:-1]), expected, rtol=0.0, atol=off)
    blocks = [dense_inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count - 1)]
    # Metres and radians differ by orders: each entry is held against its own row and column.
    sizes = np.sqrt([np.outer(np.diag(block), np.diag(block)) for block in blocks])
    assert (np.abs(found.inverse_diagonal() - blocks) <= 1e-9 * sizes).all()


def dense_system(
    points: FloatArray,
    weights: FloatArray,
    poses: tuple[IntArray, FloatArray],
    starts: IntArray,
    lines: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of poses and lines together, rows by complex steps."""
    unknowns, T_map_own = poses
    count = len(T_map_own)
    own = 3 * (count - 1)
    size = own + 2 * len(lines)
    system, right = np.zeros((size, size)), np.zeros(size)
    off = residuals(points, starts, lines)
    for s, (x, y, nx, ny) in enumerate(lines):
        for k in range(starts[s], starts[s + 1]):
            for end in range(2):
                row = np.zeros(size)
                p = points[k, end]
                if unknowns[k] < count - 1:
                    T = transform_matrix(T_map_own[unknowns[k]])
                    seen = np.linalg.solve(T, [*p, 1.0])
                    for axis in range(3):
                        step = np.zeros(3, dtype=np.complex128)
                        step[axis] = TINY * 1j
                        moved = T @ transform_matrix(step) @ seen
                        row[3 * unknowns[k] + axis] = moved[:2].imag @ [nx, ny] / TINY
                row[own + 2 * s] = -1.0
                row[own + 2 * s + 1] = -ny * (p[0] - x) + nx * (p[1] - y)
                system += weights[k] * np.outer(row, row)
                right -= weights[k] * off[k, end] * row
    return system, right


def transform_matrix(T: ComplexArray | FloatArray) -> ComplexArray:
    """(3, 3) of a planar transform (x, y, yaw), which may be complex."""
    x, y, yaw = T.astype(np.complex128)
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]])


@given(seed=st.integers(0, 1000))
def test_views_are_firm_that_some_way_of_the_graph_joins_surely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 60))
    ends = [(k, k + 1) for k in range(count - 1)]
    apart = [(a, b) for a in range(count) for b in range(a + 2, count)]
    ends += [apart[k] for k in rng.choice(len(apart), len(apart) // 20, replace=False)]
    ends += [ends[k][::step] for k in rng.choice(len(ends), 2) for step in (1, -1)]  # once more
    sizes_m = rng.uniform(0.005, 0.12, len(ends))
    edges = [
        GraphEdge(a, b, np.zeros(3), np.diag([s**2, 0.0, 0.0]), "match")
        for (a, b), s in zip(ends, sizes_m, strict=True)
    ]
    pairs = np.array([(a, b) for a in range(count) for b in range(a)])
    variance = np.full((count, count), np.inf)
    np.fill_diagonal(variance, 0.0)
    for (a, b), size_m in zip(ends, sizes_m, strict=True):
        variance[a, b] = variance[b, a] = min(variance[a, b], size_m**2)
    for k in range(count):  # Floyd and Warshall
        variance = np.minimum(variance, variance[:, k, None] + variance[None, k])
    surest = variance[pairs[:, 0], pairs[:, 1]]
    clear = np.abs(surest - SURE_SIGMA_M**2) > 1e-12
    found = _firm(pairs, edges)
    np.testing.assert_array_equal(found[clear], (surest <= SURE_SIGMA_M**2)[clear])
