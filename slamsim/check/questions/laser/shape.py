"""What scans that overlap say of their own shape: angle between beams, sweep, range offset.

Straight walls bend when the angle between beams is wrong, and places move when a turn comes full
circle; scans taken at other speeds do not fit each other when the time between beams is wrong.
No other sensor is asked.
"""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.explanation import Explanation
from slamsim.check.calibration.thinned import Thinned
from slamsim.check.fault_groups import LIDAR_TIMES, SWEEPS
from slamsim.check.findings import SURE_SIGMAS, Curve, Finding, Measurement, Plot, Verdict, decide
from slamsim.check.motion.laser_steps import (
    ANGLE_LIMIT,
    SWEEP_LIMIT,
    SWEEP_LIMIT_S,
    thinned_by,
    times_of_all,
)
from slamsim.check.question import FaultKind, Question, anywhere, judge
from slamsim.check.wording import signed_words, taken_off
from slamsim.recording import RecordingFormat
from slamsim.recording.repairs.base import Repair
from slamsim.slam.laser.calibration import NO_SWEEP
from slamsim.slam.laser.scan_motion import ScanMotions, ShapeEstimate

OFFSET_LIMIT_M = 0.03
"""What edges of the beam and dark surfaces do to a healthy lidar, and what blurs a map."""

MEANT = NO_SWEEP
"""Sweeps this near to nothing, or to minus the declared one, are meant to be so."""

UNTIMED_LIMIT_S = 4e-3
"""Robots of the kind turn by less than a quarter of a degree in that time."""

NO_FIELD: tuple[RecordingFormat, ...] = ("carmen",)
"""Formats that have no place for the time between beams."""

PLOTTED_SIGMAS = 8.0
"""To either side of the value that was found: both walls of the misfit are then seen."""
MOVING = "driving a few metres and turning at changing speed, in a place with walls on all sides"


LASER_ANGLE_STEP = FaultKind(
    "laser_angle_step", "the angle between beams is wrong", (anywhere("scan_folds"),)
)
FLASH = FaultKind(
    "flash_scan_timed",
    "beams of one instant are declared as fired one after the other",
    (anywhere(*LIDAR_TIMES, "laser_angle_step", "scans_overlap"),),
)
REVERSED = FaultKind(
    "beam_time_reversed",
    "the beams fire in the opposite order of what is declared",
    (anywhere(*LIDAR_TIMES, "laser_yaw", "laser_angle_step"),),
)
SCALED = FaultKind(
    "beam_time_scale", "the time between beams is wrong", (anywhere("scans_overlap", "scan_time"),)
)
UNTIMED = FaultKind(
    "rolling_scan_untimed",
    "beams fired one after the other are declared as of one instant",
    (anywhere(*LIDAR_TIMES, "laser_angle_step"),),
)

ANGLE_UNIT = Question(
    "laser.angle_unit",
    "angles are radians",
    (
        FaultKind(
            "laser_degrees",
            "angles in degrees where radians are asked for",
            (anywhere("laser_angle_step", "scan_folds", *SWEEPS, "range_offset"),),
        ),
    ),
    consequence="the beams point anywhere",
    repairs=("angles_to_radians",),
)
ANGLE_STEP = Question(
    "laser.angle_step",
    "the angle between beams is the one at which scans fit each other",
    (LASER_ANGLE_STEP,),
    limit=100.0 * ANGLE_LIMIT,
    unit="%",
    consequence="straight walls bend, and places move when the robot turns",
    excitation_wanted=MOVING,
    repairs=("scale_angles", "scale_beam_times"),
)
RANGE_OFFSET = Question(
    "ranges.offset",
    "ranges are neither too long nor too short by a constant",
    (FaultKind("range_offset", "ranges are too long or too short by a constant"),),
    limit=1e3 * OFFSET_LIMIT_M,
    unit="mm",
    consequence="corners are rounded, and passages too narrow or too wide by twice as much",
    excitation_wanted=MOVING,
    repairs=("add_to_ranges",),
)
SWEEP = Question(
    "laser.sweep",
    "beams fire when the scan says",
    (FLASH, REVERSED, SCALED, UNTIMED),
    limit=SWEEP_LIMIT,
    unit="of the declared time",
    consequence="scans are freed of the wrong motion: walls bend while the robot turns",
    excitation_wanted=MOVING,
    repairs=("scale_beam_times", "set_sweep"),
)


