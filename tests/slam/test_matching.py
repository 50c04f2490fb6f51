"""What every matcher promises, and the line matcher's own parts against slow oracles."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import HOKUYO, box, labyrinth, sense_scans

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between, compose, transform_points
from slamsim.core.types import Cloud, FloatArray, PlanarTrajectory
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.matching import Matcher, make_matcher
from slamsim.slam.matching.line import LineMatcher
from slamsim.slam.matching.range_noise import START_NOISE_M, RangeNoise
from slamsim.slam.matching.surfaces import (
    BEAMS,
    MAX_NORMAL_SIGMA_RAD,
    NORMAL_X,
    NORMAL_Y,
    SCATTER_XX,
    SCATTER_XY,
    SCATTER_YY,
    X,
    Y,
    range_noise_m,
    surface_pieces,
)

BOTH = pytest.mark.parametrize("name", ["line", "kiss"])
PRIOR = np.diag(np.square([0.1, 0.1, 0.1]))
ROOM = np.concatenate([box(-3.0, -2.0, 3.0, 2.0), box(1.0, 0.5, 1.6, 1.1)])


def cloud_at(T_map_base: FloatArray, walls: FloatArray, seed: int, noise_m: float = 0.01) -> Cloud:
    """One noisy sweep of a standing lidar."""
    stamps_ns = np.array([0, HOKUYO.duration_ns + 1])
    still = PlanarTrajectory(stamps_ns, np.stack([T_map_base, T_map_base]))
    scan = sense_scans(walls, still, HOKUYO, noise_m, seed)[0]
    return deskew(scan, still, 0, np.eye(4))


def matcher_in(
    walls: FloatArray, name: Literal["line", "kiss"], at: FloatArray, scans: int = 5
) -> Matcher:
    """A matcher that has seen the walls from one place."""
    matcher = make_matcher(FrontEndConfig(matcher=name))
    for seed in range(scans):
        matcher.insert(cloud_at(at, walls, 100 + seed), at)
    return matcher


@BOTH
def test_a_part_that_is_matched_changes_nothing(name: Literal["line", "kiss"]) -> None:
    """Half of fr-clinic's path went astray over noise that was learnt of trial clouds."""
    plain, tried = (matcher_in(ROOM, name, np.zeros(3)) for _ in range(2))
    for seed in range(4):
        cloud = cloud_at(np.array([0.02, 0.01, 0.01]), ROOM, seed, 0.03)
        part = replace(cloud, hit=cloud.hit & (cloud.points_m[:, 0] > 0.0))
        assert tried.match_part(part, np.zeros(3), PRIOR) is not None
        found, again = (one.match(cloud, np.zeros(3), PRIOR) for one in (plain, tried))
        assert found is not None and again is not None
        # to rounding: KISS-ICP adds up in parallel, in whatever order its threads come
        np.testing.assert_allclose(found.T_map_base, again.T_map_base, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found.information, again.information, rtol=1e-9)


@BOTH
def test_nothing_to_match_against_is_none_and_no_identity(name: Literal["line", "kiss"]) -> None:
    matcher = make_matcher(FrontEndConfig(matcher=name))
    cloud = cloud_at(np.zeros(3), ROOM, 0)
    assert matcher.match(cloud, np.zeros(3), PRIOR) is None
    assert matcher.search(cloud, np.zeros(3), PRIOR) is None
    matcher.insert(cloud, np.zeros(3))
    empty = Cloud(0, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, np.bool_))
    silent = Cloud(0, cloud.points_m, cloud.origins_m, np.zeros_like(cloud.hit))
    for useless in (empty, silent):
        matcher.insert(useless, np.zeros(3))
        assert matcher.match(useless, np.zeros(3), PRIOR) is None
        assert matcher.search(useless, np.zeros(3), PRIOR) is None
    assert matcher.match(cloud, np.zeros(3), PRIOR) is not None
    matcher.forget()
    assert matcher.match(cloud, np.zeros(3), PRIOR) is None


