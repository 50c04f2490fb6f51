"""Random fields and lines on surfaces against slow second opinions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.world.looks.patterns import (
    Pattern,
    line_share,
    pattern_at,
    random_at,
    rough_noise,
    smooth_noise,
    span_share,
    visible,
)


@given(
    x=st.floats(-50, 50),
    period=st.floats(0.05, 2.0),
    share=st.floats(0.01, 0.9),
    pixel=st.floats(0.001, 3.0),
)
def test_lines_are_averaged_over_the_pixel(
    x: float, period: float, share: float, pixel: float
) -> None:
    at = x + pixel * (np.arange(20_000) + 0.5) / 20_000 - 0.5 * pixel
    inside = np.mod(at, period) < share * period

    found = line_share(x, period, share * period, pixel)

    assert found == pytest.approx(inside.mean(), abs=2e-3)


def test_random_cells_are_even_and_unlike_their_neighbours() -> None:
    grid = np.array([[random_at(c, r, 5) for c in range(-60, 60)] for r in range(-60, 60)])
    shifted = [np.corrcoef(grid[1:].ravel(), grid[:-1].ravel())[0, 1]]
    shifted += [np.corrcoef(grid[:, 1:].ravel(), grid[:, :-1].ravel())[0, 1]]

    assert grid.min() >= 0.0 and grid.max() < 1.0
    assert grid.mean() == pytest.approx(0.5, abs=0.01)
    assert grid.var() == pytest.approx(1.0 / 12.0, abs=0.003)
    assert np.abs(shifted).max() < 0.04
    assert random_at(3, 4, 5) != random_at(4, 3, 5) != random_at(3, 4, 6)


def test_noise_is_smooth_across_cells() -> None:
    u = np.linspace(-3.0, 3.0, 6001)
    values = np.array([smooth_noise(x, 0.3, 1) for x in u])

    assert np.abs(np.diff(values)).max() < 4.0 * 1e-3  # the fade rises by 1.5 a cell, of up to 2
    assert values.std() > 0.2


@pytest.mark.parametrize("kind", list(Pattern))
def test_patterns_fade_where_pixels_are_large(kind: Pattern) -> None:
    """No pixel of 3 m shows more than the mean; small ones do show the pattern."""
    at = np.random.default_rng(0).uniform(0, 40, (200, 2))

    def tones(pixel: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        return np.array([pattern_at(kind, u, v, 64, 0.2, 0.01, 0.5, pixel) for u, v in at])

    assert tones(1e-4).std(axis=0).max() > 0.05
    # What is left of lines is the part of a period by which a pixel is no multiple of it.
    assert tones(300.0).std(axis=0).max() < 2e-3


@pytest.mark.parametrize("kind", list(Pattern))
def test_a_pixel_is_the_mean_of_its_parts(kind: Pattern) -> None:
    """A pixel against 64 smaller ones within it, on average over places: no brighter, no darker."""
    rng, pixel = np.random.default_rng(1), 0.02
    inner = (np.arange(8) + 0.5) / 8 - 0.5
    wrong = []
    for u, v in rng.uniform(0, 10, (100, 2)):
        whole = pattern_at(kind, u, v, 64, 0.2, 0.01, 0.5, pixel)
        parts = np.array(
            [
                pattern_at(kind, u + pixel * s, v + pixel * t, 64, 0.2, 0.01, 0.5, pixel / 8)
                for s in inner
                for t in inner
            ]
        )
        wrong.append(whole - parts.mean(axis=0))

    assert np.abs(np.mean(wrong, axis=0)).max() < 0.05


@given(x=st.floats(-2, 2), length=st.floats(0.01, 1.0), pixel=st.floats(0.001, 3.0))
def test_a_span_is_averaged_over_the_pixel(x: float, length: float, pixel: float) -> None:
    at = x + pixel * (np.arange(20_000) + 0.5) / 20_000 - 0.5 * pixel

    found = span_share(x, length, pixel)

    assert found == pytest.approx(((at >= 0.0) & (at < length)).mean(), abs=2e-3)


def test_octaves_end_at_the_pixel() -> None:
    assert visible(0.1, 0.1) == 0.0 and visible(0.1, 0.05) == 1.0
    assert rough_noise(0.3, 0.4, 1, 0.1, 6, 0.1) == 0.0
    assert rough_noise(0.3, 0.4, 1, 0.1, 1, 0.05) == smooth_noise(3.0, 4.0, 1)


@pytest.mark.parametrize("kind", [Pattern.CONCRETE, Pattern.SPECKLES])
def test_chips_and_pores_cover_as_much_where_none_is_seen(kind: Pattern) -> None:
    at = np.random.default_rng(2).uniform(0, 100, (20_000, 2))

    near = np.array([pattern_at(kind, u, v, 64, 0.02, 0.0, 0.5, 1e-4)[0] for u, v in at])
    far = pattern_at(kind, 1.0, 2.0, 64, 0.02, 0.0, 0.5, 0.05)[0]

    assert near.mean() == pytest.approx(far, abs=0.01)
