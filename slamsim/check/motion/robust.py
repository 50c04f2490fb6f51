"""Weights for fits among errors of which some are wild."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray

_TUKEY = 4.0
"""Standard deviations from which on an error has no weight: of normal errors some 91 % as efficient
as least squares (4.7 give 95 %)."""


def scatter(apart: FloatArray, least: float) -> float:
    """The standard deviation of errors (n,) by the median of their size, which wild ones hardly
    move; no less than ``least``."""
    return max(1.4826 * float(np.median(np.abs(apart))), least)


def tukey_weights(apart: FloatArray, least: float) -> FloatArray:
    """(n,) weights of errors (n,) by Tukey's biweight: 1 to 0. least: of their scatter."""
    units = apart / (_TUKEY * scatter(apart, least))
    return np.asarray(np.square(np.maximum(1.0 - np.square(units), 0.0)))
