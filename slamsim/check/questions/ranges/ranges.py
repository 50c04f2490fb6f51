"""Do the ranges mean what REP 117 says: metres, ``inf`` for no return, inside the limits?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.check.questions.ranges.beams import (
    CONSTANT,
    DEAD,
    ISOLATED,
    LOST,
    check_beams,
    check_isolated_returns,
    check_lost,
)
from slamsim.check.questions.ranges.no_return import NO_RETURN, check_no_return, without_codes
from slamsim.check.questions.ranges.noise import NOISE, check_noise
from slamsim.check.questions.ranges.repeats import STUCK, check_repeats
from slamsim.check.questions.ranges.rounding import ROUNDING, check_rounding
from slamsim.check.questions.ranges.units import (
    UNIT,
    declared,
    metres_of,
    outside_share,
    unit_of,
    wrong_unit,
)
from slamsim.check.questions.ranges.wraps import WRAPPED, check_wraps
from slamsim.check.scan_sample import ScanSample, positive, sample_scans
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawScans, ScanLayout
from slamsim.recording.repairs.base import Repair

MAX_OUTSIDE_SHARE = 2e-3
"""Rounding at the limits themselves puts a few readings a hair outside."""
MIN_COUNT = 20
"""Fewer readings than this are accidents."""

BEAMS = Question(
    "ranges",
    "scans hold beams",
    (),
    consequence="there is nothing to map",
    excitation_wanted="a scan with one beam or more",
)
SCAN_LAYOUT = FaultKind(
    "scan_layout", "what the scan declares of its beams does not fit its readings"
)
SCAN_FOLDS = FaultKind("scan_folds", "a scan spans more than a turn")
LAYOUT = Question(
    "ranges.layout",
    "the declared angles fit the number of beams, and the time between beams is a number",
    (SCAN_LAYOUT, SCAN_FOLDS),
    consequence="consumers that use angle_max turn or stretch the scan, or refuse it",
    repairs=("set_angle_max", "scale_angles"),
)
INTENSITIES = Question(
    "ranges.intensities",
    "scans hold an intensity for each range, or none",
    (SCAN_LAYOUT,),
    limit=0.0,
    unit="scans",
    consequence="consumers read beyond the end of the shorter list, or refuse the scan",
    limit_of_ok=False,
)
LIMITS = Question(
    "ranges.limits",
    "readings lie inside the declared limits",
    (FaultKind("range_limits", "declared minimum and maximum contradict the readings"),),
    limit=100.0 * MAX_OUTSIDE_SHARE,
    unit="%",
    consequence="a SLAM throws good readings away",
    excitation_wanted=f"{MIN_COUNT} finite readings",
    repairs=("set_range_limits",),
    limit_of_ok=False,
)


def check_ranges(evidence: RecordingEvidence) -> list[Finding]:
    """Layout, unit, limits, no-return codes, overflow, stuck, constant and isolated beams of every
    lidar."""
    recording = evidence.recording
    findings: list[Finding] = []
    for scans in recording.scans:
        findings += [*_layouts(scans), *_beam_times(scans), *_intensities(scans)]
        sample = sample_scans(scans)
        if sample is None:
            findings.append(unanswered(BEAMS, scans.topic, "no scan holds a single beam"))
            continue
        unit = unit_of(recording, scans, sample)
        if unit is not None:
            findings.append(wrong_unit(scans.topic, sample, unit))
            sample = sample.scaled(metres_of(unit))
        findings += [
            _limits(scans, sample),
            check_no_return(scans.topic, sample, recording.format == "carmen"),
        ]
        sample = without_codes(sample)
        findings += [
            check_wraps(scans.topic, sample),
            check_rounding(scans.topic, sample),
            check_noise(scans.topic, sample),
            check_repeats(recording, scans, sample),
            *check_beams(scans.topic, sample),
            check_lost(scans.topic, sample),
            check_isolated_returns(scans.topic, sample),
        ]
    return findings


GROUP = QuestionGroup(
    "ranges",
    40,
    (
        BEAMS,
        LAYOUT,
        INTENSITIES,
        UNIT,
        LIMITS,
        NO_RETURN,
        WRAPPED,
        ROUNDING,
        NOISE,
        STUCK,
        CONSTANT,
        DEAD,
        LOST,
        ISOLATED,
    ),
    check_ranges,
)


def _layouts(scans: RawScans) -> Iterator[Finding]:
    """angle_max must be where the last beam looks; reported for the first scan that is wrong."""
    beams_of = _beams_of(scans)
    for number, beams in np.unique(np.column_stack([scans.layout_of, beams_of]), axis=0).tolist():
        layout = scans.layouts[number]
        last_rad = layout.angle_min_rad + (beams - 1) * layout.angle_step_rad
        if layout.folds(beams):
            yield _folded(scans.topic, layout, beams)
            return
        off = abs(layout.angle_max_rad - last_rad)
        if off <= 1.5 * abs(layout.angle_step_rad):
            continue  # the last beam, or one more as drivers that count a full turn write it
        yield judge(
            LAYOUT,
            scans.topic,
            f"the last of {beams} beams looks along {np.degrees(last_rad):.2f} deg, angle_max says "
            f"{np.degrees(layout.angle_max_rad):.2f}",
            verdict="fault",
            advice="Let angle_max be angle_min + (number of ranges - 1) x angle_increment.",
            repairs=(Repair("set_angle_max", scans.topic),),
        )
        return


def _folded(topic: str, layout: ScanLayout, beams: int) -> Finding:
    """So many beams make more than a turn; if their angle is merely rounded, SLAM knows it."""
    ends_deg = np.degrees(layout.angle_min_rad + np.array([0.0, beams - 1]) * layout.angle_step_rad)
    words = f"{beams} beams from {ends_deg[0]:.2f} to {ends_deg[1]:.2f} deg look along some "
    words += "directions twice: "
    step_rad = layout.unfolded(beams).angle_step_rad
    if step_rad == layout.angle_step_rad:
        words += "SLAM refuses such scans"
        advice, repairs = "Publish each turn as a scan of its own", list[Repair]()
        by_ends_rad = (layout.angle_max_rad - layout.angle_min_rad) / (beams - 1)
        closed = replace(layout, angle_step_rad=by_ends_rad)
        if np.isfinite(by_ends_rad) and not closed.folds(beams):
            advice += f", or declare {by_ends_rad:.6g} rad between beams, as the first and last do"
        advice += "."
    else:
        words += f"the angle between them is rounded, and SLAM takes {step_rad:.6g} rad"
        advice = f"Declare {step_rad:.6g} rad between beams."
        factor = step_rad / layout.angle_step_rad
        repairs = [Repair("scale_angles", topic, {"factor": factor, "pivot": "first"})]
    return judge(
        LAYOUT, topic, words, verdict="fault", fault=SCAN_FOLDS, advice=advice, repairs=repairs
    )


def _beam_times(scans: RawScans) -> Iterator[Finding]:
    """Scans of which no instant but that of the first beam is known."""
    known = np.isfinite([layout.beam_dt_s for layout in scans.layouts])[scans.layout_of]
    if not known.all():
        yield judge(
            LAYOUT,
            scans.topic,
            f"in {(~known).sum()} of {len(scans):,} scans time_increment is no number",
            verdict="fault",
            advice="Publish the seconds from one beam to the next, or 0 where all see one instant.",
        )


def _beams_of(scans: RawScans) -> IntArray:
    """(n,) how many ranges each scan holds."""
    if isinstance(scans.ranges_m, np.ndarray):
        return np.full(len(scans), scans.ranges_m.shape[1], dtype=np.int64)
    return np.array([ranges_m.size for ranges_m in scans.ranges_m], dtype=np.int64)


def _intensities(scans: RawScans) -> Iterator[Finding]:
    """Scans whose intensities are not as many as their ranges."""
    others, strengths = scans.other_intensities, scans.intensities
    if strengths is not None:
        sizes = zip(strengths, scans.ranges_m, strict=True)
        others += sum(one.size not in (0, ranges.size) for one, ranges in sizes)
    if others:
        yield judge(
            INTENSITIES,
            scans.topic,
            f"{others} of {len(scans)} scans hold another number of intensities than of ranges",
            Measurement(float(others), 0.0, "scans"),
            advice="Publish one intensity for each range, or an empty list.",
        )


def _limits(scans: RawScans, sample: ScanSample) -> Finding:
    topic, layout, readings = scans.topic, sample.layout, positive(sample)
    limits_m = np.array([[one.range_min_m, one.range_max_m] for one in scans.layouts])
    empty = ~(limits_m[:, 1] > np.maximum(limits_m[:, 0], 0.0))
    without = empty[scans.layout_of]
    if without.mean() > MAX_OUTSIDE_SHARE:
        which = f"{without.sum()} of {len(scans):,} scans are"
        return judge(
            LIMITS,
            topic,
            f"{which} {declared(scans.layouts[int(empty.argmax())])}: no range can lie between",
            verdict="fault",
            advice="Declare what the data sheet of the lidar says.",
        )
    if readings.size < MIN_COUNT:
        words = f"{readings.size} finite readings in {len(sample.scans)} scans"
        return unanswered(LIMITS, topic, words)
    outside = outside_share(readings, layout)
    low, high = np.quantile(readings, [0.001, 0.999])
    return judge(
        LIMITS,
        topic,
        {
            "ok": f"readings about {np.median(readings):.2f} m lie inside, {declared(layout)}",
            "fault": f"{100.0 * outside:.2g} % of the readings lie outside ({low:.3g} to "
            f"{high:.3g} m are 99.8 % of them), {declared(layout)}",
        },
        Measurement(100.0 * outside, 0.0, "%"),
        advice="Declare what the lidar can do, or a SLAM throws good readings away.",
        repairs=(_set_limits(topic, readings, layout),),
    )


def _set_limits(topic: str, readings: FloatArray, layout: ScanLayout) -> Repair:
    """Limits that hold all readings, and what is declared where that does."""
    low = min(layout.range_min_m, 0.99 * float(readings.min()))
    high = max(layout.range_max_m, 1.01 * float(readings.max()))
    return Repair("set_range_limits", topic, {"range_min_m": low, "range_max_m": high})