def check_angles(
    motions: ScanMotions, explained: Explanation | None, thinned: Thinned | None = None
) -> list[Finding]:
    """The unit of the angles, and the angle between beams.

    explained: whether gyroscope and wheels both say that the scans turn too far. thinned: which
    beams were kept.
    """
    if thinned is not None:
        return [_unit(motions), _of_thinned(motions, thinned)]
    found, by = motions.angle_step, "the one at which scans fit"
    factor, sigma = found.value, found.sigma
    turns = None if explained is None else explained.too_large["scan_turns"]
    if explained is not None and turns is not None and "scan_turns" in explained.wrong:
        corrected = found.value if motions.contradicted[1] else 1.0
        factor = corrected / (1.0 + turns.value / 100.0)
        sigma, by = factor * turns.sigma / 100.0, "the one at which scans turn as the others do"
    error = 100.0 * (1.0 / factor - 1.0)
    step = judge(
        ANGLE_STEP,
        motions.topic,
        f"the declared angle between beams is {signed_words(error, '%', 'larger', 'smaller')} "
        f"than {by}",
        Measurement(error, 100.0 * sigma / factor**2, "%"),
        advice=f"Multiply the angle between beams by {factor:.6g}, about the middle beam.",
        repairs=(Repair("scale_angles", motions.topic, {"factor": factor}),),
    )
    return [_unit(motions), step]


def _of_thinned(motions: ScanMotions, thinned: Thinned) -> Finding:
    """Beams were left out, and what is declared of all was kept: the angle between them and, most
    often, the time."""
    every, sigma = thinned.every, motions.angle_step.sigma
    repairs = [
        Repair("scale_angles", motions.topic, {"factor": float(every), "pivot": thinned.pivot})
    ]
    what, declared = "the angle", "is declared"
    if times_of_all(motions):
        repairs.append(Repair("scale_beam_times", motions.topic, {"factor": float(every)}))
        what, declared = "angle and time", "are declared"
    return judge(
        ANGLE_STEP,
        motions.topic,
        f"of every {every} beams one was kept, but {what} between beams {declared} as of all",
        Measurement(100.0 * (1.0 / every - 1.0), 100.0 * sigma / every**2, "%"),
        advice=f"Multiply {what} between beams by {every}, about the {thinned.pivot} beam.",
        repairs=repairs,
    )


def _unit(motions: ScanMotions) -> Finding:
    return judge(
        ANGLE_UNIT,
        motions.topic,
        {
            "ok": "the beams span no more than a turn or two",
            "fault": "the beams span several turns if their angles are radians, a fan if they are "
            "degrees",
        },
        verdict="ok" if motions.radians_per_unit == 1.0 else "fault",
        advice="Publish angle_min, angle_max and angle_increment in radians.",
        repairs=(Repair("angles_to_radians", motions.topic),),
    )


def check_range_offset(motions: ScanMotions) -> Finding:
    """Ranges that are too long or too short by a constant."""
    found = motions.range_offset_m
    recorded = found.value / motions.metres_per_unit
    return judge(
        RANGE_OFFSET,
        motions.topic,
        f"ranges are {signed_words(1e3 * found.value, 'mm', 'too long', 'too short')}",
        Measurement(1e3 * found.value, 1e3 * found.sigma, "mm"),
        advice=f"{taken_off(recorded, '', 'every range')}.",
        repairs=(Repair("add_to_ranges", motions.topic, {"offset_m": -recorded}),),
    )


