"""Each stream's stamps by themselves: order, repeats, rounding, scatter, gaps."""

from __future__ import annotations

import numpy as np
from scipy.special import pdtrc

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.questions.streams.rounding import in_equal_groups, rounding_step_s
from slamsim.check.questions.streams.series import StampSeries, beat_scatter_s, is_even, spread_s

MAX_ROUNDING_S = 0.014
"""Rounding to this makes errors of 4 ms: at 1 rad/s, 4 cm at a wall 10 m away. Finer steps of
system clocks, up to 10 ms, are common in logs that map well."""
MAX_SCATTER_S = 0.005
"""The same harm. Drivers that stamp on receipt scatter by one or two milliseconds."""
MAX_REPEATED_SHARE = 5e-3
MAX_MISSING_SHARE = 0.015
MAX_GAP_S = {"lidar": 1.0, "wheels": 1.0, "imu": 0.25}
"""Scans and wheels bridge each other's gaps; nothing else tells how the robot turned."""
MAX_GAP_PERIODS = 10.0
MAX_UNEVEN_GAP_S = 10.0
"""For streams without a beat, which show no rate from which anything could be missing."""
_MIN_MESSAGES = 20
_MIN_REPEATED = 3
_USUAL_LOSS, _CHANCE = 0.005, 1e-4
"""A driver that loses this share of its messages is usual; what it could lose by chance in so many
messages, but for one recording in ten thousand, is not held against it."""


def check_spacing(series: StampSeries) -> list[Finding]:
    """One fault is told once: what would follow from it is not asked again."""
    if len(series) < 2:
        return [_cannot("time.order", series, "a single message shows no course of time")]
    findings = [_order(series)]
    if series.kind == "transform":
        return findings
    if len(series) < _MIN_MESSAGES:
        words = f"{len(series)} messages are too few to judge their spacing"
        return [*findings, _cannot("time.spacing", series, words)]
    if _is_bad(findings):
        return [*findings, _gaps(series, countable=False)]
    findings.append(_rounding(series))
    if not _is_bad(findings):
        findings.append(_scatter(series))
    if not _is_bad(findings) or in_equal_groups(series.steps_s):
        findings.append(_repeats(series))
    return [*findings, _gaps(series, countable=not _is_bad(findings))]


def _order(series: StampSeries) -> Finding:
    steps_s = series.steps_s
    backward = int((steps_s < 0.0).sum())
    estimate = Estimate(float(backward), 0.0, "backward stamps")
    if not backward:
        words = "stamps never go backward"
        return Finding("time.order", series.subject, "ok", words, estimate=estimate, limit=0.0)
    return Finding(
        "time.order",
        series.subject,
        "bad",
        f"{backward} of {len(series)} stamps lie before the one above, by up to "
        f"{-steps_s.min():.3g} s",
        "stamps_backward",
        "Look for two publishers on one topic or a clock that was set back; sort by stamp, or, "
        "where the order is right, stamp anew.",
        estimate,
        0.0,
        (Mend("restamp_evenly" if _in_order(series) else "reorder", series.subject),),
        (_steps_plot(series, ()),),
    )


def _in_order(series: StampSeries) -> bool:
    """Whether the order of the file is right, and the stamps only scatter about their beat."""
    scatter_s = beat_scatter_s(series.stamps_ns)
    return scatter_s is not None and scatter_s < 3.0 * series.span_s / len(series)


def _rounding(series: StampSeries) -> Finding:
    step_s = rounding_step_s(series.steps_s)
    period_s = series.span_s / (len(series) - 1)
    limit_s = min(MAX_ROUNDING_S, max(period_s, 1e-3))
    estimate = Estimate(1e3 * step_s, 0.0, "ms")
    if step_s <= limit_s:
        shows = (
            f"stamps are multiples of {1e3 * step_s:.4g} ms" if step_s else "no coarse step shows"
        )
        return Finding(
            "time.rounding", series.subject, "ok", shows, estimate=estimate, limit=1e3 * limit_s
        )
    single = bool(np.abs(series.stamps_ns * 1e-9).max() * 2.0**-24 >= 0.5 * step_s)
    cause = ": what is left of seconds in single precision" if single else ""
    return Finding(
        "time.rounding",
        series.subject,
        "bad",
        f"stamps are multiples of {step_s:.6g} s{cause}, while messages come every "
        f"{period_s:.4g} s",
        "stamps_quantised",
        "Carry stamps as integers of nanoseconds, or as seconds in double precision, from a "
        "clock with fine ticks.",
        estimate,
        1e3 * limit_s,
        (Mend("restamp_evenly", series.subject),),
        (_steps_plot(series, (step_s,)),),
    )


