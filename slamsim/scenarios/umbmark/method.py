"""UMBmark: systematic odometry errors from squares driven both ways.

J. Borenstein & L. Feng: Measurement and correction of systematic odometry errors in mobile
robots. IEEE Transactions on Robotics and Automation 12 (6), 1996. An error is the true end of a
square less the end by odometry, both seen from the start, which looks along x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.models.differential_drive import rolled_poses


@dataclass(frozen=True, slots=True)
class WheelCorrection:
    """diameter_ratio: E_d, right wheel over left. track_ratio: E_b, true track over nominal.

    sigmas: of both, by the scatter of what they were fitted to; None where it is not known.
    """

    diameter_ratio: float = 1.0
    track_ratio: float = 1.0
    sigmas: tuple[float, float] | None = None

    def factors(self) -> FloatArray:
        """(2,) true over nominal radius, left and right; their mean stays the nominal one."""
        ratio = self.diameter_ratio
        return np.array([2.0 / (ratio + 1.0), 2.0 * ratio / (ratio + 1.0)])


UNCORRECTED = WheelCorrection()


@dataclass(frozen=True, slots=True, eq=False)
class Square:
    """One square that was driven.

    rolled_m: (n, 2) how far each wheel rolled from reading to reading by its nominal radius, left
    and right. end_m: (2,) the true end. track_m: nominal.
    """

    counter_clockwise: bool
    rolled_m: FloatArray
    end_m: FloatArray
    track_m: float

    def error_m(self, calibration: WheelCorrection = UNCORRECTED) -> FloatArray:
        """(2,) true end less that of odometry."""
        rolled_m = self.rolled_m * calibration.factors()
        poses = rolled_poses(rolled_m, self.track_m * calibration.track_ratio, np.zeros(3))
        return np.asarray(self.end_m - poses[-1, :2])


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """End errors (n, 2) of each direction, clockwise and counter-clockwise."""

    clockwise_m: FloatArray
    counter_clockwise_m: FloatArray

    def centres_m(self) -> FloatArray:
        """(2, 2) centres of gravity, clockwise first."""
        return np.stack([self.clockwise_m.mean(axis=0), self.counter_clockwise_m.mean(axis=0)])

    def largest_m(self) -> float:
        """E_max: the distance of the farther centre from the origin."""
        return float(np.linalg.norm(self.centres_m(), axis=1).max())

    def spread_m(self) -> float:
        """The largest distance between two errors of one direction."""
        both = (self.clockwise_m, self.counter_clockwise_m)
        apart = [np.linalg.norm(e[:, None] - e[None], axis=-1).max() for e in both]
        return float(max(apart))

    def floor_m(self) -> float:
        """Expected distance of the farther centre from its place, by the scatter alone."""
        both = (self.clockwise_m, self.counter_clockwise_m)
        variances = [np.var(e, axis=0, ddof=1).sum() / len(e) for e in both if len(e) > 1]
        return float(np.sqrt(max(variances, default=0.0)))


def clusters(squares: Sequence[Square], calibration: WheelCorrection = UNCORRECTED) -> Clusters:
    """The end errors of all squares, of odometry with this calibration."""
    errors = np.array([square.error_m(calibration) for square in squares])
    left = np.array([square.counter_clockwise for square in squares])
    return Clusters(errors[~left], errors[left])


def classical(found: Clusters, side_m: float, track_m: float) -> WheelCorrection:
    """E_d and E_b by the formulas of 1996, for corners of about 90 degrees and small errors.

    They take x or y of the centres; here it is the mean of both. Raises SlamsimError for end errors
    that are too large for the formulas.
    """
    (x_cw, y_cw), (x_ccw, y_ccw) = found.centres_m().tolist()
    # A corner that is short by alpha, a side that turns left by beta.
    alpha = -((x_cw + x_ccw) + (y_cw - y_ccw)) / (8.0 * side_m)
    beta = -((x_cw - x_ccw) + (y_cw + y_ccw)) / (8.0 * side_m)
    half = np.sin(0.5 * beta) / side_m * track_m
    if abs(half) >= 1.0 or abs(alpha) >= 0.5 * np.pi:
        raise SlamsimError(
            f"the end errors of these squares (corner error {np.degrees(alpha):.0f} degrees, side "
            f"error {np.degrees(beta):.0f} degrees) are beyond the UMBmark formulas"
        )
    return WheelCorrection(
        diameter_ratio=float((1.0 + half) / (1.0 - half)),
        track_ratio=float(0.5 * np.pi / (0.5 * np.pi - alpha)),
    )


def fitted(squares: Sequence[Square]) -> WheelCorrection:
    """E_d and E_b with which odometry ends nearest to the true ends, by least squares.

    Each square is followed reading by reading, so that corners need not be of 90 degrees nor
    errors small.
    """

    def misses_m(logs: FloatArray) -> FloatArray:
        guess = WheelCorrection(*np.exp(logs).tolist())
        return np.concatenate([square.error_m(guess) for square in squares])

    solution = least_squares(misses_m, np.zeros(2), x_scale=(0.01, 0.05))
    ratios = np.exp(solution.x)
    freedom = max(solution.fun.size - 2, 1)
    variance = 2.0 * solution.cost / freedom
    slope = np.asarray(solution.jac)
    covariance = variance * np.linalg.pinv(slope.T @ slope)
    sigmas = ratios * np.sqrt(np.diag(covariance))
    return WheelCorrection(float(ratios[0]), float(ratios[1]), (float(sigmas[0]), float(sigmas[1])))


@dataclass(frozen=True, slots=True, eq=False)
class DrivenSquares:
    """The squares of one robot and size. sets: each with both directions, in their order.

    corner_deg, odometry_corner_deg: mean turn of all corners, true and by odometry.
    """

    robot: str
    side_m: float
    sets: tuple[tuple[Square, ...], ...]
    found: tuple[Clusters, ...]
    corner_deg: float
    odometry_corner_deg: float

    @property
    def largest_m(self) -> float:
        """E_max, mean of the sets."""
        return float(np.mean([found.largest_m() for found in self.found]))

    @property
    def spread_m(self) -> float:
        """Mean of the sets."""
        return float(np.mean([found.spread_m() for found in self.found]))


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionResult:
    """A robot calibrated on its first set and judged on all others.

    formulas: by those of 1996, None where they do not hold. true: where it is known. chance_m: how
    far a centre of gravity is from its place by the scatter of so few runs, of the set that was
    calibrated on and of the others together.
    """

    robot: str
    true: WheelCorrection | None
    formulas: WheelCorrection | None
    fitted: WheelCorrection
    before: Clusters
    after_formulas: Clusters | None
    after: Clusters
    chance_m: float

    @property
    def improvement(self) -> float:
        """By how much the fit makes E_max of the fresh squares smaller."""
        return self.before.largest_m() / max(self.after.largest_m(), 1e-9)
