"""Bounds of whole trajectories: against dense algebra, and an estimator that reaches them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array
from test_bound_scans import T_BASE_LASER, distance, lidar, moved, nearest, polygon

from slamsim.config.sensors import EncoderConfig, GyroConfig, ImuConfig, SensorsConfig
from slamsim.core.geometry import between, compose, wrap_angle
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.evaluate import bound_solve
from slamsim.evaluate.bound import (
    Groups,
    aligned_rmse_m,
    group_scans,
    joint_information,
    trajectory_bound,
)
from slamsim.evaluate.bound_odometry import BoundOdometryNoise, odometry_noise
from slamsim.evaluate.bound_scans import scan_information
from slamsim.evaluate.bound_solve import Blocks, draws
from slamsim.evaluate.bound_walls import Faces, wall_faces
from slamsim.evaluate.trajectory import align_se2

TRACK_M = 0.23
SIGMA_M = 0.01
NOISE = BoundOdometryNoise(forward=4e-4, sideways=1e-4, wheel_yaw=1e-3, gyro_yaw=1e-4)


class Unit(np.random.Generator):
    """Gives every unit vector in turn for normal numbers, so that draws become a square root."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def standard_normal(self, size: tuple[int, int]) -> FloatArray:  # type: ignore[override]
        return np.eye(*size)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_draws_have_the_inverse_as_their_covariance(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size)) * (rng.random((size, size)) < 0.4)
    information = root @ root.T + 0.1 * np.eye(size)
    drawn = draws(csc_array(information), size, Unit())
    np.testing.assert_allclose(drawn @ drawn.T, np.linalg.inv(information), atol=1e-9)


def test_draws_are_the_same_however_many_are_made_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    root = np.random.default_rng(1).normal(size=(50, 50))
    information = csc_array(root @ root.T + np.eye(50))
    drawn = []
    for at_once in (4, 7, 30):
        monkeypatch.setattr(bound_solve, "DRAWN_AT_ONCE", at_once)
        drawn.append(draws(information, 30, np.random.default_rng(2)))
    assert np.array_equal(drawn[0], drawn[2]) and np.array_equal(drawn[1], drawn[2])


def test_a_matrix_that_is_no_information_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        draws(csc_array(np.diag([1.0, -1.0])), 2, np.random.default_rng(0))


def test_blocks_add_up_and_are_mirrored() -> None:
    blocks = Blocks(5)
    blocks.add(np.array([0, 0]), np.array([0, 0]), np.stack([np.eye(2), np.eye(2)]))
    blocks.add(np.array([1]), np.array([2]), np.array([[[1.0, 2.0, 3.0]]]))
    expected = np.zeros((5, 5))
    expected[0, 0] = expected[1, 1] = 2.0
    expected[1, 2:], expected[2:, 1] = [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(blocks.matrix().toarray(), expected)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_small_errors_are_aligned_as_the_ate_aligns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-5.0, 5.0, (12, 3))
    errors = 1e-5 * rng.normal(size=(12, 2, 1))
    estimate = truth.copy()
    estimate[:, :2] += errors[:, :, 0]
    aligned = compose(align_se2(estimate, truth), estimate)
    rmse_m = np.sqrt(np.mean(np.sum((aligned - truth)[:, :2] ** 2, axis=1)))
    found = aligned_rmse_m(errors, truth[:, :2], np.full(12, 1 / 12))[0]
    assert found == pytest.approx(rmse_m, rel=1e-3)


def test_neighbouring_scans_are_joined_and_none_is_lost() -> None:
    x = np.concatenate([np.zeros(50), np.linspace(0.0, 2.0, 401), np.full(30, 2.0)])
    poses = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    groups = group_scans(np.arange(x.size), poses, TRACK_M)
    assert groups.counts.sum() == x.size
    assert 20 <= len(groups) <= 22
    counted = np.bincount(groups.cast_group, groups.cast_count)
    np.testing.assert_allclose(counted, groups.counts)
    assert np.all(np.diff(groups.cast) > 0)
    assert np.abs(poses[groups.cast, 0] - groups.poses[groups.cast_group, 0]).max() <= 0.101


