"""Weights for fits among errors of which some are wild."""

from __future__ import annotations

import numpy as np

from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import FloatArray

_TUKEY = 4.0
"""Standard deviations from which on an error has no weight: of normal errors some 91 % as efficient
as least squares (4.7 give 95 %)."""


def scatter(apart: FloatArray, least: float) -> float:
    """The standard deviation of errors (n,) by the median of their size, which wild ones hardly
    move; no less than ``least``."""
    return max(SIGMAS_PER_MEDIAN * float(np.median(np.abs(apart))), least)


def scatter_of_some(apart: FloatArray, counts: FloatArray, least: float) -> float:
    """``scatter`` of errors (n,) of which each counts as much as ``counts`` (n,) says."""
    return max(SIGMAS_PER_MEDIAN * weighed_median(np.abs(apart), counts), least)


def scatter_where_it_tells(
    apart: FloatArray, tells: FloatArray, least: float, most: float = np.inf
) -> float:
    """``scatter`` of errors (n,) of a robot that mostly goes straight: by how much each ``tells``
    (n,), from that of all to ``most`` times it. By straight driving, in which all images look the
    same, its few turns would be wild, and it is these that tell."""
    alike = scatter(apart, least)
    return float(np.clip(scatter_of_some(apart, tells, least), alike, most * alike))


def weighed_median(values: FloatArray, counts: FloatArray) -> float:
    """Of values (n,), of which each counts as much as ``counts`` (n,) says."""
    order = np.argsort(values)
    sums = np.cumsum(counts[order])
    return float(values[order][np.searchsorted(sums, 0.5 * sums[-1])])


def tukey_weights(apart: FloatArray, least: float) -> FloatArray:
    """(n,) weights of errors (n,) by Tukey's biweight: 1 to 0. least: of their scatter."""
    return biweights(apart, scatter(apart, least))


def biweights(apart: FloatArray, sigma: float) -> FloatArray:
    """(n,) weights of errors (n,) of this scatter by Tukey's biweight: 1 to 0."""
    units = apart / (_TUKEY * sigma)
    return np.asarray(np.square(np.maximum(1.0 - np.square(units), 0.0)))
