"""Stamps against receive times: late, early, drifting, or made up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.fault_groups import LIDAR_TIMES, SIZES, SWEEPS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import (
    FaultKind,
    Question,
    anywhere,
    judge,
    lidar_stamps,
    same_subject,
    unanswered,
)
from slamsim.check.questions.streams.series import StampSeries, spread_s
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

MAX_LATE_S = 0.5
"""Later than any network makes them; below, only other sensors can tell."""
MAX_AHEAD_S = 0.01
"""Clocks of two computers agree to a millisecond when they are kept together at all."""
MAX_DRIFT_PPM = 200.0
"""No crystal is so far off. What a smaller drift does between two sensors they tell better
themselves (``time.drift``): the receiver's clock does not matter to a map."""
MAX_GAINED_S = 0.005
"""What a drift may add to the offset between two streams over a short recording."""
INVENTED_PPM = 10_000.0
"""No clock is so wrong: the rate was assumed."""
_MIN_MESSAGES = 100
_MIN_SPAN_S = 10.0
"""Over less, jitter of the transport looks like a drift."""
_BLOCKS = 40
_EVEN_SHARE = 1e-3
"""Of a period: stamps that scatter by less are counted, not measured."""


STAMPS_FUTURE = FaultKind("stamps_future", "stamps lie after the message was received")
STAMPS_LATE = FaultKind("stamps_late", "messages are received long after their stamp")
CLOCK_DRIFT = FaultKind(
    "clock_drift",
    "one clock runs faster than another",
    (same_subject("stamps_future", "stamps_late"),),
)
STAMPS_INVENTED = FaultKind(
    "stamps_invented",
    "stamps of a constant rate that the data contradict",
    (
        same_subject(*LIDAR_TIMES, "time_offset_imu", "time_offset_wheels"),
        lidar_stamps("time_offset_imu", "time_offset_wheels"),
        anywhere(*SIZES, *SWEEPS, "laser_angle_step", "clock_drift"),
    ),
)

RECEIPT = Question(
    "time.receipt",
    "messages are received soon after they were measured",
    (STAMPS_FUTURE, STAMPS_LATE),
    limit=1e3 * MAX_LATE_S,
    unit="ms",
    consequence="a live consumer waits for transforms that do not come, and drops messages",
    excitation_wanted="a recording that holds times of receipt",
    repairs=("shift_receipt",),
)
DRIFT = Question(
    "time.receipt_drift",
    "the clock of the stamps keeps pace with the receiver's",
    (CLOCK_DRIFT, STAMPS_INVENTED),
    limit=MAX_DRIFT_PPM,
    unit="ppm",
    consequence="streams drift apart, some milliseconds a minute",
    excitation_wanted=f"{_MIN_MESSAGES} messages over {_MIN_SPAN_S:g} s, with times of receipt",
    repairs=("rescale_stamps", "stamp_by_receipt"),
)


@dataclass(frozen=True, slots=True, eq=False)
class _Drift:
    """Receipt against stamp: how much later for each second, with its sigma, by which blocks."""

    rate: float
    sigma: float
    block_s: FloatArray
    block_delay_s: FloatArray


def check_receipt(series: list[StampSeries], wrong: set[str]) -> list[Finding]:
    """Delay and drift of every sensor's stamps against the receiver's clock.

    series: those of ``series_of``. wrong: subjects whose stamps are known to tell no instants.
    """
    asked = [s for s in series if s.kind != "transform"]
    findings = [_delay(s) for s in asked if s.subject not in wrong]
    drifts = {s.subject: _drift(s) for s in asked}
    common = _common_rate([drift for drift in drifts.values() if drift is not None])
    return findings + [_drifting(s, drifts[s.subject], common) for s in asked]


def _delay(series: StampSeries) -> Finding:
    delay_s = series.latency_s
    why = _silent(series)
    if delay_s is None or why:
        return unanswered(RECEIPT, series.subject, why)
    # No scan lasts longer than until the next, whatever it declares.
    since_end_s = delay_s - np.minimum(series.lasts_ns * 1e-9, series.period_s)
    late_s, ahead_s = float(np.median(since_end_s)), -float(np.quantile(delay_s, 0.1))
    repairs = (Repair("shift_receipt", series.subject, {"offset_s": -late_s}),)
    curve = Curve("received", series.since_first_s, delay_s)
    title = f"Receipt of {series.subject}"
    plot = Plot(title, "stamp (s)", "after the stamp (s)", (curve,), (0.0,))
    if ahead_s > MAX_AHEAD_S:
        return judge(
            RECEIPT,
            series.subject,
            f"messages are received {1e3 * ahead_s:.4g} ms and more before their stamp",
            Measurement(1e3 * ahead_s, 0.0, "ms"),
            limit=1e3 * MAX_AHEAD_S,
            fault=STAMPS_FUTURE,
            advice="Keep the clocks of all computers together (chrony, PTP), and stamp with the "
            "instant of measurement.",
            repairs=repairs,
            plots=(plot,),
        )
    return judge(
        RECEIPT,
        series.subject,
        {
            "ok": f"messages are received {1e3 * late_s:.3g} ms after the end of measuring",
            "fault": f"messages are received {late_s:.3f} s after the end of measuring",
        },
        Measurement(1e3 * late_s, 0.0, "ms"),
        fault=STAMPS_LATE,
        advice="Look for a queue that fills up, or for stamps of another clock.",
        repairs=repairs,
        fault_plots=(plot,),
    )


