"""All scans' poses at once, against a dense solver that knows nothing of chains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.slam.backend.smoothing import FREEDOM, Chain, Smoothed, odometry_steps, smooth

MATCH_SIGMA = np.array([1e-3, 2e-3, 3e-4])
STEP_SIGMA = np.array([1e-4, 5e-5, 1e-4])


def drive(count: int, rng: np.random.Generator) -> FloatArray:
    """(count, 3) true poses along a winding path."""
    poses = [np.array([1.0, 2.0, 3.0])]
    for turn in 0.2 * rng.standard_normal(count - 1):
        poses.append(compose(poses[-1], np.array([0.05, 0.0, turn])))
    return np.array(poses)


def measured(truth: FloatArray, rng: np.random.Generator) -> Chain:
    """Matches and odometry as noisy as the two sigmas say."""
    count = len(truth)
    noise = STEP_SIGMA * rng.standard_normal((count - 1, 3))
    steps = compose(between(truth[:-1], truth[1:]), noise)
    track = compose(truth, MATCH_SIGMA * rng.standard_normal((count, 3)))
    stamps_ns = np.arange(count) * 100_000_000
    information = np.tile(np.diag(MATCH_SIGMA**-2.0), (count, 1, 1))
    covariance = np.tile(np.diag(STEP_SIGMA**2), (count - 1, 1, 1))
    pull = np.zeros((count, 3))
    return Chain(PlanarTrajectory(stamps_ns, track), information, pull, steps, covariance)


def error(result: Smoothed, truth: FloatArray) -> FloatArray:
    """(3,) root mean square of the steps from the truth."""
    off = between(truth, result.track.poses)
    return np.asarray(np.sqrt(np.mean(off * off, axis=0)))


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 12))
def test_the_track_is_the_most_likely_one_and_its_covariance_that_of_a_dense_solver(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    chain = measured(drive(count, rng), rng)
    mix = rng.standard_normal((count, 3, 3)) * 0.3 + np.eye(3)
    chain = replace(
        chain,
        information=np.swapaxes(mix, 1, 2) @ chain.information @ mix,
        pull=200.0 * rng.standard_normal((count, 3)),
    )
    result = smooth(chain)

    offsets = np.linalg.solve(chain.information, chain.pull[:, :, None])[:, :, 0]
    roots = np.linalg.cholesky(chain.information / result.match_scale)
    scales = np.sqrt(result.motion_scale)
    noise = np.diagonal(chain.noise, axis1=1, axis2=2) + 1e-10
    sigmas = np.sqrt(noise) * scales

    def whitened(moves: FloatArray) -> tuple[FloatArray, FloatArray]:
        poses = compose(result.track.poses, moves.reshape(-1, 3))
        match = between(chain.track.poses, poses) - offsets
        motion = between(chain.steps, between(poses[:-1], poses[1:]))
        return np.einsum("nji,nj->ni", roots, match), motion / sigmas

    def weights(part: FloatArray) -> FloatArray:
        share = (FREEDOM + 3.0) / (FREEDOM + np.sum(part**2, axis=1))
        return np.asarray(np.sqrt(share))[:, None]

    at_result = whitened(np.zeros(3 * count))
    fixed = [weights(part) for part in at_result]

    def residuals(moves: FloatArray) -> FloatArray:
        return np.concatenate(
            [(w * part).ravel() for w, part in zip(fixed, whitened(moves), strict=True)]
        )

    dense = least_squares(residuals, np.zeros(3 * count), x_scale=1e-3, xtol=1e-14, ftol=1e-14)
    assert np.abs(dense.x).max() < 1e-4
    jacobian = np.asarray(dense.jac)
    whole = np.linalg.inv(jacobian.T @ jacobian)
    blocks = np.array([whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count)])
    assert np.allclose(result.covariances, blocks, rtol=0.1, atol=0.1 * blocks.max())


def test_what_each_side_is_worth_is_learnt_and_covariances_are_true() -> None:
    rng = np.random.default_rng(3)
    truth = drive(1500, rng)
    chain = measured(truth, rng)
    claimed = replace(chain, information=chain.information * 4.0, noise=chain.noise * 1000.0)
    result = smooth(claimed)
    off = between(truth, result.track.poses)
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(result.covariances), off)
    assert 1.5 < squared.mean() < 5.0
    assert 0.5 < result.match_scale / 4.0 < 1.5
    assert (error(result, truth) < 0.5 * MATCH_SIGMA).all()


def test_bad_odometry_does_no_harm() -> None:
    rng = np.random.default_rng(4)
    truth = drive(500, rng)
    chain = measured(truth, rng)
    bad = replace(chain, steps=chain.steps + 0.1 * rng.standard_normal((499, 3)))
    assert (error(smooth(bad), truth) < 1.1 * MATCH_SIGMA).all()


def test_single_bad_matches_and_slips_count_little() -> None:
    rng = np.random.default_rng(5)
    truth = drive(500, rng)
    chain = measured(truth, rng)
    track = chain.track.poses.copy()
    track[50:450:40] += [0.1, -0.05, 0.02]
    steps = chain.steps.copy()
    steps[70:450:40] += [0.05, 0.0, 0.1]
    damaged = replace(chain, track=PlanarTrajectory(chain.track.stamps_ns, track), steps=steps)
    assert (error(smooth(damaged), truth) < 0.8 * MATCH_SIGMA).all()


def test_odometry_bridges_what_was_not_matched() -> None:
    rng = np.random.default_rng(6)
    truth = drive(400, rng)
    chain = measured(truth, rng)
    information, track = chain.information.copy(), chain.track.poses.copy()
    information[100:150] = 0.0
    information[200:300, 0, 0] = 0.0
    track[100:150] += [0.5, 0.5, 0.5]
    track[200:300] = compose(track[200:300], np.array([0.3, 0.0, 0.0]))
    chain = replace(
        chain, track=PlanarTrajectory(chain.track.stamps_ns, track), information=information
    )
    result = smooth(chain)
    off = np.abs(between(truth, result.track.poses))
    assert off[:, :2].max() < 0.01 and off[:, 2].max() < 0.003
    assert result.covariances[250, 0, 0] > 2.0 * result.covariances[350, 0, 0]


def test_covariances_of_a_drive_that_one_scan_holds_are_some() -> None:
    """Nothing contradicts the odometry, which was learnt to be exact to 10 nm where the robot
    stands: what was left of the information of all others was rounding."""
    poses = np.repeat(drive(60, np.random.default_rng(8)), 10, axis=0)
    path = PlanarTrajectory(np.arange(600) * 100_000_000, poses)
    steps, noise = odometry_steps(path)
    information = np.zeros((600, 3, 3))
    information[41] = np.diag([7e3, 6e3, 0.0])
    result = smooth(Chain(path, information, np.zeros((600, 3)), steps, noise))
    np.testing.assert_allclose(result.track.poses, path.poses, atol=1e-6)
    assert (np.linalg.eigvalsh(result.covariances)[:, 0] > 0.0).all()


def test_one_scan_alone_stays_where_it_is() -> None:
    chain = measured(np.array([[1.0, 2.0, 3.0]]), np.random.default_rng(7))
    assert np.allclose(smooth(chain).track.poses, chain.track.poses)
