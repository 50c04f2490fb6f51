"""Beams that always say the same, or never anything: what the robot's own body does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.scan_sample import ScanSample
from slamsim.types import BoolArray, FloatArray

MIN_SCANS = 50
MIN_TYPICAL_SPREAD_M = 0.3
"""Below this the robot saw so little change that a constant beam means nothing."""
MAX_CONSTANT_SPREAD_M = 0.04
"""Between the 2 % and 98 % quantiles: four standard deviations of a common lidar's noise."""
SHARP_FACTOR = 10.0
"""Beside the robot's own body the spread jumps; along a corridor it grows gently."""
MIN_DEAD_BEAMS = 3
_OFTEN, _SELDOM = 0.9, 0.2
_BESIDE = 3


def check_beams(topic: str, sample: ScanSample) -> Iterator[Finding]:
    """Constant beams (the robot sees itself) and beams that never return."""
    finite = np.isfinite(sample.ranges_m) & (sample.ranges_m > 0.0)
    spread_m = _spread_m(np.where(finite, sample.ranges_m, np.nan))
    known = spread_m[np.isfinite(spread_m)]
    typical_m = float(np.median(known)) if known.size else 0.0
    if len(sample.scans) < MIN_SCANS or typical_m < MIN_TYPICAL_SPREAD_M:
        words = (
            f"{len(sample.scans)} scans whose beams change by {typical_m:.2g} m: drive and turn "
            "more to tell the robot's own body from its surroundings"
        )
        yield Finding("ranges.constant", topic, "cannot tell", words)
        return
    share = finite.mean(axis=0)
    yield _constant(topic, sample, spread_m, share)
    yield _dead(topic, share)


def beams_on_robot(ranges_m: FloatArray) -> BoolArray:
    """(beams,) those of (k, beams) readings, not finite where nothing returned, that always see
    the same while most see changes."""
    readings = np.where(np.isfinite(ranges_m) & (ranges_m > 0.0), ranges_m, np.nan)
    spread_m = _spread_m(readings)
    known = spread_m[np.isfinite(spread_m)]
    on_robot = np.zeros(spread_m.size, dtype=np.bool_)
    if known.size and float(np.median(known)) >= MIN_TYPICAL_SPREAD_M:
        for first, last in _still_runs(spread_m, np.isfinite(readings).mean(axis=0)):
            on_robot[first : last + 1] = True
    return on_robot


def _still_runs(spread_m: FloatArray, share: FloatArray) -> list[tuple[int, int]]:
    still = (share > _OFTEN) & (spread_m < MAX_CONSTANT_SPREAD_M)
    return [run for run in _runs(still) if _is_sharp(spread_m, *run)]


def _spread_m(ranges_m: FloatArray) -> FloatArray:
    """(beams,) from the 2 % to the 98 % quantile of each beam's readings, nan without any."""
    ordered = np.sort(ranges_m, axis=0)
    count = np.isfinite(ordered).sum(axis=0)
    beams = np.arange(ordered.shape[1])
    low, high = (ordered[np.floor(q * np.maximum(count - 1, 0)).astype(int), beams]
                 for q in (0.02, 0.98))  # fmt: skip
    return np.asarray(high - low, dtype=np.float64)


def _constant(topic: str, sample: ScanSample, spread_m: FloatArray, share: FloatArray) -> Finding:
    runs = _still_runs(spread_m, share)
    if not runs:
        words = "no beam always sees the same"
        return Finding("ranges.constant", topic, "ok", words)
    beams = sum(last - first + 1 for first, last in runs)
    first, last = runs[0]
    seen_m = float(np.nanmedian(sample.ranges_m[:, first : last + 1]))
    curve = Curve("spread", np.arange(spread_m.size, dtype=np.float64), spread_m, "line")
    limits = (MAX_CONSTANT_SPREAD_M,)
    plot = Plot(f"Change of each beam of {topic}", "beam", "spread (m)", (curve,), limits)
    return Finding(
        "ranges.constant",
        topic,
        "bad",
        f"{beams} beams always see the same (first beams {first} to {last}, at {seen_m:.2f} m): "
        "the robot itself",
        "beams_constant",
        "Mask these beams in the driver; a SLAM takes them for a wall that moves along.",
        Estimate(float(beams), 0.0, "beams"),
        mends=tuple(Mend("drop_beams", topic, {"first": a, "last": b}) for a, b in runs),
        plots=(plot,),
    )


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """(first, last) of each stretch of true."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def _is_sharp(spread_m: FloatArray, first: int, last: int) -> bool:
    """Whether the beams just beside the stretch change much more, or there are none."""
    inside = float(np.median(spread_m[first : last + 1]))
    beside = [spread_m[max(first - _BESIDE, 0) : first], spread_m[last + 1 : last + 1 + _BESIDE]]
    return all(
        side.size == 0 or not np.isfinite(side).any() or np.nanmax(side) > SHARP_FACTOR * inside
        for side in beside
    )


def _dead(topic: str, share: FloatArray) -> Finding:
    """Beams without a single return whose neighbours have some."""
    runs = [
        (first, last)
        for first, last in _runs(share == 0.0)
        if max(share[max(first - _BESIDE, 0) : last + 1 + _BESIDE].max(), 0.0) > _SELDOM
    ]
    beams = sum(last - first + 1 for first, last in runs)
    if beams < MIN_DEAD_BEAMS:
        return Finding("ranges.dead", topic, "ok", "every beam returns something at times")
    first, last = runs[0]
    return Finding(
        "ranges.dead",
        topic,
        "bad",
        f"{beams} beams never return anything (first beams {first} to {last})",
        "beams_dead",
        "Look for something that covers the lidar, or a mask in its driver that is too wide.",
        Estimate(float(beams), 0.0, "beams"),
        float(MIN_DEAD_BEAMS - 1),
    )
