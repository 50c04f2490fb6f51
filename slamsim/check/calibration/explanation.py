"""Which wrong sizes explain the gains of scans, gyroscope and wheels together.

Scans, gyroscope and wheels each measure every turn, scans and wheels every path. One wrong size
changes several of these gains at once: wheels believed too large lengthen paths and turns alike,
ranges that are too long lengthen the paths of the scans alone, scans that turn too far contradict
gyroscope and wheels by one factor. The fewest sizes are taken that leave no other size at fault;
of those sets the one that fits best.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.model import UNKNOWNS
from slamsim.check.findings import Measurement, decide
from slamsim.core.types import BoolArray, FloatArray
from slamsim.slam.laser.scan_motion import ScanMotions, ShapeEstimate

Size = Literal["radius", "track", "gyro", "ranges", "scan_turns"]

EFFECTS: dict[Size, FloatArray] = {
    "radius": np.array([-1.0, -1.0, 0.0, 0.0]),
    "track": np.array([0.0, 1.0, 0.0, 0.0]),
    "gyro": np.array([0.0, 0.0, -1.0, 0.0]),
    "ranges": np.array([1.0, 0.0, 0.0, 0.0]),
    "scan_turns": np.array([0.0, 1.0, 1.0, 1.0]),
}
"""What a size that is too large by a small share changes: logarithms of the gains of path, turn
and gyroscope (scans over the other), and of the turns of the scans by their own shape."""

GAINS = ("path_gain", "turn_gain", "gyro_gain")

LIMITS: dict[Size, float] = {
    "radius": 0.0025,
    "track": 0.005,
    "gyro": 0.01,
    "ranges": 0.0025,
    "scan_turns": 0.0005,
}
"""Careful calibration leaves 0.2 % of the radius and 0.5 % of the track (Borenstein & Feng 1996);
consumer gyroscopes are sold with 1 % of scale error; ranges of a lidar are good to 0.2 %; 0.05 %
between beams is a fifth of a degree in a full turn, and walls are no straighter."""

PLACE_LIMIT_M = 0.005
"""What tape measures leave of the laser's place; tyres that give move the axle by a millimetre."""

HEALTHY_SHARE = 0.5
"""The standard deviation among healthy robots, as a share of the limit."""

OF_ROBOTS: tuple[Size, ...] = ("radius", "track", "gyro")
"""Sizes of robots, which scans measure."""

TOLD_BY_TURNS: tuple[Size, ...] = ("radius", "ranges")
"""Sizes of paths that turns tell by the track: as unsure as that they are when it is asked which
are wrong. With noise as the only doubt a track 0.3 % too narrow makes a fault of the radius,
whatever ranges are: 1 % too short, on the simulator's robot, they were called wheels of another
radius and track. Not radius and ranges by each other: which of the two it is ``RARER`` says."""

RARER: dict[Size, float] = {"ranges": 1.0, "scan_turns": 2.0}
"""Squared sigmas against what makes of a lidar as it left the factory: where the wheels, which a
robot's builder measures, explain as much, it is they. With 2, ranges that were 1 % too long
in the labyrinth, on the simulator's robot, whose wheels creep by 0.2 %, were called a radius."""

PATH_BIAS = 4e-4
"""By which share the paths of scans are off beyond their scatter: 0.033 % short on average over 32
drives of nine lidars (tests/independent, seeds 9 to 23), by noise as ``OFFSET_BIAS_SHARE``."""

MOST_WRONG = 3


