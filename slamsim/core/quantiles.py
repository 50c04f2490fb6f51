"""Quantiles that intervals rest on, bit for bit those of ``scipy.stats``, which takes 0.7 s of
processor time to import, in every process that maps or checks."""

from __future__ import annotations

import numpy as np
from scipy import special

from slamsim.core.types import FloatArray

SIGMAS_PER_MEDIAN = 1.4826
"""Standard deviation of a normal error over the median of its size."""


def chi_square(share: float | FloatArray, freedom: float | FloatArray) -> FloatArray:
    """Below which a sum of ``freedom`` squared normal errors lies with this probability.

    share, freedom: numbers or (n,); so is the quantile. nan where there is none.
    """
    return np.asarray(2.0 * special.gammaincinv(np.asarray(freedom) / 2.0, np.asarray(share)))


def student_t(share: float | FloatArray, freedom: float | FloatArray) -> FloatArray:
    """Below which an error lies with this probability, in sigmas that so many others tell.

    share, freedom: numbers or (n,); so is the quantile. nan where there is none.
    """
    return np.asarray(special.stdtrit(np.asarray(freedom), np.asarray(share)))
