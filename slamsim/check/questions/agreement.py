"""Is anything left when all sizes, clocks and mounts are fitted? A verdict without a cause.

Every other question knows one cause. Where none is found, and still the streams contradict each
other most of the time, that is told, with a picture of what is left.
"""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.slipping import LEAST_M, LEAST_RAD, LEAST_SHARE, SlipSpells
from slamsim.check.evidence import of_calibration
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.core.types import FloatArray

MOST_UNLIKE = 0.5
"""A robust fit breaks down where half of what it is given does not fit (Huber 1981). Of the real
logs aces, whose wheels slide, has 23 %, fr079 16 %; a healthy drive on a carpet has 12 %."""

LEAST_SPELLS = 20

DOES_NOT_FIT = FaultKind(
    "does_not_fit", "the streams do not tell one motion, and no known fault explains it"
)
WHEELS = Question(
    "motion.wheels",
    "wheels and scans tell one motion, once all that is known of them is fitted",
    (DOES_NOT_FIT,),
    limit=100.0 * MOST_UNLIKE,
    unit="%",
    consequence="a SLAM that believes the odometry tears the map",
    excitation_wanted="half a minute of driving and turning",
)
GYRO = Question(
    "motion.gyro",
    "gyroscope and scans tell one turn, once all that is known of them is fitted",
    (DOES_NOT_FIT,),
    limit=100.0 * MOST_UNLIKE,
    unit="%",
    consequence="a SLAM that believes the gyroscope tears the map where the robot turns",
    excitation_wanted="half a minute of driving and turning",
)
PATH, TURN = 0, 1


def check_agreement(calibration: Calibration) -> list[Finding]:
    """How often wheels and gyroscope contradict the scans, second by second."""
    spells, inputs = calibration.spells, calibration.inputs
    found: list[Finding] = []
    if spells is None:
        return found
    if inputs.wheels is not None:
        found.append(_judged(WHEELS, inputs.wheels.topic, spells, spells.wheels, (PATH, TURN)))
    if inputs.gyro is not None:
        turned = np.column_stack([np.zeros(len(spells.scans)), _by_gyro(calibration, spells)])
        found.append(_judged(GYRO, inputs.gyro.topic, spells, turned, (TURN,)))
    return found


GROUP = QuestionGroup("motion", 190, (WHEELS, GYRO), of_calibration(check_agreement), thorough=True)


def _by_gyro(calibration: Calibration, spells: SlipSpells) -> FloatArray:
    """(k,) turn of each spell, nan where it is not covered. One that the fit left out, for its
    turns have to do with those of no other stream, is taken at its best offset."""
    model, values, gyro = calibration.model, calibration.fit.values, calibration.inputs.gyro
    assert gyro is not None
    count, steps = len(spells.scans), model.steps
    if model.gyro is not None:
        turned, covered = model.predicted(values)[1], model.covered(values)[0]
    else:
        shift_ns = calibration.alignment.shifts_ns[0] - gyro.origin_ns
        begin_s, end_s = (
            np.asarray(1e-9 * (ns + shift_ns), np.float64)
            for ns in (steps.first_ns, steps.second_ns)
        )
        turned = np.asarray(gyro.at(end_s) - gyro.at(begin_s))[:, 0]
        covered = gyro.covers(begin_s, end_s)
    covered = covered & model.rolling(values)  # what the turns of the scans are summed over
    missing = np.bincount(spells.step_of, ~covered, count) > 0
    return np.where(missing, np.nan, np.bincount(spells.step_of, turned * covered, count))


def _judged(
    question: Question, topic: str, spells: SlipSpells, other: FloatArray, rows: tuple[int, ...]
) -> Finding:
    """other: (k, 2) path and turn of each spell by another stream; rows: those that it tells."""
    told = np.isfinite(other).all(axis=1)
    left, scans = (other - spells.scans)[told], spells.scans[told]
    if len(left) < LEAST_SPELLS:
        few = f"{len(left)} seconds in which it can be compared with the scans"
        return unanswered(question, topic, f"{few}; what would tell: {question.excitation_wanted}")
    extent = np.maximum(np.abs(other[told]), np.abs(scans))
    unlike = (np.abs(left) > spells.least[told]) & (np.abs(left) > LEAST_SHARE * extent)
    share = float(unlike[:, rows].any(axis=1).mean())
    sigma = float(np.sqrt(max(share * (1.0 - share), 1.0 / len(left)) / len(left)))
    start_s = spells.start_s[told]
    names = {PATH: "path (m)", TURN: "turn (rad)"}
    curves = tuple(Curve(names[row], start_s, left[:, row]) for row in rows)
    title = f"{topic} less the scans, with all sizes, clocks and mounts as fitted"
    return judge(
        question,
        topic,
        f"in {100.0 * share:.0f} % of the seconds it differs from the scans by more than "
        f"{_least(rows)}, and {100.0 * LEAST_SHARE:.0f} %, with all sizes, clocks and mounts as "
        "fitted",
        Measurement(100.0 * share, 100.0 * sigma, "%"),
        advice="The cause is not known: look at when they differ, and whether all streams are of "
        "one robot and one drive.",
        fault_plots=(Plot(title, "since the middle of the drive (s)", "in a second", curves),),
    )


def _least(rows: tuple[int, ...]) -> str:
    words = (f"{1e3 * LEAST_M:.0f} mm", f"{np.degrees(LEAST_RAD):.1f} deg")
    return " or ".join(words[row] for row in rows)
