"""Clocks against each other: who is early or late, by how much, and whose clock runs away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration import Calibration
from slamsim.check.findings import Estimate, Finding, Mend, Verdict
from slamsim.check.verdicts import SURE_SIGMAS
from slamsim.core.types import FloatArray

LIMITS_S = {"gyro": 3e-4, "wheel": 2e-3, "gyro_wheel": 2e-3}
"""Offsets up to this are healthy: less than a tenth of a scan's own noise at a walking pace. Tyres
that give make wheels seem half a millisecond early on the simulator's robot, more on soft ones."""

HARM_S = {"gyro": 5e-3, "wheel": 2e-2, "gyro_wheel": 2e-2}
DRIFT_LIMIT = 1e-5
GAINED_LIMIT_S = 1e-3
"""A drift matters if it is faster than 10 ppm and gains a millisecond over the recording."""

OTHER_EPOCH_S = 1e5
SAME_SWEEP_S = 5e-4
TURNING = "turning to and fro, ten times a minute"
PAIR_WORDS = {
    "gyro": ("inertial unit", "lidar"),
    "wheel": ("wheels", "lidar"),
    "gyro_wheel": ("wheels", "inertial unit"),
}
FAULTS = {
    "lidar": "time_offset_lidar",
    "imu": "time_offset_imu",
    "wheels": "time_offset_wheels",
}


@dataclass(frozen=True, slots=True)
class Offset:
    """One pair of streams: offset at the begin of what was compared, s, and drift, s/s."""

    pair: str
    offset_s: float
    sigma_s: float
    bound_s: float
    drift: float
    drift_sigma: float
    gained_s: float

    @property
    def is_off(self) -> bool:
        size = abs(self.offset_s)
        return size > LIMITS_S[self.pair] and size > SURE_SIGMAS * self.sigma_s

    @property
    def drifts(self) -> bool:
        return (
            abs(self.drift) > DRIFT_LIMIT
            and abs(self.gained_s) > GAINED_LIMIT_S
            and abs(self.drift) > SURE_SIGMAS * self.drift_sigma
        )

    @property
    def is_known(self) -> bool:
        return abs(self.offset_s) + 1.96 * self.sigma_s < HARM_S[self.pair]


def check_timing(calibration: Calibration) -> list[Finding]:
    """Each pair of streams, then whoever is to blame."""
    pairs = _pairs(calibration)
    offsets = {pair: _offset(calibration, pair) for pair in pairs if calibration.follows(pair)}
    blamed = _blamed({pair: (one.offset_s, one.sigma_s) for pair, one in offsets.items()})
    one_message = calibration.inputs.together
    blamed = blamed if any(one.is_off for one in offsets.values()) and not one_message else {}
    drifting = _blamed({pair: (one.drift, one.drift_sigma) for pair, one in offsets.items()})
    drifting = drifting if any(one.drifts for one in offsets.values()) and not one_message else {}
    return [
        *_contradicted(calibration),
        *_agreements(calibration, offsets),
        *(_culprit(calibration, stream, late_s) for stream, late_s in blamed.items()),
        *(_drift(calibration, offsets, drifting) if offsets else ()),
    ]


def _contradicted(calibration: Calibration) -> list[Finding]:
    """Stamps of scans that no clock explains: numbered evenly by a converter, if they are even."""
    if calibration.alignment.scans != "unsteady":
        return []
    topic = calibration.inputs.steps.topic
    words = "turns of the scans follow those of gyroscope and wheels, but at no steady clock"
    if not calibration.inputs.even_stamps:
        words += ": their stamps scatter too much to compare them"
        return [Finding("time.steady", topic, "cannot tell", words)]
    words += ", although their stamps are evenly spaced"
    advice = "Record again: a converter has numbered the scans and forgotten the lost ones."
    return [Finding("time.steady", topic, "bad", words, "stamps_invented", advice)]


def _pairs(calibration: Calibration) -> tuple[str, ...]:
    lidar = calibration.scans_count
    gyro, wheels = calibration.inputs.gyro is not None, calibration.inputs.wheels is not None
    there = {"gyro": lidar and gyro, "wheel": lidar and wheels, "gyro_wheel": gyro and wheels}
    return tuple(pair for pair, both in there.items() if both)


