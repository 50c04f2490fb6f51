"""What scans that overlap say of their own shape: angle between beams, sweep, range offset.

Straight walls bend when the angle between beams is wrong, and places move when a turn comes full
circle; scans taken at other speeds do not fit each other when the time between beams is wrong.
No other sensor is asked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.judge import SURE_SIGMAS, Answer, Question, judged
from slamsim.recording import RecordingFormat
from slamsim.slam.laser.scan_motion import ScanMotions, ShapeEstimate

ANGLE_LIMIT, ANGLE_HARM = 5e-4, 0.01
"""0.05 % between beams is a fifth of a degree in a full turn; walls are no straighter."""

OFFSET_LIMIT_M, OFFSET_HARM_M = 0.03, 0.1
"""What edges of the beam and dark surfaces do to a healthy lidar, and what blurs a map."""

SWEEP_LIMIT, SWEEP_LIMIT_S = 0.05, 5e-4
"""Errors of the time between beams up to this share, or of the sweep up to this, do no harm."""

SWEEP_HARM = 0.4
MEANT = 0.15
"""Sweeps this near to nothing, or to minus the declared one, are meant to be so."""

UNTIMED_LIMIT_S = 4e-3
"""Robots of the kind turn by less than a quarter of a degree in that time."""

UNTIMED_HARM_S = 0.05
NO_FIELD: tuple[RecordingFormat, ...] = ("carmen",)
"""Formats that have no place for the time between beams."""

PLOTTED_SIGMAS = 8.0
MOVING = "driving a few metres and turning at changing speed, in a place with walls on all sides"


@dataclass(frozen=True, slots=True)
class _Fault:
    """meaning: what it says, in words. mend: its subject is still to be named."""

    name: str
    meaning: str
    advice: str
    mend: Mend


def check_angles(motions: ScanMotions) -> list[Finding]:
    """The unit of the angles, and the angle between beams."""
    found = motions.angle_step
    error = 100.0 * (1.0 / found.value - 1.0)
    sigma = 100.0 * found.sigma / found.value**2
    topic = motions.topic
    step = judged(
        Question(
            *("laser.angle_step", topic, "laser_angle_step"),
            *(100.0 * ANGLE_LIMIT, 100.0 * ANGLE_HARM, MOVING),
        ),
        Estimate(error, sigma, "%"),
        Answer(
            f"the declared angle between beams is {error:+.3g} % off the one at which scans fit",
            f"Multiply the angle between beams by {found.value:.6g}, about the middle beam.",
            (Mend("scale_angles", topic, {"factor": found.value}),),
        ),
    )
    return [_unit(motions), step]


def _unit(motions: ScanMotions) -> Finding:
    degrees = motions.radians_per_unit != 1.0
    return Finding(
        check="laser.angle_unit",
        subject=motions.topic,
        verdict="bad" if degrees else "ok",
        words="the beams span several turns if their angles are radians, a fan if they are degrees"
        if degrees
        else "the beams span no more than a turn or two",
        fault="laser_degrees" if degrees else None,
        advice="Publish angle_min, angle_max and angle_increment in radians." if degrees else "",
        mends=(Mend("angles_to_radians", motions.topic),) if degrees else (),
    )


def check_range_offset(motions: ScanMotions) -> Finding:
    """Ranges that are too long or too short by a constant."""
    found = motions.range_offset_m
    unit = motions.metres_per_unit
    return judged(
        Question(
            *("ranges.offset", motions.topic, "range_offset"),
            *(1e3 * OFFSET_LIMIT_M, 1e3 * OFFSET_HARM_M, MOVING),
        ),
        Estimate(1e3 * found.value, 1e3 * found.sigma, "mm"),
        Answer(
            f"ranges are {1e3 * found.value:+.3g} mm too long",
            f"Subtract {found.value / unit:.4g} from every range.",
            (Mend("add_to_ranges", motions.topic, {"offset_m": -found.value / unit}),),
        ),
    )


def check_sweep(motions: ScanMotions, recorded_as: RecordingFormat) -> Finding:
    """Whether beams fire when the scan says: one after the other, all at once, backward."""
    found = motions.sweep_s
    if found.declared == 0.0:
        return _untimed(motions, recorded_as)
    share, sigma = found.value / found.declared, found.sigma / abs(found.declared)
    off = abs(share - 1.0)
    estimate = Estimate(share, sigma, "of the declared time")
    told = f"the sweep lasts {share:.3g} ± {1.96 * sigma:.2g} of the declared time"
    late = off > SWEEP_LIMIT and off * abs(found.declared) > SWEEP_LIMIT_S
    bad = _named(estimate) if late and off > SURE_SIGMAS * sigma else None
    known = off + 1.96 * sigma < SWEEP_HARM
    return _sweep_finding(motions, (told, known), (estimate, SWEEP_LIMIT), bad)


def _named(share: Estimate) -> _Fault:
    """Zero and minus one have names of their own."""
    near = max(SURE_SIGMAS * share.sigma, MEANT)
    if abs(share.value) < near:
        return _Fault(
            "flash_scan_timed",
            "all beams see one instant, or were deskewed already",
            "Declare a time between beams of 0.",
            Mend("scale_beam_times", "", {"factor": 0.0}),
        )
    if abs(share.value + 1.0) < near:
        return _Fault(
            "beam_time_reversed",
            "the last beam fired first",
            "Publish the beams in the order of their firing, with a negative angle between them.",
            Mend("scale_beam_times", "", {"factor": -1.0}),
        )
    return _Fault(
        "beam_time_scale",
        "the time between beams is wrong",
        f"Multiply the time between beams by {share.value:.4g}.",
        Mend("scale_beam_times", "", {"factor": share.value}),
    )


def _untimed(motions: ScanMotions, recorded_as: RecordingFormat) -> Finding:
    found = motions.sweep_s
    size, doubt = 1e3 * abs(found.value), 1e3 * found.sigma
    estimate, limit = Estimate(1e3 * found.value, doubt, "ms"), 1e3 * UNTIMED_LIMIT_S
    told = "the beams are declared as of one instant; by scans that overlap they take "
    told += f"{estimate.value:.3g} ± {1.96 * doubt:.2g} ms"
    sure, known = size > max(SURE_SIGMAS * doubt, limit), size + 1.96 * doubt < 1e3 * UNTIMED_HARM_S
    bad = None
    if sure and recorded_as in NO_FIELD:
        told += f", which {recorded_as} logs have no place for"
    elif sure:
        bad = _Fault(
            "rolling_scan_untimed",
            "the beams fire one after the other",
            "Declare the time between beams, so that scans can be freed of motion.",
            Mend("set_sweep", "", {"sweep_s": found.value}),
        )
    return _sweep_finding(motions, (told, known), (estimate, limit), bad)


def _sweep_finding(
    motions: ScanMotions,
    told: tuple[str, bool],
    size: tuple[Estimate, float],
    bad: _Fault | None,
) -> Finding:
    words, known = told
    if bad is not None:
        words = f"{bad.meaning}: {words}"
    elif not known:
        words += f", too unsure to tell; what would tell: {MOVING}"
    return Finding(
        check="laser.sweep",
        subject=motions.topic,
        verdict="bad" if bad is not None else "ok" if known else "cannot tell",
        words=words,
        fault=None if bad is None else bad.name,
        advice="" if bad is None else bad.advice,
        estimate=size[0],
        limit=size[1],
        mends=() if bad is None else (replace(bad.mend, subject=motions.topic),),
        plots=(_plot(motions.sweep_s),),
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
