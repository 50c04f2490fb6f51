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
from slamsim.core.types import IntArray

MAX_MISSING_SHARE = 0.015
MAX_GAP_S = {"lidar": 1.0, "wheels": 1.0, "imu": 0.25}
"""Scans and wheels bridge each other's gaps; nothing else tells how the robot turned."""
MAX_GAP_PERIODS = 10.0
MAX_UNEVEN_GAP_S = 10.0
"""For streams without a beat, which show no rate from which anything could be missing."""
_USUAL_LOSS, _CHANCE = 0.005, 1e-4
"""A driver that loses this share of its messages is usual; what it could lose by chance in so many
messages, but for one recording in ten thousand, is no fault."""

_MOST, _EVEN_TRAVEL, _MORE_ALIKE, _FAR = 95.0, 1.5, 1.05, 2.0
"""A recorder keeps a scan each so many metres if most steps (percentile) are no longer than so many
usual ones, and by so much more alike in metres than in seconds. It lost some where a step is this
many usual ones long."""

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
    if (by_distance := _by_distance(series)) is not None:
        return by_distance
    period_s = usual_step_s(steps_s)
    longest_s = _longest_s(np.sort(series.stamps_ns), period_s)
    even = is_even(series.stamps_ns)
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
    words = (
        f"{1.0 / rate_period_s:.4g} messages a second, {missing} missing, longest gap "
        f"{longest_s:.3g} s"
    )
    return _judged(series, words, size, limit)


def _by_distance(series: StampSeries) -> Finding | None:
    """The finding about a lidar whose scans were kept each so many metres, as for a pose graph: how
    long it takes to the next one says nothing. None for any other stream."""
    if series.travel_m is None:
        return None
    moved_m, steps_s = np.diff(series.travel_m), series.ordered_steps_s
    usual_m, most_m = np.percentile(moved_m, [50.0, _MOST]).tolist()
    usual_s, most_s = np.percentile(steps_s, [50.0, _MOST]).tolist()
    if (
        not 0.0 < most_m <= _EVEN_TRAVEL * usual_m
        or most_s * usual_m <= _MORE_ALIKE * most_m * usual_s
    ):
        return None
    far = moved_m > _FAR * usual_m
    longest_s = float(steps_s[far].max(initial=0.0))
    at = int(np.argmax(steps_s))
    words = (
        f"a message each {usual_m:.3g} m of the way; the longest gap is {steps_s[at]:.3g} s, in "
        f"which the robot moved {moved_m[at]:.3g} m"
    )
    if far.any():
        words += f"; up to {moved_m.max():.3g} m without a message"
    return _judged(series, words, Measurement(longest_s, 0.0, "s"), MAX_UNEVEN_GAP_S)


def _judged(series: StampSeries, words: str, size: Measurement, limit: float) -> Finding:
    return judge(
        GAPS,
        series.subject,
        words,
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


def steps_plot(series: StampSeries, *limits: float) -> Plot:
    curve = Curve("from one message to the next", series.since_first_s[1:], series.steps_s)
    return Plot(
        f"Spacing of the stamps of {series.subject}", "stamp (s)", "step (s)", (curve,), limits
    )