class Room:
    """A small room, six places in it, and all that is measured there, as plain functions."""

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        self.faces: Faces = wall_faces(polygon(rng, 7))
        turns = np.linspace(0.0, 4.0, 6)
        self.poses = np.column_stack([np.cos(turns), np.sin(turns), turns + 1.0]) * [0.8, 0.8, 1.0]
        self.stamps_ns = np.arange(6, dtype=np.int64) * 10**9
        self.beams_rad = np.deg2rad(-180.0 + 8.0 * np.arange(45))
        met = [
            [nearest(*self.ray(pose, beam), self.faces.ends_m)[0] for beam in self.beams_rad]
            for pose in self.poses
        ]
        self.met = np.array(met)

    def ray(self, pose: FloatArray, beam_rad: float) -> tuple[FloatArray, FloatArray]:
        laser = compose(pose, np.array([0.1, -0.05, beam_rad]))
        return laser[:2], np.array([np.cos(laser[2]), np.sin(laser[2])])

    def measured(self, state: FloatArray) -> FloatArray:
        """Ranges over their sigma, then steps of odometry over theirs, whitened."""
        poses = self.poses + state[:18].reshape(6, 3)
        walls = [moved(self.faces, k, *state[18 + 2 * k : 20 + 2 * k]) for k in range(7)]
        ranges = [
            distance(*self.ray(pose, beam), walls[face]) / SIGMA_M
            for pose, faces in zip(poses, self.met, strict=True)
            for beam, face in zip(self.beams_rad, faces, strict=True)
        ]
        return np.concatenate([ranges, self.odometry(poses)])

    def odometry(self, poses: FloatArray) -> FloatArray:
        true_step = between(self.poses[:-1], self.poses[1:])
        chord_m = np.hypot(true_step[:, 0], true_step[:, 1])
        rolled_m = chord_m + 0.5 * TRACK_M * np.abs(true_step[:, 2])
        covariances = NOISE.covariances(rolled_m, chord_m, np.ones(5))
        step = between(poses[:-1], poses[1:])
        step[:, 2] = true_step[:, 2] + wrap_angle(step[:, 2] - true_step[:, 2])
        white = []
        for one, true, covariance in zip(step, true_step, covariances, strict=True):
            cos, sin = true[:2] / np.hypot(*true[:2])
            along = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ one
            white.append(np.linalg.solve(np.linalg.cholesky(covariance), along))
        return np.concatenate(white)

    def jacobian(self, state: FloatArray, step: float = 1e-6) -> FloatArray:
        columns = [
            (self.measured(state + step * axis) - self.measured(state - step * axis)) / (2 * step)
            for axis in np.eye(state.size)
        ]
        return np.column_stack(columns)

    def bound(self) -> tuple[Groups, FloatArray, FloatArray]:
        """The information matrices of the module under test, walls numbered as the faces."""
        groups = group_scans(self.stamps_ns, self.poses, TRACK_M)
        config = lidar(angle_step_deg=8.0, beam_count=45, rolling=False)
        truth = PlanarTrajectory(self.stamps_ns, self.poses)
        scans = scan_information(self.faces, truth, self.stamps_ns, T_BASE_LASER, config)
        known, joint = joint_information(groups, scans, self.poses[groups.cast], NOISE)
        return groups, known.toarray(), joint.toarray()


@pytest.fixture(scope="module")
def room() -> Room:
    return Room()


def test_the_information_is_that_of_all_measurements_together(room: Room) -> None:
    """Sums of outer products of numerical derivatives, all poses and walls at once."""
    groups, known, joint = room.bound()
    assert len(groups) == 6
    jacobian = room.jacobian(np.zeros(32))
    expected = jacobian.T @ jacobian
    prior = np.zeros((32, 32))
    prior[18:, 18:] = np.eye(14)
    prior[:18, :18] = np.diag([0.01, 0.01, np.pi**-2] * 6)
    size = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose((joint - prior) / size, expected / size, atol=1e-5)
    known -= prior[:18, :18]
    np.testing.assert_allclose(
        known / size[:18, :18], expected[:18, :18] / size[:18, :18], atol=1e-5
    )


@pytest.mark.long
def test_an_efficient_estimator_reaches_the_bound_and_none_is_better(room: Room) -> None:
    """Monte Carlo of least squares over poses and walls: its ATE is the bound's on average."""
    groups, _, joint = room.bound()
    share = groups.counts / groups.counts.sum()
    drawn = draws(csc_array(joint), 4000, np.random.default_rng(1))[:18].reshape(6, 3, -1)
    expected = aligned_rmse_m(drawn[:, :2], groups.poses[:, :2], share).mean()
    rng = np.random.default_rng(2)
    jacobian = room.jacobian(np.zeros(32))
    exact = room.measured(np.zeros(32))
    information = jacobian.T @ jacobian + np.diag([0.01] * 18 + [1.0] * 14)
    found = []
    for _ in range(150):
        seen = exact + rng.standard_normal(exact.size)
        state = np.zeros(32)
        for _ in range(3):
            state += np.linalg.solve(information, jacobian.T @ (seen - room.measured(state)))
        estimate = room.poses + state[:18].reshape(6, 3)
        aligned = compose(align_se2(estimate, room.poses), estimate)
        found.append(np.sqrt(np.mean(np.sum((aligned - room.poses)[:, :2] ** 2, axis=1))))
    doubt = np.std(found) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(expected, abs=4.0 * doubt)
    assert 0.0003 < expected < 0.01


