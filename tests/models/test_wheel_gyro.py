"""Wheels and gyroscope: closed forms against numerical integration and against each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from slamsim.core.geometry import compose
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.differential_drive import (
    arcs_between,
    calibrated_motion,
    forward_and_turn,
    left_and_right,
    lever_m2,
    poses_along,
)
from slamsim.models.wheel_gyro import (
    PARAMETERS,
    ROWS,
    calibrated_turn,
    turn_at_midpoints,
    turn_at_samples,
    walk,
)

TRACK_M = 0.23
errors = st.tuples(*[st.floats(-limit, limit) for limit in (0.1, 0.2, 0.05, 0.05, 0.1)])


def _steps(seed: int, count: int = 6) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, [0.2, 0.05, 0.5, 0.5], (count, 4))


def _walked(
    steps: FloatArray, parameters: FloatArray, window_ns: tuple[int, int], stamps_ns: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    poses, jacobian = np.zeros((len(steps) + 1, 3)), np.zeros((ROWS, PARAMETERS))
    totals = np.zeros(5)
    lever = lever_m2(TRACK_M)
    walk(stamps_ns, steps, *window_ns, parameters, lever, poses, jacobian, totals)
    return poses, jacobian, totals


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-3.0, 3.0))
def test_arcs_are_the_solution_of_the_differential_equation(seed: int, heading: float) -> None:
    motion = np.random.default_rng(seed).normal(0.0, [0.3, 1.5], (4, 2))
    start = np.array([0.4, -1.0, heading])
    expected = [start]
    for forward, turn in motion:

        def rates(_: float, pose: FloatArray, v: float = forward, w: float = turn) -> list[float]:
            return [v * np.cos(pose[2]), v * np.sin(pose[2]), w]

        solved = solve_ivp(rates, (0.0, 1.0), expected[-1], rtol=1e-12, atol=1e-13)
        expected.append(solved.y[:, -1])
    np.testing.assert_allclose(poses_along(motion, start), expected, atol=1e-10)


@given(st.integers(0, 10_000))
def test_arcs_are_found_again_from_their_poses(seed: int) -> None:
    motion = np.random.default_rng(seed).normal(0.0, [0.3, 0.8], (5, 2))
    motion[:, 1] = np.clip(motion[:, 1], -3.0, 3.0)
    found = arcs_between(poses_along(motion, np.array([3.0, 4.0, 0.5])))
    np.testing.assert_allclose(found[:, [0, 2]], motion, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-12)


@given(st.integers(0, 10_000))
def test_wheels_and_base_move_as_one(seed: int) -> None:
    motion = np.random.default_rng(seed).normal(size=(5, 2))
    wheels = np.column_stack(left_and_right(motion[:, 0], motion[:, 1], TRACK_M))
    np.testing.assert_allclose(forward_and_turn(wheels, TRACK_M), motion, atol=1e-14)


@given(st.integers(0, 10_000), errors)
def test_the_compiled_integration_drives_the_calibrated_arcs(
    seed: int, errors: tuple[float, ...]
) -> None:
    steps, stamps_ns = _steps(seed), np.arange(7, dtype=np.int64) * 50_000_000
    steps[:, 1], parameters = 0.0, np.array(errors)
    path, turn, curvature, gyro, bias = errors
    by_wheels = calibrated_motion(
        steps[:, [0, 2]], 1.0 + path, 1.0 + turn, curvature, lever_m2(TRACK_M)
    )
    by_gyro = calibrated_turn(steps[:, 3], np.full(len(steps), 0.05), 1.0 + gyro, bias)
    window_ns = (0, int(stamps_ns[-1]))
    for silent, turned in ((False, by_gyro), (True, by_wheels[:, 1])):
        used = steps.copy()
        used[:, 3] = np.nan if silent else used[:, 3]
        poses, _, totals = _walked(used, parameters, window_ns, stamps_ns)
        motion = np.column_stack([by_wheels[:, 0], turned])
        np.testing.assert_allclose(poses, poses_along(motion, np.zeros(3)), atol=1e-12)
        assert totals[0] == pytest.approx(by_wheels[:, 1].sum(), abs=1e-12)


@settings(max_examples=30)
@given(st.integers(0, 10_000), errors, st.booleans())
def test_the_jacobian_is_that_of_finite_differences(
    seed: int, errors: tuple[float, ...], silent: bool
) -> None:
    steps, stamps_ns = _steps(seed), np.arange(7, dtype=np.int64) * 50_000_000
    steps[:, 3] = np.nan if silent else steps[:, 3]
    at, window_ns = np.array(errors), (20_000_000, 270_000_000)
    poses, jacobian, _ = _walked(steps, at, window_ns, stamps_ns)
    for parameter, h in enumerate(np.eye(PARAMETERS) * 1e-6):
        ahead, behind = (_walked(steps, at + s, window_ns, stamps_ns) for s in (h, -h))
        moved = compose(poses[-1], jacobian[:3, parameter] * 1e-6)
        turned = (ahead[2][0] - behind[2][0]) / 2e-6
        apart = (ahead[0][-1] - behind[0][-1]) / 2.0
        np.testing.assert_allclose(moved - poses[-1], apart, atol=1e-10)
        assert jacobian[3, parameter] == pytest.approx(turned, abs=1e-6)


@given(st.integers(0, 10_000), st.floats(-2.0, 2.0), st.floats(-5.0, 5.0))
def test_a_gyroscope_turns_as_its_rate_is_integrated(
    seed: int, rate: float, acceleration: float
) -> None:
    rng = np.random.default_rng(seed)
    stamps_ns = np.cumsum(rng.integers(1_000_000, 20_000_000, 30)).astype(np.int64)
    since_s = (stamps_ns - stamps_ns[0]) * 1e-9

    def turned(t: FloatArray) -> FloatArray:
        return np.asarray(rate * t + 0.5 * acceleration * t * t)

    rates = rate + acceleration * since_s
    np.testing.assert_allclose(turn_at_samples(stamps_ns, rates), turned(since_s), atol=1e-12)

    middle_s = (stamps_ns[:-1] + np.diff(stamps_ns) // 2 - stamps_ns[0]) * 1e-9
    means = np.diff(turned(np.concatenate([[0.0], middle_s, since_s[-1:]])))
    means /= np.diff(np.concatenate([[0.0], middle_s, since_s[-1:]]))
    middle_ns, found = turn_at_midpoints(stamps_ns, means)
    np.testing.assert_allclose((middle_ns - stamps_ns[0]) * 1e-9, middle_s, atol=1e-15)
    np.testing.assert_allclose(found, turned(middle_s) - turned(middle_s[:1]), atol=1e-12)
