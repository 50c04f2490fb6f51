"""Streams that begin long after the others, or end long before them."""

from __future__ import annotations

from collections.abc import Iterator

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge
from slamsim.check.questions.streams.series import StampSeries, series_of

MAX_MISSING_S, MAX_MISSING_SHARE = 10.0, 0.1
"""Drivers start some seconds apart, motors of lidars spin up; both must be exceeded."""

COVERAGE = Question(
    "time.coverage",
    "each stream lasts as long as the others",
    (FaultKind("stream_cut", "a stream begins late or ends early"),),
    limit=MAX_MISSING_S,
    unit="s",
    consequence="a part of the drive is mapped without it, or not at all",
)


def check_coverage(evidence: RecordingEvidence) -> Iterator[Finding]:
    """What each sensor's stream misses of the time that all of them cover together.

    Of streams that have no time in common with the others the clock is wrong, not the length.
    """
    streams = [s for s in series_of(evidence.recording) if s.kind != "transform" and len(s) > 1]
    for series in streams:
        others = [s for s in streams if s is not series and _touch(s, series)]
        if others:
            yield _missing(series, others)


GROUP = QuestionGroup("stamps", 11, (COVERAGE,), check_coverage)


def _missing(series: StampSeries, others: list[StampSeries]) -> Finding:
    begin_ns = min(int(s.instants_ns[0]) for s in others)
    end_ns = max(int(s.instants_ns[-1]) for s in others)
    late_s = max(0.0, 1e-9 * (int(series.instants_ns[0]) - begin_ns))
    early_s = max(0.0, 1e-9 * (end_ns - int(series.instants_ns[-1])))
    limit_s = max(MAX_MISSING_S, MAX_MISSING_SHARE * 1e-9 * (end_ns - begin_ns))
    words = [
        f"{what} {seconds:.3g} s {than} the other streams"
        for what, seconds, than in (("begins", late_s, "after"), ("ends", early_s, "before"))
        if seconds > limit_s
    ]
    return judge(
        COVERAGE,
        series.subject,
        {"ok": "it lasts as long as the others", "fault": f"it {' and '.join(words)}"},
        Measurement(max(late_s, early_s), 0.0, "s"),
        limit=limit_s,
        advice="Look for a driver that died or a recorder that was started early; cut the "
        "recording to the time that all streams cover.",
    )


def _touch(one: StampSeries, other: StampSeries) -> bool:
    begin_ns = max(int(one.instants_ns[0]), int(other.instants_ns[0]))
    return begin_ns <= min(int(one.instants_ns[-1]), int(other.instants_ns[-1]))
