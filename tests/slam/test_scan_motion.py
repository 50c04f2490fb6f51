"""Motion of a lidar by its scans alone: against exact truth, and against slow algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scan_recording import (
    LIDAR,
    healthy,
    raw_scans,
    scan_motions,
    truth,
    with_layout,
    with_ranges,
    world,
)
from simulated import drive, sense_scans

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, PlanarTrajectory, ScanGeometry
from slamsim.guard.numbers import require_covariances
from slamsim.models.line_bundle import fit_lines
from slamsim.recording import RawScans
from slamsim.slam.laser import scan_bundle, scan_motion
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_bends import BEND_FIELDS, LARGEST_BEND_PER_M, fit_bends
from slamsim.slam.laser.scan_bundle import SHAPE_PRIOR_SIGMAS, Shape, ShapePull, WindowFit
from slamsim.slam.laser.scan_equations import POSE, SHAPES, UNKNOWNS, moved_points, window_system
from slamsim.slam.laser.scan_motion import ScanMotions
from slamsim.slam.laser.scan_sweep import local_motion, moved_pieces, velocity_weights
from slamsim.slam.laser.scan_track import LaserTrack
from slamsim.slam.laser.scan_windows import (
    choose_windows,
    longest_ascending,
    period_s,
    surely_ascending,
)
from slamsim.slam.matching.surfaces import PIECE_FIELDS, X, Y


def chi2(motions: ScanMotions) -> FloatArray:
    """(m,) of each step against the truth, per degree of freedom."""
    T = [truth().at(window.middle_ns) for window in motions.windows]
    true = np.concatenate([between(one[:-1], one[1:]) for one in T])
    off = between(true, motions.T_first_second)
    return np.asarray(np.einsum("ki,kij,kj->k", off, motions.information, off) / 3.0)


def test_steps_are_as_near_the_truth_as_they_claim() -> None:
    found = np.concatenate([chi2(scan_motions(healthy(seed).scans[0])) for seed in range(2)])
    assert found.size > 250
    assert 0.4 < found.mean() < 2.5
    assert np.mean(found < 5.4) > 0.97, "three degrees of freedom, 99.9 %"


def test_shape_of_healthy_scans_is_as_declared() -> None:
    motions = scan_motions(healthy().scans[0])
    sweep, angle, offset = motions.sweep_s, motions.angle_step, motions.range_offset_m
    assert sweep.sigma < 0.05 * sweep.declared
    assert abs(sweep.value - sweep.declared) < 5.0 * sweep.sigma
    assert angle.sigma < 1e-3
    assert abs(angle.value - 1.0) < 5.0 * angle.sigma
    assert abs(offset.value) < 5.0 * offset.sigma


def test_windows_hold_scans_in_order_and_steps_join_neighbours() -> None:
    motions = scan_motions(healthy().scans[0])
    for window in motions.windows:
        assert (np.diff(window.scans) > 0).all()
        np.testing.assert_array_equal(window.T_window_laser[0], np.zeros(3))
        assert np.linalg.eigvalsh(window.covariance[3:, 3:]).min() > 0.0
    assert motions.first.size == motions.second.size == motions.window.size
    assert (motions.second > motions.first).all()


def test_motion_is_told_in_the_unit_of_the_ranges() -> None:
    of = healthy()
    metres = scan_motions(of.scans[0])
    millimetres = scan_motions(
        with_ranges(of, np.multiply(1000.0, of.scans[0].ranges_m, dtype=np.float64)).scans[0]
    )
    assert millimetres.metres_per_unit == 1e-3
    T = metres.T_first_second * [1000.0, 1000.0, 1.0]
    np.testing.assert_allclose(millimetres.T_first_second, T, atol=1.5)


def first(scans: RawScans, count: int) -> RawScans:
    """The scans that were recorded first."""
    return replace(
        scans,
        ranges_m=np.asarray(scans.ranges_m)[:count],
        stamps_ns=scans.stamps_ns[:count],
        layout_of=scans.layout_of[:count],
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("share", "count"), [(0.9, 90), pytest.param(0.8, 200, marks=pytest.mark.slow)]
)
def test_an_angle_that_is_far_off_is_found(share: float, count: int) -> None:
    step_rad = share * LIDAR.angle_step_rad
    wide = with_layout(
        healthy(),
        angle_step_rad=step_rad,
        angle_min_rad=-180 * step_rad,
        angle_max_rad=180 * step_rad,
    )
    found = scan_motions(first(wide.scans[0], count)).angle_step.value
    assert found == pytest.approx(1.0 / share, abs=0.005)


SLOW = ScanGeometry(-np.pi, np.deg2rad(1.0), 360, 555_000, 0.05, 12.0)
"""Five turns a second, a beam for each degree."""


def test_a_slow_sweep_that_runs_backward_is_found_on_a_lively_drive() -> None:
    walls, waypoints = world()
    path = drive(waypoints, max_s=40.0)
    twice_as_fast = PlanarTrajectory(path.stamps_ns // 2, path.poses)
    scans = raw_scans(sense_scans(walls, twice_as_fast, SLOW, 0.01, 1, 200_000_000))
    layout = scans.layouts[0]
    backward = replace(layout, beam_dt_s=-layout.beam_dt_s)
    found = scan_motions(replace(scans, layouts=(backward,))).sweep_s
    assert found.value == pytest.approx(-found.declared, rel=0.02)


def broken(scans: RawScans, rng: np.random.Generator, kind: str) -> RawScans:
    ranges, stamps = np.array(scans.ranges_m), scans.stamps_ns.copy()
    if kind == "nan":
        return replace(scans, ranges_m=np.full_like(ranges, np.nan))
    if kind == "noise":
        return replace(scans, ranges_m=rng.uniform(0, 30, ranges.shape).astype(np.float32))
    if kind == "constant":
        return replace(scans, ranges_m=np.full_like(ranges, 2.0))
    if kind == "one stamp":
        return replace(scans, stamps_ns=np.full_like(stamps, 7))
    if kind == "any stamps":
        return replace(scans, stamps_ns=rng.integers(0, 1 << 62, stamps.size))
    if kind == "beam counts":
        return replace(scans, ranges_m=[row[: rng.integers(0, row.size)] for row in ranges])
    layouts = (replace(scans.layouts[0], angle_step_rad=0.0, beam_dt_s=np.nan),)
    return replace(scans, layouts=layouts)


@pytest.mark.parametrize(
    "kind", ["nan", "noise", "constant", "one stamp", "any stamps", "beam counts", "layout"]
)
def test_whatever_is_recorded_gives_an_answer(kind: str) -> None:
    few = first(healthy().scans[0], 60)
    motions = scan_motions(broken(few, np.random.default_rng(1), kind))
    assert np.isfinite(motions.T_first_second).all()


@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_few_scans_tell_nothing(count: int) -> None:
    motions = scan_motions(first(healthy().scans[0], count))
    assert motions.windows == () and motions.weak
    assert motions.T_first_second.shape == (0, 3) and np.isinf(motions.angle_step.sigma)


def test_stray_unreadable_and_own_beams_are_left_out() -> None:
    scans = healthy().scans[0]
    ranges = np.array(scans.ranges_m)
    ranges[:, 100:120] = 0.3
    ranges[:, 7] = 0.0
    ranges[:, 9] = np.nan
    ranges[:, 200] = 29.0
    cloud = BeamReader(replace(scans, ranges_m=ranges)).cloud(40)
    angles = np.arctan2(cloud.points_m[:, 1], cloud.points_m[:, 0])
    beams = np.round((angles - LIDAR.angle_min_rad) / LIDAR.angle_step_rad).astype(int)
    assert not set(beams) & {7, 9, 200, *range(100, 120)}
    assert len(beams) > 330


def test_walls_beside_a_straight_drive_are_not_the_robot() -> None:
    scans = healthy().scans[0]
    cloud = BeamReader(scans).cloud(40)
    assert len(cloud.points_m) > 0.99 * np.isfinite(scans.ranges_m[40]).sum()


@given(
    count=st.integers(0, 5000),
    period_ms=st.integers(2, 500),
    seed=st.integers(0, 100),
    lively=st.booleans(),
)
def test_windows_lie_within_the_recording(
    count: int, period_ms: int, seed: int, lively: bool
) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.arange(count, dtype=np.int64) * period_ms * 1_000_000
    activity = rng.random(count) if lively else None
    windows = choose_windows(stamps, activity)
    for window in windows:
        assert window.size and window[0] >= 0 and window[-1] < count
        assert np.unique(np.diff(window)).size <= 1
    starts = [int(window[0]) for window in windows]
    assert starts == sorted(starts)


@given(seed=st.integers(0, 1000))
def test_usual_period_does_not_mind_odd_stamps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.arange(200, dtype=np.int64) * 25_000_000
    odd = rng.random(200) < 0.2
    stamps[odd] += rng.integers(-(10**12), 10**12, odd.sum())
    assert period_s(stamps) == pytest.approx(0.025, rel=0.5)


def test_motion_within_a_sweep_is_that_of_a_smooth_path() -> None:
    seconds = np.linspace(0.0, 0.8, 9)
    yaw = 0.3 * seconds + 0.4 * seconds**2 - 0.2 * seconds**3
    poses = np.column_stack([np.zeros(9), np.zeros(9), yaw])
    motion = local_motion(poses, seconds)[2:-2, :, 2]
    at = seconds[2:-2]
    np.testing.assert_allclose(motion[:, 0], 0.3 + 0.8 * at - 0.6 * at**2, atol=1e-9)
    np.testing.assert_allclose(motion[:, 1], 0.4 - 0.6 * at, atol=1e-9)


def driven(speed_m_s: float, noise_m: float) -> tuple[list[LaserTrack], list[WindowFit]]:
    """Thirty scans of walls 2 m away, from poses as far off as they claim, by a tenth of the noise
    a metre in radians; they tell the shape to 0.1 ms, 1e-4 and 0.1 mm."""
    rng, elapsed_s = np.random.default_rng(4), np.arange(30) / 15.0
    sigmas = noise_m * np.array([1.0, 1.0, 0.1])
    poses = np.column_stack([speed_m_s * elapsed_s, np.zeros(30), np.zeros(30)])
    poses[1:] = compose(poses[1:], rng.normal(0.0, sigmas, (29, 3)))
    walls = np.zeros((4, PIECE_FIELDS))
    walls[:, X] = 2.0
    information = np.asarray(np.kron(np.eye(29), np.diag(sigmas**-2.0)), np.float64)
    fit = WindowFit(
        poses=poses,
        inner=information,
        made_up=np.zeros((87, 87)),
        inlier_share=np.ones(30),
        information=1e8 * np.eye(SHAPES),
        pull=np.zeros(SHAPES),
        by_shape=np.zeros((87, SHAPES)),
        unit=1.0,
    )
    return [LaserTrack(np.arange(30), elapsed_s, poses, (walls,) * 30, (), 0.01)], [fit]


def share_made_up(speed_m_s: float, noise_m: float) -> float:
    return scan_motion.made_up_sweep(*driven(speed_m_s, noise_m))


def along_walls(hidden_m: float, followed: float) -> WindowFit:
    """A straight drive of ten scans, 0.1 m each, x known to hidden_m and y to 1 mm; x follows the
    range offset by this share of the way."""
    poses = np.column_stack([0.1 * np.arange(10), np.zeros(10), np.zeros(10)])
    follows = np.zeros((9, POSE, SHAPES))
    follows[:, 0, 2] = followed * poses[1:, 0]
    return WindowFit(
        poses=poses,
        inner=np.asarray(np.kron(np.eye(9), np.diag([hidden_m**-2.0, 1e6, 1e8])), np.float64),
        made_up=np.zeros((27, 27)),
        inlier_share=np.ones(10),
        information=np.eye(SHAPES),
        pull=np.zeros(SHAPES),
        by_shape=follows.reshape(27, SHAPES),
        unit=1.0,
    )


def test_a_way_that_is_hardly_known_does_not_tell_how_paths_follow_the_range_offset() -> None:
    """An old scanner beside one wall: 1 mm of offset moved it by as much as it drove, and the
    radius of the wheels could not be told to 18 %."""
    known, hidden = along_walls(1e-3, -0.2), along_walls(3.0, 500.0)
    assert scan_motion._path_by_offset([known]) == pytest.approx(-0.2)
    assert scan_motion._path_by_offset([known, hidden]) == pytest.approx(-0.2, abs=0.01)


def test_velocities_follow_small_steps_of_poses_as_told() -> None:
    rng, elapsed_s = np.random.default_rng(2), np.sort(np.random.default_rng(3).uniform(0, 2, 12))
    poses = np.cumsum(rng.normal(0.0, [0.05, 0.05, 0.01], (12, 3)), axis=0)
    steps = rng.normal(0.0, 1e-6, (12, 3))
    moved = local_motion(compose(poses, steps), elapsed_s) - local_motion(poses, elapsed_s)
    expected = velocity_weights(elapsed_s) @ steps
    np.testing.assert_allclose(moved[:, 0], expected, atol=0.2 * np.abs(expected).max())


def test_of_a_robot_that_stands_noise_alone_tells_the_sweep() -> None:
    """Of one that drives at v the velocities of noise d, 0.95 d / dt each, add their share."""
    noise = np.square(0.95 * 0.005 * 15.0) * (2.0 + 0.04)
    assert 0.6 < share_made_up(0.5, 0.005) / (noise / (0.25 + noise)) < 1.6
    assert share_made_up(0.0, 0.005) > 0.6
    assert share_made_up(0.5, 1e-4) < 1e-3


def test_sweeps_are_no_surer_than_by_what_noise_makes_them_too_short() -> None:
    """120 beams with 3 % of noise: 192.3 +- 1.3 ms of 198.3 was told to be a fault of the lidar."""
    shape, tracks, (fit,) = Shape(0.2, 1.0, 0.0), *driven(0.5, 0.005)
    reader, pull = BeamReader(healthy().scans[0]), ShapePull.of([fit] * 3)
    unsure_s = scan_motion._unmodelled(shape, reader, pull, (tracks, [fit]))[0]
    assert pull.sigmas()[0] < 1e-4
    assert unsure_s > 0.2 * share_made_up(0.5, 0.005) > 2e-3


def test_what_scans_tell_less_surely_than_it_is_known_before_counts_in_part() -> None:
    declared, nothing = Shape(0.05, 1.0, 0.0), np.zeros(SHAPES)

    def doubt(sigma: float) -> float:
        """Of angles that 40 windows find 4 sigmas too wide, be these sigmas as they may."""
        windows = 4.0 * sigma + np.sqrt(39.0) * sigma * np.tile([1.0, -1.0], 20)
        information = np.tile(np.diag([1.0, sigma**-2.0 / 40.0, 1.0]), (40, 1, 1))
        pull = information @ np.array([0.0, 1.0, 0.0]) * windows[:, None]
        return float(ShapePull(information, pull).doubts(declared, declared, nothing)[1])

    surely, as_before = doubt(1e-3), doubt(float(SHAPE_PRIOR_SIGMAS[1]))
    assert 1.3 < surely < 1.6  # 4 over Student's 2.7, less a 26th
    assert as_before == pytest.approx(0.5 * 26.0 / 25.0 * surely, rel=1e-6)


def test_pieces_move_as_their_points_do() -> None:
    rng = np.random.default_rng(5)
    pieces, shares = rng.uniform(1.0, 3.0, (6, PIECE_FIELDS)), rng.uniform(-0.5, 0.5, 6)
    motion, (sweep_s, wider_rad, offset_m) = rng.normal(size=(2, 3)), (0.08, 0.03, 0.05)
    moved = moved_pieces(pieces, shares, motion, (sweep_s, wider_rad, offset_m))
    raw = np.repeat(pieces[:, None, [X, Y]], 2, axis=1)
    seen = (np.stack([shares, shares], axis=1), np.stack([shares, shares], axis=1))
    views, still = np.zeros(6, dtype=np.int64), np.zeros((1, 3))
    shape = (sweep_s, 1.0 + wider_rad, offset_m)
    points, _ = moved_points(raw, (*seen, views), still, motion[None], shape)
    np.testing.assert_allclose(moved[:, [X, Y]], points[:, 0], atol=1e-12)


def scene(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Raw points of 12 observations from 3 scans, shares, angles, poses and motion."""
    rng = np.random.default_rng(seed)
    raw = rng.uniform(1.0, 3.0, (12, 2, 2))
    shares = rng.uniform(-0.5, 0.5, (12, 2))
    return raw, shares, 4.0 * shares, rng.normal(size=(3, 3)), rng.normal(size=(3, 2, 3))


