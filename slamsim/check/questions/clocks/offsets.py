"""Clocks against each other: which stream is early or late, by how much, and which clock drifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.map_quality.agreement import with_map
from slamsim.check.map_quality.crispness import crispness
from slamsim.check.question import (
    SURE_SIGMAS,
    FaultKind,
    Question,
    QuestionGroup,
    decide,
    judge,
    unanswered,
)
from slamsim.check.questions.streams.epochs import EPOCH_MISMATCH
from slamsim.check.questions.streams.receipt import CLOCK_DRIFT, STAMPS_INVENTED
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

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
STREAM_NAMES = {"lidar": "lidar", "imu": "inertial unit", "wheels": "wheels"}

LATE_LIDAR = FaultKind(
    "time_offset_lidar", "the lidar's stamps are early or late against the other sensors"
)
STAMP_END = FaultKind("scan_stamp_end", "the stamp is that of the last beam, not the first")
STAMP_MIDDLE = FaultKind("scan_stamp_middle", "the stamp is that of the middle beam, not the first")
LATE_IMU = FaultKind(
    "time_offset_imu", "the inertial unit's stamps are early or late against the other sensors"
)
LATE_WHEELS = FaultKind(
    "time_offset_wheels", "the wheels' stamps are early or late against the other sensors"
)


def _offset_question(id_: str, meaning: str, *faults: FaultKind, limit_s: float) -> Question:
    return Question(
        id_,
        meaning,
        faults,
        limit=1e3 * limit_s,
        unit="ms",
        consequence="scans are freed of the wrong motion, and turn against odometry and map",
        excitation_wanted=TURNING,
        repairs=("shift_stamps",) if faults else (),
    )


PAIRS = {
    pair: _offset_question(
        f"time.offset.{'imu' if pair == 'gyro_wheel' else 'lidar'}_"
        f"{'imu' if pair == 'gyro' else 'wheels'}",
        f"{one} and {other} stamp one instant alike",
        limit_s=LIMITS_S[pair],
    )
    for pair, (one, other) in PAIR_WORDS.items()
}
CULPRITS = {
    stream: _offset_question(
        f"time.offset.{stream}",
        f"the {STREAM_NAMES[stream]}'s stamps are those of the instant of measurement",
        *faults,
        EPOCH_MISMATCH,
        limit_s=LIMITS_S["gyro"],
    )
    for stream, faults in {
        "lidar": (LATE_LIDAR, STAMP_END, STAMP_MIDDLE),
        "imu": (LATE_IMU,),
        "wheels": (LATE_WHEELS,),
    }.items()
}
STEADY = Question(
    "time.steady",
    "a steady clock explains the stamps of the scans",
    (STAMPS_INVENTED,),
    consequence="scans are placed where the robot was seconds before or after",
    excitation_wanted=TURNING,
)
DRIFT = Question(
    "time.drift",
    "all clocks run at one rate",
    (CLOCK_DRIFT,),
    limit=1e6 * DRIFT_LIMIT,
    unit="ppm",
    consequence="streams that agree at the begin are milliseconds apart in the end",
    excitation_wanted="a longer recording",
    repairs=("rescale_stamps",),
)


@dataclass(frozen=True, slots=True)
class Offset:
    """One pair of streams: offset at the begin of what was compared, s, and drift, s/s.

    bound_s: the least standard deviation possible. gained_s: by the drift, over the recording.
    """

    pair: str
    offset_s: float
    sigma_s: float
    bound_s: float
    drift: float
    drift_sigma: float
    gained_s: float

    @property
    def size(self) -> Measurement:
        """In ms."""
        return Measurement(1e3 * self.offset_s, 1e3 * self.sigma_s, "ms", 1e3 * self.bound_s)

    @property
    def is_off(self) -> bool:
        return decide(self.size, 1e3 * LIMITS_S[self.pair]) == "fault"

    @property
    def drifts(self) -> bool:
        return (
            abs(self.drift) > DRIFT_LIMIT
            and abs(self.gained_s) > GAINED_LIMIT_S
            and abs(self.drift) > SURE_SIGMAS * self.drift_sigma
        )


def check_timing(calibration: Calibration) -> list[Finding]:
    """Each pair of streams, then the stream whose stamps are wrong."""
    pairs = _pairs(calibration)
    offsets = {pair: _offset(calibration, pair) for pair in pairs if calibration.follows(pair)}
    late = _most_likely({pair: (one.offset_s, one.sigma_s) for pair, one in offsets.items()})
    one_message = calibration.inputs.together
    late = late if any(one.is_off for one in offsets.values()) and not one_message else {}
    drifting = _most_likely({pair: (one.drift, one.drift_sigma) for pair, one in offsets.items()})
    drifting = drifting if any(one.drifts for one in offsets.values()) and not one_message else {}
    return [
        *_contradicted(calibration),
        *_pair_findings(calibration, offsets),
        *(_culprit(calibration, stream, late_s) for stream, late_s in late.items()),
        *(_drift(calibration, offsets, drifting) if offsets else ()),
    ]


def _with_map(evidence: RecordingEvidence) -> list[Finding]:
    """``check_timing``, and what the map says of each offset."""
    calibration, unit = evidence.calibration, evidence.wrong_unit
    if calibration is None:
        return []
    recorded = evidence.as_recorded
    placed = recorded if unit is not None and unit.side == "ranges" else calibration
    assert placed is not None
    found = crispness(evidence.recording, evidence.motions, placed)
    return with_map(check_timing(calibration), found)


GROUP = QuestionGroup(
    "motion",
    150,
    (STEADY, *PAIRS.values(), *CULPRITS.values(), DRIFT),
    _with_map,
    thorough=True,
)


def _contradicted(calibration: Calibration) -> list[Finding]:
    """Stamps of scans that no clock explains: numbered evenly by a converter, if they are even."""
    if calibration.alignment.scans != "unsteady":
        return []
    topic = calibration.inputs.steps.topic
    words = "turns of the scans follow those of gyroscope and wheels, but at no steady clock"
    if not calibration.inputs.even_stamps:
        words += ": their stamps scatter too much to compare them"
        return [unanswered(STEADY, topic, words)]
    return [
        judge(
            STEADY,
            topic,
            f"{words}, although their stamps are evenly spaced",
            verdict="fault",
            advice="Record again: a converter has numbered the scans and forgotten the lost ones.",
        )
    ]


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


def _most_likely(differences: dict[str, tuple[float, float]]) -> dict[str, float]:
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


def _pair_findings(calibration: Calibration, offsets: dict[str, Offset]) -> list[Finding]:
    """All pairs but those that differ: which stream of these is wrong is told apart."""
    return [
        _pair(calibration, pair, offsets.get(pair))
        for pair in _pairs(calibration)
        if pair not in offsets or not offsets[pair].is_off or calibration.inputs.together
    ]


def _pair(calibration: Calibration, pair: str, offset: Offset | None) -> Finding:
    """What was measured between two streams."""
    one, other = PAIR_WORDS[pair]
    subject = _topics(calibration)[_stream(pair)]
    if offset is None:
        shift = calibration.shift(pair)
        why = "nothing turns" if shift is None else f"correlation {shift.correlation:.2f}"
        words = f"turns of {one} and {other} do not follow each other ({why}): {TURNING} would tell"
        return unanswered(PAIRS[pair], subject, words)
    words = (
        f"stamps of the {one} are {_signed_ms(offset.offset_s)} against those of the {other}, "
        f"± {offset.sigma_s * 1e3:.3g} ms (at best {offset.bound_s * 1e3:.2g} ms)"
    )
    harm = 1e3 * HARM_S[pair]
    verdict = decide(offset.size, 1e3 * LIMITS_S[pair], harm, enough=False)
    if calibration.inputs.together:
        words += "; both carry one stamp, so the pose may just be older or newer than the scan"
        return judge(PAIRS[pair], subject, words, offset.size, verdict=verdict)
    return judge(PAIRS[pair], subject, words, offset.size, harm=harm, enough=False)


def _stream(pair: str) -> str:
    return "imu" if pair == "gyro" else "wheels"


def _signed_ms(offset_s: float) -> str:
    size = abs(offset_s)
    text = f"{size:.6g} s" if size >= 10.0 else f"{size * 1e3:.3g} ms"
    return f"{text} {'late' if offset_s > 0.0 else 'early'}"


def _culprit(calibration: Calibration, stream: str, late_s: float) -> Finding:
    pairs = [pair for pair in _pairs(calibration) if calibration.follows(pair)]
    sigma = min(_offset(calibration, pair).sigma_s for pair in pairs)
    question, how = CULPRITS[stream], ""
    fault = question.faults[0]
    if abs(late_s) > OTHER_EPOCH_S:
        fault, how = EPOCH_MISMATCH, ": they count from another origin"
    elif stream == "lidar":
        fault, how = _instant(calibration, late_s, sigma)
    if len(pairs) < 2:
        how += "; only two streams can be compared, so it may be the other one's"
    topic = _topics(calibration)[stream]
    return judge(
        question,
        topic,
        f"stamps of the {STREAM_NAMES[stream]} are {_signed_ms(late_s)}{how}",
        Measurement(late_s * 1e3, sigma * 1e3, "ms"),
        verdict="fault",
        fault=fault,
        advice=f"Subtract {late_s:.6g} s from its stamps, or stamp at the instant of measurement.",
        repairs=(Repair("shift_stamps", topic, {"offset_s": -late_s}),),
    )


def _instant(calibration: Calibration, late_s: float, sigma_s: float) -> tuple[FaultKind, str]:
    """Whether the lidar's stamp is that of another beam than the first."""
    sweep_s = calibration.inputs.steps.sweep_s
    near_s = 3.0 * sigma_s + SAME_SWEEP_S
    if sweep_s > 4.0 * near_s:
        if abs(late_s - sweep_s) < near_s:
            return STAMP_END, f", as long as a sweep takes ({sweep_s * 1e3:.4g} ms)"
        if abs(late_s - 0.5 * sweep_s) < near_s:
            return STAMP_MIDDLE, f", half of what a sweep takes ({sweep_s * 1e3:.4g} ms)"
    return LATE_LIDAR, ""