def _silent(series: StampSeries) -> str:
    """Why the times of receipt say nothing, empty if they do."""
    if series.received_ns is None:
        return "the recording does not say when messages were received"
    if series.is_copied:
        return "the times of receipt are the stamps over again"
    if series.latency_s is None:
        return "stamps and times of receipt count from different origins"
    return ""


def _drift(series: StampSeries) -> _Drift | None:
    """A line through the early messages of each block: what waits in a queue only comes later."""
    received_ns = series.received_ns
    if received_ns is None or series.is_copied:
        return None
    if len(series) < _MIN_MESSAGES or series.span_s < _MIN_SPAN_S:
        return None
    delay_s = (received_ns - received_ns[0]) * 1e-9 - series.since_first_s
    blocks = np.array_split(np.arange(len(series)), min(_BLOCKS, len(series) // 20))
    at_s = np.array([np.median(series.since_first_s[block]) for block in blocks])
    early_s = np.array([np.quantile(delay_s[block], 0.2) for block in blocks])
    first, second = np.triu_indices(at_s.size, 1)
    apart_s = at_s[second] - at_s[first]
    usable = apart_s > 0.1 * series.span_s
    if not usable.any():
        return None
    slopes = ((early_s[second] - early_s[first])[usable]) / apart_s[usable]
    rate = float(np.median(slopes))
    off_s = early_s - rate * at_s
    spread = SIGMAS_PER_MEDIAN * float(np.median(np.abs(off_s - np.median(off_s))))
    # Neighbouring blocks share the load of the network: as if there were half as many.
    sigma = 1.25 * spread / (np.std(at_s) * np.sqrt(at_s.size / 2.0))
    return _Drift(rate, float(sigma), at_s, early_s)


def _common_rate(drifts: list[_Drift]) -> float:
    """What all streams share is the receiver's clock, or a replay at another speed."""
    rates = np.array([drift.rate for drift in drifts])
    if rates.size < 3:
        return float(min(rates, key=abs)) if rates.size > 1 else 0.0
    return float(np.median(rates))


def _drifting(series: StampSeries, drift: _Drift | None, common: float) -> Finding:
    if drift is None:
        words = _silent(series) or "too few messages or too short a time to see a drift"
        return unanswered(DRIFT, series.subject, words)
    gained = common - drift.rate
    size = Measurement(1e6 * gained, 1e6 * drift.sigma, "ppm")
    limit_ppm = max(MAX_DRIFT_PPM, 1e6 * MAX_GAINED_S / series.span_s)
    words = f"the clock of the stamps gains {size.value:.3g} ppm on the receiver's"
    invented = abs(size.value) > INVENTED_PPM and _is_even(series)
    plot = Plot(
        f"Drift of {series.subject}",
        "stamp (s)",
        "receipt less stamp (s)",
        (Curve("early messages", drift.block_s, drift.block_delay_s, "line"),),
    )
    return judge(
        DRIFT,
        series.subject,
        {
            "ok": words,
            "inconclusive": f"{words}; receipt is too irregular to tell",
            "fault": f"stamps are spaced evenly to the last digit, yet {words}"
            if invented
            else words,
        },
        size,
        limit=limit_ppm,
        fault=STAMPS_INVENTED if invented else CLOCK_DRIFT,
        advice="Convert the recording again with the stamps that the driver gave, or with the "
        "times of receipt."
        if invented
        else "Discipline the sensor's clock (PTP), or stamp by the computer's.",
        repairs=(_drift_repair(series, size.value, invented),),
        fault_plots=(plot,),
    )


def _drift_repair(series: StampSeries, drift_ppm: float, invented: bool) -> Repair:
    if invented:
        return Repair("stamp_by_receipt", series.subject)
    origin_ns = str(int(series.stamps_ns[0]))
    slower: dict[str, float | str] = {"drift_ppm": drift_ppm, "origin_ns": origin_ns}
    return Repair("rescale_stamps", series.subject, slower)


def _is_even(series: StampSeries) -> bool:
    period_s = float(np.median(series.steps_s))
    return spread_s(series.stamps_ns, 1) < _EVEN_SHARE * period_s
