"""Which tags of a survey stand elsewhere, by the others."""

from __future__ import annotations

import numpy as np
import pytest

from slamsim.core.geometry import compose
from slamsim.core.landmarks import CameraErrors, KnownTag, Landmark
from slamsim.slam.landmarks.agreement import contradicted, disagreement

MAPPED = np.diag(np.square([0.02, 0.02, 0.01]))
SURVEYED = np.diag(np.square([0.002, 0.002, 0.01]))


def _both(
    seed: int, count: int, wrong: dict[int, float]
) -> tuple[dict[int, Landmark], list[KnownTag]]:
    rng = np.random.default_rng(seed)
    true = rng.uniform([0.0, 0.0, -3.0], [15.0, 10.0, 3.0], (count, 3))
    survey = compose(np.array([5.0, -3.0, 1.2]), true)
    for number, off_m in wrong.items():
        survey[number, 0] += off_m
    noisy = compose(true, rng.normal(size=true.shape) * np.sqrt(np.diag(MAPPED)))
    found = {k: Landmark(k, pose, MAPPED, 5, 0) for k, pose in enumerate(noisy)}
    return found, [KnownTag(k, pose, SURVEYED) for k, pose in enumerate(survey)]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [4, 9, 40])
def test_those_that_were_moved_are_named_and_no_others(seed: int, count: int) -> None:
    wrong = {1: 1.4} if count < 9 else {1: 1.4, 3: -0.5, 6: 0.4}
    told = contradicted(*_both(seed, count, wrong))

    assert set(told) == set(wrong)
    for number, off_m in told.items():
        assert abs(off_m - abs(wrong[number])) < 0.15


@pytest.mark.parametrize(("count", "wrong"), [(3, {0: 1.0}), (4, {0: 1.0, 1: -2.0}), (2, {0: 1.0})])
def test_none_is_named_where_nothing_tells_which(count: int, wrong: dict[int, float]) -> None:
    assert contradicted(*_both(2, count, wrong)) == {}


def test_seldom_is_a_right_survey_doubted() -> None:
    told = [contradicted(*_both(100 + seed, 10, {})) for seed in range(100)]
    assert sum(map(len, told)) <= 5  # of a thousand tags


def test_lengths_disagree_by_wheels_and_camera_together() -> None:
    cameras = {"front": CameraErrors(scale=0.0025)}
    shared = np.zeros((2, 6))
    shared[:, -1] = -0.01, 0.07
    assert np.allclose(disagreement(shared, cameras, 0.03), (0.08, 0.08 / np.hypot(0.0025, 0.03)))
    assert np.allclose(disagreement(shared[1:], {}, 0.035), (0.07, 2.0))
    assert disagreement(np.zeros((1, 6)), {}, 0.0) == (0.0, 0.0)