def driven(metres: float, seed: int = 0) -> tuple[PlanarTrajectory, PlanarTrajectory]:
    """A winding drive, and wheels with a wrong radius and track that slip by 1 mm/sqrt(m)."""
    rng = np.random.default_rng(seed)
    count = round(metres / 0.02)
    turn = 0.02 * np.sin(np.arange(count) * 0.03)
    rolled = np.column_stack([np.full(count, 0.02), 0.01 * turn, turn])
    true_step = rolled + rng.normal(size=(count, 3)) * np.sqrt(0.02) * [1e-3, 2e-3, 3e-3]
    wheel_step = rolled * [1.01, 1.0, 0.97]
    stamps_ns = np.arange(count + 1, dtype=np.int64) * 40_000_000
    return PlanarTrajectory(stamps_ns, chained(true_step)), PlanarTrajectory(
        stamps_ns, chained(wheel_step)
    )


def chained(steps: FloatArray) -> FloatArray:
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def test_slip_is_what_calibration_leaves() -> None:
    truth, wheels = driven(200.0)
    noise = odometry_noise(truth, wheels, SensorsConfig(), TRACK_M)
    rolled = 1.0 + 0.5 * TRACK_M * np.abs(np.diff(truth.poses[:, 2])).mean() / 0.02
    assert np.sqrt(noise.forward * rolled) == pytest.approx(1e-3, rel=0.2)
    assert np.sqrt(noise.sideways * rolled) == pytest.approx(2e-3, rel=0.2)
    assert np.sqrt(noise.wheel_yaw * rolled) == pytest.approx(3e-3, rel=0.2)
    assert noise.gyro_yaw == pytest.approx(SensorsConfig().imu.gyro.noise_density ** 2)


def sensors(**noise: float) -> SensorsConfig:
    gyro = GyroConfig(noise_density=noise.get("gyro", 1e-4))
    return SensorsConfig(lidar=lidar(angle_step_deg=1.0, beam_count=360), imu=ImuConfig(gyro=gyro))


def test_bounds_are_ordered_and_fall_with_better_sensors() -> None:
    outline = polygon(np.random.default_rng(4), 9) * 3.0
    truth, wheels = driven(12.0)
    bound = trajectory_bound(outline, truth, wheels, T_BASE_LASER, sensors(), TRACK_M)
    assert bound is not None
    assert 0.0 < bound.localisation_m < bound.scan_m
    assert bound.localisation_rad < bound.scan_rad
    assert bound.ate_m < 0.02
    blind = sensors().model_copy(
        update={
            "imu": ImuConfig(enabled=False),
            "encoders": EncoderConfig(enabled=False),
        }
    )
    without = trajectory_bound(outline, truth, wheels, T_BASE_LASER, blind, TRACK_M)
    assert without is not None
    assert without.localisation_m > 1.2 * bound.localisation_m
    assert without.scan_m == pytest.approx(bound.scan_m)


def test_a_corridor_holds_no_pose_along_itself() -> None:
    sides = [[[-50.0, -1.0], [50.0, -1.0]], [[50.0, 1.0], [-50.0, 1.0]]]
    outline = np.array(sides)[:, ::-1]
    truth, wheels = driven(6.0)
    near = sensors().model_copy(update={"lidar": lidar(range_max_m=8.0)})
    bound = trajectory_bound(outline, truth, wheels, T_BASE_LASER, near, TRACK_M)
    assert bound is not None
    assert bound.scans.worst_m.min() > 1.0
    along = np.abs(np.cos(bound.scans.worst_direction_rad))
    assert along.min() > 0.99
    assert bound.ate_m < 0.05


def test_nothing_to_bound_is_none() -> None:
    outline = polygon(np.random.default_rng(4), 9)
    truth, wheels = driven(3.0)
    still = PlanarTrajectory(truth.stamps_ns, np.zeros_like(truth.poses))
    bare = np.zeros((0, 2, 2))
    off = sensors().model_copy(update={"lidar": lidar(enabled=False)})
    none = PlanarTrajectory(wheels.stamps_ns + 10**15, wheels.poses)
    for walls, true, rolled, config in (
        (outline, still, still, sensors()),
        (bare, truth, wheels, sensors()),
        (outline, truth, wheels, off),
        (outline, truth, none, sensors()),
    ):
        assert trajectory_bound(walls, true, rolled, T_BASE_LASER, config, TRACK_M) is None
