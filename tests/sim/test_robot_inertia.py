"""Inertia formulas against numerical integration over the body."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.sim.robot.inertia import Inertial, box_inertia, cylinder_inertia, join, sphere_inertia

CELLS = 40


def _inertia_of_points(points_m: FloatArray, mass_kg: float) -> FloatArray:
    """(3, 3) about the points' own centre, all of equal mass."""
    arms = points_m - points_m.mean(axis=0)
    squares = np.einsum("ni,ni->n", arms, arms)
    tensor = np.eye(3) * squares.mean() - arms.T @ arms / len(arms)
    return np.asarray(mass_kg * tensor)


def _lattice(size_m: tuple[float, float, float]) -> FloatArray:
    """Middles of CELLS^3 equal cells that fill a cuboid."""
    axes = [edge * ((np.arange(CELLS) + 0.5) / CELLS - 0.5) for edge in size_m]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


sizes = st.floats(min_value=0.01, max_value=2.0)


@settings(max_examples=25)
@given(sizes, sizes, sizes)
def test_box_equals_integral(x: float, y: float, z: float) -> None:
    expected = _inertia_of_points(_lattice((x, y, z)), 2.5)
    np.testing.assert_allclose(box_inertia(2.5, (x, y, z)), expected, rtol=2e-3, atol=1e-12)


@settings(max_examples=25)
@given(sizes, sizes)
def test_cylinder_equals_integral(radius: float, length: float) -> None:
    points = _lattice((2 * radius, 2 * radius, length))
    points = points[np.hypot(points[:, 0], points[:, 1]) <= radius]
    expected = _inertia_of_points(points, 0.7)
    actual = cylinder_inertia(0.7, radius, length)
    np.testing.assert_allclose(np.diag(actual), np.diag(expected), rtol=1e-2)


@settings(max_examples=10)
@given(sizes)
def test_sphere_equals_integral(radius: float) -> None:
    points = _lattice((2 * radius, 2 * radius, 2 * radius))
    points = points[np.linalg.norm(points, axis=1) <= radius]
    expected = _inertia_of_points(points, 3.0)
    actual = sphere_inertia(3.0, radius)
    np.testing.assert_allclose(np.diag(actual), np.diag(expected), rtol=1e-2)


def test_the_cameras_published_value() -> None:
    """RealSense D435, 72 g, 25 x 90 x 25 mm: 5.235e-5 kg m^2 about x."""
    assert box_inertia(0.072, (0.025, 0.090, 0.025))[0, 0] == pytest.approx(5.235e-5, rel=1e-6)


@settings(max_examples=10)
@given(st.integers(min_value=0, max_value=2**32 - 1))
def test_joined_bodies_equal_the_integral_over_both(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies, clouds = [], []
    for mass_share in (1, 2):
        size = rng.uniform(0.1, 1.0, 3)
        T = se3_from_parts(matrix_from_rpy(*rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3))
        body = Inertial(float(mass_share), np.zeros(3), box_inertia(mass_share, size.tolist()))
        bodies.append(body.seen_from(T))
        lattice = _lattice((size[0], size[1], size[2])) @ T[:3, :3].T + T[:3, 3]
        clouds += [lattice] * mass_share
    points = np.vstack(clouds)
    joined = join(bodies)
    assert joined.mass_kg == 3.0
    np.testing.assert_allclose(joined.centre_m, points.mean(axis=0), atol=1e-9)
    expected = _inertia_of_points(points, 3.0)
    np.testing.assert_allclose(joined.inertia_kg_m2, expected, atol=2e-3 * expected.max())


def test_a_frame_far_away_sees_the_same_inertia_about_the_centre() -> None:
    body = Inertial(1.0, np.array([0.1, 0.2, 0.3]), np.diag([1.0, 2.0, 2.5]))
    T = se3_from_parts(matrix_from_rpy(0.0, 0.0, np.pi / 2), np.array([5.0, 0.0, 0.0]))
    seen = body.seen_from(T)
    np.testing.assert_allclose(seen.centre_m, [4.8, 0.1, 0.3], atol=1e-12)
    np.testing.assert_allclose(np.diag(seen.inertia_kg_m2), [2.0, 1.0, 2.5], atol=1e-12)