@dataclass(frozen=True, slots=True)
class Explanation:
    """too_large: by how many per cent each size is, None where nothing tells. wrong: those at
    fault."""

    too_large: dict[Size, Measurement | None]
    wrong: frozenset[Size]


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where the laser sits, (2,) as declared and by its motion, in lengths of its scans, with
    standard deviations (2,), in m, and the part of them that is of tyres that give (2,)."""

    declared_m: FloatArray
    found_m: FloatArray
    sigmas_m: FloatArray
    given_m: FloatArray

    def is_wrong(self, too_long: float) -> bool:
        """If ranges are too long by this share."""
        off_m = self.found_m / (1.0 + too_long) - self.declared_m
        each = zip(off_m.tolist(), self.sigmas_m.tolist(), self.given_m.tolist(), strict=True)
        sizes = [Measurement(off, sigma, "m", allowed=given) for off, sigma, given in each]
        return any(decide(size, PLACE_LIMIT_M) == "fault" for size in sizes)


@dataclass(frozen=True, slots=True, eq=False)
class _Gains:
    """seen: (k,) known rows of ``EFFECTS``, noise: (k, k) their covariance, known: (4,) which rows
    these are. place: of the laser, None where none is declared."""

    seen: FloatArray
    noise: FloatArray
    known: BoolArray
    place: _Place | None = None

    def effects(self, sizes: tuple[Size, ...]) -> FloatArray:
        """(k, m)."""
        return np.array([EFFECTS[size] for size in sizes]).reshape(-1, 4)[:, self.known].T

    def covariance(self, others: Iterable[Size]) -> FloatArray:
        """(k, k) of the noise, and of what healthy robots differ by in these sizes."""
        sizes = tuple(others)
        columns = self.effects(sizes) * [HEALTHY_SHARE * LIMITS[size] for size in sizes]
        return np.asarray(self.noise + columns @ columns.T)

    def solver(self, sizes: tuple[Size, ...], covariance: FloatArray) -> FloatArray:
        """(m, k) sizes by weighted least squares are this times ``seen``."""
        columns = self.effects(sizes)
        weighted = np.linalg.solve(covariance, columns).T
        return np.asarray(np.linalg.solve(weighted @ columns, weighted))


def explain(calibration: Calibration, motions: ScanMotions | None = None) -> Explanation:
    """The fewest wrong sizes that make the gains of a joint calibration.

    motions: of its scans, for what they say of their own shape; None where it is not asked.
    """
    gains = _gains(calibration, motions)
    wrong = _fewest(gains)
    return Explanation({size: _told(gains, size, wrong) for size in EFFECTS}, frozenset(wrong))


def _gains(calibration: Calibration, motions: ScanMotions | None) -> _Gains:
    values = np.array([calibration.value(name) for name in GAINS])
    places = [UNKNOWNS.index(name) for name in GAINS]
    wheels = calibration.model.wheels is not None and calibration.follows("wheel")
    gyro = calibration.model.gyro is not None and calibration.follows("gyro")
    by_shape = motions is not None and bool(np.isfinite(motions.angle_step.sigma))
    known = np.array([wheels, wheels, gyro, by_shape]) & np.append(values != 0.0, True)
    seen, noise = np.zeros(4), np.zeros((4, 4))
    seen[:3] = np.log(np.abs(np.where(known[:3], values, 1.0)))
    noise[:3, :3] = calibration.covariance[np.ix_(places, places)] / np.outer(values, values)
    noise[0, 0] += np.square(PATH_BIAS)
    if motions is not None and by_shape:
        step, offset = _left(motions, 1), _left(motions, 2)
        seen[3] = -np.log(step.value)
        noise[3, 3] = np.square(step.sigma / step.value)
        seen[0] += motions.path_by_offset_per_m * offset.value
        noise[0, 0] += np.square(motions.path_by_offset_per_m * offset.sigma)
    return _Gains(seen[known], noise[np.ix_(known, known)], known, _place(calibration))


def _place(calibration: Calibration) -> _Place | None:
    declared = calibration.inputs.T_base_laser
    if declared is None:
        return None
    names = ("laser_x_m", "laser_y_m")
    return _Place(
        declared[:2],
        np.array([calibration.value(name) for name in names]),
        np.array([calibration.sigma(name) for name in names]),
        np.array([calibration.given(name) for name in names]),
    )


def _left(motions: ScanMotions, number: int) -> ShapeEstimate:
    """Angle step (1) or range offset (2) beyond what scans have been corrected by already."""
    found = (motions.sweep_s, motions.angle_step, motions.range_offset_m)[number]
    return replace(found, value=found.declared) if motions.contradicted[number] else found


def _fewest(gains: _Gains) -> tuple[Size, ...]:
    """Each of them a fault, and no other; all that can be told apart where no few explain it."""
    for count in range(MOST_WRONG + 1):
        sets = [chosen for chosen in _sets(gains, count) if _explains(gains, chosen)]
        if sets:
            return min(sets, key=lambda chosen: _misfit(gains, chosen))
    return ("radius", "track", "gyro")


def _sets(gains: _Gains, count: int) -> Iterator[tuple[Size, ...]]:
    """Sets of so many sizes that what is known tells apart."""
    for chosen in combinations(EFFECTS, count):
        if _told_apart(gains, chosen):
            yield chosen


def _told_apart(gains: _Gains, chosen: tuple[Size, ...]) -> bool:
    """Wheels alone tell the turns of scans no better than their track is known, ten times too
    little: gyroscope or the scans' own shape is needed."""
    if "scan_turns" in chosen and not gains.known[2:].any():
        return False
    return not chosen or bool(np.linalg.matrix_rank(gains.effects(chosen)) == len(chosen))