VIEWS = np.tile(np.repeat(np.arange(3), 2), 2).astype(np.int64)


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_those_of_the_points(seed: int) -> None:
    raw, shares, angles, poses, motion = scene(seed)
    shape = np.array([0.07, 1.02, 0.05])

    def points(pose_step: FloatArray, shape_step: FloatArray) -> FloatArray:
        moved = compose(poses, np.tile(pose_step, (3, 1)))
        seen = (shares, angles, VIEWS)
        return moved_points(raw, seen, moved, motion, tuple((shape + shape_step).tolist()))[0]

    _, change = moved_points(raw, (shares, angles, VIEWS), poses, motion, tuple(shape.tolist()))
    for unknown in range(UNKNOWNS):
        step = np.zeros(UNKNOWNS)
        step[unknown] = 1e-6
        up = points(step[:POSE], step[POSE:])
        down = points(-step[:POSE], -step[POSE:])
        np.testing.assert_allclose(change[:, :, unknown], (up - down) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_system_is_what_dense_algebra_leaves_of_the_surfaces(seed: int) -> None:
    raw, shares, angles, poses, motion = scene(seed)
    seen = (shares, angles, VIEWS)
    points, change = moved_points(raw, seen, poses, motion, (0.07, 1.0, 0.0))
    weights = np.random.default_rng(seed).uniform(1.0, 9.0, 12)
    starts = np.array([0, 6, 12])
    lines = fit_lines(points, weights, starts)
    bends = fit_bends(points, weights, starts, lines)
    surfaces = np.repeat([0, 1], 6)
    of = (points, change, weights, VIEWS)
    system, right = window_system(of, surfaces, starts, lines, bends, 3)

    size = 3 * POSE + SHAPES
    rows, off = np.zeros((24, size + 6)), np.zeros(24)
    for k in range(12):
        x, y, nx, ny = lines[k // 6]
        for end in range(2):
            r = 2 * k + end
            dx, dy = points[k, end] - [x, y]
            t = nx * dy - ny * dx
            by_offset, by_slope, bend, _ = bends[k // 6]
            bent, slope = t**2 - by_slope * t - by_offset, bend * (2.0 * t - by_slope)
            normal = change[k, end] @ [nx + slope * ny, ny - slope * nx]
            rows[r, POSE * VIEWS[k] : POSE * VIEWS[k] + POSE] = normal[:POSE]
            rows[r, 3 * POSE : size] = normal[POSE:]
            rows[r, size + 3 * (k // 6) :][:3] = -1.0, -t, -bent
            off[r] = nx * dx + ny * dy - bend * bent
    whole = rows.T @ (np.repeat(weights, 2)[:, None] * rows)
    pull = -rows.T @ (np.repeat(weights, 2) * off)
    ours, lines_own = slice(None, size), slice(size, None)
    before = np.diag(2 * [0.0, 0.0, LARGEST_BEND_PER_M**-2])
    inverse = np.linalg.inv(whole[lines_own, lines_own] + before)
    np.testing.assert_allclose(
        system,
        whole[ours, ours] - whole[ours, lines_own] @ inverse @ whole[lines_own, ours],
        atol=1e-8,
    )
    np.testing.assert_allclose(right, pull[ours], atol=1e-8)


def test_scans_that_share_no_surface_tell_nothing() -> None:
    nothing, none = np.zeros((0, 2, 2)), np.zeros(0, dtype=np.int64)
    seen = (nothing, np.zeros((0, 2, UNKNOWNS, 2)), np.zeros(0), none)
    of = (np.zeros((0, 4)), np.zeros((0, BEND_FIELDS)))
    system, right = window_system(seen, none, np.zeros(1, dtype=np.int64), *of, 3)
    assert system.shape == (3 * POSE + SHAPES,) * 2 and not system.any() and not right.any()


def _most_in_order(stamps: list[int]) -> int:
    """Slow: the longest chain that ends with each."""
    longest: list[int] = []
    for index, stamp in enumerate(stamps):
        before = (longest[k] for k in range(index) if stamps[k] <= stamp)
        longest.append(1 + max(before, default=0))
    return max(longest, default=0)


@given(st.lists(st.integers(0, 30), max_size=40))
def test_as_many_scans_as_can_be_are_kept_in_order(stamps: list[int]) -> None:
    given_ns = np.array(stamps, dtype=np.int64)
    kept = longest_ascending(given_ns)
    assert (np.diff(kept) > 0).all()
    assert (np.diff(given_ns[kept]) >= 0).all()
    assert kept.size == _most_in_order(stamps)
    sure = surely_ascending(given_ns)
    assert set(sure.tolist()) <= set(kept.tolist())


def test_of_two_scans_that_contradict_each_other_neither_is_used() -> None:
    stamps_ns = np.array([0, 10, 20, 30, 15, 40, 50], dtype=np.int64)
    assert surely_ascending(stamps_ns).tolist() == [0, 1, 2, 3, 5, 6], "15 contradicts two"
    swapped_ns = np.array([0, 10, 30, 25, 40], dtype=np.int64)
    assert surely_ascending(swapped_ns).tolist() == [0, 1, 4]


@given(seed=st.integers(0, 10_000), size=st.integers(1, 30), share=st.floats(0.0, 0.6))
def test_made_up_information_is_taken_away_with_and_without_eigenvectors(
    seed: int, size: int, share: float
) -> None:
    """Against the spectral form, which holds where hardly anything is left as well."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size)) + 3.0 * np.eye(size)
    information = root @ root.T
    axes, _ = np.linalg.qr(rng.standard_normal((size, size)))
    factor = np.linalg.cholesky(information)
    made_up = factor @ axes @ np.diag(rng.uniform(0.0, share, size)) @ axes.T @ factor.T
    found = scan_bundle._believable(information, made_up)
    exact = scan_bundle._spectrally_believable(information, made_up)
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-9 * np.abs(exact).max())


@given(seed=st.integers(0, 10_000), exponent=st.floats(8.0, 14.0))
def test_what_a_step_tells_is_symmetric_however_little_one_direction_is_told(
    seed: int, exponent: float
) -> None:
    """Where an inverse is rounded by a hundredth, as of ranges in steps of 25 cm."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = axes @ np.diag([1e-8, 1e-6, 10.0 ** (exponent - 8.0)]) @ axes.T
    T_first_second = rng.normal(0.0, 0.3, (1, 3))
    information = scan_motion._step_information(T_first_second, covariance)
    require_covariances("what a step tells", information, (1, 3, 3), 1e20)
