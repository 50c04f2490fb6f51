"""By how much the stamps of two streams differ, to a few hundredths of a second, from the signal
that both see: correlation over every lag at which they overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from slamsim.core.arrays import Samples
from slamsim.core.types import FloatArray

GRID_S = 0.02
MOST_CELLS = 1 << 20
LEAST_SHARE = 0.5
"""Of what each stream tells where the other one is, at the most, so much must overlap."""

CLEAR = 0.75
"""Correlation from which on a lag is believed."""

RIVAL_S = 1.0
"""Peaks farther from the best than this are other answers."""

RIVAL_MISFIT, LEAST_MISFIT = 2.0, 0.02
"""Another answer must miss perfect likeness by so many times more, and by this."""

TAPER = 0.1
"""By so much a lag as long as the log counts less: of two like answers it is the smaller lag's."""


@dataclass(frozen=True, slots=True, eq=False)
class Rate(Samples):
    """A signal that two streams see: mean values (n,) between starts_s and ends_s (n,), in order
    and not overlapping."""

    starts_s: FloatArray
    ends_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Lag:
    """lag_s: what must be added to times of the one stream for those of the other. correlation:
    -1 to 1 there. clear: whether it is high, and no other lag is nearly as good."""

    lag_s: float
    correlation: float
    clear: bool


def coarse_lag(one: Rate, other: Rate) -> Lag | None:
    """The lag with the largest correlation without regard to its sign; None if nothing varies."""
    spans = [float(rate.ends_s[-1] - rate.starts_s[0]) for rate in (one, other) if rate.values.size]
    if len(spans) < 2:
        return None
    step = max(GRID_S, sum(spans) / MOST_CELLS)
    (a, known_a), (b, known_b) = (sampled(rate, step) for rate in (one, other))
    correlation = correlations(a, known_a, b, known_b)
    if not np.any(correlation):
        return None
    # Cell i of the full correlation: b is read i - (len(a) - 1) cells later than a.
    lags = np.arange(correlation.size) - (len(a) - 1)
    begin_s = float(other.starts_s[0] - one.starts_s[0])
    lags_s = lags * step + begin_s
    score = np.abs(correlation) * (1.0 - TAPER * np.minimum(np.abs(lags_s) / max(spans), 1.0))
    best = int(np.argmax(score))
    likeness = abs(float(correlation[best]))
    rival = float(score[np.abs(lags_s - lags_s[best]) > RIVAL_S].max(initial=0.0))
    clear = likeness >= CLEAR and 1.0 - rival > RIVAL_MISFIT * (1.0 - likeness) + LEAST_MISFIT
    fine = lags_s[best] + step * _vertex(np.abs(correlation), best)
    return Lag(float(fine), float(correlation[best]), bool(clear))


def sampled(rate: Rate, step_s: float) -> tuple[FloatArray, FloatArray]:
    """(m,) values on a grid from the first start; (m,) 1 where they are known, else 0."""
    begin, end = float(rate.starts_s[0]), float(rate.ends_s[-1])
    times = begin + step_s * (np.arange(max(int((end - begin) / step_s), 1)) + 0.5)
    piece = np.clip(np.searchsorted(rate.starts_s, times, side="right") - 1, 0, None)
    known = times < rate.ends_s[piece]
    values = np.where(known, rate.values[piece], 0.0)
    return values, known.astype(np.float64)


def convolved(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n + m - 1,) of (n,) and (m,), bit for bit as ``scipy.signal.fftconvolve``, which takes 0.8 s
    of processor time to import."""
    if min(a.size, b.size) == 1:
        return a * b
    size = a.size + b.size - 1
    padded = fft.next_fast_len(size, real=True)
    return np.asarray(fft.irfft(fft.rfft(a, padded) * fft.rfft(b, padded), padded)[:size])


def correlations(
    a: FloatArray, known_a: FloatArray, b: FloatArray, known_b: FloatArray
) -> FloatArray:
    """(len(a) + len(b) - 1,) normalised, over what both know; 0 where they overlap too little."""
    both = np.maximum(convolved(known_b, known_a[::-1]), 1.0)
    sum_a, sum_b = convolved(known_b, a[::-1]), convolved(b, known_a[::-1])
    product = convolved(b, a[::-1]) - sum_a * sum_b / both
    square_a = convolved(known_b, np.square(a)[::-1]) - np.square(sum_a) / both
    square_b = convolved(np.square(b), known_a[::-1]) - np.square(sum_b) / both
    enough = (square_a > LEAST_SHARE * square_a.max()) & (square_b > LEAST_SHARE * square_b.max())
    scale = np.sqrt(np.maximum(square_a, 0.0) * np.maximum(square_b, 0.0))
    least = 1e-9 * np.sqrt(np.square(a).sum() * np.square(b).sum())
    enough &= (scale > least) & (scale > 0.0)
    found = np.divide(product, scale, out=np.zeros_like(product), where=enough)
    return np.asarray(np.clip(found, -1.0, 1.0))


def _vertex(values: FloatArray, at: int) -> float:
    """Where between its neighbours, -0.5 to 0.5 cells, the parabola through a peak is highest."""
    if at in (0, len(values) - 1):
        return 0.0
    left, middle, right = values[at - 1 : at + 2]
    bend = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0