@BOTH
def test_a_scan_is_found_from_a_wrong_guess(name: Literal["line", "kiss"]) -> None:
    start = np.array([-1.0, 0.2, 0.3])
    matcher = matcher_in(ROOM, name, start)
    true = compose(start, np.array([0.15, -0.05, 0.1]))
    close_m, close_rad = (0.004, 0.002) if name == "line" else (0.03, 0.02)
    for error in ([0.0, 0.0, 0.0], [0.1, -0.08, 0.06], [-0.12, 0.1, -0.08]):
        guess = compose(true, np.array(error))
        match = matcher.match(cloud_at(true, ROOM, 7), guess, PRIOR)
        assert match is not None
        off = between(true, match.T_map_base)
        assert np.hypot(off[0], off[1]) < close_m
        assert abs(off[2]) < close_rad
        assert match.inlier_ratio > 0.9
        assert match.covered_ratio > 0.9
        assert not match.degenerate


def test_search_finds_what_the_prediction_missed_by_far() -> None:
    """The basin promised by the configuration: 0.6 m and 25 degrees, inside its window."""
    walls, _ = labyrinth(3)
    start = np.array([1.0, 1.0, 0.4])
    matcher = matcher_in(walls, "line", start)
    true = compose(start, np.array([0.1, 0.0, 0.1]))
    rng = np.random.default_rng(0)
    for _ in range(12):
        way = rng.uniform(-np.pi, np.pi)
        error = np.array([0.5 * np.cos(way), 0.5 * np.sin(way), np.deg2rad(rng.uniform(-25, 25))])
        match = matcher.search(cloud_at(true, walls, 9), compose(true, error), PRIOR)
        assert match is not None
        off = between(true, match.T_map_base)
        assert np.hypot(off[0], off[1]) < 0.01
        assert abs(off[2]) < 0.005


@BOTH
def test_a_corridor_leaves_its_own_direction_to_the_prediction(
    name: Literal["line", "kiss"],
) -> None:
    """Two endless walls along 0.5 rad: across them and in heading the scan decides, along not."""
    walls = np.array([[-50.0, 1.0, 50.0, 1.0], [-50.0, -1.0, 50.0, -1.0]])
    start = np.array([0.0, 0.1, 0.5])
    matcher = matcher_in(walls, name, start)
    true = compose(start, np.array([0.05, 0.02, 0.02]))
    guess = true + np.array([0.06, 0.03, 0.01])
    match = matcher.match(cloud_at(true, walls, 3), guess, np.diag(np.square([0.05, 0.05, 0.02])))
    assert match is not None
    assert match.degenerate
    assert len(match.degenerate_directions) == 1
    free = match.degenerate_directions[0]
    along = np.array([np.cos(true[2]), -np.sin(true[2])])
    assert abs(free[:2] @ along) / np.linalg.norm(free[:2]) > 0.98
    assert free @ match.information @ free < 1e-6 * np.trace(match.information)
    assert match.T_map_base[0] == pytest.approx(guess[0], abs=0.01)
    assert match.T_map_base[1] == pytest.approx(true[1], abs=0.01)


def test_a_foreign_scan_does_not_fit() -> None:
    matcher = matcher_in(ROOM, "line", np.zeros(3))
    foreign = cloud_at(np.array([1.0, 1.0, 0.0]), labyrinth(5)[0], 0)
    match = matcher.match(foreign, np.zeros(3), PRIOR)
    assert match is None or match.inlier_ratio * match.covered_ratio < 0.6


def patchy_corridor(x_m: float, rng: np.random.Generator, noise_m: float) -> Cloud:
    """A corridor without doors as a lidar sees it that loses half of its returns."""
    angles = np.linspace(-np.pi / 2.0, np.pi / 2.0, 330)
    with np.errstate(divide="ignore"):
        true_m = np.where(angles < 0.0, -0.85, 0.95) / np.sin(angles)
    ranges_m = true_m + rng.normal(0.0, noise_m, angles.size)
    hit = (true_m < 8.7) & (rng.random(angles.size) > 0.45)
    points_m = np.where(hit, ranges_m, 8.7)[:, None] * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    return Cloud(round(x_m * 1e9), points_m, np.zeros_like(points_m), hit)


def test_noise_is_no_wall_across_a_corridor() -> None:
    rng, noise_m = np.random.default_rng(5), 0.028
    normals = []
    for _ in range(50):
        pieces = surface_pieces(patchy_corridor(0.0, rng, noise_m), noise_m, 0.25, 60.0)
        assert len(pieces) >= 7  # enough to be matched by
        normals.append(np.arctan2(pieces[:, NORMAL_X], np.abs(pieces[:, NORMAL_Y])))
    angles = np.abs(np.concatenate(normals))
    assert np.median(angles) < 0.15 and np.quantile(angles, 0.99) < 3.0 * MAX_NORMAL_SIGMA_RAD


