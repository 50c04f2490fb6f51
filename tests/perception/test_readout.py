"""How long a shutter rolls is learnt from turns, and sweeping points there and back is exact."""

from __future__ import annotations

import numpy as np
import pytest

from slamsim.core.types import FloatArray
from slamsim.perception.point_fit import SeenPoints, fit_motion
from slamsim.perception.readout import Readout
from slamsim.perception.tag_pose import step_between
from slamsim.perception.twist import at_first_row, exponential, logarithm, swept_points

FOCAL_PX = 300.0


def _seen(T: FloatArray, swept: FloatArray, rng: np.random.Generator) -> SeenPoints:
    """Points of a box as a rolling shutter sees them after a motion."""
    points_m = rng.uniform([-1.0, -0.7, 1.5], [1.0, 0.7, 3.0], (200, 3))
    there = points_m @ T[:3, :3].T + T[:3, 3]
    late = rng.uniform(0.0, 1.0, 200)
    x, y, z = swept_points(there, late, swept).T
    rays_xy = np.column_stack([x / z, y / z]) + rng.normal(0.0, 0.2 / FOCAL_PX, (200, 2))
    return SeenPoints(points_m, rays_xy, there[:, 2], late, np.ones(200))


@pytest.mark.parametrize("readout_s", [0.0, 0.03])
def test_the_readout_is_learnt_while_the_camera_turns(readout_s: float) -> None:
    rng, readout = np.random.default_rng(4), Readout()
    for k in range(60):
        velocity = np.array([0.1, 0.0, 0.3, 0.0, 0.8 * np.sin(0.3 * k), 0.0])
        T = exponential(0.1 * velocity)
        seen = _seen(T, readout_s * velocity, rng)
        fitted = fit_motion(T, seen, FOCAL_PX, readout.seconds * velocity)
        readout.learn(fitted.T_now_keyframe, seen, velocity, 0.2 / FOCAL_PX)
    assert readout.seconds == pytest.approx(readout_s, abs=0.003)


def test_straight_ahead_nothing_is_learnt() -> None:
    rng, readout = np.random.default_rng(5), Readout()
    velocity = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    readout.learn(np.eye(4), _seen(np.eye(4), 0.03 * velocity, rng), velocity, 0.2 / FOCAL_PX)
    assert readout.seconds == 0.0


def test_points_are_where_they_were_at_the_first_row() -> None:
    rng = np.random.default_rng(6)
    points_m = rng.uniform([-1.0, -0.7, 1.5], [1.0, 0.7, 3.0], (50, 3))
    late, swept = rng.uniform(0.0, 1.0, 50), np.array([0.004, 0.0, -0.01, 0.0, 0.01, 0.002])
    seen = swept_points(points_m, late, swept)
    by_ray = seen * (points_m[:, 2:] / seen[:, 2:])  # its direction, and the depth of the first row
    assert np.abs(at_first_row(by_ray, late, swept) - points_m).max() < 1e-3 * 0.03 + 3e-4


def test_errors_that_a_whole_part_of_the_image_shares_make_a_motion_less_sure() -> None:
    """A quarter of the image is off by a pixel, as where colour and depth do not lie upon each
    other: points alone would be as sure as ever."""
    rng, nothing = np.random.default_rng(7), np.zeros(6)
    inflation = []
    for _ in range(30):
        seen = _seen(np.eye(4), nothing, rng)
        corner = (seen.rays_xy > 0.0).all(axis=1)
        seen.rays_xy[corner] += rng.normal(0.0, 0.5 / FOCAL_PX, 2)
        fitted = fit_motion(np.eye(4), seen, FOCAL_PX, nothing)
        off = step_between(fitted.T_now_keyframe, np.eye(4))
        inflation.append(off @ np.linalg.solve(fitted.covariance, off))
    assert np.mean(inflation) < 6.0 * 1.4  # six degrees of freedom


def test_the_logarithm_undoes_the_exponential() -> None:
    motion = np.array([0.1, -0.2, 0.3, 0.02, -0.5, 0.1])
    assert np.allclose(logarithm(exponential(motion)), motion)
