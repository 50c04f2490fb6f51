"""Planar and spatial algebra against 4 x 4 matrices and SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slamsim.core import geometry as geo
from slamsim.core.types import (
    FloatArray,
    OutsideTimeRange,
    PlanarTrajectory,
    ScanGeometry,
    Trajectory,
)

coordinate = st.floats(-50.0, 50.0)
angle = st.floats(-10.0, 10.0)
pose = st.tuples(coordinate, coordinate, angle).map(np.array)
quat = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


def matrix(planar: FloatArray) -> FloatArray:
    x, y, yaw = planar
    return np.array([[np.cos(yaw), -np.sin(yaw), x], [np.sin(yaw), np.cos(yaw), y], [0, 0, 1.0]])


@given(pose, pose)
def test_compose_is_the_matrix_product(a: FloatArray, b: FloatArray) -> None:
    np.testing.assert_allclose(matrix(geo.compose(a, b)), matrix(a) @ matrix(b), atol=1e-9)


@given(pose, pose)
def test_between_undoes_compose(a: FloatArray, b: FloatArray) -> None:
    np.testing.assert_allclose(matrix(geo.between(a, geo.compose(a, b))), matrix(b), atol=1e-9)


@given(pose, pose)
def test_one_pair_and_a_stack_of_pairs_are_the_same(a: FloatArray, b: FloatArray) -> None:
    for function in (geo.compose, geo.between):
        stacked = function(a[None], b[None])[0]
        np.testing.assert_allclose(matrix(function(a, b)), matrix(stacked), atol=1e-12)


@given(pose, st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=5))
def test_points_move_as_by_the_matrix(a: FloatArray, points: list[tuple[float, float]]) -> None:
    expected = [(matrix(a) @ [x, y, 1.0])[:2] for x, y in points]
    np.testing.assert_allclose(geo.transform_points(a, np.array(points)), expected, atol=1e-9)


@given(quat)
def test_quaternion_order_is_xyzw(q: FloatArray) -> None:
    np.testing.assert_allclose(
        geo.matrix_from_xyzw(q), Rotation.from_quat(q).as_matrix(), atol=1e-12
    )


@given(quat)
def test_matrix_and_quaternion_are_inverse(q: FloatArray) -> None:
    back = geo.xyzw_from_matrix(geo.matrix_from_xyzw(q))
    assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-7


@given(angle, angle, angle)
def test_rpy_turns_about_fixed_axes(roll: float, pitch: float, yaw: float) -> None:
    np.testing.assert_allclose(
        geo.matrix_from_rpy(roll, pitch, yaw),
        Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix(),
        atol=1e-12,
    )


@given(quat, quat, st.floats(0.0, 1.0))
def test_slerp_divides_the_turn(a: FloatArray, b: FloatArray, fraction: float) -> None:
    mid = geo.slerp_xyzw(a[None], b[None], np.array([fraction]))[0]
    whole = (Rotation.from_quat(b) * Rotation.from_quat(a).inv()).magnitude()
    part = (Rotation.from_quat(mid) * Rotation.from_quat(a).inv()).magnitude()
    assert part == pytest.approx(fraction * whole, abs=2e-6)


@given(angle)
def test_yaw_survives_the_quaternion(yaw: float) -> None:
    back = float(geo.yaw_from_xyzw(geo.xyzw_from_yaw(np.array(yaw))))
    assert np.cos(back - yaw) == pytest.approx(1.0)


def test_interpolation_leaves_its_input_alone() -> None:
    start, end = np.array([[0.0, 0.0, 3.0]]), np.array([[1.0, 0.0, -3.0]])
    mid = geo.interpolate_se2(start, end, np.array([0.5]))
    np.testing.assert_array_equal(end, [[1.0, 0.0, -3.0]])
    assert abs(abs(mid[0, 2]) - np.pi) < 1e-12


def test_trajectory_refuses_to_extrapolate() -> None:
    planar = PlanarTrajectory(np.array([10, 20], dtype=np.int64), np.zeros((2, 3)))
    with pytest.raises(OutsideTimeRange, match=r"10\.\.20 ns, asked for 9\.\.9"):
        planar.at(np.array([9], dtype=np.int64))
    with pytest.raises(OutsideTimeRange, match="nothing"):
        PlanarTrajectory(np.array([], dtype=np.int64), np.zeros((0, 3))).at(np.array([1]))


def test_trajectory_of_one_sample_answers_at_its_instant() -> None:
    one = PlanarTrajectory(np.array([5], dtype=np.int64), np.array([[1.0, 2.0, 0.5]]))
    np.testing.assert_allclose(one.at(np.array([5])), [[1.0, 2.0, 0.5]])


def test_spatial_and_planar_interpolation_agree_on_the_floor() -> None:
    stamps = np.array([0, 1_000, 2_000], dtype=np.int64)
    yaw = np.array([3.0, -3.0, -2.9])
    positions = np.array([[0.0, 0, 0.1], [1, 1, 0.1], [2, 0, 0.1]])
    spatial = Trajectory(stamps, positions, geo.xyzw_from_yaw(yaw))
    query = np.array([0, 250, 1_500, 2_000], dtype=np.int64)
    difference = spatial.at(query).planar().poses - spatial.planar().at(query)
    difference[:, 2] = geo.wrap_angle(difference[:, 2])
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def test_beam_i_looks_along_its_own_angle_at_its_own_time() -> None:
    geometry = ScanGeometry(-1.0, 0.5, 4, 7, 0.1, 30.0)
    np.testing.assert_allclose(geometry.angles_rad(), [-1.0, -0.5, 0.0, 0.5])
    np.testing.assert_array_equal(geometry.offsets_ns(), [0, 7, 14, 21])
    assert geometry.duration_ns == 21
