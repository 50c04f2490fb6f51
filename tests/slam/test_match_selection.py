"""Which match to believe: what odometry says against what a scan says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_t

from slamsim.core.geometry import compose
from slamsim.core.types import Cloud, FloatArray
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.frontend.match_selection import (
    LIKELY_SIGMAS,
    TAIL_FREEDOM,
    MatchSelector,
    _surprise,
)
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.frontend.preintegration import OdometryStep
from slamsim.slam.matching import Match

SIGMAS = np.array([0.005, 0.005, 0.002])
HERE = np.array([1.0, 2.0, 0.3])


@dataclass
class OneMatch:
    """A matcher that finds a scan in one place, where more of it lies on the map than elsewhere."""

    T_map_base: FloatArray
    gain: float
    inlier_ratio: float = 0.95

    def pieces(self, cloud: Cloud) -> FloatArray:
        return np.zeros((0, 10))

    pieces_of_part = pieces

    def match(self, cloud: Cloud, guess: FloatArray, covariance: FloatArray) -> Match | None:
        at = self.T_map_base
        return Match(at, 1e4 * np.eye(3), self.inlier_ratio, 1.0, np.zeros((0, 3)))

    search = match_part = match

    def support(self, cloud: Cloud, T_map_base: FloatArray) -> float:
        return 10.0 + self.gain * np.array_equal(T_map_base, self.T_map_base)

    def insert(self, cloud: Cloud, T_map_base: FloatArray) -> None: ...

    def forget(self) -> None: ...


def cloud(stamp_ns: int) -> Cloud:
    return Cloud(stamp_ns, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, dtype=np.bool_))


def predicted(stamp_ns: int, jump: bool = False) -> Prediction:
    step, none = np.zeros(3), OdometryStep.none(np.zeros(PARAMETERS))
    covariance = np.diag(np.square(SIGMAS))
    return Prediction(stamp_ns, HERE, covariance, HERE, step, HERE, jump, none, covariance)


def placed(placer: MatchSelector, gain: float, sigmas: float, jump: bool = False) -> bool:
    there = compose(HERE, np.array([sigmas * SIGMAS[0], 0.0, 0.0]))
    at = predicted(10**8, jump)
    return placer.place(OneMatch(there, gain), cloud(10**8), at, HERE) is not None


@given(st.floats(0.0, 1e4))
def test_surprise_is_that_of_scipys_student_t(sigmas: float) -> None:
    student = multivariate_t(shape=np.eye(3), df=int(TAIL_FREEDOM))
    exact = student.logpdf(np.zeros(3)) - student.logpdf(np.array([sigmas, 0.0, 0.0]))
    assert np.isclose(_surprise(sigmas), exact, rtol=1e-9, atol=1e-9)


@given(st.floats(-20.0, 0.0))
def test_a_match_where_odometry_has_it_needs_no_better_fit(gain: float) -> None:
    assert placed(MatchSelector(0.55), gain, 0.99 * LIKELY_SIGMAS)


@pytest.mark.parametrize("sigmas", [10.0, 30.0, 60.0])
def test_a_match_far_from_odometry_must_explain_so_many_more_pieces(sigmas: float) -> None:
    needed = _surprise(sigmas) - _surprise(LIKELY_SIGMAS)
    assert not placed(MatchSelector(0.55), 0.85 * needed, sigmas)
    assert placed(MatchSelector(0.55), needed, sigmas)


def test_odometry_that_jumps_is_outweighed_by_anything_that_fits() -> None:
    assert placed(MatchSelector(0.55), 0.0, 30.0, jump=True)


def test_odometry_that_errs_often_by_more_than_its_noise_is_believed_less() -> None:
    placer = MatchSelector(0.55)
    assert not placed(placer, 5.0, 10.0)
    for number in range(60):
        there = compose(HERE, np.array([10.0 * SIGMAS[0] * (number % 2), 0.0, 0.0]))
        placer.place(OneMatch(there, 30.0), cloud(number), predicted(number), HERE)
    assert placed(placer, 5.0, 10.0)


def test_a_lost_robot_that_finds_what_looks_alike_now_and_then_stays_lost() -> None:
    placer = MatchSelector(0.55)
    for number in range(12):
        matcher = OneMatch(HERE, 0.0, 0.5 if number % 3 == 2 else 0.3)
        placer.place(matcher, cloud(number), predicted(number), HERE)
    assert len(placer.lost) == 8
