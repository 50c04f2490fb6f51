"""Rays and drives of the independent generator beside slow oracles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from independent.drives import ROBOT_RADIUS_M, STEP_S, Drive, integrated, random_drive
from independent.rays import Floats, Scene, cast, clearance
from independent.rooms import KINDS, random_room

SEEDS = st.integers(0, 2**32 - 1)


def _slow_wall(wall: Floats, origin: Floats, along: Floats) -> float:
    """Solve for both lengths at once: o + t d = a + s e."""
    begin, edge = wall[:2], wall[2:] - wall[:2]
    system = np.column_stack([along, -edge])
    if abs(np.linalg.det(system)) < 1e-14:
        return np.inf
    far, share = np.linalg.solve(system, begin - origin)
    return float(far) if far > 0.0 and -1e-9 <= share <= 1.0 + 1e-9 else np.inf


def _slow_post(post: Floats, origin: Floats, along: Floats) -> float:
    """The least positive root of |o + t d - c|^2 = r^2."""
    to = origin - post[:2]
    roots = np.roots([along @ along, 2.0 * along @ to, to @ to - post[2] ** 2])
    positive = [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0.0]
    return float(min(positive, default=np.inf))


@given(SEEDS)
def test_rays_meet_what_the_slow_oracle_meets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls, posts = rng.uniform(-5.0, 5.0, (6, 4)), rng.uniform(0.2, 2.0, (3, 3))
    scene = Scene(walls, posts, np.zeros(6, bool))
    origins, angles = rng.uniform(-5.0, 5.0, (20, 2)), rng.uniform(-4.0, 4.0, 20)
    found = cast(scene, origins, angles)
    for origin, angle, distance in zip(origins, angles, found, strict=True):
        along = np.array([np.cos(angle), np.sin(angle)])
        expected = min(
            *(_slow_wall(wall, origin, along) for wall in walls),
            *(_slow_post(post, origin, along) for post in posts),
        )
        assert distance == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_more_rays_than_one_piece_of_work_are_the_same_rays() -> None:
    scene = random_room(np.random.default_rng(3))
    origins, angles = np.zeros((9000, 2)), np.linspace(-3.0, 3.0, 9000)
    whole = cast(scene, origins, angles)
    halves = [cast(scene, origins[part], angles[part]) for part in (slice(700), slice(700, None))]
    np.testing.assert_allclose(whole, np.concatenate(halves), rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_no_ray_leaves_a_room(kind: object) -> None:
    """Also through corners, at which two walls touch."""
    rng = np.random.default_rng(1)
    seen = 0
    while seen < 3:
        index = int(rng.integers(1 << 30))
        scene = random_room(np.random.default_rng(index))
        if KINDS[int(np.random.default_rng(index).integers(len(KINDS)))] is not kind:
            continue
        seen += 1
        angles = np.linspace(0.0, 2.0 * np.pi, 5000)
        corners = np.arctan2(scene.walls[:, 1], scene.walls[:, 0])
        every = np.concatenate([angles, corners])
        assert np.isfinite(cast(scene, np.zeros((len(every), 2)), every)).all()


def test_a_pane_is_seen_head_on_alone() -> None:
    scene = Scene(
        np.array([[1.0, -5.0, 1.0, 5.0], [2.0, -9.0, 2.0, 9.0]]),
        np.zeros((0, 3)),
        np.array([True, False]),
    )
    found = cast(scene, np.zeros((2, 2)), np.array([0.1, 0.8]))
    np.testing.assert_allclose(found, [1.0 / np.cos(0.1), 2.0 / np.cos(0.8)])


@pytest.mark.long
@given(SEEDS)
def test_poses_are_those_of_the_differential_equation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    knots = 40
    speeds, turns = rng.uniform(-1.0, 1.0, knots), rng.uniform(-2.0, 2.0, knots)
    drive = integrated(speeds, turns, rng.uniform(-2.0, 2.0, 3))
    known_s = STEP_S * np.arange(knots)

    def rates(at_s: float, pose: Floats) -> list[float]:
        v, w = np.interp(at_s, known_s, speeds), np.interp(at_s, known_s, turns)
        return [float(v * np.cos(pose[2])), float(v * np.sin(pose[2])), float(w)]

    at_s = np.sort(rng.uniform(0.0, drive.seconds, 5))
    solved = solve_ivp(
        rates, (0.0, drive.seconds), drive.poses[0], t_eval=at_s, max_step=STEP_S / 4, rtol=1e-9
    )
    np.testing.assert_allclose(drive.at(at_s), solved.y.T, atol=1e-6)


def _path(drive: Drive) -> Floats:
    return drive.at(np.linspace(0.0, drive.seconds, 2000))[:, :2]


@pytest.mark.parametrize("seed", range(6))
def test_a_random_drive_goes_far_turns_both_ways_and_touches_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_room(rng)
    drive = random_drive(scene, rng, 60.0)
    assert drive.seconds == pytest.approx(60.0)
    assert clearance(scene, _path(drive)).min() > ROBOT_RADIUS_M - 0.01
    turned = np.diff(drive.poses[:, 2])
    assert min(turned[turned > 0.0].sum(), -turned[turned < 0.0].sum()) > np.pi
    assert np.abs(drive.speeds_m_s).sum() * STEP_S > 8.0