def _repeats(series: StampSeries) -> Finding:
    repeated = len(series) - series.instants_ns.size
    share = repeated / len(series)
    estimate = Estimate(100.0 * share, 0.0, "%")
    limit = 100.0 * MAX_REPEATED_SHARE
    words = f"{repeated} of {len(series)} messages carry the stamp of another one"
    if repeated < _MIN_REPEATED or share <= MAX_REPEATED_SHARE:
        return Finding("time.repeats", series.subject, "ok", words, estimate=estimate, limit=limit)
    return Finding(
        "time.repeats",
        series.subject,
        "bad",
        words,
        "stamps_repeated",
        "Stamp each message with the instant of its own measurement.",
        estimate,
        limit,
        (Mend("restamp_evenly", series.subject),),
        (_steps_plot(series, ()),),
    )


def _scatter(series: StampSeries) -> Finding:
    scatter_s = beat_scatter_s(series.stamps_ns)
    if scatter_s is None:
        words = (
            f"messages come unevenly ({1e3 * spread_s(series.stamps_ns, 1):.3g} ms from one to "
            "the next), and without a beat stamps alone do not tell whose fault that is"
        )
        return _cannot("time.scatter", series, words, (_steps_plot(series, ()),))
    error_s = scatter_s / np.sqrt(len(series) / 10.0)
    estimate = Estimate(1e3 * scatter_s, 1e3 * float(error_s), "ms")
    if scatter_s <= MAX_SCATTER_S:
        words = f"stamps keep to an even beat within {1e3 * scatter_s:.2g} ms"
        return Finding(
            "time.scatter", series.subject, "ok", words, None, "", estimate, 1e3 * MAX_SCATTER_S
        )
    return Finding(
        "time.scatter",
        series.subject,
        "bad",
        f"stamps scatter by {1e3 * scatter_s:.3g} ms about an even beat",
        "stamps_jitter",
        "Stamp with the sensor's own clock, or where the data arrive and not where they are "
        "published.",
        estimate,
        1e3 * MAX_SCATTER_S,
        (Mend("restamp_evenly", series.subject),),
        (_steps_plot(series, ()),),
    )


def _gaps(series: StampSeries, countable: bool) -> Finding:
    """countable: whether what is missing can be counted from the spacing."""
    steps_s = series.ordered_steps_s
    if not steps_s.size:
        return _cannot("time.gaps", series, "all messages carry one and the same stamp")
    period_s = float(np.median(steps_s))
    longest_s = float(steps_s.max())
    even = is_even(series.stamps_ns)
    limit_s = max(MAX_GAP_S[series.kind], MAX_GAP_PERIODS * period_s) if even else MAX_UNEVEN_GAP_S
    missing = int((np.rint(steps_s / period_s) - 1.0).clip(0.0).sum()) if even and countable else 0
    sent = missing + len(series)
    by_chance = missing == 0 or pdtrc(missing - 1, _USUAL_LOSS * sent) > _CHANCE
    share = 0.0 if by_chance else missing / sent
    rate = f"{1.0 / period_s:.4g} messages a second"
    words = f"{rate}, {missing} missing, longest gap {longest_s:.3g} s"
    estimate = Estimate(100.0 * share, 0.0, "%")
    if share <= MAX_MISSING_SHARE and longest_s <= limit_s:
        limit = 100.0 * MAX_MISSING_SHARE
        return Finding("time.gaps", series.subject, "ok", words, None, "", estimate, limit)
    if share <= MAX_MISSING_SHARE:
        estimate, limit = Estimate(longest_s, 0.0, "s"), limit_s
    else:
        limit = 100.0 * MAX_MISSING_SHARE
    return Finding(
        "time.gaps",
        series.subject,
        "bad",
        words,
        "stream_gaps",
        "Look for a full queue, a slow disk or a cable: what is missing cannot be mended.",
        estimate,
        limit,
        plots=(_steps_plot(series, (limit_s,)),),
    )


def _cannot(check: str, series: StampSeries, words: str, plots: tuple[Plot, ...] = ()) -> Finding:
    return Finding(check, series.subject, "cannot tell", words, plots=plots)


def _is_bad(findings: list[Finding]) -> bool:
    return any(finding.verdict == "bad" for finding in findings)


def _steps_plot(series: StampSeries, limits: tuple[float, ...]) -> Plot:
    curve = Curve("from one message to the next", series.since_first_s[1:], series.steps_s)
    return Plot(
        f"Spacing of the stamps of {series.subject}", "stamp (s)", "step (s)", (curve,), limits
    )
