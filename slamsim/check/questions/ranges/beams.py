"""Beams that always measure the same (the robot itself), never return, or are isolated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.check.scan_sample import ScanSample
from slamsim.core.components import runs_of
from slamsim.core.types import FloatArray
from slamsim.guard.quantities import as_count, as_number
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.scans import isolated_returns
from slamsim.slam.laser.own_body import (
    BESIDE,
    MAX_CONSTANT_SPREAD_M,
    MIN_TYPICAL_SPREAD_M,
    spread_of,
    still_runs,
)

MIN_SCANS = 50
MIN_DEAD_BEAMS = 3
_SELDOM = 0.2
"""A neighbour of a blind beam returns more often, or the surroundings are far away."""

MAX_ISOLATED_SHARE = 5e-3
"""Of the readings: five of eight logs of Radish show 0.05 to 0.3 %, three 1 to 2.4 %."""
MIN_JUDGED_BEAMS = 200
_WIDEST_STEP_RAD = float(np.radians(1.1))
"""Of lidars of about one beam a degree: with wider steps neighbours meet different things
anyway."""

MAX_LOST_SHARE, SAME_SURFACE = 0.2, 0.05
"""Of the beams between two that meet one surface: the logs of Radish lose up to 0.1 %, cheap lidars
in the sun or on black cloth some 10 %. Two ranges that differ by less are of one surface."""

CONSTANT = Question(
    "ranges.constant",
    "no beam sees the robot itself",
    (FaultKind("beams_constant", "some beams always see the same: the robot itself"),),
    unit="beams",
    consequence="a SLAM takes them for a wall that moves along",
    excitation_wanted="driving and turning, so that all other beams change",
    repairs=("drop_beams",),
)
DEAD = Question(
    "ranges.dead",
    "every beam returns something at times",
    (FaultKind("beams_dead", "some beams never return anything"),),
    limit=float(MIN_DEAD_BEAMS - 1),
    unit="beams",
    consequence="obstacles in these directions are not seen",
    limit_of_ok=False,
)
ISOLATED = Question(
    "ranges.stray",
    "hardly any beam differs from its neighbours for one scan",
    (FaultKind("scan_interference", "stray short or long readings: another lidar or sunlight"),),
    limit=100.0 * MAX_ISOLATED_SHARE,
    unit="%",
    consequence="obstacles appear in free space",
    excitation_wanted="beams at most 1.1 degrees apart, on surfaces wider than three of them",
    repairs=("drop_stray_beams",),
    limit_of_ok=False,
)


LOST = Question(
    "ranges.lost",
    "beams return something where their neighbours do",
    (FaultKind("beams_lost", "the lidar loses many of its beams"),),
    limit=100.0 * MAX_LOST_SHARE,
    unit="%",
    consequence="thin obstacles are not seen, and a SLAM has less to match",
    limit_of_ok=False,
)


def check_beams(topic: str, sample: ScanSample) -> Iterator[Finding]:
    """Constant beams (the robot sees itself) and beams that never return."""
    finite = np.isfinite(sample.ranges_m) & (sample.ranges_m > 0.0)
    spread_m = spread_of(np.where(finite, sample.ranges_m, np.nan))
    known = spread_m[np.isfinite(spread_m)]
    typical_m = float(np.median(known)) if known.size else 0.0
    if len(sample.scans) < MIN_SCANS or typical_m < MIN_TYPICAL_SPREAD_M:
        words = (
            f"the beams of {as_count(len(sample.scans), 'scan')} change by {typical_m:.2g} m: "
            "drive and turn more to tell the robot's own body from its surroundings"
        )
        yield unanswered(CONSTANT, topic, words)
        return
    share = finite.mean(axis=0)
    yield _constant(topic, sample, spread_m, share)
    yield _dead(topic, share)


def _constant(topic: str, sample: ScanSample, spread_m: FloatArray, share: FloatArray) -> Finding:
    runs = still_runs(spread_m, share)
    if not runs:
        words = "no beam always sees the same"
        return judge(CONSTANT, topic, words, verdict="ok")
    beams = sum(last - first + 1 for first, last in runs)
    first, last = runs[0]
    seen_m = float(np.nanmedian(sample.ranges_m[:, first : last + 1]))
    curve = Curve("spread", np.arange(spread_m.size, dtype=np.float64), spread_m, "line")
    limits = (MAX_CONSTANT_SPREAD_M,)
    plot = Plot(f"Change of each beam of {topic}", "beam", "spread (m)", (curve,), limits)
    return judge(
        CONSTANT,
        topic,
        f"{beams} beams always see the same (first beams {first} to {last}, at {seen_m:.2f} m): "
        "the robot itself",
        Measurement(float(beams), 0.0, "beams"),
        verdict="fault",
        advice="Mask these beams in the driver; a SLAM takes them for a wall that moves along.",
        repairs=tuple(Repair("drop_beams", topic, {"first": a, "last": b}) for a, b in runs),
        plots=(plot,),
    )


def _dead(topic: str, share: FloatArray) -> Finding:
    """Beams without a single return whose neighbours have some."""
    runs = [
        (first, last)
        for first, last in runs_of(share == 0.0)
        if max(share[max(first - BESIDE, 0) : last + 1 + BESIDE].max(), 0.0) > _SELDOM
    ]
    beams = sum(last - first + 1 for first, last in runs)
    if beams < MIN_DEAD_BEAMS:
        return judge(DEAD, topic, "every beam returns something at times", verdict="ok")
    first, last = runs[0]
    return judge(
        DEAD,
        topic,
        f"{beams} beams never return anything (first beams {first} to {last})",
        Measurement(float(beams), 0.0, "beams"),
        advice="Look for something that covers the lidar, or a mask in its driver that is too "
        "wide.",
    )


def check_lost(topic: str, sample: ScanSample) -> Finding:
    """How many beams return nothing between two that meet one surface."""
    ranges_m = np.where(np.isfinite(sample.ranges_m), sample.ranges_m, 0.0)
    before, beam, after = ranges_m[:, :-2], ranges_m[:, 1:-1], ranges_m[:, 2:]
    near = np.abs(before - after) < SAME_SURFACE * np.minimum(before, after)
    between = (before > 0.0) & (after > 0.0) & near
    if int(between.sum()) < MIN_JUDGED_BEAMS:
        return unanswered(LOST, topic, "too few beams have two neighbours that meet one surface")
    share = float((between & (beam <= 0.0)).sum() / between.sum())
    return judge(
        LOST,
        topic,
        f"{as_number(100.0 * share, 2)} % of the beams between two that meet one surface return "
        "nothing",
        Measurement(100.0 * share, 0.0, "%"),
        advice="Clean the window; look for sunlight, black surfaces and filters of the driver.",
    )


def check_isolated_returns(topic: str, sample: ScanSample) -> Finding:
    """Beams that differ from two neighbours which agree; a pole does that as well, but stays."""
    fine = 0.0 < abs(sample.layout.angle_step_rad) <= _WIDEST_STEP_RAD
    if not fine or sample.ranges_m.shape[1] < 3:
        words = "beams so far apart that a pole and a stray reading look alike"
        return unanswered(ISOLATED, topic, words)
    known, isolated = isolated_returns(
        sample.ranges_m, sample.following_m, sample.layout.angle_step_rad
    )
    if int(known.sum()) < MIN_JUDGED_BEAMS:
        return unanswered(ISOLATED, topic, "too few beams have two neighbours that agree")
    share = float(isolated.sum() / known.sum())
    return judge(
        ISOLATED,
        topic,
        f"{100.0 * share:.2g} % of the beams stand alone in one scan and are gone in the next",
        Measurement(100.0 * share, 0.0, "%"),
        advice="Look for another lidar, sunlight or a dirty window; filter single beams.",
        repairs=(Repair("drop_stray_beams", topic),),
    )