def check_sweep(motions: ScanMotions, recorded_as: RecordingFormat) -> Finding:
    """Whether beams fire when the scan says: one after the other, all at once, backward."""
    found = motions.sweep_s
    if found.declared == 0.0:
        return _untimed(motions, recorded_as)
    share = Measurement(
        found.value / found.declared, found.sigma / abs(found.declared), "of the declared time"
    )
    words = f"the sweep lasts {share.value:.3g} ± {1.96 * share.sigma:.2g} of the declared time"
    fault, meaning, advice, factor = _named(share)
    finding = judge(
        SWEEP,
        motions.topic,
        {"ok": words, "inconclusive": words, "fault": f"{meaning}: {words}"},
        share,
        limit=max(SWEEP_LIMIT, SWEEP_LIMIT_S / abs(found.declared)),
        healthy=1.0,
        fault=fault,
        advice=advice,
        repairs=(Repair("scale_beam_times", motions.topic, {"factor": factor}),),
        plots=(_plot(found),),
    )
    if times_of_all(motions):  # told once, with the angle between beams
        return finding.inconclusive(
            f"as that of every {thinned_by(motions)} beams of which one was kept"
        )
    return finding


def _named(share: Measurement) -> tuple[FaultKind, str, str, float]:
    """Fault, what it says, advice, and what to multiply the time between beams by; zero and minus
    one have names of their own."""
    near = max(SURE_SIGMAS * share.sigma, MEANT)
    if abs(share.value) < near:
        meaning = "all beams see one instant, or were deskewed already"
        return FLASH, meaning, "Declare a time between beams of 0.", 0.0
    if abs(share.value + 1.0) < near:
        advice = (
            "Publish the beams in the order of their firing, with a negative angle between them."
        )
        return REVERSED, "the last beam fired first", advice, -1.0
    advice = f"Multiply the time between beams by {share.value:.4g}."
    return SCALED, "the time between beams is wrong", advice, share.value


def _untimed(motions: ScanMotions, recorded_as: RecordingFormat) -> Finding:
    found = motions.sweep_s
    size, limit = Measurement(1e3 * found.value, 1e3 * found.sigma, "ms"), 1e3 * UNTIMED_LIMIT_S
    words = (
        "the beams are declared as of one instant; by scans that overlap they take "
        f"{size.value:.3g} ± {1.96 * size.sigma:.2g} ms"
    )
    verdict: Verdict | None = None
    if recorded_as in NO_FIELD and decide(size, limit) == "fault":
        verdict, words = "ok", f"{words}, which {recorded_as} logs have no place for"
    return judge(
        SWEEP,
        motions.topic,
        {
            "ok": words,
            "inconclusive": words,
            "fault": f"the beams fire one after the other: {words}",
        },
        size,
        verdict=verdict,
        limit=limit,
        fault=UNTIMED,
        advice="Declare the time between beams, so that scans can be freed of motion.",
        repairs=(Repair("set_sweep", motions.topic, {"sweep_s": found.value}),),
        plots=(_plot(found),),
    )


def _plot(found: ShapeEstimate) -> Plot:
    """Misfit of scans that overlap, against how long the sweep is taken to last."""
    if not np.isfinite(found.sigma):
        return Plot("Misfit against sweep", "sweep (ms)", "misfit", ())
    reach = max(abs(found.value - found.declared), abs(found.value), PLOTTED_SIGMAS * found.sigma)
    sweep = np.linspace(found.value - 1.2 * reach, found.value + 1.2 * reach, 121)
    misfit = np.square((sweep - found.value) / found.sigma)
    top = float(misfit.max())
    mark = np.array([0.0, top])
    return Plot(
        title="Misfit of overlapping scans against the length of the sweep",
        x_label="time from the first beam to the last (ms)",
        y_label="misfit above the least (variances)",
        curves=(
            Curve("misfit", 1e3 * sweep, misfit, "line"),
            Curve("as declared", np.full(2, 1e3 * found.declared), mark, "line"),
            Curve("all beams at once", np.zeros(2), mark, "line"),
        ),
    )
