"""Clock offsets and drifts between streams: which stream is early or late, and by how much."""

from __future__ import annotations

from dataclasses import replace

from slamsim.check.calibration.joint import Calibration
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.alignment import Shift
from slamsim.check.motion.coarse_offset import CLEAR
from slamsim.check.question import FaultKind, Question, anywhere, judge, same_subject, unanswered
from slamsim.check.questions.clocks.pairs import (
    DRIFT_LIMIT,
    LIMITS_S,
    PAIR_WORDS,
    Offset,
    most_likely,
    offset_of,
    pairs_of,
    stream_of,
)
from slamsim.check.questions.streams.epochs import EPOCH_MISMATCH
from slamsim.check.questions.streams.receipt import CLOCK_DRIFT, STAMPS_INVENTED
from slamsim.check.wording import taken_off
from slamsim.guard.quantities import as_interval
from slamsim.recording.repairs.base import Repair

OTHER_EPOCH_S = 1e5
"""More than a day: no queue is so long, it is another origin of time."""
SAME_SWEEP_S = 5e-4
"""Beside three sigmas: the sweep of a lidar is known no better from its own scans."""
TURNING = "turning to and fro, ten times a minute"
_UNTOLD = "no two of the three agree, so nothing tells which two are wrong"
_SYNCHRONISE = "Synchronise the clocks, or stamp all streams by one."
STREAM_NAMES = {"lidar": "lidar", "imu": "inertial unit", "wheels": "wheels"}

_RECEIPT = (same_subject("stamps_future", "stamps_late"),)
"""Stamps that are wrong do not lie where receipt expects them."""

LATE_LIDAR = FaultKind(
    "time_offset_lidar",
    "the lidar's stamps are early or late against the other sensors",
    _RECEIPT,
)
STAMP_END = FaultKind(
    "scan_stamp_end", "the stamp is that of the last beam, not the first", _RECEIPT
)
STAMP_MIDDLE = FaultKind(
    "scan_stamp_middle", "the stamp is that of the middle beam, not the first", _RECEIPT
)
LATE_IMU = FaultKind(
    "time_offset_imu",
    "the inertial unit's stamps are early or late against the other sensors",
    _RECEIPT,
)
LATE_WHEELS = FaultKind(
    "time_offset_wheels",
    "the wheels' stamps are early or late against the other sensors",
    (*_RECEIPT, anywhere("tf_contradicts_odometry")),
)
CLOCKS_APART = FaultKind(
    "clocks_apart",
    "no two of lidar, inertial unit and wheels stamp one instant alike",
    LATE_WHEELS.explains,
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
        repairs=("shift_stamps",),
    )


