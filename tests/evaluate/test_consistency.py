"""NEES against its distribution, and what each part of SLAM is found to cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from slamsim.core.geometry import compose, wrap_angle
from slamsim.core.result import PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.evaluate.budget import at_instants, error_budget
from slamsim.evaluate.consistency import nees, nees_band, nees_in_map
from slamsim.guard.errors import InputRefused
from slamsim.guard.numbers import BadNumbers, NoSolution
from slamsim.io.text.keyframes import HEADER, IN_MAP, read_keyframes, write_keyframes


def path(count: int, rng: np.random.Generator) -> PlanarTrajectory:
    poses = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    poses[:, 2] = wrap_angle(poses[:, 2])
    return PlanarTrajectory(np.arange(count, dtype=np.int64) * 10**8, poses)


def covariances(count: int, rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(count, 3, 3)) * 1e-3
    made = root @ np.swapaxes(root, 1, 2) + 1e-7 * np.eye(3)
    made[0] = 0.0
    return made


def disturbed(
    truth: PlanarTrajectory, claimed: FloatArray, rng: np.random.Generator
) -> PlanarTrajectory:
    """Each pose a small step in its own frame away, of just the claimed covariance."""
    steps = np.array([rng.multivariate_normal(np.zeros(3), c) for c in claimed])
    return PlanarTrajectory(truth.stamps_ns, compose(truth.poses, steps))


def test_true_covariances_give_the_expected_nees_wherever_the_map_lies() -> None:
    rng = np.random.default_rng(3)
    truth, claimed = path(4000, rng), covariances(4000, rng)
    estimate = disturbed(truth, claimed, rng)
    elsewhere = compose(np.array([7.0, -3.0, 2.0]), estimate.poses)
    found = nees(PlanarTrajectory(truth.stamps_ns, elsewhere), claimed, truth)
    assert found is not None
    low, high = nees_band(4000)
    assert low < found.mean < high
    assert found.inside_share == pytest.approx(0.95, abs=0.015)
    assert np.mean(np.abs(found.errors) < 2.0 * found.sigmas) == pytest.approx(0.9545, abs=0.01)


def test_relative_to_the_map_the_first_pose_counts_as_any_other() -> None:
    rng = np.random.default_rng(5)
    truth, claimed = path(4000, rng), covariances(4000, rng)
    claimed[0] = claimed[1]
    estimate = disturbed(truth, claimed, rng)
    elsewhere = compose(np.array([7.0, -3.0, 2.0]), estimate.poses)
    found = nees_in_map(PlanarTrajectory(truth.stamps_ns, elsewhere), claimed, truth)
    assert found is not None
    low, high = nees_band(4000)
    assert low < found.mean < high
    turned = estimate.poses.copy()
    turned[0, 2] += 0.1  # which would be in all others, relative to it
    found = nees_in_map(PlanarTrajectory(truth.stamps_ns, turned), claimed, truth)
    assert found is not None
    assert low < found.nees[1:].mean() < high and found.nees[0] > 100.0
    two = PlanarTrajectory(truth.stamps_ns[:2], truth.poses[:2])
    assert nees_in_map(two, claimed[:2], truth) is None


@pytest.mark.parametrize(("covered", "told"), [(100, True), (96, True), (90, False), (30, False)])
def test_a_truth_of_a_part_of_the_path_does_not_tell_errors_within_the_whole_map(
    covered: int, told: bool
) -> None:
    """Half of a drifting path, aligned by itself, is off by less than in the whole."""
    rng = np.random.default_rng(8)
    truth, claimed = path(100, rng), covariances(100, rng)
    claimed[0] = claimed[1]
    known = PlanarTrajectory(truth.stamps_ns[:covered], truth.poses[:covered])
    found = nees_in_map(disturbed(truth, claimed, rng), claimed, known)
    assert (found is not None) == told


def test_an_estimate_too_sure_of_itself_is_told() -> None:
    rng = np.random.default_rng(4)
    truth, claimed = path(500, rng), covariances(500, rng)
    found = nees(disturbed(truth, claimed, rng), claimed / 4.0, truth)
    assert found is not None
    assert found.mean == pytest.approx(12.0, rel=0.2)
    assert found.inside_share < 0.6


def test_too_little_truth_says_nothing() -> None:
    rng = np.random.default_rng(5)
    truth, claimed = path(5, rng), covariances(5, rng)
    later = PlanarTrajectory(truth.stamps_ns[1:], truth.poses[1:])
    assert nees(truth, claimed, later) is None
    one = PlanarTrajectory(truth.stamps_ns[:1], truth.poses[:1])
    assert nees(one, claimed[:1], truth) is None


def test_a_covariance_that_is_none_is_refused() -> None:
    rng = np.random.default_rng(6)
    truth, claimed = path(5, rng), covariances(5, rng)
    claimed[3, 0, 0] = -1.0
    with pytest.raises(BadNumbers, match="negative in some direction"):
        nees(truth, claimed, truth)
    claimed[3] = 0.0
    with pytest.raises(NoSolution):
        nees(truth, claimed, truth)


@settings(max_examples=20)
@given(st.integers(1, 300))
def test_the_band_holds_the_mean_of_so_many_runs(runs: int) -> None:
    low, high = nees_band(runs)
    inside = chi2.cdf(high * runs, 3 * runs) - chi2.cdf(low * runs, 3 * runs)
    assert inside == pytest.approx(0.95)
    assert low < 3.0 < high


@pytest.mark.parametrize("alike", [0.0, 0.9, 0.999])
def test_the_band_holds_means_over_paths_whose_errors_are_alike(alike: float) -> None:
    rng = np.random.default_rng(9)
    campaigns, runs, keyframes = 400, 20, 40
    off = rng.normal(size=(campaigns, runs, 3))
    means = np.zeros((campaigns, runs))
    for _ in range(keyframes):
        off = alike * off + np.sqrt(1.0 - alike**2) * rng.normal(size=off.shape)
        means += (off**2).sum(axis=2) / keyframes
    low, high = nees_band(runs)
    over_runs = means.mean(axis=1)
    assert np.mean((low < over_runs) & (over_runs < high)) > 0.925


def test_each_part_is_measured_at_the_key_frames_it_knows() -> None:
    rng = np.random.default_rng(7)
    truth = path(200, rng)
    off = np.tile([0.001, 0.0, 0.0], (200, 1)) * (-1.0) ** np.arange(200)[:, None]
    jittery = PlanarTrajectory(truth.stamps_ns, compose(truth.poses, off))
    keys = truth.stamps_ns[::10]
    tail = PlanarTrajectory(truth.stamps_ns[100:], truth.poses[100:])
    short = PlanarTrajectory(truth.stamps_ns[:5], truth.poses[:5])
    found = error_budget(
        {"graph": truth, "odometry": jittery, "smoothed": tail, "closures": short, "x": truth},
        keys,
        truth,
    )
    assert list(found) == ["odometry", "graph", "smoothed"]
    assert found["graph"].ate_rmse_m < 1e-9
    assert found["smoothed"].step_rmse_m < 1e-9
    every = error_budget({"odometry": jittery}, truth.stamps_ns, truth)["odometry"]
    assert every.ate_rmse_m == pytest.approx(0.001, rel=0.05)
    assert every.step_rmse_m > 0.001
    assert len(at_instants(tail, keys)) == 10


def test_key_frames_are_read_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    truth, claimed = path(20, rng), covariances(20, rng)
    for in_map in (None, covariances(20, rng)):
        write_keyframes(tmp_path / "keyframes.csv", PoseGraph(truth, claimed, (), in_map))
        poses, read, read_in_map = read_keyframes(tmp_path / "keyframes.csv")
        np.testing.assert_array_equal(poses.stamps_ns, truth.stamps_ns)
        np.testing.assert_allclose(poses.poses, truth.poses, rtol=1e-10)
        np.testing.assert_allclose(read, claimed, rtol=1e-10, atol=1e-20)
        assert (in_map is None) == (read_in_map is None)
        if in_map is not None and read_in_map is not None:
            np.testing.assert_allclose(read_in_map, in_map, rtol=1e-10, atol=1e-20)


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ([HEADER], "no key frame"),
        ([HEADER, "1.0,2"], "line 2"),
        ([HEADER, "1.0" + ",1" * 9, "1.0" + ",1" * 9], "line 3"),
        ([HEADER, "1.0" + ",nan" * 9], "line 2"),
        ([HEADER, "yesterday" + ",1" * 9], "line 2"),
        ([HEADER, "1.0" + ",1" * 15], "line 2"),
        ([HEADER + IN_MAP, "1.0" + ",1" * 9], "line 2"),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, lines: list[str], reason: str) -> None:
    file = tmp_path / "keyframes.csv"
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputRefused, match=reason):
        read_keyframes(file)
