"""Every value that crosses a stage: what is no number is refused where the value is made."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fault_numbers import EDGES_NS, Case, cases, judge, line, put, refused, right, steps
from fault_values import (
    COVARIANCES,
    ENCODERS,
    GEOMETRY,
    IMU,
    PATH,
    QUATS,
    THREE,
    TICKS,
    VALUES,
    N,
    damaged_values,
)

from slamsim.core.geometry import (
    between,
    compose,
    inverse,
    matrix_from_xyzw,
    slerp_xyzw,
    transform_points,
    xyzw_from_matrix,
)
from slamsim.core.result import Calibrated, PoseGraph
from slamsim.core.types import (
    Grid,
    Log,
    PlanarTrajectory,
    Trajectory,
    TriangleMesh,
)
from slamsim.slam.matching import Match
from slamsim.slam.online.samples import MotionSamples

pytestmark = pytest.mark.fault


def _log(**changed: object) -> Case:
    return refused(lambda: Log(**{**VALUES["log"][1], **changed}))


_LAID = np.diag([1.0, 1.0, -1.0, 1.0])

DEGENERATE: dict[str, Case] = {
    "log: an IMU that runs backwards": _log(imu=replace(IMU, stamps_ns=steps(N)[::-1].copy())),
    "log: an IMU that stands still": _log(imu=replace(IMU, stamps_ns=steps(N) * 0)),
    "log: encoders that run backwards": _log(
        encoders=replace(ENCODERS, stamps_ns=steps(N)[::-1].copy())
    ),
    "log: a lidar that is mirrored": _log(T_base_laser=_LAID),
    "log: a lidar of double size": _log(T_base_laser=2.0 * np.eye(4)),
    "log: a mount of zeros": _log(T_base_laser=np.zeros((4, 4))),
    "log: an IMU that is sheared": _log(T_base_imu=np.eye(4) + np.eye(4, k=1)),
    "samples: an IMU that runs backwards": refused(
        lambda: MotionSamples(imu=replace(IMU, stamps_ns=steps(N)[::-1].copy()))
    ),
    "samples: encoders that stand still": refused(
        lambda: MotionSamples(encoders=replace(ENCODERS, stamps_ns=steps(N) * 0))
    ),
    "trajectory: a look between stamps that run backwards": refused(
        lambda: Trajectory(steps(N)[::-1].copy(), THREE, QUATS).at(steps(1))
    ),
    "trajectory: the plane of stamps that stand still": refused(
        lambda: Trajectory(steps(N) * 0, THREE, QUATS).planar()
    ),
    "trajectory: quaternions of zeros": refused(
        lambda: Trajectory(steps(N), THREE, np.zeros((N, 4)))
    ),
    "trajectory: quaternions of double size": refused(
        lambda: Trajectory(steps(N), THREE, 2.0 * QUATS)
    ),
    "trajectory: nothing at all": right(
        lambda: PlanarTrajectory(steps(0), np.zeros((0, 3))).path_length_m()
    ),
    "trajectory: a look at nothing": refused(
        lambda: PlanarTrajectory(steps(0), np.zeros((0, 3))).at(steps(1))
    ),
    "trajectory: one pose, looked at": right(
        lambda: PlanarTrajectory(steps(1), np.ones((1, 3))).at(steps(1))
    ),
    "trajectory: a look beyond its end": refused(lambda: PATH.at(steps(N) + 1)),
    "trajectory: a look at the end of time": refused(lambda: PATH.at(np.array([EDGES_NS["most"]]))),
    "mesh: a corner that is not there": refused(
        lambda: TriangleMesh(np.eye(3), np.array([[0, 1, 3]], np.int32))
    ),
    "mesh: a corner before the first": refused(
        lambda: TriangleMesh(np.eye(3), np.array([[0, 1, -1]], np.int32))
    ),
    "grid: more than sure": refused(lambda: Grid(np.full((2, 2), 1.5, np.float32), 0.1, (0, 0))),
    "grid: less than never": refused(lambda: Grid(np.full((2, 2), -0.1, np.float32), 0.1, (0, 0))),
    "grid: endless": refused(lambda: Grid(np.full((2, 2), np.inf, np.float32), 0.1, (0, 0))),
    "grid: a line": refused(lambda: Grid(np.zeros(4, np.float32), 0.1, (0, 0))),
    "grid: cells without size": refused(lambda: Grid(np.zeros((2, 2), np.float32), 0.0, (0, 0))),
    "grid: cells of nan": refused(lambda: Grid(np.zeros((2, 2), np.float32), math.nan, (0, 0))),
    "grid: an origin of nan": refused(
        lambda: Grid(np.zeros((2, 2), np.float32), 0.1, (math.nan, 0.0))
    ),
    "geometry: no beam": refused(lambda: replace(GEOMETRY, beam_count=0)),
    "geometry: a billion beams": refused(lambda: replace(GEOMETRY, beam_count=10**9)),
    "geometry: all beams one way": refused(lambda: replace(GEOMETRY, angle_step_rad=0.0)),
    "geometry: one beam, one way": right(
        lambda: replace(GEOMETRY, angle_step_rad=0.0, beam_count=1)
    ),
    "geometry: no room between the ranges": refused(lambda: replace(GEOMETRY, range_max_m=0.1)),
    "geometry: the ranges swapped": refused(lambda: replace(GEOMETRY, range_min_m=50.0)),
    "geometry: a range below zero": refused(lambda: replace(GEOMETRY, range_min_m=-1.0)),
    "encoders: wheels of no size": refused(lambda: replace(ENCODERS, wheel_radius_m=0.0)),
    "encoders: wheels turned inside out": refused(lambda: replace(ENCODERS, track_m=-0.4)),
    "encoders: no ticks a turn": refused(lambda: replace(ENCODERS, ticks_per_revolution=0)),
    "encoders: ticks beyond counting": refused(
        lambda: replace(ENCODERS, ticks=put(TICKS, EDGES_NS["most"]))
    ),
    "calibrated: a sigma below zero": refused(lambda: Calibrated(1.0, -0.1, True)),
    "match: more inliers than points": refused(
        lambda: Match(np.zeros(3), np.eye(3), 1.5, 1.0, np.zeros((0, 3)))
    ),
    "pose graph: a covariance that leans": refused(
        lambda: PoseGraph(PATH, COVARIANCES + np.eye(3, k=1), ())
    ),
    "pose graph: a covariance below zero": refused(lambda: PoseGraph(PATH, -COVARIANCES, ())),
}


@cases(damaged_values(), DEGENERATE)
def test_no_value_is_made_of_what_is_no_number(case: Case) -> None:
    judge(case)


ALGEBRA: dict[str, Callable[[float], np.ndarray]] = {
    "compose, one": lambda bad: compose(np.array([bad, 0.0, 0.0]), np.ones(3)),
    "compose, the other": lambda bad: compose(np.ones(3), np.array([0.0, bad, 0.0])),
    "compose, many": lambda bad: compose(put(line(N), bad, 4), np.ones((N, 3)))[1],
    "between": lambda bad: between(np.array([bad, 0.0, 0.0]), np.ones(3)),
    "between, many": lambda bad: between(np.ones((N, 3)), put(line(N), bad, 4))[1],
    "inverse": lambda bad: inverse(np.array([bad, 1.0, 0.3])),
    "points": lambda bad: transform_points(np.array([0.0, 0.0, 0.3]), np.array([[bad, 1.0]])),
    "slerp": lambda bad: slerp_xyzw(put(QUATS, bad, 4), QUATS, np.full(N, 0.5))[1],
    "rotation": lambda bad: matrix_from_xyzw(np.array([bad, 0.0, 0.0, 1.0])),
}


@pytest.mark.parametrize("name", ALGEBRA)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_algebra_never_makes_a_number_of_none(name: str, bad: float) -> None:
    """It is the innermost loop and asks nothing: what comes out says that something was wrong."""
    with np.errstate(invalid="ignore"):
        assert not np.isfinite(ALGEBRA[name](bad)).all()


def test_algebra_of_sound_numbers_is_sound_at_its_edges() -> None:
    opposite = slerp_xyzw(QUATS, -QUATS, np.full(N, 0.5))
    assert np.allclose(np.abs(np.sum(opposite * QUATS, axis=1)), 1.0)
    for rotation in (np.eye(3), np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])):
        assert np.allclose(matrix_from_xyzw(xyzw_from_matrix(rotation)), rotation)
    far = np.array([1e9, -1e9, 1e9])
    assert np.isfinite(compose(far, far)).all() and np.isfinite(inverse(far)).all()
