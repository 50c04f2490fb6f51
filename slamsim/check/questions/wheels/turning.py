"""An odometry that drives on and never turns, while gyroscope, counters, scans or others turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.fault_groups import SIZES
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.inputs import as_odometry
from slamsim.check.motion.integrated import IntegratedMotion, integrated_odometry, integrated_wheels
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.check.questions.wheels.counters import MOVED_M, MOVED_RAD
from slamsim.check.questions.wheels.odometry import ODOMETRY_FROZEN
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawOdometry
from slamsim.recording.repairs.base import Repair

LOOK_S = 1.0
CONSTANT_RAD = 1e-6
"""Counters and filters scatter by more in a second of driving, rounding to six digits by less."""
LEAST_S, LEAST_TURN_RAD = 3.0, 1.0
"""Pushed along a wall wheels may roll straight on while the robot turns, but not for so long."""
LEAST_WHILE_STILL_RAD = 6.0
"""A robot that is lifted and carried does not turn round again and again."""

NO_TURN = Question(
    "odometry.turning",
    "the odometry turns when the robot does",
    (
        FaultKind(
            "odometry_no_turn",
            "the odometry drives on and does not turn with the robot",
            (
                anywhere(
                    *SIZES,
                    *("odometry_contradicts_wheels", "tf_contradicts_odometry"),
                    *("odometries_contradict", "time_offset_wheels", "time_offset_lidar"),
                    *("wheels_swapped", "wheel_reversed", "laser_world_fixed", "odometry_frozen"),
                    *("laser_angle_step", "time_offset_imu", "clock_drift", "range_offset"),
                    *("gyro_bias", "odometry_twist"),
                ),
            ),
        ),
        ODOMETRY_FROZEN,
    ),
    limit=LEAST_S,
    unit="s",
    consequence="the map is one straight corridor",
    excitation_wanted="stamps in order",
    repairs=("odometry_from_ticks",),
    limit_of_ok=False,
)


@dataclass(frozen=True, slots=True, eq=False)
class _Turns:
    """What another stream turns, rad, from begin_ns to end_ns (n,)."""

    topic: str
    begin_ns: IntArray
    end_ns: IntArray
    turned: FloatArray


def check_turning(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each odometry against every other stream that tells turns."""
    recording = evidence.recording
    edges = [one for one in recording.moving if one.child == evidence.base]
    motions = [
        evidence.inputs.gyro,
        *map(integrated_wheels, recording.ticks),
        *map(integrated_odometry, recording.odometries),
        *(integrated_odometry(as_odometry(edge)) for edge in edges),
    ]
    others = [_by_the_second(one) for one in motions if one is not None]
    if len(evidence.inputs.steps):
        others.append(_by_windows(evidence.inputs.steps))
    for odometry in recording.odometries:
        if np.any(np.diff(odometry.stamps_ns) < 0):
            words = "its stamps go backward, so that it is unknown what it says when"
            yield unanswered(NO_TURN, odometry.topic, words)
            continue
        never = _never_moves(odometry, others)
        yield from [never] if never else _missed(odometry, others, bool(recording.ticks))


GROUP = QuestionGroup("motion", 110, (NO_TURN,), check_turning, thorough=True)


def _by_the_second(motion: IntegratedMotion) -> _Turns:
    edges_s = np.arange(0.0, min(float(motion.times_s[-1]), 1e6), LOOK_S)
    turned = np.diff(motion.at(edges_s)[:, -1])
    at_ns = motion.origin_ns + np.rint(1e9 * edges_s).astype(np.int64)
    # A bias is no turn: most of the time robots drive straight on.
    usual = float(np.median(turned)) if turned.size and motion.totals.shape[1] == 1 else 0.0
    return _Turns(motion.topic, at_ns[:-1], at_ns[1:], turned - usual)


def _by_windows(steps: LaserSteps) -> _Turns:
    """Of scans, over each stretch of neighbouring ones."""
    windows, which = np.unique(steps.window, return_inverse=True)
    begin = np.full(windows.size, np.iinfo(np.int64).max)
    end = np.full(windows.size, np.iinfo(np.int64).min)
    np.minimum.at(begin, which, steps.first_ns)
    np.maximum.at(end, which, steps.second_ns)
    turned = np.bincount(which, steps.T_first_second[:, 2])
    return _Turns(steps.topic, begin, end, np.asarray(turned))


