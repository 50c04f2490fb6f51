"""Stamps of each stream: order, repeats, rounding, jitter."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import BY_SCANS, LIDAR_TIMES
from slamsim.check.findings import Finding, Measurement, decide
from slamsim.check.question import (
    FaultKind,
    Question,
    anywhere,
    judge,
    lidar_stamps,
    same_subject,
    unanswered,
)
from slamsim.check.questions.streams.gaps import (
    MAX_MISSING_SHARE,
    by_chance,
    check_gaps,
    steps_plot,
)
from slamsim.check.questions.streams.rounding import in_equal_groups, rounding_step_s
from slamsim.check.questions.streams.series import (
    StampSeries,
    beat_scatter_s,
    held_up_s,
    spread_s,
)
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

MAX_ROUNDING_S = 0.014
"""Rounding to this makes errors of 4 ms: at 1 rad/s, 4 cm at a wall 10 m away. Finer steps of
system clocks, up to 10 ms, are common in logs that map well."""
MAX_SCATTER_S = 0.005
"""The same harm. Drivers that stamp on receipt scatter by one or two milliseconds."""
MAX_REPEATED_SHARE = 5e-3
"""Of the messages: above what a queue repeats now and then."""
_MIN_MESSAGES = 20
_MIN_REPEATED = 3
_OFFSETS = (*LIDAR_TIMES, "time_offset_imu", "time_offset_wheels", "clock_drift")
_EVENLY = ("restamp_evenly",)

ORDER = Question(
    "time.order",
    "stamps never go backward",
    (
        FaultKind(
            "stamps_backward",
            "stamps go backward",
            (same_subject("odometry_twist"), lidar_stamps(*BY_SCANS)),
        ),
    ),
    limit=0.0,
    unit="backward stamps",
    consequence="filters and bag players drop or reorder messages",
    excitation_wanted="two messages or more",
    repairs=("restamp_evenly", "reorder"),
)
SPACING = Question(
    "time.spacing",
    "there are enough messages to judge their spacing",
    (),
    consequence="nothing is known of the stamps",
    excitation_wanted=f"{_MIN_MESSAGES} messages or more",
)
ROUNDING = Question(
    "time.rounding",
    "stamps are finer than the time between messages",
    (
        FaultKind(
            "stamps_quantised",
            "stamps are rounded coarsely",
            (
                anywhere(*_OFFSETS),
                # From one multiple to the next, where the rate is nearly that of the multiples.
                same_subject("odometry_twist", "clock_step"),
                lidar_stamps(*BY_SCANS),
            ),
        ),
    ),
    limit=1e3 * MAX_ROUNDING_S,
    unit="ms",
    consequence="scans are placed where the robot was some centimetres before or after",
    repairs=_EVENLY,
)
SCATTER = Question(
    "time.scatter",
    "stamps keep to an even beat",
    (
        FaultKind(
            "stamps_jitter",
            "stamps scatter: time of publishing, not of measuring",
            (
                lidar_stamps(*BY_SCANS),
                anywhere(*LIDAR_TIMES, "time_offset_imu", "time_offset_wheels"),
                same_subject("stamps_backward", "stamps_future"),
                # Stamped up to a step late, wheels of the right size looked 4 % too small: up to
                # ``diagnosis.MOST_SIZED``.
                same_subject("wheel_radius", "wheel_track", "wheel_slip", "odometry_twist"),
            ),
        ),
    ),
    limit=1e3 * MAX_SCATTER_S,
    unit="ms",
    consequence="scans are placed where the robot was some centimetres before or after",
    excitation_wanted="a sensor that measures at a constant rate",
    repairs=_EVENLY,
)
REPEATS = Question(
    "time.repeats",
    "every message has a stamp of its own",
    (
        FaultKind(
            "stamps_repeated",
            "messages carry the stamp of another one",
            (
                same_subject(*_OFFSETS, "stamps_jitter", "odometry_twist"),
                lidar_stamps(*BY_SCANS, *_OFFSETS),  # of which it is the lidar's that are none
            ),
        ),
    ),
    limit=100.0 * MAX_REPEATED_SHARE,
    unit="%",
    consequence="consumers drop one of two messages with one stamp, or divide by zero",
    repairs=(*_EVENLY, "drop_copies"),
)


def check_spacing(series: StampSeries) -> list[Finding]:
    """One fault is reported once: what would follow from it is not asked again."""
    if len(series) < 2:
        return [unanswered(ORDER, series.subject, "a single message shows no course of time")]
    findings = [_order(series)]
    if series.kind == "transform":
        return findings
    if len(series) < _MIN_MESSAGES:
        words = f"{len(series)} messages are too few to judge their spacing"
        return [*findings, unanswered(SPACING, series.subject, words)]
    if _any_fault(findings):
        return [*findings, check_gaps(series, countable=False)]
    findings.append(_rounding(series.once))
    if not _any_fault(findings):
        findings.append(_scatter(series.once))
    if not _any_fault(findings) or in_equal_groups(series.steps_s):
        findings.append(_repeats(series))
    return [*findings, check_gaps(series, countable=not _any_fault(findings))]


def _order(series: StampSeries) -> Finding:
    steps_s = series.steps_s
    backward = int((steps_s < 0.0).sum())
    size = Measurement(float(backward), 0.0, ORDER.unit)
    if not backward:
        return judge(ORDER, series.subject, "stamps never go backward", size)
    return judge(
        ORDER,
        series.subject,
        f"{backward:,} of {len(series):,} stamps lie before the one above, by up to "
        f"{-steps_s.min():.3g} s",
        size,
        advice="Look for two publishers on one topic or a clock that was set back; sort by stamp, "
        "or, where the order is right, stamp anew.",
        repairs=(Repair("restamp_evenly" if _in_order(series) else "reorder", series.subject),),
        plots=(steps_plot(series),),
    )


def _in_order(series: StampSeries) -> bool:
    """Whether the order of the file is right, and the stamps only scatter about their beat."""
    scatter_s = beat_scatter_s(series.stamps_ns)
    return scatter_s is not None and scatter_s < 3.0 * series.span_s / len(series)


def _rounding(series: StampSeries) -> Finding:
    step_s = rounding_step_s(series.steps_s)
    period_s = series.span_s / (len(series) - 1)
    coarsest_s = float(np.spacing(np.float32(np.abs(series.stamps_ns * 1e-9).max())))
    single = step_s in (coarsest_s, 0.5 * coarsest_s)  # half of it while a power of two is passed
    cause = ": what is left of seconds in single precision" if single else ""
    return judge(
        ROUNDING,
        series.subject,
        {
            "ok": f"stamps are multiples of {1e3 * step_s:.4g} ms"
            if step_s
            else "no coarse step shows",
            "fault": f"stamps are multiples of {step_s:.6g} s{cause}, while messages come every "
            f"{period_s:.4g} s",
        },
        Measurement(1e3 * step_s, 0.0, "ms"),
        limit=1e3 * min(MAX_ROUNDING_S, max(period_s, 1e-3)),
        advice="Carry stamps as integers of nanoseconds, or as seconds in double precision, from a "
        "clock with fine ticks.",
        repairs=(Repair("restamp_evenly", series.subject),),
        fault_plots=(steps_plot(series, step_s),),
    )


def _repeats(series: StampSeries) -> Finding:
    repeated = len(series) - series.instants_ns.size
    copied = series.once is not series
    words = f"{repeated:,} of {len(series):,} messages carry the stamp of another one"
    return judge(
        REPEATS,
        series.subject,
        f"{words}, and are copies of it" if copied else words,
        Measurement(100.0 * repeated / len(series), 0.0, "%"),
        limit=100.0 * max(MAX_REPEATED_SHARE, (_MIN_REPEATED - 0.5) / len(series)),
        advice="Stamp each message with the instant of its own measurement.",
        repairs=(Repair("drop_copies" if copied else "restamp_evenly", series.subject),),
        fault_plots=(steps_plot(series),),
    )


def _scatter(series: StampSeries) -> Finding:
    if series.instants_ns.size < _MIN_MESSAGES:
        words = f"{len(series)} messages carry {series.instants_ns.size} different stamps: no beat"
        return unanswered(SCATTER, series.subject, words)
    late_s = held_up_s(series.stamps_ns)
    late = int((late_s > 2.0 * MAX_SCATTER_S).sum())
    if late > MAX_MISSING_SHARE * len(series) and not by_chance(late, len(series)):
        return _held_up(series, late_s, late)
    # A stamp that comes twice moves all later ones off a beat that is counted by messages.
    scatter_s = beat_scatter_s(series.instants_ns)
    if scatter_s is None:
        words = (
            f"messages come unevenly ({1e3 * spread_s(series.stamps_ns, 1):.3g} ms from one to "
            "the next), and without a beat stamps alone do not tell whose fault that is"
        )
        return unanswered(SCATTER, series.subject, words, (steps_plot(series),))
    error_s = scatter_s / np.sqrt(len(series) / 10.0)
    # Its sigma is a share of it: by sigmas off 0 the length of the log alone would decide.
    verdict = decide(Measurement(scatter_s, 0.0, "s"), MAX_SCATTER_S)
    return judge(
        SCATTER,
        series.subject,
        {
            "ok": f"stamps keep to an even beat within {1e3 * scatter_s:.2g} ms",
            "fault": f"stamps scatter by {1e3 * scatter_s:.3g} ms about an even beat",
        },
        Measurement(1e3 * scatter_s, 1e3 * float(error_s), "ms"),
        verdict=verdict,
        advice="Stamp with the sensor's own clock, or where the data arrive and not where they are "
        "published.",
        repairs=(Repair("restamp_evenly", series.subject),),
        fault_plots=(steps_plot(series),),
    )


def _held_up(series: StampSeries, late_s: FloatArray, late: int) -> Finding:
    return judge(
        SCATTER,
        series.subject,
        f"{late:,} of {len(series):,} messages came together at the end of a pause, the first "
        f"{1e3 * late_s.max():.3g} ms late, and carry the time when they came",
        Measurement(1e3 * float(np.sqrt(np.mean(np.square(late_s)))), 0.0, "ms"),
        verdict="fault",
        advice="Stamp with the sensor's own clock, or in the driver before messages can wait.",
        repairs=(Repair("restamp_evenly", series.subject),),
        fault_plots=(steps_plot(series),),
    )


def _any_fault(findings: list[Finding]) -> bool:
    return any(finding.verdict == "fault" for finding in findings)
