"""Messages that are missing from a stream, or that a driver held up."""

from __future__ import annotations

import numpy as np
from scipy.special import pdtrc

from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.check.questions.streams.series import (
    StampSeries,
    is_even,
    usual_step_s,
)
from slamsim.core.types import FloatArray, IntArray

MAX_MISSING_SHARE = 0.015
MAX_GAP_S = {"lidar": 1.0, "wheels": 1.0, "imu": 0.25}
"""Scans and wheels bridge each other's gaps; nothing else tells how the robot turned."""
MAX_GAP_PERIODS = 10.0
MAX_UNEVEN_GAP_S = 10.0
"""For streams without a beat, which show no rate from which anything could be missing."""
_USUAL_LOSS, _CHANCE = 0.005, 1e-4
"""A driver that loses this share of its messages is usual; what it could lose by chance in so many
messages, but for one recording in ten thousand, is no fault."""

_SHORT, _RARELY = 0.5, 0.05
"""Of a period, and of the messages: a beat with messages missing has no more steps so short."""
_USUAL_TRAVEL = 2.0
"""A recorder that keeps a scan each so many metres keeps none that is this much farther."""

_CAUGHT_UP, _LONG_STEPS = 0.75, 100
"""Of the messages that are due, about a step; of so many of the longest steps."""

GAPS = Question(
    "time.gaps",
    "no messages are missing",
    (FaultKind("stream_gaps", "messages are missing"),),
    limit=100.0 * MAX_MISSING_SHARE,
    unit="%",
    consequence="the motion during a gap is not known",
)


def by_chance(count: int, of: int) -> bool:
    """Whether a driver that loses, or holds up, messages as is usual may do so with so many."""
    return count == 0 or bool(pdtrc(count - 1, _USUAL_LOSS * of) > _CHANCE)


def check_gaps(series: StampSeries, countable: bool) -> Finding:
    """countable: whether what is missing can be counted from the spacing."""
    steps_s = series.ordered_steps_s
    if not steps_s.size:
        return unanswered(GAPS, series.subject, "all messages carry one and the same stamp")
    period_s = usual_step_s(steps_s)
    even = is_even(series.stamps_ns) and _is_least(period_s, steps_s)
    longest_s = _longest_s(np.sort(series.stamps_ns), period_s)
    if not even:
        longest_s = _longest_driven_s(series, longest_s)
    rate_period_s = period_s if even else float(np.mean(steps_s))
    longest_limit_s = (
        max(MAX_GAP_S[series.kind], MAX_GAP_PERIODS * period_s) if even else MAX_UNEVEN_GAP_S
    )
    missing = int((np.rint(steps_s / period_s) - 1.0).clip(0.0).sum()) if even and countable else 0
    # What comes late catches up: fewer are missing than the longer steps alone would hold.
    missing = min(missing, max(round(series.span_s / period_s) + 1 - len(series), 0))
    sent = missing + len(series)
    share = 0.0 if by_chance(missing, sent) else missing / sent
    size, limit = Measurement(100.0 * share, 0.0, "%"), 100.0 * MAX_MISSING_SHARE
    if share <= MAX_MISSING_SHARE and longest_s > longest_limit_s:
        size, limit = Measurement(longest_s, 0.0, "s"), longest_limit_s
    return judge(
        GAPS,
        series.subject,
        f"{1.0 / rate_period_s:.4g} messages a second, {missing} missing, longest gap "
        f"{longest_s:.3g} s",
        size,
        limit=limit,
        advice="Look for a full queue, a slow disk or a cable: what is missing cannot be repaired.",
        fault_plots=(steps_plot(series, limit),),
    )


def _longest_s(sorted_ns: IntArray, period_s: float) -> float:
    """The longest step, if messages are missing in it, and not just late: those catch up, and as
    many come within its length and that of the next one as ever."""
    since_s = (sorted_ns - sorted_ns[0]) * 1e-9
    steps_s = np.diff(since_s)
    for at in np.argsort(-steps_s)[:_LONG_STEPS]:
        until = np.searchsorted(since_s, since_s[at] + 2.0 * steps_s[at], side="right") - 1
        due = (since_s[until] - since_s[at]) / max(period_s, 1e-9)
        if until == since_s.size - 1 or until - at < _CAUGHT_UP * due:
            return float(steps_s[at])
    return float(np.median(steps_s))


def _is_least(period_s: float, steps_s: FloatArray) -> bool:
    """Whether hardly any messages come sooner: of a lidar that is recorded each half metre the
    usual step is as long as the robot takes for it, and a turn makes it shorter."""
    return bool((steps_s < _SHORT * period_s).mean() <= _RARELY)


def _longest_driven_s(series: StampSeries, longest_s: float) -> float:
    """The longest step in which the robot moved farther than from one message to the next."""
    if series.travel_m is None:
        return longest_s
    moved_m, steps_s = np.diff(series.travel_m), np.diff(series.instants_ns) * 1e-9
    far = moved_m > _USUAL_TRAVEL * np.median(moved_m)
    return float(min(steps_s[far].max(initial=0.0), longest_s))


def steps_plot(series: StampSeries, *limits: float) -> Plot:
    curve = Curve("from one message to the next", series.since_first_s[1:], series.steps_s)
    return Plot(
        f"Spacing of the stamps of {series.subject}", "stamp (s)", "step (s)", (curve,), limits
    )
