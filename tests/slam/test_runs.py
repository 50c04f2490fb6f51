"""Where one surface ends and the next begins, against fitting every pair of lines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.core.types import FloatArray
from slamsim.slam.matching.runs import BEND_SIGMAS, BREAK_CHI2, LEAST_INCIDENCE, parted

NOISE_M = 0.01


def seen(walls: list[tuple[FloatArray, float]], bearings: FloatArray) -> FloatArray:
    """(n, 2) where beams from the origin meet the first of some lines: (unit normal, distance)."""
    rays: FloatArray = np.column_stack([np.cos(bearings), np.sin(bearings)])
    ranges = np.array([distance / (rays @ normal) for normal, distance in walls])
    nearest = np.where(ranges > 0.0, ranges, np.inf).min(axis=0)
    return np.asarray(rays * nearest[:, None])


def noisy(points: FloatArray, rng: np.random.Generator) -> FloatArray:
    ranges = np.linalg.norm(points, axis=1)
    return np.asarray(points * (1.0 + NOISE_M * rng.standard_normal(len(points)) / ranges)[:, None])


def least(points: FloatArray) -> float:
    """Sum of squares about the best line."""
    off = points - points.mean(axis=0)
    return float(np.linalg.eigvalsh(off.T @ off)[0]) if len(points) > 2 else 0.0


def best_break(points: FloatArray) -> tuple[int, float]:
    """As the contract says: two lines fitted at every place, in sigmas of that place's beam."""
    chord = points[-1] - points[0]
    whole, best, gain = least(points), 0, 0.0
    for i in range(len(points) - 1):
        apart = least(points[: i + 1]) + least(points[i + 1 :])
        sine = abs(points[i, 0] * chord[1] - points[i, 1] * chord[0])
        sine /= np.linalg.norm(points[i]) * np.linalg.norm(chord)
        better = (whole - apart) / (NOISE_M * max(sine, LEAST_INCIDENCE)) ** 2
        if better > gain:
            best, gain = i, better
    return best, gain


@given(seed=st.integers(0, 10**6), count=st.integers(4, 40), slant=st.floats(-1.2, 1.2))
def test_the_break_is_the_best_of_all(seed: int, count: int, slant: float) -> None:
    rng = np.random.default_rng(seed)
    bearings = np.linspace(-0.1, 0.1, count)
    normal = np.array([np.cos(slant), np.sin(slant)])
    points = noisy(seen([(normal, rng.uniform(0.5, 8.0))], bearings), rng)
    points[rng.integers(count) :] += 1.5 * NOISE_M * normal
    middle = parted(points, np.zeros_like(points), 0, count - 1, NOISE_M)
    best, gain = best_break(points)
    chord = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    bend_m = np.abs((points - points[0]) @ [-chord[1], chord[0]])
    if bend_m.max() > BEND_SIGMAS * NOISE_M:
        assert middle == bend_m.argmax()
    elif middle >= 0:
        assert middle == best and gain > BREAK_CHI2
    else:
        assert gain <= BREAK_CHI2


@pytest.mark.parametrize("past", [4, 7, 12, 20])
def test_a_few_beams_past_the_end_of_a_wall_are_cut_off(past: int) -> None:
    rng = np.random.default_rng(past)
    points = np.column_stack([np.full(40, 2.0), np.linspace(-0.2, 0.2, 40)])
    points[40 - past :, 0] += 0.03
    points[:, 0] += 0.1 * NOISE_M * rng.standard_normal(40)
    assert parted(points, np.zeros((40, 2)), 0, 39, NOISE_M) == 39 - past


def test_one_wall_is_hardly_ever_broken_by_noise() -> None:
    rng = np.random.default_rng(2)
    bearings = np.linspace(-0.15, 0.15, 60)
    walls = [seen([(np.array([np.cos(a), np.sin(a)]), 3.0)], bearings) for a in (0.0, 0.6, 1.1)]
    broken = [
        parted(noisy(wall, rng), np.zeros((60, 2)), 0, 59, NOISE_M) >= 0
        for wall in walls
        for _ in range(300)
    ]
    assert np.mean(broken) < 0.05
