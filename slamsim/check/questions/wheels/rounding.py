"""Are the poses of an odometry written with enough digits? The step that all of them keep."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    anywhere,
    judge,
    same_subject,
    unanswered,
)
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry

DECIMALS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Steps of numbers that are rounded for writing, in metres, radians or degrees. Counters that are
coarse keep a step, too, when the robot turns on the spot, but none of these."""
TOLERANCE = 2e-6
"""What single precision leaves of a rounded number of some metres or radians."""
LEAST_DISTINCT = 20
LEAST_KINDS = 3
"""So many multiples of a step, and so many lengths of what is between two messages, must occur: a
robot that turns by right angles alone, or at one rate, keeps a step however finely it is written.
"""
WALL_M, HARM_M = 10.0, 0.05
"""A step moves a wall so far away by no more than a map's cell."""

ROUNDING = Question(
    "odometry.rounding",
    "poses are written with enough digits",
    (
        FaultKind(
            "odometry_coarse",
            "poses of the odometry are rounded to large steps",
            (
                anywhere("wheel_slip", "odometry_jump", "odometry_frozen"),
                same_subject("time_offset_wheels"),  # 0.01 rad are turned in some 20 ms
            ),
        ),
    ),
    limit=1e3 * HARM_M,
    unit="mm",
    consequence="walls 10 m away jump to and fro by this much from scan to scan",
    excitation_wanted=f"driving and turning, over {LEAST_DISTINCT} steps of what is written",
    limit_of_ok=False,
)


def check_rounding(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each odometry by itself."""
    for odometry in evidence.recording.odometries:
        yield _judged(odometry)


GROUP = QuestionGroup("odometry", 63, (ROUNDING,), check_rounding)


def _judged(odometry: RawOdometry) -> Finding:
    poses = np.column_stack([odometry.positions_m[:, :2], yaw_from_xyzw(odometry.quats_xyzw)])
    poses = poses[is_sound(poses)]
    if len(poses) < LEAST_DISTINCT:
        few = f"{len(poses)} poses do not show whether they keep a common step"
        return unanswered(ROUNDING, odometry.topic, f"{few}; it takes {ROUNDING.excitation_wanted}")
    place_m = min(kept_step(poses[:, axis]) for axis in (0, 1))
    turn_rad = _heading_step(poses[:, 2])
    shown = [f"{1e3 * place_m:.3g} mm"] * (place_m > 0.0)
    shown += [f"{np.degrees(turn_rad):.3g} deg"] * (turn_rad > 0.0)
    words = f"poses are {' and '.join(shown)} or a multiple of that apart"
    return judge(
        ROUNDING,
        odometry.topic,
        words if shown else "poses keep no common step",
        Measurement(1e3 * max(place_m, WALL_M * turn_rad), 0.0, "mm"),
        advice="Publish poses as they are computed, in double precision.",
        fault_plots=(_plot(odometry.topic, poses),),
    )


def _heading_step(yaw_rad: FloatArray) -> float:
    """Rounded before or after it was wrapped; in radians or in degrees. yaw_rad: (n,), wrapped."""
    turns = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])
    unwrapped = [np.unwrap(yaw_rad) + turn for turn in turns]
    steps = [kept_step(each) for each in (yaw_rad, *unwrapped)]
    return max(*steps, float(np.radians(kept_step(np.degrees(yaw_rad)))))


def kept_step(values: FloatArray) -> float:
    """The largest of ``DECIMALS`` of which all values are multiples, 0 of none, or if these are
    too few to tell. values: (n,)."""
    for step in DECIMALS:
        counts = np.rint(values / step)
        if (np.abs(values - counts * step) < TOLERANCE).all():
            kinds = np.unique(counts).size, np.unique(np.diff(counts)).size
            return step if kinds[0] >= LEAST_DISTINCT and kinds[1] >= LEAST_KINDS else 0.0
    return 0.0


def _plot(topic: str, poses: FloatArray) -> Plot:
    """The first motion: what is rounded moves by steps. poses: (n, 3)."""
    moving = np.flatnonzero((np.diff(poses, axis=0) != 0.0).any(axis=1))
    begin = int(moving[0]) if moving.size else 0
    part = slice(begin, begin + 10 * LEAST_DISTINCT)
    number = np.arange(len(poses), dtype=np.float64)[part]
    heading = np.degrees(np.unwrap(poses[:, 2]))[part]
    curve = Curve("heading", number, heading)
    return Plot(f"Headings of {topic}", "message", "heading (deg)", (curve,))
