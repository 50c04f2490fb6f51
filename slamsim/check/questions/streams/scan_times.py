"""Does the declared scan_time fit the stamps of the scans, and the time from beam to beam?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge
from slamsim.check.questions.streams.series import StampSeries, series_of
from slamsim.recording import RawScans
from slamsim.recording.edits.beams import beam_counts
from slamsim.recording.repairs.base import Repair

MAX_LONGER, MAX_SHORTER = 0.2, 0.05
"""Longer than the time between scans: of that time, by which a motor may turn slower than its
nominal speed. Shorter than a sweep: of the sweep, for both are computed from one speed."""
MIN_SCANS = 20

SCAN_TIME = Question(
    "time.scan_time",
    "scan_time is at least a sweep and at most the time between scans",
    (FaultKind("scan_time", "scan_time contradicts the stamps or the time_increment"),),
    unit="ms",
    consequence="consumers that take scan_time for the sweep free scans of the wrong motion",
    repairs=("set_scan_time",),
)


def check_scan_time(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each lidar that declares one; 0 says that it is not known, and less can be of a lidar of
    which only every second scan is recorded."""
    series = {one.subject: one for one in series_of(evidence.recording) if one.kind == "lidar"}
    for scans in evidence.recording.scans:
        found = series.get(scans.topic)
        if len(scans) < MIN_SCANS or found is None or evidence.recording.format == "carmen":
            continue
        declared_s = np.array([layout.scan_time_s for layout in scans.layouts])[scans.layout_of]
        middle_s = float(np.median(declared_s))
        if middle_s != 0.0 and found.period_s > 0.0:
            yield _scan_time(scans, middle_s, found)


GROUP = QuestionGroup("stamps", 11, (SCAN_TIME,), check_scan_time)


def _scan_time(scans: RawScans, declared_s: float, series: StampSeries) -> Finding:
    period_s = series.period_s
    steps_s = np.array([abs(layout.beam_dt_s) for layout in scans.layouts])[scans.layout_of]
    sweep_s = float(np.median(steps_s * (beam_counts(scans) - 1)))
    words = f"scan_time is {1e3 * declared_s:.4g} ms, scans come every {1e3 * period_s:.4g} ms"
    most_s = (1.0 + MAX_LONGER) * period_s
    wrong = not 0.0 < declared_s <= most_s
    if sweep_s <= most_s:  # else the sweep itself is wrong, and asked for elsewhere
        wrong |= declared_s < (1.0 - MAX_SHORTER) * sweep_s
    words += f" and a sweep takes {1e3 * sweep_s:.4g} ms" if sweep_s > 0.0 else ""
    curve = Curve("from one scan to the next", series.since_first_s[1:], series.steps_s)
    return judge(
        SCAN_TIME,
        scans.topic,
        words,
        Measurement(1e3 * declared_s, 0.0, "ms"),
        verdict="fault" if wrong and sweep_s <= most_s else "ok",
        limit=1e3 * most_s,
        advice="Declare the time from one scan to the next, in seconds.",
        repairs=(Repair("set_scan_time", scans.topic, {"scan_time_s": period_s}),),
        fault_plots=(
            Plot(
                f"{scans.topic} against scan_time", "stamp (s)", "step (s)", (curve,), (declared_s,)
            ),
        ),
    )