def test_noise_does_not_hold_a_robot_back_in_a_corridor() -> None:
    rng, noise_m, off_m = np.random.default_rng(6), 0.028, 0.1
    matcher = LineMatcher(FrontEndConfig())
    steps, sigmas = [], []
    for number in range(80):
        T_map_base = np.array([0.05 * number, 0.0, 0.0])
        cloud = patchy_corridor(T_map_base[0], rng, noise_m)
        guess = compose(T_map_base, np.array([off_m, 0.0, 0.0]))
        match = matcher.match(cloud, guess, PRIOR)
        if match is not None and number > 10:
            information = match.information + np.linalg.inv(PRIOR)
            sigmas.append(np.sqrt(np.linalg.inv(information)[0, 0]))
            steps.append(match.T_map_base[0] - T_map_base[0])
        if number % 3 == 0:
            matcher.insert(cloud, T_map_base)
    errors = np.array(steps) - off_m
    assert abs(errors.mean()) < 0.1 * off_m  # the prediction decides
    assert np.median(sigmas) > 0.9 * np.sqrt(PRIOR[0, 0])


def test_same_input_same_bytes() -> None:
    results = []
    for _ in range(2):
        matcher = matcher_in(ROOM, "line", np.zeros(3))
        match = matcher.match(cloud_at(np.full(3, 0.05), ROOM, 1), np.zeros(3), PRIOR)
        assert match is not None
        results.append(match.T_map_base.tobytes() + match.information.tobytes())
    assert results[0] == results[1]


def test_information_holds_what_it_claims() -> None:
    """Squared errors in claimed sigmas average to no more than three directions, and not to
    nothing, once the matcher knows the noise."""
    start = np.array([-1.0, 0.2, 0.3])
    squares = []
    for run in range(6):
        matcher = matcher_in(ROOM, "line", start, scans=1 + run % 3)
        for seed in range(80):
            match = matcher.match(cloud_at(start, ROOM, 1000 * run + seed), start, PRIOR)
            assert match is not None
            step = between(start, match.T_map_base)
            squares.append(step @ match.information @ step)
    assert 0.1 < np.mean(squares) < 4.0


def test_range_noise_is_learnt_from_the_scans() -> None:
    for noise_m in (0.005, 0.01, 0.03):
        matcher = make_matcher(FrontEndConfig())
        assert isinstance(matcher, LineMatcher)
        for seed in range(40):
            matcher.insert(cloud_at(np.zeros(3), ROOM, seed, noise_m), np.zeros(3))
        assert matcher.range_noise_m == pytest.approx(noise_m, rel=0.15)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), yaw=st.floats(-3.0, 3.0), offset_m=st.floats(0.5, 5.0))
def test_pieces_of_a_wall_are_the_wall(seed: int, yaw: float, offset_m: float) -> None:
    """Every beam but the first and the last, which may have met something else as well, is in one
    piece; normals face the lidar, means lie on the wall."""
    rng = np.random.default_rng(seed)
    along = np.linspace(-1.0, 1.0, 200)
    local = np.column_stack([np.full(200, offset_m) + rng.normal(0.0, 0.001, 200), along])
    points = transform_points(np.array([0.0, 0.0, yaw]), local)
    cloud = Cloud(0, points, np.zeros((200, 2)), np.ones(200, np.bool_))
    pieces = surface_pieces(cloud, 0.002, 0.25, 60.0)
    assert pieces[:, BEAMS].sum() == 198
    normal = np.array([np.cos(yaw), np.sin(yaw)])
    assert np.all(pieces[:, [NORMAL_X, NORMAL_Y]] @ normal < -0.99)
    np.testing.assert_allclose(pieces[:, [X, Y]] @ normal, offset_m, atol=0.002)


def without_slant(points: FloatArray, noise_m: float) -> FloatArray:
    """(2, 2) scatter of points seen from the origin, less what noise adds along the surface."""
    scatter = np.cov(points.T, bias=True) * len(points)
    beam = points.mean(axis=0) / np.linalg.norm(points.mean(axis=0))
    noise = (len(points) - 1) * noise_m**2
    normal = np.linalg.eigh(scatter - noise * np.outer(beam, beam))[1][:, 0]
    kept = (normal @ beam) ** 2 * np.outer(normal, normal)
    return np.asarray(scatter - noise * (np.outer(beam, beam) - kept))