PAIRS = {
    pair: _offset_question(
        f"time.offset.{'imu' if pair == 'gyro_wheel' else 'lidar'}_"
        f"{'imu' if pair == 'gyro' else 'wheels'}",
        f"{one} and {other} stamp one instant alike",
        CLOCKS_APART,
        limit_s=LIMITS_S[pair],
    )
    for pair, (one, other) in PAIR_WORDS.items()
}
CULPRITS = {
    stream: _offset_question(
        f"time.offset.{stream}",
        f"stamps of the {STREAM_NAMES[stream]} are those of the instant of measurement",
        *faults,
        EPOCH_MISMATCH,
        limit_s=LIMITS_S["wheel" if stream == "wheels" else "gyro"],
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


def check_timing(calibration: Calibration) -> list[Finding]:
    """Each pair of streams, then the stream whose stamps are wrong, where one can be told."""
    pairs = pairs_of(calibration)
    offsets = {pair: offset_of(calibration, pair) for pair in pairs if calibration.follows(pair)}
    late = {} if calibration.inputs.together else _late(calibration, offsets)
    return [
        *_contradicted(calibration),
        *_pair_findings(calibration, offsets, told=bool(late)),
        *(_culprit(calibration, offsets, stream, late_s) for stream, late_s in late.items()),
        *(_drift(calibration, offsets) if offsets else ()),
    ]


def _late(calibration: Calibration, offsets: dict[str, Offset]) -> dict[str, float]:
    """The streams that are to blame, with how late each is; empty if none is, or nothing tells."""
    wrong = {pair for pair, one in offsets.items() if one.is_off}
    seen = {pair: (one.offset_s, one.sigma_s) for pair, one in offsets.items()}
    late = most_likely(seen, wrong, LIMITS_S)
    if late or len(wrong) < len(PAIRS):
        return late
    # Two streams are late, any two. A lidar late by a sweep, or half of one, is no accident.
    between_s = offsets["gyro_wheel"].offset_s
    found = [
        {"lidar": -offsets[pair].offset_s, other: other_s}
        for pair, other, other_s in (("gyro", "wheels", between_s), ("wheel", "imu", -between_s))
        if _instant(calibration, -offsets[pair].offset_s, offsets[pair].sigma_s)[0] != LATE_LIDAR
    ]
    return found[0] if len(found) == 1 else {}


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


def _topics(calibration: Calibration) -> dict[str, str]:
    inputs = calibration.inputs
    return {
        "lidar": inputs.steps.topic,
        "imu": inputs.gyro.topic if inputs.gyro else "",
        "wheels": inputs.wheels.topic if inputs.wheels else "",
    }


def _pair_findings(
    calibration: Calibration, offsets: dict[str, Offset], told: bool
) -> list[Finding]:
    """All pairs. told: but those that are off, for a stream that is wrong is told by itself."""
    return [
        _pair(calibration, pair, offsets.get(pair))
        for pair in pairs_of(calibration)
        if not (told and pair in offsets and offsets[pair].is_off)
    ]


def _pair(calibration: Calibration, pair: str, offset: Offset | None) -> Finding:
    """What was measured between two streams."""
    one, other = PAIR_WORDS[pair]
    subject = _topics(calibration)[stream_of(pair)]
    if offset is None:
        words = (
            f"turns of {one} and {other} {_unlike(calibration.shift(pair))}: {TURNING} would tell"
        )
        return unanswered(PAIRS[pair], subject, words)
    words = (
        f"stamps of the {one} are {_signed_ms(offset.offset_s)} against those of the {other}, "
        f"± {offset.sigma_s * 1e3:.3g} ms (at best {offset.bound_s * 1e3:.2g} ms)"
    )
    if calibration.inputs.together and offset.is_off:
        words += "; both carry one stamp, so the pose may just be older or newer than the scan"
        return judge(PAIRS[pair], subject, words, offset.size, verdict="inconclusive")
    if offset.is_off:
        words += f"; {_UNTOLD}"
    return judge(
        PAIRS[pair],
        subject,
        words,
        offset.size,
        advice="Record with all clocks kept together, and stamp at the instant of measurement.",
        repairs=_onto_imu(calibration, "shift_stamps", pair, {"offset_s": -offset.offset_s}),
    )


def _onto_imu(
    calibration: Calibration, operation: str, pair: str, correction: dict[str, float | str]
) -> tuple[Repair, ...]:
    """That which brings a stream to the clock of the inertial unit: where all three differ, each
    would do as well. correction: of the stream that the pair names first."""
    topics = _topics(calibration)
    if pair == "gyro":
        turned = {name: -v if isinstance(v, float) else v for name, v in correction.items()}
        return (Repair(operation, topics["lidar"], turned),)
    return (Repair(operation, topics["wheels"], correction),) if pair == "gyro_wheel" else ()


def _unlike(shift: Shift | None) -> str:
    """Why the turns of two streams tell no offset."""
    if shift is None:
        return "do not follow each other (nothing turns)"
    correlation = f"correlation {shift.correlation:.3f}"
    if abs(shift.correlation) < CLEAR:
        return f"do not follow each other ({correlation})"
    best_s = 1e-9 * abs(shift.shift_ns)
    return f"repeat: they are nearly as alike at other offsets as at {best_s:.3g} s ({correlation})"


def _signed_ms(offset_s: float) -> str:
    size = abs(offset_s)
    text = f"{size:.6g} s" if size >= 10.0 else f"{size * 1e3:.3g} ms"
    return f"{text} {'late' if offset_s > 0.0 else 'early'}"


def _of(stream: str, offsets: dict[str, Offset]) -> list[Offset]:
    """Those that compare a stream with another."""
    return [one for pair, one in offsets.items() if STREAM_NAMES[stream] in PAIR_WORDS[pair]]


def _culprit(
    calibration: Calibration, offsets: dict[str, Offset], stream: str, late_s: float
) -> Finding:
    surest = min(_of(stream, offsets), key=lambda one: one.sigma_s)
    question, how = CULPRITS[stream], ""
    fault = question.faults[0]
    if abs(late_s) > OTHER_EPOCH_S:
        fault, how = EPOCH_MISMATCH, ": they count from another origin"
    elif stream == "lidar":
        fault, how = _instant(calibration, late_s, surest.sigma_s)
    if len(offsets) < 2:
        how += "; only two streams can be compared, so it may be the other one's"
    topic = _topics(calibration)[stream]
    return judge(
        question,
        topic,
        f"stamps of the {STREAM_NAMES[stream]} are {_signed_ms(late_s)}{how}",
        replace(surest.size, value=late_s * 1e3, bound=None),
        verdict="fault",
        limit=1e3 * LIMITS_S[surest.pair],
        fault=fault,
        advice=f"{taken_off(late_s, 's', 'its stamps')}, or stamp at the instant of measurement.",
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


def _drift(calibration: Calibration, offsets: dict[str, Offset]) -> list[Finding]:
    """The stream whose clock drifts; where none can be told, the pairs that do."""
    drifts = {pair: one for pair, one in offsets.items() if one.drifts}
    seen = {pair: (one.drift, one.drift_sigma) for pair, one in offsets.items()}
    limits = {pair: 1e-6 * one.drift_limit_ppm for pair, one in offsets.items()}
    drifting = {} if calibration.inputs.together else most_likely(seen, set(drifts), limits)
    if drifting:
        return [
            _drifts(calibration, stream, rate, min(one.drift_sigma for one in _of(stream, offsets)))
            for stream, rate in drifting.items()
        ]
    best = min(offsets.values(), key=lambda one: one.drift_sigma)
    return [_apart(calibration, one) for one in drifts.values() or (best,)]


def _apart(calibration: Calibration, offset: Offset) -> Finding:
    """How two clocks run apart."""
    one, other = PAIR_WORDS[offset.pair]
    size = offset.drift_size
    words = f"clocks of {one} and {other} run apart by {as_interval(size.value, size.sigma)} ppm"
    together = calibration.inputs.together
    if offset.drifts and not together:
        words += f"; {_UNTOLD}"
    return judge(
        DRIFT,
        _topics(calibration)[stream_of(offset.pair)],
        words,
        size,
        verdict="inconclusive" if offset.drifts and together else None,
        limit=offset.drift_limit_ppm,
        advice=_SYNCHRONISE,
        repairs=_onto_imu(
            calibration, "rescale_stamps", offset.pair, _slowed(calibration, offset.drift)
        ),
    )


def _slowed(calibration: Calibration, rate: float) -> dict[str, float | str]:
    """What takes a drift off the stamps."""
    begin_ns = int(calibration.model.steps.first_ns[0])
    return {"drift_ppm": rate * 1e6, "origin_ns": str(begin_ns)}


def _drifts(calibration: Calibration, stream: str, rate: float, sigma: float) -> Finding:
    topic = _topics(calibration)[stream]
    return judge(
        DRIFT,
        topic,
        f"its clock runs {abs(rate) * 1e6:.4g} ppm too {'fast' if rate > 0.0 else 'slow'}",
        Measurement(rate * 1e6, sigma * 1e6, "ppm"),
        verdict="fault",
        advice=_SYNCHRONISE,
        repairs=(Repair("rescale_stamps", topic, _slowed(calibration, rate)),),
    )
