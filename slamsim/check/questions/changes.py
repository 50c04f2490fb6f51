"""Sizes that change during the drive: a laser that was knocked, a clock that was set."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.explanation import LIMITS, PLACE_LIMIT_M
from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.model import UNKNOWNS
from slamsim.check.calibration.noise import Pieces
from slamsim.check.evidence import of_calibration
from slamsim.check.fault_groups import MOUNTING
from slamsim.check.findings import Curve, Finding, Measurement, Plot, decide
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge
from slamsim.check.questions.clocks.pairs import LIMITS_S
from slamsim.check.questions.inertial.gyroscope import BIAS_LIMIT_RAD_S
from slamsim.check.questions.laser.mounting import YAW_LIMIT_DEG
from slamsim.check.questions.streams.clock_steps import CLOCK_STEP
from slamsim.core.quantiles import chi_square, student_t
from slamsim.core.types import FloatArray

EXPLAINED = 0.001
"""Pieces on either side of a true step agree as noise makes them, but for this share of steps; a
size that wanders does not."""

LEAST_PIECES, UNTOLD_TIMES = 2, 4.0
"""On either side of a step: a single odd piece is no lasting change, nor is one beside another that
is so many times as unsure as the usual one."""


OTHERS_CHANGE = 4.0
"""Times their own limits: by no more do the other sizes of a piece change beside the one that is
asked for. With none at all the bias of a gyroscope is not known in pieces that turn at one rate;
with one limit a true step of it is told a fifth too small, for the whole fit's gain is off."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One of ``UNKNOWNS`` whose change is asked for. limit: in unit, which is factor times its
    own. words: what it is, in "... changes by"."""

    unknown: str
    words: str
    limit: float
    unit: str
    factor: float


LASER_MOVED = FaultKind(
    "laser_moved",
    "the laser's mount changes during the drive",
    (anywhere(*MOUNTING, "wheel_slip"),),
)
WHEELS_CHANGED = FaultKind(
    "wheels_changed",
    "the wheels change their size during the drive",
    (anywhere("wheel_radius", "wheel_track", "wheel_slip", "range_scale"),),
)
_TURNS = "turning on the spot and ten metres of straight driving, in both halves of the drive"
LASER = Question(
    "laser.steady",
    "the laser keeps its place on the base",
    (LASER_MOVED,),
    consequence="scans before and after the change do not fit one map",
    excitation_wanted=_TURNS,
)
CLOCKS = Question(
    "time.steps",
    "no clock is set during the drive",
    (CLOCK_STEP,),
    consequence="scans are placed where the robot was before or after",
    excitation_wanted="turning to and fro, ten times a minute",
)
INERTIAL = Question(
    "gyro.steady",
    "the gyroscope keeps its bias",
    (
        FaultKind(
            "gyro_bias_changed",
            "the gyroscope's bias changes during the drive",
            (anywhere("gyro_bias", "gyro_scale"),),
        ),
    ),
    consequence="the heading of a filter drifts from the change on",
    excitation_wanted="standing still, in both halves of the drive",
)
WHEELS = Question(
    "wheels.steady",
    "the wheels keep their size",
    (WHEELS_CHANGED,),
    consequence="no one calibration of the odometry holds for the whole drive",
    excitation_wanted=_TURNS,
)

_DEGREES = float(np.degrees(1.0))
"""In a radian."""
QUANTITIES: dict[Question, tuple[Quantity, ...]] = {
    LASER: (
        Quantity("laser_yaw_rad", "the laser's yaw", YAW_LIMIT_DEG, "deg", _DEGREES),
        Quantity("laser_x_m", "the laser's place along x", 1e3 * PLACE_LIMIT_M, "mm", 1e3),
        Quantity("laser_y_m", "the laser's place along y", 1e3 * PLACE_LIMIT_M, "mm", 1e3),
    ),
    CLOCKS: (
        Quantity("gyro_delay_s", "the inertial unit's offset", 1e3 * LIMITS_S["gyro"], "ms", 1e3),
        Quantity("wheel_delay_s", "the wheels' offset", 1e3 * LIMITS_S["wheel"], "ms", 1e3),
    ),
    INERTIAL: (
        Quantity("gyro_bias_rad_s", "the gyroscope's bias", BIAS_LIMIT_RAD_S, "rad/s", 1.0),
    ),
    WHEELS: (
        Quantity("path_gain", "the path by the wheels", 100.0 * LIMITS["radius"], "%", 100.0),
        Quantity("turn_gain", "the turn by the wheels", 100.0 * LIMITS["track"], "%", 100.0),
    ),
}


@dataclass(frozen=True, slots=True)
class _Step:
    """at_s: from and to, after the middle of the drive. size: after less before."""

    at_s: tuple[float, float]
    size: Measurement
    quantity: Quantity


def check_changes(calibration: Calibration) -> list[Finding]:
    """The largest lasting change of each kind of size."""
    pieces = calibration.fit.pieces
    if pieces is None or not calibration.scans_count or not calibration.comparable:
        return []
    findings, pieces = [], pieces.each_alone(_others_change())
    for question, quantities in QUANTITIES.items():
        asked = [one for one in quantities if calibration.model.free[UNKNOWNS.index(one.unknown)]]
        if asked:
            findings.append(_judged(question, calibration, pieces, asked))
    return findings


GROUP = QuestionGroup(
    "motion", 185, (LASER, CLOCKS, INERTIAL, WHEELS), of_calibration(check_changes), thorough=True
)


def _others_change() -> FloatArray:
    """(p,) by how much the unknowns may change, inf of those without a limit."""
    limits = np.full(len(UNKNOWNS), np.inf)
    limits[UNKNOWNS.index("gyro_gain")] = LIMITS["gyro"]
    for one in (one for each in QUANTITIES.values() for one in each):
        limits[UNKNOWNS.index(one.unknown)] = one.limit / one.factor
    return OTHERS_CHANGE * limits


def _judged(
    question: Question, calibration: Calibration, pieces: Pieces, quantities: list[Quantity]
) -> Finding:
    steps = [step for one in quantities for step in _steps(pieces, one)]
    subject = _subject(question, calibration)
    found = max(steps, key=_beyond, default=None)
    if found is None or decide(found.size, found.quantity.limit) != "fault":
        words = f"{len(pieces.middle_s)} pieces of the drive show no lasting change"
        return judge(question, subject, words, verdict="ok")
    since_s = calibration.model.first_s.min()
    begin_s, end_s = (at_s - since_s for at_s in found.at_s)
    one = found.quantity
    return judge(
        question,
        subject,
        f"{one.words} changes by {found.size.value:+.3g} {one.unit} between {begin_s:.0f} and "
        f"{end_s:.0f} s after the first scan",
        found.size,
        verdict="fault",
        limit=one.limit,
        advice="Look for what was knocked, loaded or restarted then; split the recording there.",
        plots=(_plot(calibration, pieces, one),),
    )


def _subject(question: Question, calibration: Calibration) -> str:
    inputs = calibration.inputs
    if question is LASER:
        return inputs.laser_frame
    if question is INERTIAL and inputs.gyro:
        return inputs.gyro.topic
    return inputs.wheels.topic if question is WHEELS and inputs.wheels else inputs.steps.topic


def _beyond(step: _Step) -> float:
    """By how many sigmas the change is beyond its limit."""
    return (abs(step.size.value) - step.quantity.limit) / step.size.sigma


def _steps(pieces: Pieces, one: Quantity) -> Iterator[_Step]:
    """Changes between any two neighbouring pieces, or within one, that explain the scatter."""
    place = UNKNOWNS.index(one.unknown)
    told = pieces.sigmas[:, place] < UNTOLD_TIMES * np.median(pieces.sigmas[:, place])
    moved, sigmas = pieces.moved[told, place], pieces.sigmas[told, place]
    middle_s, count = pieces.middle_s[told], int(told.sum())
    for end in range(LEAST_PIECES, count):
        for begin in (end, end + 1):
            if count - begin < LEAST_PIECES:
                continue
            before, after = _mean(moved[:end], sigmas[:end]), _mean(moved[begin:], sigmas[begin:])
            freedom, scatter = end + count - begin - 2, before[2] + after[2]
            if scatter > chi_square(1.0 - EXPLAINED, freedom):
                continue
            # Noise is as the pieces scatter about either side, few as they are (Student, Birge).
            wider = np.sqrt(max(scatter / freedom, 1.0)) * student_t(0.975, freedom) / 1.96
            size = Measurement(
                one.factor * (after[0] - before[0]),
                one.factor * float(np.hypot(before[1], after[1]) * wider),
                one.unit,
            )
            yield _Step((middle_s[end - 1], middle_s[begin]), size, one)


def _mean(values: FloatArray, sigmas: FloatArray) -> tuple[float, float, float]:
    """Weighted mean, its sigma, and the squared scatter about it."""
    weights = 1.0 / np.square(sigmas)
    mean = float((weights * values).sum() / weights.sum())
    return mean, float(1.0 / np.sqrt(weights.sum())), float((weights * (values - mean) ** 2).sum())


def _plot(calibration: Calibration, pieces: Pieces, one: Quantity) -> Plot:
    place = UNKNOWNS.index(one.unknown)
    seconds = pieces.middle_s - calibration.model.first_s.min()
    moved, half = pieces.moved[:, place], 1.96 * pieces.sigmas[:, place]
    curves = (
        Curve("by each piece of the drive", seconds, one.factor * moved),
        Curve("95 %, lower end", seconds, one.factor * (moved - half), "line"),
        Curve("95 %, upper end", seconds, one.factor * (moved + half), "line"),
    )
    title = f"Change of {one.words} against the whole drive"
    return Plot(title, "since the first scan (s)", one.unit, curves, (0.0,))
