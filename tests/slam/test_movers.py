"""A person who walks along a corridor ahead of the robot is no sign that its wheels slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import HOKUYO, box, sense_scans

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between
from slamsim.core.types import Cloud, FloatArray, PlanarTrajectory
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.frontend.match_selection import MatchSelector
from slamsim.slam.frontend.movers import WIDEST_M, compact_things
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.frontend.preintegration import OdometryStep
from slamsim.slam.frontend.standing import PROVEN_S, PROVEN_SCANS, WATCHED_S
from slamsim.slam.matching import Match
from slamsim.slam.matching.line import LineMatcher

CORRIDOR = box(-60.0, -1.0, 60.0, 1.0)
SIGMAS = np.array([0.008, 0.008, 0.003])
STEP_S, STEP_M = 0.03, 0.025


def person(ahead_m: float) -> FloatArray:
    return box(ahead_m - 0.15, -0.2, ahead_m + 0.15, 0.2)


def seen(walls: FloatArray, T_map_base: FloatArray, seed: int) -> Cloud:
    stamps_ns = np.array([0, HOKUYO.duration_ns + 1])
    still = PlanarTrajectory(stamps_ns, np.stack([T_map_base, T_map_base]))
    return deskew(sense_scans(walls, still, HOKUYO, 0.01, seed)[0], still, 0, np.eye(4))


def placed(
    walls: FloatArray, walls_before: FloatArray, moved_m: float, times: int = 2
) -> tuple[Match, Match]:
    """After odometry of STEP_M and a motion of moved_m, seen so many times: the match that is
    believed, and the bare one."""
    matcher, start = LineMatcher(FrontEndConfig()), np.zeros(3)
    for seed in range(5):
        matcher.insert(seen(walls_before, start, seed), start)
    T_map_base = np.array([STEP_M, 0.0, 0.0])
    step = replace(OdometryStep.none(np.zeros(PARAMETERS)), T_first_last=T_map_base, seconds=STEP_S)
    covariance = np.diag(np.square(SIGMAS))
    here = Prediction(
        *(10**8, T_map_base, covariance, T_map_base, T_map_base, start, False, step, covariance)
    )
    cloud = seen(walls, np.array([moved_m, 0.0, 0.0]), 9)
    bare = matcher.match(cloud, T_map_base, covariance)
    selector, match = MatchSelector(0.55), None
    for k in range(times):
        now = replace(here, stamp_ns=10**8 + round(1e9 * STEP_S) * k)
        match = selector.place(matcher, cloud, now, T_map_base)
    assert match is not None and bare is not None
    return match, bare


def test_a_person_who_walks_ahead_does_not_hold_the_robot() -> None:
    before = np.concatenate([CORRIDOR, person(0.8)])
    after = np.concatenate([CORRIDOR, person(0.8 + STEP_M)])
    match, bare = placed(after, before, STEP_M)
    assert bare.T_map_base[0] < 0.5 * STEP_M, "it does hold a robot that is not warned"
    assert abs(match.T_map_base[0] - STEP_M) < SIGMAS[0]
    assert match.degenerate


def test_what_seems_to_move_once_may_be_a_stamp_that_is_wrong() -> None:
    before = np.concatenate([CORRIDOR, person(0.8)])
    after = np.concatenate([CORRIDOR, person(0.8 + STEP_M)])
    match, _ = placed(after, before, STEP_M, times=1)
    assert match.T_map_base[0] < 0.5 * STEP_M, "walls would tell slip as this does"


def seen_along(matcher: LineMatcher, ahead_m: list[float]) -> list[int]:
    """A robot that drives STEP_M a scan in the corridor, a person so far ahead of it in each: how
    many beams of each scan are taken to be on something that moves."""
    selector, left_out = MatchSelector(0.55), []
    covariance = np.diag(np.square(SIGMAS))
    for k, ahead in enumerate(ahead_m):
        T_before, T = np.array([STEP_M * (k - 1), 0.0, 0.0]), np.array([STEP_M * k, 0.0, 0.0])
        whole = seen(np.concatenate([CORRIDOR, person(T[0] + ahead)]), T, k)
        none = OdometryStep.none(np.zeros(PARAMETERS))
        step = replace(none, T_first_last=between(T_before, T), seconds=STEP_S)
        now_ns = 10**8 + round(1e9 * STEP_S) * k
        here = Prediction(
            now_ns, T, covariance, T, STEP_M * np.eye(3)[0], T_before, False, step, covariance
        )
        cloud = selector.standing(matcher, whole, here)
        left_out.append(len(whole.hit) - len(cloud.hit))
        selector.place(matcher, cloud, here, T)
        matcher.insert(cloud, T)
    return left_out


def test_who_walks_is_left_out_of_each_scan_until_he_stands() -> None:
    walks = [2.0] * 30
    stands = [2.0 - STEP_M * k for k in range(1, 51)]
    left_out = np.array(seen_along(LineMatcher(FrontEndConfig()), [*walks, *stands]))
    assert np.all(left_out[PROVEN_SCANS : len(walks)] > 10)
    stood_s = STEP_S * np.arange(1, 51)
    assert np.all(left_out[len(walks) :][stood_s > WATCHED_S + 3 * STEP_S] == 0)


def test_who_stands_counts_as_soon_as_that_is_known() -> None:
    left_out = np.array(
        seen_along(LineMatcher(FrontEndConfig()), [2.0 - STEP_M * k for k in range(30)])
    )
    assert np.all(left_out[round(PROVEN_S / STEP_S) + 1 :] == 0)


def test_a_crowd_that_creeps_along_does_not_take_the_robot_with_it() -> None:
    """None of them alone denies the odometry, whose sigmas are such as scans have shown."""
    matcher, selector = LineMatcher(FrontEndConfig()), MatchSelector(0.55)
    at = [(0.9, 0.4, 0.12), (1.3, -0.5, 0.2)]
    seconds, speed_m_s, estimate = 1 / 6, 0.05, np.zeros(3)
    step_m = np.array([speed_m_s * seconds, 0.0, 0.0])
    covariance = np.diag(np.square([0.02, 0.02, 0.003]))
    for k in range(40):
        t_s = k * seconds
        people = [person(x + v * t_s) + np.array([0.0, y, 0.0, y]) for x, y, v in at]
        T = np.array([speed_m_s * t_s, 0.0, 0.0])
        cloud = seen(np.concatenate([CORRIDOR, *people]), T, k)
        near = replace(cloud, hit=cloud.hit & (np.hypot(*cloud.points_m.T) < 4.0))
        none = OdometryStep.none(np.zeros(PARAMETERS))
        step = replace(none, T_first_last=step_m, seconds=seconds)
        predicted = estimate + step_m if k else estimate
        here = Prediction(
            *(round(1e9 * t_s), predicted, covariance, T, step_m, estimate, False, step, covariance)
        )
        standing = selector.standing(matcher, near, here)
        match = selector.place(matcher, standing, here, predicted) if k else None
        estimate = predicted if match is None else match.T_map_base
        matcher.insert(standing, estimate)
    assert abs(estimate[0] - speed_m_s * 39 * seconds) < 0.03


def test_walls_tell_that_wheels_slip() -> None:
    room = np.concatenate([box(-4.0, -3.0, 4.0, 3.0), person(0.8)])
    match, bare = placed(room, room, 0.0)
    assert np.abs(match.T_map_base - bare.T_map_base).max() < 1e-3
    assert abs(match.T_map_base[0]) < 0.005


def test_pillars_that_agree_tell_so_too() -> None:
    """Each of them is compact; without any one of them the others still say it."""
    pillars = [box(x - 0.2, y - 0.2, x + 0.2, y + 0.2) for x in (-3.0, 2.0) for y in (-2.5, 3.0)]
    hall = np.concatenate([box(-40.0, -40.0, 40.0, 40.0), *pillars])
    match, _ = placed(hall, hall, 0.0)
    assert abs(match.T_map_base[0]) < 0.01


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_things_are_compact_and_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(rng.integers(0, 8)):
        x_m, y_m = rng.uniform(-5.0, 5.0, 2)
        if np.hypot(x_m, y_m) > 1.5:
            size_m = rng.uniform(0.1, 1.5)
            boxes.append(box(x_m - 0.5 * size_m, y_m - 0.1, x_m + 0.5 * size_m, y_m + 0.1))
    cloud = seen(np.concatenate([box(-6.0, -6.0, 6.0, 6.0), *boxes]), np.zeros(3), seed)
    taken = np.zeros(len(cloud.hit), dtype=int)
    for thing in compact_things(cloud):
        points_m = cloud.points_m[thing]
        apart_m = np.hypot(*(points_m[:, None] - points_m[None]).transpose(2, 0, 1))
        assert apart_m.max(initial=0.0) <= 2.0 * WIDEST_M
        assert cloud.hit[thing].all()
        taken += thing
    assert taken.max(initial=0) <= 1


def test_two_legs_are_one_thing() -> None:
    legs = [box(0.9, y - 0.06, 1.02, y + 0.06) for y in (-0.15, 0.15)]
    cloud = seen(np.concatenate([CORRIDOR, *legs]), np.zeros(3), 1)
    first = next(compact_things(cloud))
    y_m = cloud.points_m[first, 1]
    assert y_m.min() < -0.1 and y_m.max() > 0.1
    assert np.all(np.abs(cloud.points_m[first, 0] - 0.96) < 0.15)


def test_a_person_ends_where_nothing_comes_back() -> None:
    """Between him and the wall beside him the corridor is longer than the range."""
    cloud = seen(np.concatenate([CORRIDOR, person(3.0)]), np.zeros(3), 1)
    near = cloud.select(np.hypot(*cloud.points_m.T) < 4.0)
    first = next(compact_things(near))
    assert first.sum() > 5
    assert np.all(np.hypot(*(near.points_m[first] - [3.0, 0.0]).T) < 0.4)


def test_far_walls_of_a_second_lidar_with_fewer_beams_are_no_things() -> None:
    """By the angle between beams of the first, each of its beams was a thing of its own."""
    fine, coarse = (np.radians(np.arange(*of)) for of in ((-90.0, 90.0, 0.25), (150.0, 210.0, 1.0)))
    angles = np.concatenate([fine, coarse])
    far_m = np.append(np.full(fine.size, 5.0), np.full(coarse.size, 14.0))
    points_m = far_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    hit = np.ones(angles.size, dtype=np.bool_)
    cloud = Cloud(0, points_m, np.zeros_like(points_m), hit, own_beams=fine.size)
    assert not list(compact_things(cloud))
