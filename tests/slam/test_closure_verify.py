"""Closures: the true ones found to the millimetre, the tempting ones refused, and why."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from closure_scene import FLASH, keyframes, straight, submap, tracked
from simulated import box

from slamsim.config.back_end import (
    BackEndConfig,
    ClosureConfig,
    GraphConfig,
    KeyframeConfig,
    SubmapConfig,
)
from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import between, compose, transform_points
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.closures.closure import Closure, ClosureFinder, Expected
from slamsim.slam.closures.pending import WaitingClosures, agree
from slamsim.slam.closures.submaps import FREE, UNKNOWN, WALL, Surfaces, space_grid, submap_is_full
from slamsim.slam.frontend.keyframes import KeyframeMaker, chain_edge
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep

ROOM = np.concatenate(
    [
        box(-5.0, -4.0, 5.0, 4.0),
        box(1.0, 1.0, 2.0, 1.6),
        box(-3.0, -2.5, -2.4, -1.5),
        box(-5.0, 2.0, -4.0, 4.0),
        box(3.0, -4.0, 3.4, -2.0),
    ]
)
CORRIDOR = np.concatenate([box(-40.0, -1.0, 40.0, 1.0)])
SURE = np.diag([0.05, 0.05, 0.01]) ** 2
UNSURE = np.diag([1.0, 1.0, 0.1]) ** 2
TARGET_POSES = straight(np.array([-2.0, 0.0, 0.2]), 2.0, 5)
QUERY_POSES = straight(np.array([1.5, -0.8, 2.9]), 1.5, 4)


def found(
    target_walls: FloatArray,
    query_walls: FloatArray,
    off: FloatArray,
    covariance: FloatArray,
    poses: tuple[FloatArray, FloatArray] = (TARGET_POSES, QUERY_POSES),
    config: BackEndConfig | None = None,
) -> tuple[Closure | str, FloatArray]:
    """What the finder says when it expects the query off its true place, and that place."""
    target = submap(target_walls, poses[0], anchor=2)
    query = submap(query_walls, poses[1], anchor=len(poses[1]) - 1, first=100)
    truth = between(poses[0][2], poses[1][-1])
    finder = ClosureFinder(config or BackEndConfig())
    expected = Expected(compose(truth, off), covariance)
    return finder.find(query, 0, target, expected, 0.01), truth


def accuracy(edge: GraphEdge, truth: FloatArray) -> tuple[float, float]:
    off = between(truth, edge.T_source_target)
    return float(np.hypot(off[0], off[1])), abs(float(off[2]))


@pytest.mark.parametrize("off", [[0.0, 0.0, 0.0], [0.1, -0.1, 0.02], [-0.1, 0.05, -0.02]])
def test_a_room_seen_again_is_recognised_to_the_millimetre(off: list[float]) -> None:
    closure, truth = found(ROOM, ROOM, np.array(off), SURE)
    assert isinstance(closure, Closure)
    off_m, off_rad = accuracy(closure.edge, truth)
    assert off_m < 0.005 and off_rad < 0.002
    assert closure.expected
    sigma_m = np.sqrt(np.diag(closure.edge.covariance))
    assert (sigma_m[:2] < 0.05).all() and off_m < 3.0 * sigma_m[:2].max()


def test_after_a_long_drift_it_is_found_too_but_waits_for_others() -> None:
    closure, truth = found(ROOM, ROOM, np.array([0.9, -0.7, 0.12]), UNSURE)
    assert isinstance(closure, Closure) and not closure.expected
    assert accuracy(closure.edge, truth)[0] < 0.005


def test_a_match_far_beyond_the_gate_waits_for_others_even_if_it_was_near() -> None:
    closure, _ = found(ROOM, ROOM, np.array([0.3, 0.2, 0.0]), 0.01 * SURE)
    assert isinstance(closure, Closure) and not closure.expected


def test_another_room_is_not_recognised() -> None:
    other = np.concatenate([box(-3.0, -6.0, 3.0, 6.0), box(-1.0, 2.0, 1.5, 2.5)])
    refusal, _ = found(ROOM, other, np.zeros(3), UNSURE)
    assert isinstance(refusal, str)


def test_a_wall_where_free_space_was_seen_contradicts() -> None:
    blocked = np.concatenate([ROOM, box(-1.6, -2.2, -1.5, 2.4), box(-1.5, -2.2, 2.5, -2.1)])
    lenient = BackEndConfig(closures=ClosureConfig(min_score=0.2, min_inliers=0.2))
    refusal, _ = found(ROOM, blocked, np.zeros(3), SURE, config=lenient)
    assert refusal == "contradiction"


def test_a_corridor_seen_from_an_unsure_place_is_ambiguous() -> None:
    poses = (
        straight(np.array([-2.0, 0.0, 0.0]), 2.0, 5),
        straight(np.array([0.0, 0.1, 0.0]), 1.5, 4),
    )
    covariance = np.diag([1.0, 0.01, 0.01]) ** 2
    refusal, _ = found(CORRIDOR, CORRIDOR, np.zeros(3), covariance, poses)
    assert refusal == "ambiguous"


def test_along_a_corridor_a_closure_claims_nothing() -> None:
    poses = (
        straight(np.array([-2.0, 0.0, 0.0]), 2.0, 5),
        straight(np.array([0.0, 0.1, 0.0]), 1.5, 4),
    )
    closure, truth = found(CORRIDOR, CORRIDOR, np.array([0.2, 0.0, 0.0]), SURE, poses)
    assert isinstance(closure, Closure)
    variances, axes = np.linalg.eigh(closure.edge.covariance[:2, :2])
    assert np.sqrt(variances[1]) > 100.0 and np.sqrt(variances[0]) < 0.05
    assert abs(axes[1, 1]) < 0.002  # the corridor runs along x
    off = between(truth, closure.edge.T_source_target)
    assert abs(off[1]) < 0.01 and abs(off[2]) < 0.003


def test_what_lies_far_apart_does_not_overlap() -> None:
    far = np.concatenate([ROOM, box(40.0, -4.0, 50.0, 4.0)])
    poses = (TARGET_POSES, straight(np.array([45.0, 0.0, 0.0]), 1.0, 3))
    refusal, _ = found(far, far, np.zeros(3), SURE, poses)
    assert refusal in ("score", "overlap")


def test_space_is_free_where_beams_passed_wall_where_they_ended_else_unknown() -> None:
    piece = submap(ROOM, np.array([[0.0, 0.0, 0.0]]))
    grid = space_grid(piece, 0.08, 20.0)
    points = np.array([[2.5, 0.0], [5.0, 0.0], [1.0, 1.2], [1.5, 1.9], [9.0, 9.0]])
    assert grid.at(points).tolist() == [FREE, WALL, WALL, UNKNOWN, UNKNOWN]


def test_merged_surfaces_are_fewer_and_lie_on_the_walls() -> None:
    members = keyframes(ROOM, TARGET_POSES)
    joined = submap(ROOM, TARGET_POSES, anchor=0)
    assert len(joined.surfaces) < 0.6 * sum(len(member.pieces) for member in members)
    points = transform_points(TARGET_POSES[0], joined.points_m)
    start, step = ROOM[:, :2], ROOM[:, 2:] - ROOM[:, :2]
    share = ((points[:, None] - start) * step).sum(-1) / (step**2).sum(-1)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * step
    off = np.linalg.norm(points[:, None] - nearest, axis=-1).min(axis=1)
    assert np.quantile(off, 0.95) < 0.02


def test_a_submap_ends_by_travel_turn_or_number() -> None:
    config = SubmapConfig(travel_m=2.0, turn_deg=90.0, max_keyframes=6)
    members = keyframes(ROOM, straight(np.array([-2.0, 0.0, 0.0]), 1.5, 4))
    assert not submap_is_full(members, config)
    assert submap_is_full(keyframes(ROOM, straight(np.array([-2.0, 0, 0]), 2.5, 4)), config)
    turning = np.column_stack([np.zeros((3, 2)), [0.0, 0.8, 1.7]])
    assert submap_is_full(keyframes(ROOM, turning), config)
    assert submap_is_full(keyframes(ROOM, straight(np.array([-2.0, 0, 0]), 1.0, 6)), config)


def test_surfaces_forget_what_they_held_before() -> None:
    scratch = Surfaces()
    pieces = keyframes(ROOM, TARGET_POSES[:1])[0].pieces
    scratch.fill([(pieces, np.zeros(3))], 0.01)
    once = scratch.collected()
    scratch.fill([(pieces[:5], np.array([30.0, 0.0, 0.0]))], 0.01)
    assert 0 < len(scratch.collected()) <= 5
    scratch.fill([(pieces, np.zeros(3))], 0.01)
    assert np.array_equal(scratch.collected(), once)


def test_key_frames_come_by_travel_turn_or_time_and_not_at_rest() -> None:
    maker = KeyframeMaker(KeyframeConfig(travel_m=0.5, turn_deg=20.0, interval_s=5.0), 20.0)
    poses = [[0, 0, 0], [0.3, 0, 0], [0.6, 0, 0], [0.6, 0, 0.3], [0.6, 0, 0.4]]
    poses += [[0.6, 0, 0.4]] * 8 + [[0.7, 0, 0.4]]
    made = [
        maker.make(tracked(ROOM, np.array(pose, dtype=float), k)) for k, pose in enumerate(poses)
    ]
    assert [k for k, one in enumerate(made) if one is not None] == [0, 2, 4, 13]


def test_a_chain_to_a_local_map_begun_anew_is_odometry_and_as_unsure_as_the_place() -> None:
    maker = KeyframeMaker(KeyframeConfig(travel_m=0.5), 20.0)
    poses = straight(np.array([-2.0, 0.0, 0.0]), 2.0, 5)
    scans = [tracked(ROOM, pose, k, lost=k == 3) for k, pose in enumerate(poses)]
    restart = np.diag([0.04, 0.04, 0.01])
    scans[3] = replace(scans[3], restart=restart)
    made = [maker.make(scan) for scan in scans]
    frames = [one for one in made if one is not None]
    noise = OdometryNoise(MotionConfig())
    edges = [chain_edge(a, b, noise, GraphConfig()) for a, b in itertools.pairwise(frames)]
    assert [edge.kind for edge in edges] == ["match", "match", "odometry", "match"]
    sure, lost = edges[1].covariance, edges[2].covariance
    assert np.trace(lost) > 4.0 * np.trace(sure)
    np.testing.assert_allclose(lost, restart, rtol=0.05, atol=1e-9)
    assert all(np.linalg.eigvalsh(edge.covariance).min() > 0.0 for edge in edges)


def test_a_direction_that_walls_do_not_hold_keeps_the_uncertainty_of_the_wheels() -> None:
    frames = keyframes(ROOM, straight(np.array([-2.0, 0.0, 0.0]), 0.5, 2))
    rolled = replace(OdometryStep.none(np.zeros(PARAMETERS)), path_m=0.25, seconds=1.0)
    blind = replace(frames[1], information=np.diag([0.0, 1e6, 1e6]), odometry=rolled)
    edge = chain_edge(
        frames[0], blind, OdometryNoise(MotionConfig(slip_m_per_sqrt_m=0.1)), GraphConfig()
    )
    sigma = np.sqrt(np.diag(edge.covariance))
    assert 0.04 < sigma[0] < 0.06 and sigma[1] < 0.01


def closure_between(source: int, target: int, T: FloatArray, path_m: float = 0.0) -> Closure:
    edge = GraphEdge(source, target, T, np.diag([1e-4, 1e-4, 1e-5]), "closure")
    return Closure(edge, False, 0, path_m)


def test_closures_that_say_the_same_are_believed_together() -> None:
    poses = straight(np.zeros(3), 9.0, 10)
    shift = np.array([0.5, 0.2, 0.05])
    waiting = WaitingClosures(3, 1.0)
    say = [
        closure_between(a, b, between(poses[a], compose(shift, poses[b])), path_m=float(b))
        for a, b in ((0, 7), (1, 8), (2, 9))
    ]
    assert agree(say[0], say[1], poses)
    assert waiting.add(say[0], poses) == ()
    assert waiting.add(say[1], poses) == ()
    assert len(waiting.add(say[2], poses)) == 3
    assert waiting.forget(np.inf) == 0


def test_closures_that_contradict_each_other_wait_and_are_forgotten() -> None:
    poses = straight(np.zeros(3), 9.0, 10)
    waiting = WaitingClosures(2, 1.0)
    for k in range(4):
        wrong = np.array([0.7 * k, -0.5 * k, 0.2 * k])
        said = closure_between(k, 9 - k, compose(between(poses[k], poses[9 - k]), wrong))
        assert waiting.add(said, poses) == ()
    assert waiting.forget(5.0) == 0
    assert waiting.forget(100.0) == 4


def test_one_key_frame_does_not_agree_with_itself() -> None:
    poses = straight(np.zeros(3), 9.0, 10)
    waiting = WaitingClosures(2, 1.0)
    assert waiting.add(closure_between(0, 9, between(poses[0], poses[9])), poses) == ()
    assert waiting.add(closure_between(1, 9, between(poses[1], poses[9])), poses) == ()


def test_key_frames_that_share_their_scans_are_one_witness() -> None:
    """A metre of corridor, wrong by one door: every key frame on it says the same."""
    poses = straight(np.zeros(3), 9.0, 19)
    step = np.array([2.0, 0.0, 0.0])
    waiting = WaitingClosures(3, 2.0)
    for k in range(12, 16):
        wrong = compose(step, between(poses[0], poses[k]))
        assert waiting.add(closure_between(0, k, wrong, path_m=0.5 * k), poses) == ()
    last = closure_between(1, 18, compose(step, between(poses[1], poses[18])), path_m=9.0)
    assert waiting.add(last, poses) == ()  # 6 m and 9 m of path: two witnesses
    first = closure_between(0, 8, compose(step, between(poses[0], poses[8])), path_m=4.0)
    assert len(waiting.add(first, poses)) == 6


def test_the_scene_sees_what_it_should() -> None:
    cloud = tracked(ROOM, np.zeros(3), 0, noise_m=0.0).cloud
    assert len(cloud.points_m) == FLASH.beam_count
    straight_ahead = cloud.points_m[np.argmin(np.abs(FLASH.angles_rad()))]
    assert np.allclose(straight_ahead, [5.0, 0.0], atol=1e-6)
