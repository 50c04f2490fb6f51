"""Questions about stamps: within a stream, common epoch, receive times."""

from __future__ import annotations

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.fault_groups import LIDAR_TIMES
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    judge,
    same_subject,
    unanswered,
)
from slamsim.check.questions.streams.clock_steps import STEP, check_step
from slamsim.check.questions.streams.epochs import EPOCH, check_epochs
from slamsim.check.questions.streams.gaps import GAPS
from slamsim.check.questions.streams.invented import INVENTED, check_invented
from slamsim.check.questions.streams.receipt import DRIFT, RECEIPT, check_receipt
from slamsim.check.questions.streams.series import StampSeries, series_of
from slamsim.check.questions.streams.spacing import (
    ORDER,
    REPEATS,
    ROUNDING,
    SCATTER,
    SPACING,
    check_spacing,
)
from slamsim.core.types import IntArray
from slamsim.recording.edits.beams import scan_durations_ns
from slamsim.recording.repairs.base import Repair

MAX_OVERLAP = 0.02
"""Of the scan's duration. Drivers that declare the nominal speed of their motor are off by less."""
MIN_OVERLAP_S = 1e-4
MOST_TOO_LONG = 0.01
"""Of the scans: drivers measure how long a scan took by a clock that waits for the computer."""
MOST_PERIODS = 10.0
"""No clock waits for so long without a gap in the stamps: a single scan that lasts longer is
declared wrong, unless the motor started with it."""
_NO_INSTANTS = ("epoch_mismatch", "stamps_quantised", "stamps_repeated")
"""Stamps so wrong that how long they are before the receipt says nothing more."""


OVERLAP = Question(
    "time.overlap",
    "a scan begins when the one before it has ended",
    (
        FaultKind(
            "scans_overlap",
            "a scan begins before the one before it ended",
            (same_subject(*LIDAR_TIMES),),  # of a sweep too long the middle is too late
        ),
    ),
    unit="ms",
    consequence="scans are freed of the wrong motion: walls bend while the robot turns",
    excitation_wanted="two scans of different stamps",
    repairs=("scale_beam_times",),
)


def check_stamps(evidence: RecordingEvidence) -> list[Finding]:
    """Order, repeats, rounding, scatter and gaps of stamps, and how they fit their receipt."""
    series = series_of(evidence.recording)
    if not series:
        words = "the recording holds no stream with stamps"
        return [unanswered(ORDER, evidence.recording.name, words)]
    lasts_ns = {
        scans.topic: scan_durations_ns(scans, either_way=True) for scans in evidence.recording.scans
    }
    findings = check_epochs(series)
    for stream in series:
        findings += check_spacing(stream)
        if stream.kind == "lidar":
            findings.append(_overlap(stream, lasts_ns[stream.subject]))
    findings += [check_step(stream) for stream in series if stream.kind != "transform"]
    findings += check_invented(series)
    wrong = {finding.subject for finding in findings if finding.fault in _NO_INSTANTS}
    return findings + check_receipt(series, wrong)


GROUP = QuestionGroup(
    "stamps",
    10,
    (
        EPOCH,
        ORDER,
        SPACING,
        ROUNDING,
        SCATTER,
        REPEATS,
        GAPS,
        OVERLAP,
        STEP,
        INVENTED,
        RECEIPT,
        DRIFT,
    ),
    check_stamps,
)


def _overlap(series: StampSeries, lasts_ns: IntArray) -> Finding:
    """One lidar begins a scan only when it has ended the one before. lasts_ns: (n,) of each."""
    steps_s = series.ordered_steps_s
    if not steps_s.size:
        return unanswered(OVERLAP, series.subject, "there are not two scans of different stamps")
    lasts_s, step_s = float(np.median(lasts_ns)) * 1e-9, series.period_s
    overlap_s = lasts_s - step_s
    # Jitter moves the next stamp by less than a period, or messages would change their order.
    begins_s = np.maximum(series.steps_s, step_s)
    too_long = 1e-9 * lasts_ns[:-1] > step_s + begins_s
    if too_long.mean() <= MOST_TOO_LONG:
        starts = np.concatenate([[True], series.steps_s[:-1] > 2.0 * step_s])
        too_long = (1e-9 * lasts_ns[:-1] > MOST_PERIODS * begins_s) & ~starts
    some = overlap_s <= MIN_OVERLAP_S and bool(too_long.any())
    if some:
        lasts_s = float(np.median(lasts_ns[:-1][too_long])) * 1e-9
    which = f"{too_long.sum()} of {len(series):,} scans last" if some else "a scan lasts"
    curve = Curve("from one scan to the next", series.since_first_s[1:], series.steps_s)
    return judge(
        OVERLAP,
        series.subject,
        f"{which} {1e3 * lasts_s:.4g} ms as declared, the next begins after {1e3 * step_s:.4g} ms",
        Measurement(1e3 * max(lasts_s - step_s, 0.0), 0.0, "ms"),
        limit=1e3 * max(MIN_OVERLAP_S, MAX_OVERLAP * lasts_s),
        advice="Declare the time_increment that the lidar really has: at most the period over the "
        "number of beams of a full turn.",
        repairs=(Repair("scale_beam_times", series.subject, {"factor": step_s / lasts_s}),)
        if overlap_s > 0.0 and not some
        else (),
        fault_plots=(
            Plot("Scans against their duration", "stamp (s)", "step (s)", (curve,), (lasts_s,)),
        ),
    )
