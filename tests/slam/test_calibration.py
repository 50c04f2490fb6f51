"""Calibration of wheels and gyroscope: known errors found, with sigmas that hold."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import drive, noisy_gyro

from slamsim.config.slam import MotionConfig
from slamsim.console.summary import summary
from slamsim.core.geometry import between, compose, wrap_angle
from slamsim.core.result import GraphEdge
from slamsim.core.types import EncoderStream, FloatArray, PlanarTrajectory
from slamsim.models.differential_drive import Reading, encoder_reading, pose_reading, wheel_odometry
from slamsim.models.wheel_gyro import CURVATURE, PARAMETERS
from slamsim.slam.calibration.calibrated import calibrated
from slamsim.slam.calibration.online import (
    PRIOR_SIGMAS,
    USUAL_SQUARE,
    Calibrator,
    evidence,
    fit_factor,
    match_information,
)
from slamsim.slam.calibration.solve import (
    Interval,
    Solved,
    closed_by_loops,
    knots_of,
    moved_match,
    shares,
    solve_calibration,
)
from slamsim.slam.frontend.motion import Odometry, increments
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep

TURNING = np.array([[0.0, 0.0], [3, 0], [3, 2], [0, 2], [0, 4], [3, 4], [3, 6], [0, 6], [0, 0]])
STRAIGHT = np.array([[0.0, 0.0], [20.0, 0.0]])
RADII_M, TRACK_M = np.array([0.0352, 0.0354]), 0.232
NOMINAL_RADIUS_M, NOMINAL_TRACK_M = 0.035, 0.23
MATCH_M, MATCH_RAD = 0.001, 0.0003
BIAS_RAD_S = 0.01


@cache
def truth(straight: bool = False) -> PlanarTrajectory:
    return drive(STRAIGHT if straight else TURNING, max_s=120.0)


def encoders_of(path: PlanarTrajectory) -> EncoderStream:
    """Ticks of wheels with the true radii and track, read as if they had the nominal ones."""
    step = between(path.poses[:-1], path.poses[1:])
    forward, turned = np.hypot(step[:, 0], step[:, 1]), step[:, 2]
    rolled = forward[:, None] + 0.5 * TRACK_M * turned[:, None] * np.array([-1.0, 1.0])
    angle = np.vstack([np.zeros(2), np.cumsum(rolled / RADII_M, axis=0)])
    ticks = np.floor(angle * (2500 / (2.0 * np.pi))).astype(np.int64)
    return EncoderStream(path.stamps_ns, ticks, 2500, NOMINAL_RADIUS_M, NOMINAL_TRACK_M)


def odometry_of(path: PlanarTrajectory, gyro: bool = True) -> Odometry:
    encoders = encoders_of(path)
    imu = noisy_gyro(path, 0, BIAS_RAD_S) if gyro else None
    return Odometry(increments(wheel_odometry(encoders), imu), encoder_reading(encoders))


def matches(path: PlanarTrajectory, seed: int, every: int = 20) -> PlanarTrajectory:
    poses = path.poses[::every]
    noise = np.random.default_rng(seed).normal(size=poses.shape)
    return PlanarTrajectory(
        path.stamps_ns[::every], compose(poses, noise * [MATCH_M, MATCH_M, MATCH_RAD])
    )


INFORMATION = np.diag(1.0 / np.square([MATCH_M, MATCH_M, MATCH_RAD])) * 4.0


def intervals_of(
    odometry: Odometry, seen: PlanarTrajectory, information: FloatArray = INFORMATION
) -> list[Interval]:
    nominal = np.zeros(PARAMETERS)
    return [
        Interval(
            odometry.step(int(a), int(b), nominal, 0.02),
            between(seen.poses[n], seen.poses[n + 1]),
            information,
            int(b),
        )
        for n, (a, b) in enumerate(zip(seen.stamps_ns[:-1], seen.stamps_ns[1:], strict=True))
    ]


def follow(odometry: Odometry, seen: PlanarTrajectory) -> Calibrator:
    calibrator = Calibrator(OdometryNoise(MotionConfig()))
    last = int(seen.stamps_ns[0])
    for stamp_ns, pose in zip(seen.stamps_ns.tolist(), seen.poses, strict=True):
        step = odometry.step(last, stamp_ns, calibrator.parameters, calibrator.bias_sigma_rad_s)
        calibrator.follow(step, pose, INFORMATION)
        last = stamp_ns
    return calibrator


def test_wheels_and_gyroscope_are_calibrated_in_robot_units() -> None:
    odometry = odometry_of(truth())
    seen = matches(truth(), 1, every=200)
    found = calibrated(
        solve_calibration(intervals_of(odometry, seen), MotionConfig()), odometry.reading, True
    )
    expected = {
        "wheel_radius_left_m": RADII_M[0],
        "wheel_radius_right_m": RADII_M[1],
        "track_m": TRACK_M,
        "gyro_bias_rad_s": BIAS_RAD_S,
        "gyro_scale": 1.0,
    }
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].observed, name
        assert abs(found[name].value - value) < 4.0 * found[name].sigma, name
    assert found["track_m"].sigma < 0.002
    assert found["wheel_radius_left_m"].sigma < 1e-4


def test_on_line_each_step_knows_only_what_was_before_it() -> None:
    odometry, seen = odometry_of(truth()), matches(truth(), 2)
    half = PlanarTrajectory(seen.stamps_ns[:200], seen.poses[:200])
    changed = np.vstack([seen.poses[:200], seen.poses[200:] + 1.0])
    other = PlanarTrajectory(seen.stamps_ns, changed)
    before = follow(odometry, half).parameters
    cut = PlanarTrajectory(other.stamps_ns[:200], other.poses[:200])
    np.testing.assert_array_equal(before, follow(odometry, cut).parameters)
    calibrator = follow(odometry, seen)
    first = int(seen.stamps_ns[0])
    last = int(seen.stamps_ns[-1])
    nominal = odometry.step(first, last, np.zeros(PARAMETERS)).T_first_last
    learnt = odometry.step(first, last, calibrator.parameters).T_first_last
    true = between(seen.poses[0], seen.poses[-1])
    assert np.hypot(*between(true, learnt)[:2]) < 0.2 * np.hypot(*between(true, nominal)[:2])


def test_the_track_is_not_observed_by_driving_straight() -> None:
    odometry = odometry_of(truth(straight=True))
    seen = matches(truth(straight=True), 3, every=200)
    solved = solve_calibration(intervals_of(odometry, seen), MotionConfig())
    found = calibrated(solved, odometry.reading, True)
    assert not found["track_m"].observed
    assert not found["gyro_scale"].observed
    assert found["gyro_bias_rad_s"].observed
    apart = found["wheel_radius_right_m"].value - found["wheel_radius_left_m"].value
    assert apart == pytest.approx(RADII_M[1] - RADII_M[0], abs=1e-5)


@pytest.mark.parametrize("gyro", [True, False])
def test_somebodys_odometry_has_its_scales_and_its_curvature_found(gyro: bool) -> None:
    path = truth()
    step = between(path.poses[:-1], path.poses[1:])
    forward = np.hypot(step[:, 0], step[:, 1])
    wrong = np.column_stack(
        [step[:, :2] / 1.05, step[:, 2] / 1.08 - np.deg2rad(2.0) * forward / 1.05 / 1.08]
    )
    poses = [np.zeros(3)]
    for one in wrong:
        poses.append(compose(poses[-1], one))
    wheels = PlanarTrajectory(path.stamps_ns, np.array(poses))
    imu = noisy_gyro(path, 0, BIAS_RAD_S) if gyro else None
    odometry = Odometry(increments(wheels, imu), pose_reading(wheels))
    seen = matches(path, 4, every=200)
    found = calibrated(
        solve_calibration(intervals_of(odometry, seen), MotionConfig()), odometry.reading, gyro
    )
    assert found["path_scale"].value == pytest.approx(1.05, abs=0.003)
    assert found["turn_scale"].value == pytest.approx(1.08, abs=0.004)
    assert found["curvature_rad_per_m"].value == pytest.approx(np.deg2rad(2.0), abs=0.003)
    assert ("gyro_scale" in found) == gyro


def test_a_few_bad_matches_do_not_bend_the_calibration() -> None:
    odometry, seen = odometry_of(truth()), matches(truth(), 5, every=200)
    poses = seen.poses.copy()
    for first in (10, 17, 31):
        poses[first:] = compose(np.array([0.5, 0.2, 0.3]), poses[first:])
    bad = solve_calibration(
        intervals_of(odometry, PlanarTrajectory(seen.stamps_ns, poses)), MotionConfig()
    )
    good = solve_calibration(intervals_of(odometry, seen), MotionConfig())
    assert np.all(
        np.abs(bad.values - good.values)
        < 0.02 * np.append(PRIOR_SIGMAS[:4], 0.02)[np.minimum(np.arange(len(good.values)), 4)]
    )


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_evidence_equals_that_of_both_measurements_stacked(seed: int) -> None:
    """Woodbury's form against the plain inverse of the summed covariances."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3, 3))
    matched, own = a @ a.T + 0.1 * np.eye(3), np.zeros((4, 4))
    own[:3, :3] = b @ b.T + 0.1 * np.eye(3)
    own[3, 3] = rng.uniform(0.1, 2.0)
    T = rng.normal(size=3) * 0.1
    found = evidence(
        T, np.linalg.inv(matched), T + 0.01, np.asarray(0.2), rng.normal(size=(4, 5)), own
    )
    spread = np.vstack([np.eye(3), [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        found.weight, np.linalg.inv(own + spread @ matched @ spread.T), rtol=1e-6, atol=1e-9
    )
    assert found.residual[3] == pytest.approx(wrap_angle(0.2 - T[2]))


def test_a_direction_that_no_match_knows_weighs_nothing() -> None:
    own = np.diag([1e-4, 1e-4, 1e-6, np.inf])
    step, T = np.array([0.5, 0.1, 0.0]), np.zeros(3)
    found = evidence(T, np.diag([0.0, 1e6, 1e7]), step, np.asarray(0.0), np.zeros((4, 5)), own)
    assert found.weight[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert found.weight[3, 3] == 0.0
    assert found.squared == pytest.approx(0.1**2 * found.weight[1, 1])


def test_no_match_is_better_than_its_floor() -> None:
    known = match_information(np.diag([0.0, 1e12, 1e12]))
    assert known[0, 0] == 0.0
    assert 1.0 / np.sqrt(known[1, 1]) == pytest.approx(0.001, rel=1e-3)


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.3, 1.0, 10.0]))
def test_the_noise_is_found_in_spite_of_outliers(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    fixed, variance = rng.uniform(0.0, 0.001, 400), rng.uniform(0.5, 2.0, 400)
    square = rng.normal(size=400) ** 2 * (fixed + factor * variance)
    square[:20] *= 1e4
    fitted = fit_factor(np.column_stack([square, fixed, variance]))
    assert 0.5 * factor < fitted < 2.5 * factor
    assert USUAL_SQUARE > 1.0


def test_the_bias_is_a_line_through_its_knots() -> None:
    stamps_ns = np.arange(0, 301, 10) * 10**9
    knots_ns = knots_of(stamps_ns, gyro=True)
    assert len(knots_of(stamps_ns, gyro=False)) == 1
    share = shares(knots_ns, stamps_ns)
    np.testing.assert_allclose(share.sum(axis=1), 1.0)
    expected = np.interp(stamps_ns, knots_ns, np.sin(np.arange(len(knots_ns))))
    np.testing.assert_allclose(share @ np.sin(np.arange(len(knots_ns))), expected)


def straight_loop(count: int) -> tuple[list[Interval], FloatArray, list[GraphEdge]]:
    """A corridor driven there by wheels alone, its length known from one closure."""
    none = OdometryStep.none(np.zeros(PARAMETERS))
    jacobian = np.zeros((4, PARAMETERS))
    jacobian[0, 0] = 0.5
    jacobian[3, CURVATURE] = jacobian[2, CURVATURE] = 0.5
    step = replace(
        none, T_first_last=np.array([0.5, 0, 0]), jacobian=jacobian, path_m=0.5, seconds=1.0
    )
    blind = np.diag([0.0, 1e8, 1e9])
    intervals = [Interval(step, step.T_first_last, blind, n * 10**9) for n in range(1, count + 1)]
    poses = np.column_stack([0.5 * np.arange(count + 1), np.zeros((count + 1, 2))])
    covariance = np.diag([0.02**2 * 0.5, 1e-6, 1e-8])
    edges = [GraphEdge(n, n + 1, step.T_first_last, covariance, "match") for n in range(count)]
    far = np.array([0.5 * count * 1.01, 0.0, 0.0])
    edges.append(GraphEdge(0, count, far, np.diag([1e-6, 1e-6, 1e-8]), "closure"))
    return intervals, poses, edges


def test_a_closure_at_the_end_of_a_corridor_calibrates_the_wheels_on_the_way() -> None:
    count = 40
    intervals, poses, edges = straight_loop(count)
    ends = [(n, n + 1) for n in range(count)]
    alone = solve_calibration(intervals, MotionConfig())
    solved = alone
    for _ in range(3):
        # The chain follows the calibration, and its poses the closure: here a spring in a row.
        T = moved_match(intervals[0], intervals[0].step.T_first_last, solved)
        chain = [replace(edge, T_source_target=T) for edge in edges[:-1]]
        springs, given = count * chain[0].covariance[0, 0], edges[-1].covariance[0, 0]
        gap = edges[-1].T_source_target[0] - count * T[0]
        poses[:, 0] = np.arange(count + 1) * (T[0] + gap * springs / (springs + given) / count)
        solved = closed_by_loops(alone, solved, intervals, ends, poses, [*chain, edges[-1]])
    # By hand: one number, its prior, and one measurement of the whole length.
    length, prior = 0.5 * count, 1.0 / PRIOR_SIGMAS[0] ** 2
    known = length**2 / (springs + given)
    assert solved.values[0] == pytest.approx(0.01 * known / (known + prior), rel=0.02)
    assert solved.covariance[0, 0] == pytest.approx(1.0 / (known + prior), rel=0.02)


def test_without_wheels_that_are_known_the_scales_are_told() -> None:
    values = np.array([0.05, -0.02, 0.03, 0.0, 0.001])
    solved = Solved(
        values, np.diag(np.full(5, 1e-8)), np.zeros(1, np.int64), OdometryNoise(MotionConfig())
    )
    found = calibrated(solved, Reading(0.0, 0.0, 0.0, 0.0), gyro=False)
    assert [round(one.value, 6) for one in found.values()] == [1.05, 0.98, 0.03]
    assert all(one.observed for one in found.values())


def test_only_what_was_observed_is_told_in_a_line() -> None:
    def one(value: float, sigma: float, observed: bool) -> dict[str, object]:
        return {"value": value, "sigma": sigma, "observed": observed}

    report = {
        "calibration": {
            "wheel_radius_left_m": one(0.0352, 5e-6, True),
            "track_m": one(0.23, 0.01, False),
            "gyro_scale": one(1.001, 1e-4, True),
        }
    }
    line = summary(report)["calibration"]
    assert line == "radius left 35.2 ± 0.005 mm, gyro scale 0.1 ± 0.01 %"
    assert "calibration" not in summary({"calibration": {}})
