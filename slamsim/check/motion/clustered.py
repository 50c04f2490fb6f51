"""Least squares whose residuals belong together in blocks."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray, IntArray


def clustered_fit(
    design: FloatArray, seen: FloatArray, block: IntArray
) -> tuple[FloatArray, FloatArray]:
    """(p,) by least squares and (p, p) its covariance, with blocks as units of what disturbs.

    design: (n, p). seen: (n,). block: (n,) from 0 on, two or more. White 1980, in the clustered
    form of Liang & Zeger 1986.
    """
    inverse = np.asarray(np.linalg.pinv(design.T @ design), dtype=np.float64)
    found = inverse @ (design.T @ seen)
    scores = design * (seen - design @ found)[:, None]
    return found, clustered_covariance(inverse, scores, block)


def clustered_covariance(inverse: FloatArray, scores: FloatArray, block: IntArray) -> FloatArray:
    """(p, p) sandwich of the inverse information (p, p) and the rows' scores (n, p), by blocks."""
    summed = np.stack([np.bincount(block, column) for column in scores.T], axis=1)
    few = len(summed) / (len(summed) - 1.0)
    return few * inverse @ (summed.T @ summed) @ inverse
