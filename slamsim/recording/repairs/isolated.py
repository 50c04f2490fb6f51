"""Isolated readings in single scans: interference of another lidar, sunlight, dust."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slamsim.core.types import BoolArray, Float32Array
from slamsim.recording import RawScans
from slamsim.recording.row_store import RowStore

_BLOCK = 2048
_NAN = np.float32(np.nan)
_JUMP_M, _AGREE_M = 0.3, 0.1
_TURNED_RAD = float(np.radians(10.0))
"""A robot hardly turns further between two scans: a pole is found again within this."""


def without_isolated_returns(scans: RawScans) -> RawScans:
    """NaN in the place of each isolated return; scans of several lengths as they are."""
    if not isinstance(scans.ranges_m, np.ndarray):
        return scans
    store = RowStore()
    for start in range(0, len(scans), _BLOCK):
        rows = scans.ranges_m[start : start + _BLOCK]
        after = scans.ranges_m[start + 1 : start + 1 + _BLOCK]
        if len(after) < len(rows):
            after = np.concatenate([after, rows[-1:]])
        isolated = isolated_returns(rows, after, scans.layout(start).angle_step_rad)[1]
        store.add(np.where(isolated, _NAN, rows))
    return replace(scans, ranges_m=store.rows())


def isolated_returns(
    ranges_m: Float32Array, following_m: Float32Array, angle_step_rad: float
) -> tuple[BoolArray, BoolArray]:
    """(k, beams) of which beams it could be told, and which of them are isolated.

    ranges_m, following_m: (k, beams) of some scans and of the scan after each.
    """
    known, alone = _alone(ranges_m)
    known &= np.isfinite(following_m).any(axis=1, keepdims=True)
    beams = ranges_m.shape[1]  # which no angle that is declared by mistake exceeds
    step_rad = abs(angle_step_rad) if np.isfinite(angle_step_rad) else np.inf
    reach = beams if step_rad * beams < _TURNED_RAD else max(math.ceil(_TURNED_RAD / step_rad), 1)
    return known, alone & known & ~_found_again(ranges_m, following_m, reach)


def _alone(ranges_m: Float32Array) -> tuple[BoolArray, BoolArray]:
    """(k, beams) whether the neighbours of a beam agree, and whether it differs from them."""
    left, right = np.roll(ranges_m, 1, axis=1), np.roll(ranges_m, -1, axis=1)
    with np.errstate(invalid="ignore"):
        known = (np.abs(left - right) < _AGREE_M) & np.isfinite(ranges_m) & (ranges_m > 0.0)
        alone = np.abs(ranges_m - 0.5 * (left + right)) > _JUMP_M
    known[:, [0, -1]] = False
    return known, alone & known


def _found_again(now: Float32Array, after: Float32Array, reach: int) -> BoolArray:
    """(k, beams) whether the scan after has such a reading within so many beams."""
    found = np.zeros(now.shape, dtype=np.bool_)
    rows, beams = np.nonzero(_alone(now)[1])
    for shift in range(-reach, reach + 1):
        beside = np.clip(beams + shift, 0, now.shape[1] - 1)
        with np.errstate(invalid="ignore"):
            found[rows, beams] |= np.abs(after[rows, beside] - now[rows, beams]) < _JUMP_M
    return found
