"""The pose graph in space: against the truth, with false closures, and with tags and wheels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import se3_from_se2
from slamsim.core.spatial import CameraTrack, SpatialEdge, TagSeen
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.models.differential_drive import pose_reading
from slamsim.perception.twist import exponential
from slamsim.slam.frontend.motion import Odometry, increments
from slamsim.slam.visual.camera_map import camera_map
from slamsim.slam.visual.graph import sigmas_off, solve_in_space

SIGMAS = np.repeat([0.003, 0.002], 3)
COUNT = 60
PERIOD_NS = 1_000_000_000
T_BASE_CAMERA = exponential(np.array([0.1, 0.02, 0.3, 1.2, -1.2, 1.2]))


def _circle() -> FloatArray:
    """(n, 4, 4) T_map_base twice around."""
    angle = np.linspace(0.0, 4.0 * np.pi, COUNT)
    return np.array([se3_from_se2(np.array([2 * np.sin(a), 2 - 2 * np.cos(a), a])) for a in angle])


def _edge(
    poses: FloatArray, one: int, other: int, kind: str, rng: np.random.Generator
) -> SpatialEdge:
    T = np.linalg.inv(poses[one]) @ poses[other] @ exponential(rng.normal(0.0, SIGMAS))
    return SpatialEdge(one, other, T, np.diag(SIGMAS**2), kind)  # type: ignore[arg-type]


def _track(poses: FloatArray, rng: np.random.Generator, **more: object) -> CameraTrack:
    """What a camera on the robot tells of every pose."""
    seen = poses @ T_BASE_CAMERA
    edges = tuple(_edge(seen, k, k + 1, "camera", rng) for k in range(len(poses) - 1))
    numbers = np.arange(len(poses))
    since = np.tile(np.eye(4), (len(poses), 1, 1))
    known = {"edges": edges, "tags": (), "lost": 0, "refused": 0} | more
    return CameraTrack(numbers * PERIOD_NS, since, numbers, numbers, **known)  # type: ignore[arg-type]


def _nees(found: FloatArray, covariances: FloatArray, true: FloatArray) -> FloatArray:
    edges = [
        SpatialEdge(k, k, T, C, "floor")
        for k, (T, C) in enumerate(zip(found, covariances, strict=True))
    ]
    return np.square(sigmas_off(true, edges[1:]))


@pytest.mark.long
def test_a_chain_errs_as_it_claims() -> None:
    true, rng = _circle(), np.random.default_rng(0)
    nees = []
    for _ in range(20):
        found = camera_map(_track(true, rng), T_BASE_CAMERA, None, MotionConfig())
        nees.append(_nees(found.poses, found.covariances, true)[-1])
    assert 4.0 < np.mean(nees) < 8.5  # 99 % of the mean of 20, six degrees of freedom


def test_a_false_closure_is_withdrawn_and_a_true_one_helps() -> None:
    true, rng = _circle(), np.random.default_rng(1)
    plain = _track(true, rng)
    seen = true @ T_BASE_CAMERA
    right = [_edge(seen, k, k + 29, "closure", rng) for k in range(0, 30, 3)]
    false = replace(_edge(seen, 3, 40, "closure", rng), T_source_target=np.eye(4))
    track = replace(plain, edges=(*plain.edges, *right, false))
    before = camera_map(plain, T_BASE_CAMERA, None, MotionConfig())
    after = camera_map(track, T_BASE_CAMERA, None, MotionConfig())

    assert after.closures == (10, 1)
    assert next(e for e in after.edges if (e.source, e.target) == (3, 40)).weight == 0.0
    assert _rms_m(after.poses, true) < _rms_m(before.poses, true)
    assert after.sigmas_m.max() < before.sigmas_m.max()


def _rms_m(found: FloatArray, true: FloatArray) -> float:
    return float(np.sqrt(np.mean((found[:, :3, 3] - true[:, :3, 3]) ** 2)))


def _tag_views(true: FloatArray, rng: np.random.Generator) -> tuple[TagSeen, ...]:
    tags = [
        exponential(np.array([3.0 * np.cos(a), 3.0 * np.sin(a), 0.5, 1.5, a, 0.0]))
        for a in (0, 2, 4)
    ]
    views = []
    for k, pose in enumerate(true):
        for number in (k % 3, (k + 1) % 3):
            T = np.linalg.inv(pose @ T_BASE_CAMERA) @ tags[number]
            T = T @ exponential(rng.normal(0.0, 2 * SIGMAS))
            views.append(TagSeen(k, number, T, np.diag((2 * SIGMAS) ** 2)))
    return tuple(views)


def test_tags_alone_give_the_path_and_their_own_places() -> None:
    true, rng = _circle(), np.random.default_rng(2)
    track = _track(true, rng, edges=(), tags=_tag_views(true, rng))
    found = camera_map(track, T_BASE_CAMERA, None, MotionConfig())

    assert _rms_m(found.poses, true) < 0.02
    assert [tag.number for tag in found.tags] == [0, 1, 2]
    assert np.linalg.norm(found.tags[0].T_map_tag[:3, 3] - [3.0, 0.0, 0.5]) < 0.06
    assert found.guessed == COUNT - 1


def test_where_the_camera_is_lost_wheels_bridge_and_without_them_it_is_told() -> None:
    true, rng = _circle(), np.random.default_rng(3)
    track = _track(true, rng)
    holey = replace(track, edges=track.edges[:20] + track.edges[25:], lost=5)
    odometry = _wheels(true, rng)
    with_wheels = camera_map(holey, T_BASE_CAMERA, odometry, MotionConfig())
    without = camera_map(holey, T_BASE_CAMERA, None, MotionConfig())

    assert with_wheels.guessed == 0 and without.guessed == 5
    assert _rms_m(with_wheels.poses, true) < 0.1 < without.sigmas_m[-1]
    assert np.abs(with_wheels.poses[:, 2, 3]).max() < 0.03  # it stays on its floor


def _wheels(true: FloatArray, rng: np.random.Generator) -> Odometry:
    yaw = np.unwrap(np.arctan2(true[:, 1, 0], true[:, 0, 0]))
    path = PlanarTrajectory(np.arange(COUNT) * PERIOD_NS, np.column_stack([true[:, :2, 3], yaw]))
    return Odometry(increments(path), pose_reading(path))


def test_nothing_known_is_refused_and_so_is_a_pose_that_nothing_holds() -> None:
    true, rng = _circle(), np.random.default_rng(4)
    with pytest.raises(SlamsimError, match="nothing tells how the camera moved"):
        camera_map(_track(true, rng, edges=()), T_BASE_CAMERA, None, MotionConfig())
    with pytest.raises(SlamsimError, match="camera's path"):
        solve_in_space(true[:3], [_edge(true, 0, 1, "camera", rng)])