def _drift(
    calibration: Calibration, offsets: dict[str, Offset], drifting: dict[str, float]
) -> list[Finding]:
    if not drifting:
        best = min(offsets.values(), key=lambda one: one.drift_sigma)
        size = Measurement(best.drift * 1e6, best.drift_sigma * 1e6, "ppm")
        one, other = PAIR_WORDS[best.pair]
        words = f"clocks of {one} and {other} run apart by {size.value:.3g} ppm ± {size.sigma:.2g}"
        return [
            judge(
                DRIFT,
                _topics(calibration)[_stream(best.pair)],
                {"ok": words, "inconclusive": f"{words}; a longer recording would tell"},
                size,
                enough=False,
                doubt=1e7 * DRIFT_LIMIT,
            )
        ]
    sigma = min(one.drift_sigma for one in offsets.values())
    return [_drifts(calibration, stream, rate, sigma) for stream, rate in drifting.items()]


def _drifts(calibration: Calibration, stream: str, rate: float, sigma: float) -> Finding:
    topic = _topics(calibration)[stream]
    begin_ns = int(calibration.model.steps.first_ns[0])
    correction: dict[str, float | str] = {"drift_ppm": rate * 1e6, "origin_ns": str(begin_ns)}
    return judge(
        DRIFT,
        topic,
        f"its clock runs {abs(rate) * 1e6:.4g} ppm too {'fast' if rate > 0.0 else 'slow'}",
        Measurement(rate * 1e6, sigma * 1e6, "ppm"),
        verdict="fault",
        advice="Synchronise the clocks, or stamp all streams by one.",
        repairs=(Repair("rescale_stamps", topic, correction),),
    )
