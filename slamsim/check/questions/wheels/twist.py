"""Is the odometry's twist the speed at which its pose moves, in the frame of the robot?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import SURE_SIGMAS, Curve, Finding, Measurement, Plot, decide
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.check.questions.wheels.counters import MOVED_M, MOVED_RAD
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry
from slamsim.recording.edits.motion import rotated
from slamsim.recording.repairs.base import Repair

MAX_OFF = 0.2
"""Of speed or turn rate, over most seconds. Drivers filter the twist or take the command for it:
that is right on average. Of what consumers do with it a fifth more is lost in the wheels' slip."""
LOOK_S, MIN_LOOKS = 1.0, 5
LONGEST_S = 3600.0
SAME_FRAME = 0.1
"""Of the motion: in the right frame most seconds differ by less."""
CLEARLY = 4.0
"""So many times better a frame must explain the motion than the other one does."""
LEAP, LEAP_SIGMAS = 0.3, 6.0
"""In m/s or rad/s, and in scatters of the twists: no robot on wheels changes its speed by so much
and back from one message to the next, least of all one whose poses do not."""
BESIDE = 2
"""Messages on either side that a leap is compared with."""
MAX_LEAPS = 5e-3
"""Of the messages in which the robot moves: above what is lost or repeated now and then."""
STRETCH_S, STEP_S = 10.0, 0.25
"""Over so long a stretch, looked at in such steps, a twist that is too large is told from one that
is late. In 23 drives of four simulators with twists filtered by 0.3 to 1 s, 0.3 s late or 0.3 s
early, no stretch is told; of 69 stretches of a fifth of a drive, with turn rates 1.9, 1.3 and 0.6
times as large, 61, 60 and 61 are: in the others the robot hardly turns."""
LEAST_IN_STRETCH = (0.5, 1.0)
"""Path, m, and turn, rad, without which a stretch says nothing."""
LEFT_OUT = 12
"""Steps of a stretch, those that are most off, without which it must be off too: poses that jump
are another fault, and a twist that is the command says for 3 s that a robot drives which was
stopped."""
MOST_ALIKE = 0.95
"""Correlation of what is left in neighbouring steps: a stretch has 40."""

TWIST = Question(
    "odometry.twist",
    "the twist is the speed of the pose, in the robot's frame",
    (
        FaultKind(
            "odometry_twist",
            "the odometry's twist is not the speed of its pose in the robot's frame",
        ),
    ),
    limit=100.0 * MAX_OFF,
    unit="%",
    consequence="filters that read the twist drive another path than the poses",
    excitation_wanted="some seconds of driving and turning, with twists in the messages",
    repairs=("twist_from_poses",),
)


