"""Where the laser sits on the base, by its own motion against wheels and gyroscope.

Hand-eye calibration: turns tell how far from the axle it sits, straight driving which way it looks
(Censi, Franchi, Marchionni & Oriolo 2013). Errors of wheels and gyroscope, and a delay between
their stamps and the lidar's, are unknowns of the same least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import adjoint, between, compose, inverse, wrap_angle
from slamsim.core.types import FloatArray
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.calibration.online import PRIOR_SIGMAS, Evidence, evidence, step_covariance
from slamsim.slam.calibration.solve import MEDIAN_CHI2_3, UNIT_BOUNDS
from slamsim.slam.frontend.motion import Odometry
from slamsim.slam.frontend.preintegration import OdometryNoise, OdometryStep
from slamsim.slam.laser.scan_motion import BundledWindow

MOUNT, DELAY = slice(PARAMETERS, PARAMETERS + 3), PARAMETERS + 3
FOUND = slice(PARAMETERS, PARAMETERS + 4)
PLACE_SIGMA_M, YAW_SIGMA_RAD, DELAY_SIGMA_S = 0.05, np.deg2rad(2.0), 0.05
"""Prior standard deviations: of a mount by tape measure and by eye, of stamps by software."""
ANY_YAW_SIGMA_RAD = np.pi / np.sqrt(3.0)
"""Of a direction that may be any."""

UNMODELLED = np.array([7e-4, 3e-4, 1e-4, 3e-4])
"""Standard deviation of x, y (m), yaw (rad) and delay (s) beyond noise: tyres give when they push,
so that the robot turns about another point, and later. Fitted to the physics of the simulated
TurtleBot2."""

STRETCH_SCANS = 8
"""Scans from which to which steps are compared: half a second to some seconds, in which wheels
hardly slip and scans overlap."""

ROUNDS = 8
STILL_SIGMAS = 0.01
"""A step smaller than this changes no interval that is reported."""
HEARD_SHARE = 0.99
"""Of a stretch that a gyroscope tells: all of it, but for what sums round."""
FIT_SQUARED = 2.0
"""Scans and odometry are one motion if the median of the squared errors is no more than so many
times that of three normal variables. Of the four that a gyroscope makes it is 1.4 times that, give
or take 0.4 of twelve stretches; seven healthy drives came to 0.2 at most, skidding robots to 3 and
more."""
DOUBT_SQUARED = 9.0
"""Errors of three sigmas count half (Cauchy)."""
DELAY_STEP_S, DELAY_ROUNDS = 0.02, 4
"""Of the central difference over time: long against the noise of odometry, short against the turns
of a robot. A delay that is longer is found about where it was found before."""
MOUNT_STEP = 1e-4
"""Of the central differences over mount and wheels, in metres and radians: their curvature is below
rounding there."""
ROUNDING = 1e-12
"""Variance added so that noiseless odometry can be inverted: a micrometre."""
TURNED_RAD, TURNED_SHARE = np.deg2rad(20.0), 0.9
"""A laser that looks so far elsewhere, ten prior sigmas, is no error by eye: its frame is that of
another one, most often turned by 180 degrees. Believed if its steps keep their direction to the
odometry's: of all lengths so much is left when they are added, which steps that scatter by 25
degrees leave."""
LEAST_STRETCHES = 12
LEAST_WINDOWS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """off: (4,) T_base_laser (x_m, y_m, yaw_rad) as found less as declared, and the seconds by
    which the laser measured later than it says. sigmas: (4,) by the scatter of so many windows.
    fits: whether scans and odometry then are the same motion, within what they claim."""

    off: FloatArray
    sigmas: FloatArray
    windows: int
    fits: bool

    def delayed(self, delay_s: float) -> Mount:
        """For a laser that was taken to measure so much later than it says."""
        return replace(self, off=np.append(self.off[:3], self.off[3] + delay_s))


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """n stretches: step of the laser (n, 3) with covariance (n, 3, 3), odometry's step of the base,
    its derivative (n, 4) by a delay of the odometry's stamps, and the window (n,) it is from."""

    T_laser: FloatArray
    covariance: FloatArray
    steps: tuple[OdometryStep, ...]
    by_delay: FloatArray
    window: FloatArray

    @property
    def turns_rad(self) -> FloatArray:
        """(n, 3) by laser, wheels and gyroscope, nan where that was silent for a part."""
        turned = [
            (
                step.wheel_turn_rad,
                step.T_first_last[2] if step.gyro_s > HEARD_SHARE * step.seconds else np.nan,
            )
            for step in self.steps
        ]
        return np.column_stack([self.T_laser[:, 2], np.array(turned).reshape(-1, 2)])

    def mirrored(self) -> Stretches:
        """As a laser that looks from the other side of the plane would have them."""
        turned = np.array([1.0, -1.0, -1.0])
        T_laser, covariance = self.T_laser * turned, self.covariance * np.outer(turned, turned)
        return replace(self, T_laser=T_laser, covariance=covariance)