def _explains(gains: _Gains, wrong: tuple[Size, ...]) -> bool:
    """Whether all of them are at fault, and no other size then is."""
    at_fault = all(_at_fault(gains, size, wrong) == (size in wrong) for size in EFFECTS)
    return at_fault and not ("ranges" in wrong and _displaces_laser(gains, wrong))


def _displaces_laser(gains: _Gains, wrong: tuple[Size, ...]) -> bool:
    """Whether ranges that are wrong put a laser elsewhere that sits where it is declared to sit.

    Scans measure the lever arm of a turn in lengths of their own. An odometry whose path alone is
    scaled leaves it as long as it is; ranges would stretch it along with the path.
    """
    ranges = _size(gains, "ranges", wrong)
    if gains.place is None or ranges is None:
        return False
    return gains.place.is_wrong(ranges.value / 100.0) and not gains.place.is_wrong(0.0)


def _at_fault(gains: _Gains, size: Size, wrong: tuple[Size, ...]) -> bool:
    found = _size(gains, size, wrong)
    return found is not None and decide(found, 100.0 * LIMITS[size]) == "fault"


def _size(gains: _Gains, size: Size, wrong: tuple[Size, ...]) -> Measurement | None:
    """By how many per cent it is too large, with this and all that is wrong free.

    Weighed as if the others differed from nothing as those of healthy robots do; the sigma is that
    of the noise, and of the track in ``TOLD_BY_TURNS``.
    """
    unsure: tuple[Size, ...] = ("track",) if size in TOLD_BY_TURNS and "track" not in wrong else ()
    return _measured(gains, size, wrong, gains.covariance(EFFECTS), gains.covariance(unsure))


def _told(gains: _Gains, size: Size, wrong: tuple[Size, ...]) -> Measurement | None:
    """As ``_size``, and as unsure as sizes make it which differ from nothing on healthy robots too.

    Those of a robot are measured by scans, and turns tell a radius by the track. Ranges are
    measured by wheels, and are no surer than their radius: the simulator's robot rolls 0.20 % less
    than its wheels count, whatever its lidar (16 drives against the truth), and has its ranges
    called 0.27 % too short for it. Noise upon that made a fault of it in one of 14 short drives.
    """
    if size == "scan_turns":  # by their own shape
        return _size(gains, size, wrong)
    others = gains.covariance(other for other in OF_ROBOTS if other not in {*wrong, size})
    return _measured(gains, size, wrong, others, others)


def _measured(
    gains: _Gains,
    size: Size,
    wrong: tuple[Size, ...],
    weighed_by: FloatArray,
    noise: FloatArray,
) -> Measurement | None:
    """weighed_by, noise: (k, k) covariances of the gains for the value and for its sigma."""
    chosen = wrong if size in wrong else (*wrong, size)
    if not _told_apart(gains, chosen):
        return None
    solver = gains.solver(chosen, weighed_by)[chosen.index(size)]
    factor = float(np.exp(solver @ gains.seen))
    sigma = float(np.sqrt(solver @ noise @ solver))
    return Measurement(100.0 * (factor - 1.0), 100.0 * factor * sigma, "%")


def _misfit(gains: _Gains, wrong: tuple[Size, ...]) -> float:
    """Squared sigmas that are left, and what makes the set less likely beforehand."""
    left, covariance = gains.seen, gains.covariance(EFFECTS)
    if wrong:
        left = left - gains.effects(wrong) @ (gains.solver(wrong, covariance) @ left)
    squares = float(left @ np.linalg.solve(covariance, left))
    return squares + sum(RARER.get(size, 0.0) for size in wrong)