def test_noise_does_not_turn_the_normals_of_slanted_walls() -> None:
    """As it turns those of plain total least squares, for range errors act along the beams."""
    rng = np.random.default_rng(0)
    bearings = np.linspace(-0.05, 0.05, 26)
    rays = np.column_stack([np.cos(bearings), np.sin(bearings)])
    normal = np.array([np.cos(1.2), np.sin(1.2)])
    exact = 0.8 / (rays @ normal)

    def off_rad(axis: FloatArray) -> float:
        axis = axis * np.sign(axis @ normal)
        return float(np.arctan2(normal[0] * axis[1] - normal[1] * axis[0], normal @ axis))

    ours, plain = [], []
    for _ in range(1000):
        points = rays * (exact + 0.01 * rng.standard_normal(26))[:, None]
        cloud = Cloud(0, points, np.zeros((26, 2)), np.ones(26, np.bool_))
        pieces = surface_pieces(cloud, 0.01, 2.0, 60.0)
        if len(pieces) == 1:  # noise looks like two walls once in a thousand times
            ours.append(off_rad(pieces[0, [NORMAL_X, NORMAL_Y]]))
            plain.append(off_rad(np.linalg.eigh(np.cov(points[1:-1].T))[1][:, 0]))
    assert len(ours) >= 995
    assert abs(np.mean(ours)) < 0.5 * abs(np.mean(plain))


def test_pieces_pool_their_beams_as_numpy_does() -> None:
    cloud = cloud_at(np.zeros(3), ROOM, 0)
    pieces = surface_pieces(cloud, 0.01, 0.25, 60.0)
    assert len(pieces) > 30
    first = pieces[len(pieces) // 2]
    count = int(first[BEAMS])
    means = np.array(
        [cloud.points_m[i : i + count].mean(axis=0) for i in range(len(cloud.hit) - count + 1)]
    )
    begin = int(np.argmin(np.linalg.norm(means - first[[X, Y]], axis=1)))
    points = cloud.points_m[begin : begin + count]
    np.testing.assert_allclose(points.mean(axis=0), first[[X, Y]], atol=1e-9)
    scatter = without_slant(points, 0.01)
    expected = [scatter[0, 0], scatter[0, 1], scatter[1, 1]]
    np.testing.assert_allclose(first[[SCATTER_XX, SCATTER_XY, SCATTER_YY]], expected, atol=1e-6)
    assert range_noise_m(pieces) == pytest.approx(0.01, rel=0.3)


def test_walls_seen_from_both_sides_stay_two_surfaces() -> None:
    """A wall of 5 cm: matching from the far side must not be drawn to the near one."""
    walls = np.concatenate([box(-6.0, -3.0, 6.0, 3.0), box(-6.0, -0.025, 4.0, 0.025)])
    below, above = np.array([0.0, -1.5, 0.0]), np.array([0.0, 1.5, 0.0])
    matcher = matcher_in(walls, "line", below)
    for seed in range(5):
        matcher.insert(cloud_at(above, walls, seed), above)
    for true in (below, above):
        guess = true + np.array([0.0, 0.04, 0.0])
        match = matcher.match(cloud_at(true, walls, 77), guess, PRIOR)
        assert match is not None
        assert match.T_map_base[1] == pytest.approx(true[1], abs=0.004)


def rounded(cloud: Cloud, step_m: float, noise_m: float, seed: int) -> Cloud:
    """The same beams with noise of their own, read in whole steps."""
    beams = cloud.points_m - cloud.origins_m
    ranges_m = np.hypot(beams[:, 0], beams[:, 1])
    noisy_m = ranges_m + np.random.default_rng(seed).normal(0.0, noise_m, ranges_m.size)
    read_m = np.round(noisy_m / step_m) * step_m if step_m else noisy_m
    points_m = cloud.origins_m + beams * (read_m / np.maximum(ranges_m, 1e-9))[:, None]
    return Cloud(cloud.stamp_ns, points_m, cloud.origins_m, cloud.hit)


def in_a_cell(T_map_base: FloatArray, step_m: float, noise_m: float, seed: int) -> Cloud:
    """1128 beams over 180 deg in a square of 1.9 m about the origin, read in whole steps."""
    bearings = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 1128)
    beams = np.column_stack([np.cos(bearings), np.sin(bearings)])
    turned = transform_points(np.array([0.0, 0.0, T_map_base[2]]), beams)
    walls_m = (0.95 * np.sign(turned) - T_map_base[:2]) / turned
    points_m = walls_m.min(axis=1)[:, None] * beams
    hit = np.ones(len(beams), np.bool_)
    return rounded(Cloud(0, points_m, np.zeros_like(points_m), hit), step_m, noise_m, seed)