def _offset(calibration: Calibration, pair: str) -> Offset:
    """With a drift that is beyond doubt, what counts is the offset before it began."""
    drift, drift_sigma, _ = calibration.drift(pair)
    seconds = calibration.model.span_s
    now = Offset(pair, *calibration.offset(pair), drift, drift_sigma, drift * seconds)
    if now.drifts:
        now = Offset(
            *(pair, *calibration.offset(pair, -0.5 * seconds)),
            *(drift, drift_sigma, drift * seconds),
        )
    return now


def _blamed(differences: dict[str, tuple[float, float]]) -> dict[str, float]:
    """How late each stream is that must be, if as few as possible are: by stream.

    differences: by pair, value and sigma. Of two streams alone the lidar is blamed, for its
    messages take longest to make; of three that all differ, the inertial unit is trusted.
    """
    if "gyro" in differences and "wheel" in differences:
        seen = np.array([differences["gyro"][0], differences["wheel"][0]])
        sigmas = np.array([differences["gyro"][1], differences["wheel"][1]])
        patterns = {"lidar": [-1.0, -1.0], "imu": [1.0, 0.0], "wheels": [0.0, 1.0]}
        fits = {name: _explained(np.array(by), seen, sigmas) for name, by in patterns.items()}
        name, (late, misfit) = min(fits.items(), key=lambda one: one[1][1])
        if misfit < SURE_SIGMAS**2:
            return {name: late}
        return {"lidar": -float(seen[0]), "wheels": float(seen[1] - seen[0])}
    if "gyro" in differences:
        return {"lidar": -differences["gyro"][0]}
    if "wheel" in differences:
        return {"lidar": -differences["wheel"][0]}
    if "gyro_wheel" in differences:
        return {"wheels": differences["gyro_wheel"][0]}
    return {}


def _explained(by: FloatArray, seen: FloatArray, sigmas: FloatArray) -> tuple[float, float]:
    """The size of one cause that fits best, and what it leaves, in squared sigmas."""
    late = float((by * seen / sigmas**2).sum() / (by**2 / sigmas**2).sum())
    return late, float((((seen - late * by) / sigmas) ** 2).sum())


def _topics(calibration: Calibration) -> dict[str, str]:
    inputs = calibration.inputs
    return {
        "lidar": inputs.steps.topic,
        "imu": inputs.gyro.topic if inputs.gyro else "",
        "wheels": inputs.wheels.topic if inputs.wheels else "",
    }


def _agreements(calibration: Calibration, offsets: dict[str, Offset]) -> list[Finding]:
    """All pairs but those that differ: who is to blame for these is told apart."""
    return [
        _pair(calibration, pair, offsets.get(pair))
        for pair in _pairs(calibration)
        if pair not in offsets or not offsets[pair].is_off or calibration.inputs.together
    ]


def _pair(calibration: Calibration, pair: str, offset: Offset | None) -> Finding:
    """What was measured between two streams."""
    one, other = PAIR_WORDS[pair]
    check = f"time.offset.{'lidar' if other == 'lidar' else 'imu'}_{_stream(pair)}"
    subject = _topics(calibration)[_stream(pair)]
    if offset is None:
        shift = calibration.shift(pair)
        why = "nothing turns" if shift is None else f"correlation {shift.correlation:.2f}"
        words = f"turns of {one} and {other} do not follow each other ({why}): {TURNING} would tell"
        return Finding(check, subject, "cannot tell", words)
    estimate = _in_ms(offset)
    words = (
        f"stamps of the {one} are {_signed_ms(offset.offset_s)} against those of the {other}, "
        f"± {offset.sigma_s * 1e3:.3g} ms (at best {offset.bound_s * 1e3:.2g} ms)"
    )
    if calibration.inputs.together:
        words += "; both carry one stamp, so the pose may just be older or newer than the scan"
    elif not offset.is_known:
        words += f", too unsure to tell; what would tell: {TURNING}"
    verdict: Verdict = "ok" if offset.is_known else "cannot tell"
    return Finding(check, subject, verdict, words, estimate=estimate, limit=LIMITS_S[pair] * 1e3)


