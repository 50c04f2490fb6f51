"""Readings that stand alone in a scan and are gone in the next: another lidar, sunlight, dust."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.scan_sample import ScanSample
from slamsim.core.types import BoolArray, Float32Array

MAX_STRAY_SHARE = 5e-3
MIN_BEAMS = 200
_JUMP_M, _AGREE_M = 0.3, 0.1
_WIDEST_STEP_RAD = float(np.radians(1.1))
_TURNED_RAD = float(np.radians(10.0))
"""A robot hardly turns further between two scans: a pole is found again within this."""


def check_stray(topic: str, sample: ScanSample) -> Finding:
    """Beams that differ from two neighbours which agree; a pole does that as well, but stays."""
    fine = 0.0 < abs(sample.layout.angle_step_rad) <= _WIDEST_STEP_RAD
    if not fine or sample.ranges_m.shape[1] < 3:
        words = "beams so far apart that a pole and a stray reading look alike"
        return Finding("ranges.stray", topic, "cannot tell", words)
    known, stray = stray_beams(sample)
    if int(known.sum()) < MIN_BEAMS:
        words = "too few beams have two neighbours that agree"
        return Finding("ranges.stray", topic, "cannot tell", words)
    share = float(stray.sum() / known.sum())
    estimate = Estimate(100.0 * share, 0.0, "%")
    words = f"{100.0 * share:.2g} % of the beams stand alone in one scan and are gone in the next"
    if share <= MAX_STRAY_SHARE:
        return Finding("ranges.stray", topic, "ok", words, estimate=estimate)
    return Finding(
        "ranges.stray",
        topic,
        "bad",
        words,
        "scan_interference",
        "Look for another lidar, sunlight or a dirty window; filter single beams.",
        estimate,
        100.0 * MAX_STRAY_SHARE,
        (Mend("drop_stray_beams", topic),),
    )


def stray_beams(sample: ScanSample) -> tuple[BoolArray, BoolArray]:
    """(k, beams) of which beams it could be told, and which of them are stray."""
    known, alone = _alone(sample.ranges_m)
    known &= np.isfinite(sample.following_m).any(axis=1, keepdims=True)
    return known, alone & known & ~_found_again(sample)


def _alone(ranges_m: Float32Array) -> tuple[BoolArray, BoolArray]:
    """(k, beams) whether the neighbours of a beam agree, and whether it differs from them."""
    left, right = np.roll(ranges_m, 1, axis=1), np.roll(ranges_m, -1, axis=1)
    with np.errstate(invalid="ignore"):
        known = (np.abs(left - right) < _AGREE_M) & np.isfinite(ranges_m) & (ranges_m > 0.0)
        alone = np.abs(ranges_m - 0.5 * (left + right)) > _JUMP_M
    known[:, [0, -1]] = False
    return known, alone & known


def _found_again(sample: ScanSample) -> BoolArray:
    """(k, beams) whether the scan after it has such a reading in nearly the same direction."""
    now, after = sample.ranges_m, sample.following_m
    reach = max(int(np.ceil(_TURNED_RAD / abs(sample.layout.angle_step_rad))), 1)
    found = np.zeros(now.shape, dtype=np.bool_)
    rows, beams = np.nonzero(_alone(now)[1])
    for shift in range(-reach, reach + 1):
        beside = np.clip(beams + shift, 0, now.shape[1] - 1)
        with np.errstate(invalid="ignore"):
            found[rows, beams] |= np.abs(after[rows, beside] - now[rows, beams]) < _JUMP_M
    return found