def _never_moves(odometry: RawOdometry, others: list[_Turns]) -> Finding | None:
    """A pose that is one and the same in all messages, while another stream turns again and
    again."""
    if len(odometry) < 2:
        return None
    same = np.ptp(np.column_stack([odometry.positions_m, odometry.quats_xyzw]), axis=0)
    if np.any(same > CONSTANT_RAD) or not np.isfinite(same).all():
        return None
    for other in others:
        turns = np.abs(other.turned) > MOVED_RAD
        seconds = float((other.end_ns - other.begin_ns)[turns].sum()) * 1e-9
        turned = float(np.abs(other.turned[turns]).sum())
        if seconds >= LEAST_S and turned >= LEAST_WHILE_STILL_RAD:
            return judge(
                NO_TURN,
                odometry.topic,
                f"its pose is the same in all messages, while {other.topic} turns by "
                f"{np.degrees(turned):.0f} deg",
                Measurement(seconds, 0.0, "s"),
                fault=ODOMETRY_FROZEN,
                advice="Look for a driver that publishes before its counters are connected.",
            )
    return None


def _missed(odometry: RawOdometry, others: list[_Turns], has_ticks: bool) -> Iterator[Finding]:
    known_ns, track = planar_track(odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw)
    if known_ns.size < 2:
        return
    for other in others:
        within = (other.begin_ns >= known_ns[0]) & (other.end_ns <= known_ns[-1])
        within &= np.abs(other.turned) > MOVED_RAD
        begin_ns, end_ns = other.begin_ns[within], other.end_ns[within]
        constant = _is_constant(known_ns, track[:, 2], begin_ns, end_ns)
        from_to = [track_at(known_ns, track, at_ns)[:, :2] for at_ns in (begin_ns, end_ns)]
        moved = np.linalg.norm(from_to[1] - from_to[0], axis=1) > MOVED_M
        missed = constant & moved
        seconds = float((end_ns - begin_ns)[missed].sum()) * 1e-9
        turned = float(np.abs(other.turned[within][missed]).sum())
        if seconds < LEAST_S or turned < LEAST_TURN_RAD:
            continue
        since_s = (known_ns - known_ns[0]) * 1e-9
        spells = (np.stack([begin_ns, end_ns], axis=1)[missed] - known_ns[0]) * 1e-9
        curve = Curve("heading of the odometry", since_s, track[:, 2], "line")
        yield judge(
            NO_TURN,
            odometry.topic,
            f"its heading stays the same for {seconds:.0f} s of driving in which {other.topic} "
            f"turns by {np.degrees(turned):.0f} deg",
            Measurement(seconds, 0.0, "s"),
            advice="Look for a driver that does not fill in the orientation, or for one wheel's "
            "counter that is read twice.",
            repairs=(Repair("odometry_from_ticks", odometry.topic),) if has_ticks else (),
            fault_plots=(
                Plot(
                    f"Heading by {odometry.topic} (shaded: {other.topic} turns)",
                    "stamp (s)",
                    "heading (rad)",
                    (curve,),
                    spans=tuple((float(begin), float(end)) for begin, end in spells),
                ),
            ),
        )
        return
    words = "its heading changes wherever others see the robot turn"
    yield judge(NO_TURN, odometry.topic, words, Measurement(0.0, 0.0, "s"))


def _is_constant(
    known_ns: IntArray, heading: FloatArray, begin_ns: IntArray, end_ns: IntArray
) -> FloatArray:
    """(m,) whether the heading (n,) never changes from begin to end (m,)."""
    changed = np.concatenate([[0], np.cumsum(np.abs(np.diff(heading)) > CONSTANT_RAD)])
    first = np.searchsorted(known_ns, begin_ns, side="right") - 1
    last = np.searchsorted(known_ns, end_ns, side="left")
    return np.asarray(changed[last] == changed[first])
