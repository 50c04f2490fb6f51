"""Stamps that were counted, at an even rate, and never read from a clock.

A converter that has no stamps numbers messages, and writes the same times as receipt. A message
that was recorded live is received later than it was measured, by a time that varies.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import Question, judge
from slamsim.check.questions.streams.receipt import STAMPS_INVENTED
from slamsim.check.questions.streams.series import StampSeries
from slamsim.core.types import FloatArray

MIN_MESSAGES = 100
EXACT_NS = 256.0
"""What double precision leaves of nanoseconds since 1970; every clock that is read is off by more.
"""
LEAST_JITTER_NS = 10_000
"""No operating system passes messages on more evenly."""
SAME_PERIOD_NS = 1.0
ROUND_NS, ROUND_HZ = 1_000, 0.1
"""Periods of whole microseconds and rates of whole tenths of a hertz are those of a simulator, or
of a sensor that is triggered by a timer: such stamps are right though they are counted."""
STEPS_HZ = np.array([480.0, 90.0, 144.0])
"""So are periods of whole steps of a simulator, at 30, 60, 120, 240 or 480 Hz, or as often as a
display is drawn: 8.57 Hz is each seventh step at 60 Hz."""

INVENTED = Question(
    "time.invented",
    "stamps are read from a clock",
    (STAMPS_INVENTED,),
    limit=EXACT_NS,
    unit="ns",
    consequence="where messages were lost, scans are placed where the robot was seconds before",
    limit_of_ok=False,
)


def check_invented(series: list[StampSeries]) -> Iterator[Finding]:
    """Streams of sensors whose receipt repeats their stamps, and that never leave an even rate."""
    asked = [one for one in series if one.kind != "transform" and len(one) >= MIN_MESSAGES]
    is_live = any(_latency_varies(one) for one in asked)
    for one in asked:
        left_ns, period_ns = _left_ns(one)
        off_ns = float(np.abs(left_ns).max())
        counted = one.is_copied and off_ns <= EXACT_NS and (is_live or not _is_round(period_ns))
        how = (
            "others were received after their stamps, by times that vary"
            if is_live
            else "no clock has such a rate"
        )
        curve = Curve("stamp less even rate", np.arange(left_ns.size, dtype=np.float64), left_ns)
        yield judge(
            INVENTED,
            one.subject,
            {
                "ok": "the stamps are not known to be counted",
                "fault": f"stamps are spaced by {1e-6 * period_ns:.6f} ms to the microsecond, and "
                f"received at that very instant; {how}",
            },
            Measurement(off_ns, 0.0, "ns"),
            verdict="fault" if counted else "ok",
            advice="Convert the recording again with the stamps that the driver gave.",
            fault_plots=(Plot(f"Stamps of {one.subject}", "message", "off (ns)", (curve,)),),
        )


def _latency_varies(series: StampSeries) -> bool:
    """Whether messages were received after their stamps, by times that differ: a simulator that
    adds what a sensor takes adds the same each time."""
    if series.received_ns is None or series.is_copied:
        return False
    return bool(np.ptp(series.received_ns - series.stamps_ns) > LEAST_JITTER_NS)


def _left_ns(series: StampSeries) -> tuple[FloatArray, float]:
    """(n,) by how much stamps are off the even rate from the first to the last, and its period."""
    since_ns = (series.stamps_ns - series.stamps_ns[0]).astype(np.float64)
    period_ns = float(since_ns[-1]) / (since_ns.size - 1)
    return since_ns - period_ns * np.arange(since_ns.size), period_ns


def _is_round(period_ns: float) -> bool:
    rate_hz = 1e9 / max(period_ns, 1.0)
    nearest_ns = 1e9 / max(round(rate_hz / ROUND_HZ) * ROUND_HZ, ROUND_HZ)
    whole_ns = round(period_ns / ROUND_NS) * ROUND_NS
    steps_ns = np.round(period_ns * 1e-9 * STEPS_HZ) / STEPS_HZ * 1e9
    known = np.array([nearest_ns, whole_ns, *steps_ns])
    return bool(np.abs(period_ns - known).min() <= SAME_PERIOD_NS)