def check_twist(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each odometry by itself."""
    for odometry in evidence.recording.odometries:
        yield _twist(odometry)


GROUP = QuestionGroup("odometry", 62, (TWIST,), check_twist)


@dataclass(frozen=True, slots=True, eq=False)
class _Looks:
    """(k, 2) x and y in the robot's frame, m, and (k,) turn, rad, in a second: by the poses, and by
    twists that are in the robot's frame, or in the world's. leaps: share of single messages, of
    those in which the robot moves, whose twist neither the others nor the poses know. stretch: the
    one that is most clearly off. whole: by how many % speed and turn rate are too large in all."""

    moved: FloatArray
    turned: FloatArray
    by_twist: FloatArray
    by_world_twist: FloatArray
    turned_by_twist: FloatArray
    leaps: float
    stretch: _Stretch | None
    whole: tuple[Measurement, Measurement]


@dataclass(frozen=True, slots=True)
class _Stretch:
    """size: by how many % what of its twists is too large. begin_s: since the first message."""

    what: str
    size: Measurement
    begin_s: float


def _twist(odometry: RawOdometry) -> Finding:
    looks = _looks(odometry)
    if looks is None:
        words = "its messages hold no twists, or the robot hardly moves"
        return unanswered(TWIST, odometry.topic, words)
    moves, turns = (
        (np.linalg.norm(looks.moved, axis=1) > MOVED_M),
        (np.abs(looks.turned) > MOVED_RAD),
    )
    told, sizes = [], []
    if int(moves.sum()) >= MIN_LOOKS:
        if _is_of_world(looks, moves):
            told.append("its speeds are those in the frame of the odometry")
            sizes.append(_share(looks.by_twist[moves], looks.moved[moves]))
        else:
            moved, said = looks.moved[moves], looks.by_twist[moves]
            along = (said * moved).sum(axis=1) / np.square(moved).sum(axis=1)
            sizes.append(_but_for_delay(float(np.median(along)) - 1.0, looks.whole[0]))
            told.append(f"its speed is {1.0 + sizes[-1]:.4g} of that of its pose")
    if int(turns.sum()) >= MIN_LOOKS:
        ratio = looks.turned_by_twist[turns] / looks.turned[turns]
        sizes.append(_but_for_delay(float(np.median(ratio)) - 1.0, looks.whole[1]))
        told.append(f"its turn rate is {1.0 + sizes[-1]:.4g} of that")
    if not told:
        return unanswered(TWIST, odometry.topic, "the robot moves for too few seconds")
    size, limit = Measurement(100.0 * max(sizes, key=abs), 0.0, "%"), 100.0 * MAX_OFF
    if abs(size.value) <= limit and looks.leaps > MAX_LEAPS:
        size, limit = Measurement(100.0 * looks.leaps, 0.0, "%"), 100.0 * MAX_LEAPS
        told.append(f"and {size.value:.3g} % of its messages leap away from those beside them")
    elif abs(size.value) <= limit and looks.stretch is not None:
        size = looks.stretch.size
        told.append(
            f"but for {STRETCH_S:.0f} s, {looks.stretch.begin_s:.0f} s after the first message, "
            f"its {looks.stretch.what} is {1.0 + 0.01 * size.value:.3g} of that"
        )
    curves = (
        Curve("ahead (m/s)", looks.moved[:, 0], looks.by_twist[:, 0]),
        Curve("turn (rad/s)", looks.turned, looks.turned_by_twist),
    )
    return judge(
        TWIST,
        odometry.topic,
        ", ".join(told),
        size,
        limit=limit,
        advice="Fill in metres and radians per second in the frame of child_frame_id, x ahead.",
        repairs=(Repair("twist_from_poses", odometry.topic),),
        fault_plots=(Plot(f"Twist of {odometry.topic}", "by the pose", "by the twist", curves),),
    )


def _but_for_delay(too_large: float, whole: Measurement) -> float:
    """By the usual second, unless the whole drive, a delay fitted beside, says that all is well: of
    a robot that changes its speed twice a second, twists 0.3 s late are a quarter too small in most
    seconds."""
    is_delay = abs(too_large) > MAX_OFF and decide(whole, 100.0 * MAX_OFF) == "ok"
    return 0.01 * whole.value if is_delay else too_large


def _looks(odometry: RawOdometry) -> _Looks | None:
    twists = np.column_stack([odometry.linear_m_s[:, :2], odometry.angular_rad_s[:, 2]])
    sound = is_sound(twists) & is_sound(odometry.quats_xyzw) & is_sound(odometry.positions_m)
    if int(sound.sum()) < MIN_LOOKS or not np.any(twists[sound]):
        return None
    stamps_ns, first = np.unique(odometry.stamps_ns[sound], return_index=True)
    known_ns, track = planar_track(
        stamps_ns, odometry.positions_m[sound][first], odometry.quats_xyzw[sound][first]
    )
    times_s = (known_ns - known_ns[0]) * 1e-9
    if not MIN_LOOKS * LOOK_S < times_s[-1] < LONGEST_S:
        return None
    speeds = twists[sound][first]
    by_world = rotated(speeds[:, :2], -track[:, 2])
    totals = np.cumsum(_means(np.column_stack([speeds, by_world]), times_s), axis=0)
    totals = np.vstack([np.zeros(5), totals])

    def steps(edges_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3) x, y and turn by the poses, and (k, 5) by both kinds of twists."""
        poses = track_at(known_ns, track, known_ns[0] + np.rint(1e9 * edges_s).astype(np.int64))
        midway = 0.5 * (poses[:-1, 2] + poses[1:, 2])
        moved = rotated(np.diff(poses[:, :2], axis=0), -midway)
        # The chord of an arc is shorter than the arc, which speeds add up to.
        turned = np.diff(poses[:, 2])
        moved /= np.sinc(np.clip(turned, -np.pi, np.pi) / (2.0 * np.pi))[:, None]
        said = [np.interp(edges_s, times_s, column) for column in totals.T]
        return np.column_stack([moved, turned]), np.diff(np.column_stack(said), axis=0)

    edges_s = np.arange(0.0, times_s[-1], LOOK_S)
    known, said = steps(edges_s)
    leaps = _leaps(times_s, track, speeds)
    finely = steps(np.arange(0.0, times_s[-1], STEP_S))
    turn_rate = _too_large(*(one[:, 2] for one in finely))
    return _Looks(
        known[:, :2],
        known[:, 2],
        said[:, :2],
        said[:, 3:],
        said[:, 2],
        leaps,
        _worst_stretch(*finely),
        (_speed_too_large(*finely), turn_rate),
    )


def _speed_too_large(known: FloatArray, said: FloatArray) -> Measurement:
    """Of x and y, as far as the robot goes that way, the one that may be most off: of a robot
    that drives sideways, this may be wrong while the little that it goes ahead is right.

    known: (n, 3) x, y and turn in each step by the poses. said: (n, 5) by the twists.
    """
    path_m = np.abs(known[:, :2]).sum(axis=0)
    ways = np.flatnonzero(path_m >= SAME_FRAME * path_m.sum())
    return max((_too_large(known[:, way], said[:, way]) for way in ways), key=_most_off)


def _worst_stretch(known: FloatArray, said: FloatArray) -> _Stretch | None:
    """Of those in which twists are clearly too large or too small; None without one.

    known: (n, 3) x, y and turn in each step by the poses. said: (n, 5) by the twists.
    """
    count, worst = round(STRETCH_S / STEP_S), None
    for what, column, least in zip(("speed", "turn rate"), (0, 2), LEAST_IN_STRETCH, strict=True):
        for begin in range(0, len(known) - count + 1, round(LOOK_S / STEP_S)):
            steps = np.column_stack([known[:, column], said[:, column]])[begin : begin + count]
            if np.abs(steps[:, 0]).sum() < least:
                continue
            without = steps.copy()
            without[np.argsort(np.abs(steps[:, 1] - steps[:, 0]))[-LEFT_OUT:]] = 0.0
            size = min(_too_large(*steps.T), _too_large(*without.T), key=_least_off)
            is_worse = worst is None or _least_off(size) > _least_off(worst.size)
            if is_worse and decide(size, 100.0 * MAX_OFF) == "fault":
                worst = _Stretch(what, size, begin * STEP_S)
    return worst


def _least_off(size: Measurement) -> float:
    """How far off it is at least."""
    return abs(size.value) - SURE_SIGMAS * size.sigma


def _most_off(size: Measurement) -> float:
    """How far off it may be."""
    return abs(size.value) + 1.96 * size.scatter


def _too_large(known: FloatArray, said: FloatArray) -> Measurement:
    """By how many % what is said in each step (n,) is more than what is known.

    What is late is off by its delay times the speed, and what is filtered by its time constant
    times the speed it says: both are fitted besides, and are no fault. Told as far as sums and
    single steps both tell it: in sums noise adds up, in steps delays leave something.
    """
    gone, told = np.cumsum(known), np.cumsum(said)
    summed = _fitted(told - gone, gone, known, said)
    single = _fitted(said - known, known, np.gradient(known), np.gradient(said))
    off, sigma = min(summed[0], single[0], key=abs), max(summed[1], single[1])
    return Measurement(100.0 * off, 100.0 * sigma, "%")


def _fitted(off: FloatArray, *parts: FloatArray) -> tuple[float, float]:
    """How much of the first part (n,) what is off holds, and its standard deviation.

    What is left goes on from step to step, as of a robot that takes seconds to do what it is told:
    so many steps tell less than as many independent ones (a process of first order).
    """
    columns = np.column_stack([*parts, np.ones(len(off))])
    solve = np.linalg.pinv(columns)
    found = solve @ off
    left = off - columns @ found
    squares = float(left @ left)
    alike = float(np.clip(left[1:] @ left[:-1] / max(squares, 1e-18), 0.0, MOST_ALIKE))
    variance = squares / (len(off) - len(found)) * (1.0 + alike) / (1.0 - alike)
    return float(found[0]), float(np.sqrt(variance) * np.linalg.norm(solve[0]))


def _leaps(times_s: FloatArray, track: FloatArray, speeds: FloatArray) -> float:
    """track: (n, 3), speeds: (n, 3), at times (n,)."""
    around = 2 * BESIDE + 1
    if len(speeds) < around:
        return 0.0
    steps, midway = np.diff(track, axis=0), 0.5 * (track[1:, 2] + track[:-1, 2])
    by_pose = np.column_stack([rotated(steps[:, :2], -midway), steps[:, 2]])
    by_pose /= np.diff(times_s)[:, None]
    inside = slice(BESIDE, len(speeds) - BESIDE)
    usual = np.median(np.lib.stride_tricks.sliding_window_view(speeds, around, axis=0), axis=-1)
    off = np.abs(speeds[inside] - usual)
    # Counters with few steps a turn make leaps in poses as well, one step before or behind.
    before, after = by_pose[BESIDE - 1 : -BESIDE], by_pose[BESIDE : 1 - BESIDE]
    over = np.maximum(
        np.minimum(before, after) - speeds[inside], speeds[inside] - np.maximum(before, after)
    )
    # Twists of a robot that stands do not scatter, and say nothing of those of one that moves.
    across = track[2 * BESIDE :] - track[: -2 * BESIDE]
    lasts_s = (times_s[2 * BESIDE :] - times_s[: -2 * BESIDE]) / LOOK_S
    moves = np.linalg.norm(across[:, :2], axis=1) > MOVED_M * lasts_s
    moves |= np.abs(across[:, 2]) > MOVED_RAD * lasts_s
    if not moves.any():
        return 0.0
    # Lengths may be millimetres: a leap is as large a share of the robot's speed as well.
    fast = max(1.0, float(np.quantile(np.hypot(speeds[:, 0], speeds[:, 1]), 0.95)))
    scatter = LEAP_SIGMAS * SIGMAS_PER_MEDIAN * np.median(off[moves], axis=0)
    least = np.maximum(LEAP * np.array([fast, fast, 1.0]), scatter)
    return float(((off > least) & (over > least)).any(axis=1)[moves].mean())


def _means(values: FloatArray, times_s: FloatArray) -> FloatArray:
    """(n - 1, k) what values (n, k) add up to from each time to the next."""
    return np.asarray(0.5 * (values[1:] + values[:-1]) * np.diff(times_s)[:, None])


def _is_of_world(looks: _Looks, moves: FloatArray) -> bool:
    """Whether speeds explain the motion if they are taken for those in the world's frame, and not
    as they should be."""
    in_robot, in_world = (
        _share(said[moves], looks.moved[moves]) for said in (looks.by_twist, looks.by_world_twist)
    )
    return in_robot > SAME_FRAME and in_robot > CLEARLY * in_world


def _share(said: FloatArray, moved: FloatArray) -> float:
    """Of the motion, by which most seconds differ."""
    off = np.linalg.norm(said - moved, axis=1) / np.linalg.norm(moved, axis=1)
    return float(np.quantile(off, 0.75))
