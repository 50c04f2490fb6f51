"""Wheel slip and stalled counters: wheels against scans, second by second."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.distance_unit import SAME
from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.slip_beams import mistaken_scans
from slamsim.check.calibration.slipping import SlipSpells
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.check.questions.wheels.odometry import ODOMETRY_FROZEN
from slamsim.core.types import BoolArray
from slamsim.recording.choice import lidars

POSES_SHARE = 0.05
"""Of poses instead of counters so much of the whole must slip where no two spells follow each
other: scans that are matched wrongly err as much in corridors, now and then (fr079, aces, intel).
"""

IN_A_ROW_S = 1.5
SLIP_LIMIT_M, SLIP_LIMIT_RAD = 0.1, 0.15
"""Of all slips together: less is lost on any floor."""

STANDING = Question(
    "wheels.frozen",
    "the wheels turn whenever the scans move",
    (ODOMETRY_FROZEN,),
    limit=1.0,
    unit="s",
    consequence="a SLAM without good scans maps both ends of the gap onto each other",
    excitation_wanted="driving",
)
SLIP = Question(
    "wheels.slip",
    "the wheels roll where the scans go",
    (FaultKind("wheel_slip", "the wheels slip"),),
    limit=SLIP_LIMIT_M,
    unit="m",
    consequence="the odometry is off by this much where scans cannot correct it",
    excitation_wanted="turns that wheels and scans both see",
)


def check_slip(calibration: Calibration, mistaken: BoolArray | None = None) -> list[Finding]:
    """Wheels against scans, second by second. mistaken: (k,) the spells in which single beams
    say that the scans are wrong, none if not given."""
    spells, wheels = calibration.spells, calibration.model.wheels
    if spells is None or wheels is None:
        return []
    if not calibration.comparable:
        return [
            unanswered(SLIP, wheels.topic, "turns of wheels and scans do not follow each other")
        ]
    plot = Plot(
        "wheels against scans, second by second",
        "since the middle of the drive, s",
        "path, m",
        (
            Curve("wheels", spells.start_s, spells.wheels[:, 0]),
            Curve("scans", spells.start_s, spells.scans[:, 0]),
        ),
    )
    findings = [_standing(wheels, spells, plot)] if spells.frozen.any() else []
    slips = spells.slipping & ~(spells.beside_frozen & spells.frozen.any())
    no_slip = slips & (False if mistaken is None else mistaken)
    slips &= ~no_slip
    excess = np.abs(spells.wheels - spells.scans)[slips].sum(axis=0)
    limits = np.array([SLIP_LIMIT_M, SLIP_LIMIT_RAD])
    if not wheels.wired and not np.any(np.diff(spells.start_s[slips]) < IN_A_ROW_S):
        limits = np.maximum(limits, POSES_SHARE * np.abs(spells.wheels).sum(axis=0))
    slip = judge(
        SLIP,
        wheels.topic,
        f"in {int(slips.sum())} of {len(slips)} s wheels and scans differ, together by "
        f"{excess[0]:.2f} m and {np.degrees(excess[1]):.1f} deg{_beside(no_slip)}",
        Measurement(float(excess[0]), 0.0, "m"),
        verdict="fault" if (excess > limits).any() else "ok",
        limit=float(limits[0]),
        advice="Do not trust the wheels there: let scans or gyroscope tell the motion.",
        plots=(plot,),
    )
    return [*findings, slip]


def _slip_in_metres(evidence: RecordingEvidence) -> list[Finding]:
    """Scans that were matched at another scale than theirs tell no slip."""
    calibration, unit = evidence.calibration, evidence.wrong_unit
    findings = [] if calibration is None else check_slip(calibration, _mistaken(evidence))
    if unit is None or unit.side == "wheels":
        return findings
    if abs(unit.metres / evidence.metres_per_unit - 1.0) < SAME:
        return findings
    reason = f"ranges in {unit.name} were matched as if they were in metres"
    return [one.inconclusive(reason) for one in findings]


GROUP = QuestionGroup("motion", 130, (STANDING, SLIP), _slip_in_metres, thorough=True)


def _mistaken(evidence: RecordingEvidence) -> BoolArray | None:
    """(k,) the spells in which the scans are wrong, not the wheels; None where nothing slips."""
    calibration, motions = evidence.calibration, evidence.motions
    if motions is None or calibration is None or calibration.spells is None:
        return None
    if not calibration.spells.slipping.any():
        return None
    scans = next(one for one in lidars(evidence.recording) if one.topic == motions.topic)
    return mistaken_scans(calibration, scans, motions.range_noise_m)


def _beside(no_slip: BoolArray) -> str:
    """What is left out."""
    seconds = int(no_slip.sum())
    if not seconds:
        return ""
    return f"; in {seconds} s more they do, which single beams do not bear out"


def _standing(wheels: IntegratedMotion, spells: SlipSpells, plot: Plot) -> Finding:
    count = int(spells.frozen.sum())
    moved_m = float(np.abs(spells.scans - spells.wheels)[spells.frozen, 0].sum())
    return judge(
        STANDING,
        wheels.topic,
        {
            "ok": f"the wheels stand for {count} s while the scans move, which may be scans that "
            "were matched wrongly",
            "fault": f"the wheels stand still for {count} s while the scans move, by "
            f"{moved_m:.2f} m",
        },
        Measurement(float(count), 0.0, "s"),
        advice="Look for a driver that stalls; leave these spells to the scans.",
        plots=(plot,),
    )