def test_steps_of_rounded_ranges_are_no_pieces_of_wall() -> None:
    """Each step of 5 cm is a piece square to the beams otherwise, exact to 3 mm: normals were off
    by 31 deg in the median, and the match by 30 mm and 1.1 deg."""
    at, there = np.array([-0.2, 0.1, 0.3]), np.array([-0.1, 0.03, 0.5])
    matcher = LineMatcher(FrontEndConfig())
    for seed in range(60):
        pieces = matcher.pieces(in_a_cell(at, 0.05, 0.003, seed))
    assert matcher.range_noise_m == pytest.approx(0.05 / np.sqrt(12.0))
    angles = np.arctan2(pieces[:, NORMAL_Y], pieces[:, NORMAL_X]) + at[2]
    off_rad = np.abs(angles - np.round(angles / (0.5 * np.pi)) * (0.5 * np.pi))
    assert np.median(off_rad) < np.deg2rad(6.0)
    matcher.insert_pieces(pieces, at)
    near = np.array([0.05, -0.04, 0.02])
    match = matcher.match(in_a_cell(there, 0.05, 0.003, 77), compose(there, near), PRIOR)
    assert match is not None
    left = between(there, match.T_map_base)
    assert np.hypot(left[0], left[1]) < 0.01 and abs(left[2]) < 0.005


def test_steps_that_noise_came_upon_are_no_pieces_of_wall() -> None:
    """What simulators write that follow a beam in steps: circles about the lidar, which went with
    the robot. A drive of 193 m in MRPT's simulator, steps of 16 cm and 1 cm of noise, was 1.57 m
    off; it is 18 mm since they are found."""
    matcher, rng = LineMatcher(FrontEndConfig()), np.random.default_rng(3)
    for seed in range(60):
        pose = np.array([*rng.uniform(-2.0, 2.0, 2), rng.uniform(-3.0, 3.0)])
        stepped = rounded(cloud_at(pose, ROOM, seed, noise_m=0.0), 0.16, 0.0, seed)
        matcher.pieces(rounded(stepped, 0.0, 0.01, seed))
    assert matcher.range_noise_m == pytest.approx(0.16 / np.sqrt(12.0), rel=0.02)


@pytest.mark.parametrize(("step_m", "noise_m"), [(0.0, 0.003), (0.001, 0.003), (0.01, 0.006)])
def test_fine_steps_leave_the_noise_that_is_seen(step_m: float, noise_m: float) -> None:
    walls, matcher = cloud_at(np.zeros(3), ROOM, 0, noise_m=0.0), LineMatcher(FrontEndConfig())
    for seed in range(60):
        matcher.pieces(rounded(walls, step_m, noise_m, seed))
    assert matcher.range_noise_m == pytest.approx(np.hypot(noise_m, step_m / 12.0**0.5), rel=0.15)


def test_steps_are_found_from_few_beams_too() -> None:
    """Twelve readings a scan show a step only after many scans."""
    noise, rng = RangeNoise(), np.random.default_rng(5)
    for _ in range(400):
        ranges_m = np.round(rng.uniform(0.5, 4.0, 12) / 0.05) * 0.05
        points_m = np.column_stack([ranges_m, np.zeros(12)])
        noise.see(Cloud(0, points_m, np.zeros((12, 2)), np.ones(12, np.bool_)))
    assert noise.sigma_m == pytest.approx(START_NOISE_M)
    for _ in range(60):
        noise.learn(exact_pieces())
    assert noise.sigma_m == pytest.approx(0.05 / np.sqrt(12.0))


def exact_pieces() -> FloatArray:
    """Of walls without any noise."""
    return surface_pieces(cloud_at(np.zeros(3), ROOM, 0, noise_m=0.0), 0.002, 0.25, 30.0)
