"""Deskew against a per-beam oracle that goes the long way round, and what it promises in words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray, OutsideTimeRange, PlanarTrajectory, Scan, ScanGeometry
from slamsim.slam.frontend.deskew import deskew


def _spatial(T_a_b: FloatArray) -> FloatArray:
    return se3_from_parts(matrix_from_rpy(0.0, 0.0, T_a_b[2]), np.array([*T_a_b[:2], 0.0]))


def _oracle(
    scan: Scan, motion: PlanarTrajectory, at_ns: int, T_base_laser: FloatArray
) -> FloatArray:
    """(n, 5): end x, y, origin x, y, hit; one beam at a time, with 4 x 4 matrices."""
    rows = []
    T_base_odom = np.linalg.inv(_spatial(motion.at(np.array([at_ns]))[0]))
    for i, angle in enumerate(scan.geometry.angles_rad()):
        reach = float(scan.ranges_m[i])
        if np.isnan(reach) or reach < scan.geometry.range_min_m:
            continue
        hit = reach < scan.geometry.range_max_m
        reach = min(reach, scan.geometry.range_max_m)
        t_ns = scan.stamp_ns + i * scan.geometry.beam_dt_ns
        T_odom_base = _spatial(motion.at(np.array([t_ns]))[0])
        T = T_base_odom @ T_odom_base @ T_base_laser
        end = T @ np.array([reach * np.cos(angle), reach * np.sin(angle), 0.0, 1.0])
        rows.append([end[0], end[1], T[0, 3], T[1, 3], hit])
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


def _motion(rng: np.random.Generator) -> PlanarTrajectory:
    gaps = rng.integers(1_000_000, 20_000_000, 60)
    stamps_ns = 10**18 + np.concatenate([[0], np.cumsum(gaps)])
    steps = rng.normal(0.0, [0.02, 0.01, 0.05], (61, 3))
    return PlanarTrajectory(stamps_ns, np.cumsum(steps, axis=0))


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    beams=st.integers(1, 80),
    beam_dt_ns=st.sampled_from([0, 17_361, 1_000_000, -500_000]),
    flipped=st.booleans(),
)
def test_matches_the_per_beam_oracle(seed: int, beams: int, beam_dt_ns: int, flipped: bool) -> None:
    rng = np.random.default_rng(seed)
    motion = _motion(rng)
    geometry = ScanGeometry(-2.0, 0.05, beams, beam_dt_ns, 0.1, 10.0)
    ranges = rng.uniform(0.0, 12.0, beams)
    ranges[rng.random(beams) < 0.1] = np.nan
    ranges[rng.random(beams) < 0.1] = np.inf
    start_ns = int(motion.stamps_ns[0]) + 200_000_000
    scan = Scan(start_ns, ranges.astype(np.float32), geometry)
    at_ns = start_ns + int(rng.integers(0, 50_000_000))
    roll = np.pi if flipped else 0.0
    T_base_laser = se3_from_parts(
        matrix_from_rpy(roll + 0.05, -0.1, rng.uniform(-3.0, 3.0)), np.array([0.2, -0.1, 0.0])
    )
    cloud = deskew(scan, motion, at_ns, T_base_laser)
    expected = _oracle(scan, motion, at_ns, T_base_laser)
    assert cloud.stamp_ns == at_ns
    np.testing.assert_allclose(cloud.points_m, expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(cloud.origins_m, expected[:, 2:4], atol=1e-9)
    np.testing.assert_array_equal(cloud.hit, expected[:, 4] > 0.0)


def _still(at_ns: int = 0) -> PlanarTrajectory:
    return PlanarTrajectory(np.array([at_ns, at_ns + 10**9]), np.zeros((2, 3)))


def test_a_turning_robot_sees_a_wall_straight() -> None:
    """A wall at x = 2, swept while turning at 3 rad/s: skewed when raw, straight when deskewed."""
    geometry = ScanGeometry(-0.5, 0.01, 101, 1_000_000, 0.1, 30.0)
    stamps_ns = np.arange(0, 200_000_001, 1_000_000)
    motion = PlanarTrajectory(
        stamps_ns, np.column_stack([np.zeros((201, 2)), 3e-9 * stamps_ns.astype(float)])
    )
    heading = geometry.angles_rad() + 3e-9 * geometry.offsets_ns()
    scan = Scan(0, (2.0 / np.cos(heading)).astype(np.float32), geometry)
    straight = deskew(scan, motion, 0, np.eye(4)).points_m
    raw = deskew(scan, _still(), 0, np.eye(4)).points_m
    assert np.ptp(straight[:, 0]) < 1e-6
    assert np.ptp(raw[:, 0]) > 0.1


def test_an_upside_down_lidar_counts_its_beams_clockwise() -> None:
    geometry = ScanGeometry(0.5, 0.0, 1, 0, 0.1, 30.0)
    scan = Scan(0, np.array([2.0], np.float32), geometry)
    upside_down = se3_from_parts(matrix_from_rpy(np.pi, 0.0, 0.0), np.zeros(3))
    cloud = deskew(scan, _still(), 0, upside_down)
    np.testing.assert_allclose(cloud.points_m, [[2.0 * np.cos(0.5), -2.0 * np.sin(0.5)]])


def test_no_return_ends_at_maximum_range_and_invalid_is_dropped() -> None:
    geometry = ScanGeometry(0.0, 0.1, 6, 0, 0.2, 8.0)
    ranges = np.array([np.inf, np.nan, 0.1, 8.0, 9.0, 3.0], np.float32)
    cloud = deskew(Scan(0, ranges, geometry), _still(), 0, np.eye(4))
    assert cloud.hit.tolist() == [False, False, False, True]
    np.testing.assert_allclose(np.linalg.norm(cloud.points_m, axis=1), [8.0, 8.0, 8.0, 3.0])


def test_a_scan_with_nothing_in_it_becomes_an_empty_cloud() -> None:
    geometry = ScanGeometry(0.0, 0.1, 3, 10, 0.2, 8.0)
    cloud = deskew(Scan(0, np.full(3, np.nan, np.float32), geometry), _still(), 0, np.eye(4))
    assert cloud.points_m.shape == (0, 2)
    assert cloud.hit.shape == (0,)


def test_steep_beams_and_floor_returns_are_dropped() -> None:
    geometry = ScanGeometry(0.0, np.pi / 2, 2, 0, 0.1, 30.0)
    ranges = np.array([5.0, 5.0], np.float32)
    sideways = se3_from_parts(matrix_from_rpy(0.0, np.pi / 2, 0.0), np.zeros(3))
    assert len(deskew(Scan(0, ranges, geometry), _still(), 0, sideways).hit) == 1
    nodding = se3_from_parts(matrix_from_rpy(0.0, 0.1, 0.0), np.array([0.0, 0.0, 0.3]))
    forward = deskew(Scan(0, ranges, geometry), _still(), 0, nodding)
    np.testing.assert_allclose(forward.points_m, [[0.0, 5.0]], atol=1e-9)


@pytest.mark.parametrize("shift_ns", [-1, 1])
def test_motion_is_never_extrapolated(shift_ns: int) -> None:
    geometry = ScanGeometry(0.0, 0.1, 11, 10_000_000, 0.2, 8.0)
    edge_ns = 0 if shift_ns < 0 else 10**9 - geometry.duration_ns
    ranges = np.ones(11, np.float32)
    deskew(Scan(edge_ns, ranges, geometry), _still(), edge_ns, np.eye(4))
    with pytest.raises(OutsideTimeRange, match="motion covers 0"):
        deskew(Scan(edge_ns + shift_ns, ranges, geometry), _still(), edge_ns, np.eye(4))