def _in_ms(offset: Offset) -> Estimate:
    ms = 1e3
    return Estimate(offset.offset_s * ms, offset.sigma_s * ms, "ms", offset.bound_s * ms)


def _stream(pair: str) -> str:
    return "imu" if pair == "gyro" else "wheels"


def _signed_ms(offset_s: float) -> str:
    size = abs(offset_s)
    text = f"{size:.6g} s" if size >= 10.0 else f"{size * 1e3:.3g} ms"
    return f"{text} {'late' if offset_s > 0.0 else 'early'}"


def _culprit(calibration: Calibration, stream: str, late_s: float) -> Finding:
    pairs = [pair for pair in _pairs(calibration) if calibration.follows(pair)]
    sigma = min(_offset(calibration, pair).sigma_s for pair in pairs)
    fault, how = FAULTS[stream], ""
    if abs(late_s) > OTHER_EPOCH_S:
        fault, how = "epoch_mismatch", ": they count from another origin"
    elif stream == "lidar":
        fault, how = _instant(calibration, late_s, sigma)
    if len(pairs) < 2:
        how += "; only two streams can be compared, so it may be the other one's"
    topic = _topics(calibration)[stream]
    mend = Mend("shift_stamps", topic, {"offset_s": -late_s})
    name = {"lidar": "lidar", "imu": "inertial unit", "wheels": "wheels"}[stream]
    return Finding(
        f"time.offset.{stream}",
        topic,
        "bad",
        f"stamps of the {name} are {_signed_ms(late_s)}{how}",
        fault,
        f"Subtract {late_s:.6g} s from its stamps, or stamp at the instant of measurement.",
        Estimate(late_s * 1e3, sigma * 1e3, "ms"),
        LIMITS_S["gyro"] * 1e3,
        (mend,),
    )


def _instant(calibration: Calibration, late_s: float, sigma_s: float) -> tuple[str, str]:
    """Whether the lidar's stamp is that of another beam than the first."""
    sweep_s = calibration.inputs.steps.sweep_s
    near_s = 3.0 * sigma_s + SAME_SWEEP_S
    if sweep_s > 4.0 * near_s:
        if abs(late_s - sweep_s) < near_s:
            return "scan_stamp_end", f", as long as a sweep takes ({sweep_s * 1e3:.4g} ms)"
        if abs(late_s - 0.5 * sweep_s) < near_s:
            return "scan_stamp_middle", f", half of what a sweep takes ({sweep_s * 1e3:.4g} ms)"
    return "time_offset_lidar", ""


def _drift(
    calibration: Calibration, offsets: dict[str, Offset], drifting: dict[str, float]
) -> list[Finding]:
    if not drifting:
        best = min(offsets.values(), key=lambda one: one.drift_sigma)
        estimate = Estimate(best.drift * 1e6, best.drift_sigma * 1e6, "ppm")
        topic = _topics(calibration)[_stream(best.pair)]
        one, other = PAIR_WORDS[best.pair]
        sure = 1.96 * best.drift_sigma < 10.0 * DRIFT_LIMIT
        words = f"clocks of {one} and {other} run apart by {estimate.value:.3g} ppm"
        words += f" ± {estimate.sigma:.2g}" + ("" if sure else "; a longer recording would tell")
        verdict: Verdict = "ok" if sure else "cannot tell"
        return [Finding("time.drift", topic, verdict, words, estimate=estimate, limit=10.0)]
    sigma = min(one.drift_sigma for one in offsets.values())
    return [_drifts(calibration, stream, rate, sigma) for stream, rate in drifting.items()]


def _drifts(calibration: Calibration, stream: str, rate: float, sigma: float) -> Finding:
    topic = _topics(calibration)[stream]
    begin_ns = int(calibration.model.steps.first_ns[0])
    return Finding(
        "time.drift",
        topic,
        "bad",
        f"its clock runs {abs(rate) * 1e6:.4g} ppm too {'fast' if rate > 0.0 else 'slow'}",
        "clock_drift",
        "Synchronise the clocks, or stamp all streams by one.",
        Estimate(rate * 1e6, sigma * 1e6, "ppm"),
        DRIFT_LIMIT * 1e6,
        (Mend("rescale_stamps", topic, {"drift_ppm": rate * 1e6, "origin_ns": str(begin_ns)}),),
    )