def stretches(windows: Sequence[BundledWindow], later_ns: int, odometry: Odometry) -> Stretches:
    """All of them that odometry covers and in which the robot drives. later_ns: by how
    much the middle beams fired later than ``windows`` say."""
    none, step_ns = np.zeros(PARAMETERS), round(DELAY_STEP_S * 1e9)
    moved, covariances, steps, by_delay, numbers = [], [], [], [], []
    for number, window in enumerate(windows):
        at_ns = window.middle_ns + later_ns
        for first in range(0, len(at_ns) - STRETCH_SCANS, STRETCH_SCANS):
            last = first + STRETCH_SCANS
            begin_ns, end_ns = int(at_ns[first]), int(at_ns[last])
            around = (begin_ns - step_ns, end_ns + step_ns)
            if begin_ns >= end_ns or not odometry.covers(*around):
                continue
            step = odometry.step(begin_ns, end_ns, none)
            if step.path_m == 0.0:
                continue
            early = odometry.step(begin_ns - step_ns, end_ns - step_ns, none)
            late = odometry.step(begin_ns + step_ns, end_ns + step_ns, none)
            T_step = between(window.T_window_laser[first], window.T_window_laser[last])
            jacobian = np.hstack([-adjoint(inverse(T_step)), np.eye(3)])
            rows = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in (first, last)])
            moved.append(T_step)
            covariances.append(jacobian @ window.covariance[np.ix_(rows, rows)] @ jacobian.T)
            steps.append(step)
            turned = late.wheel_turn_rad - early.wheel_turn_rad
            apart = np.append(between(early.T_first_last, late.T_first_last), turned)
            by_delay.append(apart / (2.0 * DELAY_STEP_S))
            numbers.append(number)
    return Stretches(
        np.array(moved).reshape(-1, 3),
        np.array(covariances).reshape(-1, 3, 3),
        tuple(steps),
        np.array(by_delay).reshape(-1, 4),
        np.array(numbers, dtype=np.float64),
    )


def find_mount(found: Stretches, T_base_laser: FloatArray, config: MotionConfig) -> Mount | None:
    """The mount near the declared one (3,); None where the motion tells nothing of it. A laser
    upside down is to be mirrored by the caller."""
    if len(found.steps) < LEAST_STRETCHES or np.unique(found.window).size < LEAST_WINDOWS:
        return None
    begin = np.append(T_base_laser[:2], _rough_yaw_rad(found, T_base_laser))
    # Of a laser that looks elsewhere nothing is known but what its steps tell.
    yaw_sigma_rad = YAW_SIGMA_RAD if begin[2] == T_base_laser[2] else ANY_YAW_SIGMA_RAD
    sigmas = np.concatenate(
        [PRIOR_SIGMAS, [PLACE_SIGMA_M, PLACE_SIGMA_M, yaw_sigma_rad, DELAY_SIGMA_S]]
    )
    start = np.concatenate([np.zeros(PARAMETERS), begin, [0.0]])
    noise, prior, values = OdometryNoise(config), np.diag(1.0 / np.square(sigmas)), start.copy()
    for _ in range(ROUNDS):
        weighted = _weighted(found, values, noise)
        total = prior + weighted.information.sum(axis=0)
        covariance = np.asarray(np.linalg.inv(total), dtype=np.float64)
        step = -covariance @ (weighted.push.sum(axis=0) + prior @ (values - start))
        values = values + step
        if np.abs(step / np.sqrt(np.diag(covariance))).max() < STILL_SIGMAS:
            break
    # The scatter of the windows tells what their noise really is (sandwich estimator).
    left = weighted.push + weighted.information @ step
    spread = np.array([left[found.window == one].sum(axis=0) for one in np.unique(found.window)])
    meat = spread.T @ spread * (len(spread) / (len(spread) - 1.0)) + prior
    robust = np.diag(covariance @ meat @ covariance)
    variance = np.maximum(robust, np.diag(covariance))[FOUND] + np.square(UNMODELLED)
    off = values[FOUND] - np.append(T_base_laser, 0.0)
    left_over = float(np.median(_residual(found, values, noise).squared))
    return Mount(off, np.sqrt(variance), len(spread), left_over <= FIT_SQUARED * MEDIAN_CHI2_3)


