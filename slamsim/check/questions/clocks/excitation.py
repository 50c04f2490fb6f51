"""Excitation of each unknown of the joint calibration, and which motion would add to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.evidence import RecordingEvidence, of_calibration
from slamsim.check.findings import Curve, Finding, Plot, Verdict
from slamsim.check.question import Question, QuestionGroup, judge, unanswered


@dataclass(frozen=True, slots=True)
class Need:
    """unknown: as in ``UNKNOWNS``. name: of it, for people. sigma: the standard deviation wanted.
    motion: which tells it."""

    unknown: str
    name: str
    sigma: float
    motion: str


_TURNS, _DRIVES = "turning to and fro, ten times a minute", "ten metres of straight driving"
NEEDS = (
    Need("gyro_delay_s", "delay of the gyroscope", 3e-4, _TURNS),
    Need("wheel_delay_s", "delay of the wheels", 1e-3, _TURNS),
    Need("gyro_gain", "scale of the gyroscope", 2e-3, "a few full turns to either side"),
    Need("gyro_bias_rad_s", "bias of the gyroscope", 1e-3, "standing still for some seconds"),
    Need("path_gain", "scale of the path", 1e-3, _DRIVES),
    Need("turn_gain", "scale of turns", 2e-3, "a few full turns to either side"),
    Need("curvature_rad_m", "curvature of the path", 5e-3, _DRIVES),
    Need("laser_x_m", "x of the laser", 3e-3, "turning on the spot to both sides"),
    Need("laser_y_m", "y of the laser", 3e-3, "turning on the spot to both sides"),
    Need("laser_yaw_rad", "yaw of the laser", 1e-3, _DRIVES),
)
"""About a fifth of the sizes that are faults."""

SENSORS = Question(
    "calibration",
    "two of lidar, inertial unit and wheels can be compared",
    (),
    consequence="nothing tells whether clocks, wheels and mounting are as declared",
    excitation_wanted="scans, inertial readings and wheels or odometry",
)
EXCITATION = Question(
    "motion.excitation",
    "the motion tells every unknown as sharply as it is wanted",
    (),
    consequence="errors of the unknowns that it does not tell go unnoticed",
    excitation_wanted="turning to both sides, and ten metres of straight driving",
)


def check_sensors(evidence: RecordingEvidence) -> list[Finding]:
    """Whether there is anything to compare."""
    if evidence.calibration is not None:
        return []
    words = "two of a lidar, an inertial unit and wheels are needed to compare them"
    if evidence.motions is not None and evidence.motions.weak:
        words += f"; the lidar tells no motion: {evidence.motions.weak}"
    return [unanswered(SENSORS, evidence.recording.name, words)]


SENSORS_GROUP = QuestionGroup("motion", 115, (SENSORS,), check_sensors, thorough=True)


def check_excitation(calibration: Calibration) -> list[Finding]:
    """One finding for all unknowns that are looked for."""
    model = calibration.model
    if not calibration.scans_count:
        return []
    there = {"gyro": model.gyro is not None, "other": model.wheels is not None}
    needs = [one for one in NEEDS if there["gyro" if one.unknown.startswith("gyro") else "other"]]
    reached = np.array([calibration.sigma(one.unknown) / one.sigma for one in needs])
    short = [(one, share) for one, share in zip(needs, reached, strict=True) if share > 1.0]
    words = f"the motion tells all {len(needs)} unknowns as sharply as they are wanted"
    if short:
        told = [f"{one.name} ({share:.1f} times too unsure: {one.motion})" for one, share in short]
        words = f"the motion tells too little of {'; '.join(told)}"
    rows = np.arange(len(needs), dtype=np.float64)
    plot = Plot(
        "How sharply the motion tells each unknown",
        "standard deviation over that wanted",
        "",
        (Curve("reached", reached, rows), Curve("wanted", np.ones(2), rows[[0, -1]], "line")),
        row_names=tuple(one.name for one in needs),
    )
    verdict: Verdict = "inconclusive" if short else "ok"
    return [judge(EXCITATION, "motion", words, verdict=verdict, plots=(plot,))]


GROUP = QuestionGroup("motion", 190, (EXCITATION,), of_calibration(check_excitation), thorough=True)
