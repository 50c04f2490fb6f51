"""Whether all streams count time from the same origin."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import LIDAR_TIMES
from slamsim.check.findings import Curve, Finding, Plot
from slamsim.check.question import FaultKind, Question, judge, same_subject, unanswered
from slamsim.check.questions.streams.series import StampSeries
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

_APART_S = 60.0
"""Streams of one recording begin within a minute of each other, unless they count from different
origins."""
_UNIX_S = 946_684_800.0
"""1 January 2000 in Unix time: earlier stamps count from the start of a computer or of a
simulation."""

EPOCH_MISMATCH = FaultKind(
    "epoch_mismatch",
    "streams count time from different origins",
    (same_subject(*LIDAR_TIMES, "time_offset_imu", "time_offset_wheels"),),
)
EPOCH = Question(
    "time.epoch",
    "all streams count time from one origin",
    (EPOCH_MISMATCH,),
    consequence="a SLAM finds no odometry at the instants of the scans and drops them all",
    excitation_wanted="a stream with two stamps",
    repairs=("shift_stamps",),
)


def check_epochs(series: list[StampSeries]) -> list[Finding]:
    """Streams of one recording cover about the same time; a group apart has another origin.

    series: those of ``series_of``, of at least one message each.
    """
    groups = _groups([s for s in series if len(s) > 1 and s.span_s > 0.0])
    if not groups:
        return [unanswered(EPOCH, "all streams", "no stream shows a course of time")]
    if len(groups) == 1:
        words = f"all streams count {_origin(groups[0])}"
        return [judge(EPOCH, "all streams", words, verdict="ok")]
    main = max(groups, key=_trust)
    return [_apart(s, main) for group in groups if group is not main for s in group]


def _groups(series: list[StampSeries]) -> list[list[StampSeries]]:
    """Streams whose spans touch, or nearly, belong together."""
    groups: list[list[StampSeries]] = []
    end_s = -np.inf
    for s in sorted(series, key=_begin_s):
        if _begin_s(s) > end_s + max(_APART_S, s.span_s):
            groups.append([])
        groups[-1].append(s)
        end_s = max(end_s, _end_s(s))
    return groups


def _trust(group: list[StampSeries]) -> tuple[int, int, int]:
    """The more kinds of sensors, then those stamped near their receipt, then the more streams."""
    near = sum(s.latency_s is not None for s in group)
    return len({s.kind for s in group}), near, len(group)


def _apart(series: StampSeries, main: list[StampSeries]) -> Finding:
    begin_s = min(_begin_s(s) for s in main)
    off_s = _begin_s(series) - begin_s
    return judge(
        EPOCH,
        series.subject,
        f"its stamps count {_origin([series])}, those of {main[0].subject} {_origin(main)}: "
        f"{off_s:.3f} s apart",
        verdict="fault",
        advice="Run all drivers on one clock, and set use_sim_time everywhere or nowhere.",
        repairs=(Repair("shift_stamps", series.subject, {"offset_s": _shift_s(series, off_s)}),),
        plots=(_plot([*main, series], begin_s),),
    )


def _shift_s(series: StampSeries, off_s: float) -> float:
    """By how much the stamps are to be moved: as far as their receipt says, else to the begin."""
    if series.received_ns is None:
        return -off_s
    ends_ns = series.stamps_ns + series.lasts_ns
    return float(np.quantile((series.received_ns - ends_ns) * 1e-9, 0.05))


def _origin(group: list[StampSeries]) -> str:
    return "from 1970" if _begin_s(group[0]) > _UNIX_S else "from a start of their own"


def _begin_s(series: StampSeries) -> float:
    return float(np.quantile(series.stamps_ns, 0.02)) * 1e-9


def _end_s(series: StampSeries) -> float:
    return float(np.quantile(series.stamps_ns, 0.98)) * 1e-9


def _plot(series: list[StampSeries], begin_s: float) -> Plot:
    def line(s: StampSeries) -> tuple[FloatArray, FloatArray]:
        ends = np.array([0.0, len(s) - 1.0])
        return ends, np.array([_begin_s(s) - begin_s, _end_s(s) - begin_s])

    curves = tuple(Curve(s.subject, *line(s), "line") for s in series)
    return Plot("Time covered by each stream", "message", "stamp (s)", curves)