def _rough_yaw_rad(found: Stretches, T_base_laser: FloatArray) -> float:
    """Where the laser looks by the direction of its steps against those of the place where it is
    declared to sit, which in turns moves otherwise than the base, if that is far from the declared
    one, from which the least squares would not come there; else as declared."""
    base, laser = np.array([step.T_first_last for step in found.steps]), found.T_laser
    steps = [one[:, 0] + 1j * one[:, 1] for one in (base, laser)]
    place, declared_rad = complex(*T_base_laser[:2]), float(T_base_laser[2])
    both = (steps[0] + (np.exp(1j * base[:, 2]) - 1.0) * place) * np.conj(steps[1])
    kept = abs(both.sum()) > TURNED_SHARE * np.abs(both).sum()
    off_rad = float(wrap_angle(np.angle(both.sum()) - declared_rad))
    return declared_rad + off_rad if kept and abs(off_rad) > TURNED_RAD else declared_rad


@dataclass(frozen=True, slots=True, eq=False)
class _Weighted:
    """information (n, 9, 9) and push (n, 9) of each stretch."""

    information: FloatArray
    push: FloatArray


def _weighted(found: Stretches, values: FloatArray, noise: OdometryNoise) -> _Weighted:
    at = _residual(found, values, noise)
    jacobian = np.zeros((*at.residual.shape, len(values)))
    jacobian[..., :PARAMETERS] = at.jacobian
    jacobian[..., DELAY] = found.by_delay
    for unknown in range(MOUNT.start, MOUNT.stop):
        step = np.zeros(len(values))
        step[unknown] = MOUNT_STEP
        ahead, behind = (_residual(found, values + s, noise).residual for s in (step, -step))
        jacobian[..., unknown] = (ahead - behind) / (2.0 * MOUNT_STEP)
    # What fits worse than most counts less (Cauchy), in units of what most show.
    unit = float(np.clip(np.median(at.squared) / MEDIAN_CHI2_3, *UNIT_BOUNDS))
    weight = at.weight / unit / (1.0 + at.squared / unit / DOUBT_SQUARED)[:, None, None]
    return _Weighted(
        np.einsum("nri,nrs,nsj->nij", jacobian, weight, jacobian),
        np.einsum("nri,nrs,ns->ni", jacobian, weight, at.residual),
    )


def _residual(found: Stretches, values: FloatArray, noise: OdometryNoise) -> Evidence:
    """Odometry less scans, as steps of the base."""
    T_base_laser = np.broadcast_to(values[MOUNT], found.T_laser.shape)
    T_base = compose(compose(T_base_laser, found.T_laser), inverse(T_base_laser))
    carry = adjoint(T_base_laser)
    covariance = carry @ found.covariance @ np.swapaxes(carry, -1, -2) + ROUNDING * np.eye(3)
    steps = [step.at(values[:PARAMETERS]) for step in found.steps]
    shift = values[DELAY] * found.by_delay
    return evidence(
        T_base,
        np.asarray(np.linalg.inv(covariance)),
        compose(np.array([step.T_first_last for step in steps]), shift[:, :3]),
        np.array([step.wheel_turn_rad for step in steps]) + shift[:, 3],
        np.array([step.jacobian for step in steps]),
        np.array([step_covariance(step, noise) for step in steps]),
    )
