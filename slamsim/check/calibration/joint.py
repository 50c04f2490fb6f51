"""Joint calibration: clocks, wheels, gyroscope and mounting in one fit to the scans' motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.check.calibration.fit import Fit, fit
from slamsim.check.calibration.model import (
    GYRO_DELAY,
    GYRO_DRIFT,
    GYRO_GAIN,
    LASER,
    LASER_Y,
    LASER_YAW,
    LEVER_UNSURE,
    PATH_GAIN,
    SLIP_SIGMAS,
    TURN_GAIN,
    UNKNOWNS,
    WHEEL_DELAY,
    WHEEL_DRIFT,
    Model,
)
from slamsim.check.calibration.slipping import SlipSpells, find_spells
from slamsim.check.motion.alignment import Alignment, Shift, align, laser_path
from slamsim.check.motion.inputs import Inputs, from_above
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.motion.robust import scatter, tukey_weights
from slamsim.core.types import FloatArray

PSEUDO_STEP_NS = 100_000_000
LEAST_GAIN = 1e-4
"""A gain nearer to 0 is of a stream that shows no motion; to divide by it would make numbers
without meaning."""
SLIP_ROUNDS = 4
LEAST_SIDEWAYS_STEPS, SIDEWAYS_ROUNDS = 30, 6
LEAST_APART_M, LEAST_INFORMATION = 1e-5, 1e-12
"""Hundredths of millimetres are below what scans tell; the latter only keeps equations solvable."""
CONFIRMED_SHARES, CONFIRMED_SIGMA = (0.5, 1.5), 0.1
"""Noise of poses, and a heading that comes late, are 0 of what scans see; steps to the side are 1,
less what rollers slip: the limit is midway, and five standard deviations from 0."""
HARDLY_TURNING_RAD_S = 0.05
"""Standard deviation of the turn rate: below it a recording is one of a straight drive, from which
turns say nothing."""
MOST_PSEUDO_STEPS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The fit, and the first look that it started from.

    model: to ask for predictions. spells: wheels against scans second by second, as far as both
    are there.
    """

    inputs: Inputs
    alignment: Alignment
    model: Model
    fit: Fit
    spells: SlipSpells | None

    def value(self, name: str) -> float:
        """The fitted value of one of ``UNKNOWNS``."""
        return float(self.fit.values[UNKNOWNS.index(name)])

    def sigma(self, name: str) -> float:
        """Its standard deviation."""
        place = UNKNOWNS.index(name)
        return float(np.sqrt(self.covariance[place, place]))

    def given(self, name: str) -> float:
        """The part of ``sigma`` that no fit can know, for tyres give."""
        return float(SLIP_SIGMAS[UNKNOWNS.index(name)])

    @property
    def covariance(self) -> FloatArray:
        """(p, p) with what no fit can know: how tyres give, and of poses by what lever unequal
        wheels drive forward in turns, as a laser does that sits to the side."""
        unknown = SLIP_SIGMAS.copy()
        wheels = self.model.wheels
        if wheels is not None and not wheels.wired:
            forward_m_rad = LEVER_UNSURE * wheels.lever_m2 * self.value("curvature_rad_m")
            unknown[LASER_Y] = np.hypot(unknown[LASER_Y], forward_m_rad)
        return np.asarray(self.fit.covariance + np.diag(np.square(unknown)))

    def offset(self, stream: str, at_s: float = 0.0) -> tuple[float, float, float]:
        """Stamp less the lidar's stamp of the same instant, s: value, sigma, Cramer-Rao bound.

        stream: "gyro" or "wheel"; of "gyro_wheel" the wheels' less the gyroscope's. at_s: after
        the middle of what was compared.
        """
        gyro_ns, wheel_ns = self.alignment.shifts_ns
        shift_ns = {"gyro": gyro_ns, "wheel": wheel_ns, "gyro_wheel": wheel_ns - gyro_ns}[stream]
        by = _delays(stream, GYRO_DELAY, WHEEL_DELAY) + at_s * _delays(
            stream, GYRO_DRIFT, WHEEL_DRIFT
        )
        value_s, sigma_s, bound_s = self._combined(by, shift_ns * 1e-9)
        by_scans_s = 0.0 if stream == "gyro_wheel" else self.inputs.instant_sigma_s
        return value_s, float(np.hypot(sigma_s, by_scans_s)), bound_s

    def drift(self, stream: str) -> tuple[float, float, float]:
        """Growth of ``offset`` per second."""
        return self._combined(_delays(stream, GYRO_DRIFT, WHEEL_DRIFT), 0.0)

    def shift(self, stream: str) -> Shift | None:
        """What the first look said."""
        pairs = self.alignment
        return {
            "gyro": pairs.lidar_gyro,
            "wheel": pairs.lidar_wheels,
            "gyro_wheel": pairs.gyro_wheels,
        }[stream]

    @property
    def scans_count(self) -> bool:
        """Whether the motion of the scans is in the fit at all."""
        return bool(np.any(self.model.steps.information))

    @property
    def comparable(self) -> bool:
        """Whether wheels and scans go together, if anything turns that could tell."""
        return self.follows("wheel") or hardly_turns(self.model.steps)

    def follows(self, stream: str) -> bool:
        """Whether the turns of two streams plainly have to do with each other."""
        shift = self.shift(stream)
        return shift is not None and shift.clear

    def _combined(self, by: FloatArray, onto: float) -> tuple[float, float, float]:
        sigma, bound = (
            float(np.sqrt(by @ matrix @ by))
            for matrix in (self.fit.covariance, self.fit.bound_covariance)
        )
        given = float(np.linalg.norm(by * SLIP_SIGMAS))
        return onto + float(by @ self.fit.values), float(np.hypot(max(sigma, bound), given)), bound


def calibrate_inputs(inputs: Inputs) -> Calibration | None:
    """Everything at once; None where there are not two of scans, gyroscope and wheels."""
    gyro, wheels, steps = inputs.gyro, inputs.wheels, inputs.steps
    if (len(steps) > 0) + (gyro is not None) + (wheels is not None) < 2:
        return None
    yaw_rad = 0.0 if inputs.T_base_laser is None else float(inputs.T_base_laser[2])
    alignment = align(steps, gyro, wheels, yaw_rad)
    if alignment.mirrored:
        steps = from_above(steps)
        alignment = replace(align(steps, gyro, wheels, yaw_rad), mirror=True)
    if alignment.scans != "of use" or not len(steps):
        assert wheels is not None
        steps = _nothing_seen(wheels)
        alignment = _by_wheels(alignment)
    middle_ns = int(steps.first_ns[0] + (steps.second_ns[-1] - steps.first_ns[0]) // 2)
    believed = gyro if _gyro_tells(steps, alignment) else None

    def fitted(wheels: IntegratedMotion | None) -> tuple[Model, FloatArray, Fit]:
        model = Model(steps, believed, wheels, middle_ns, alignment.shifts_ns)
        start = _start(model, inputs.T_base_laser, alignment.growth)
        return model, start, fit(model, start)

    model, start, found = fitted(alignment.wheels)
    share = _sideways_share(model, found)
    if share is not None:
        assert alignment.wheels is not None and alignment.wheels.aside_m is not None
        wheels = replace(alignment.wheels, sideways_m=share * alignment.wheels.aside_m)
        alignment = replace(alignment, wheels=wheels)
        model, start, found = fitted(wheels)
    spells = None
    if alignment.wheels is not None and np.any(steps.information):
        found, spells = _without_slip(model, start, found)
    return Calibration(inputs, alignment, model, found, spells)


def _sideways_share(model: Model, found: Fit) -> float | None:
    """How much of what odometry says of steps to the side the scans confirm, as of a robot that
    drives sideways (rollers slip: 1 is rare); None where they plainly do not.

    Of what is left after a fit without them, and of the steps themselves, counts what neither the
    way, nor turns (a laser or a base elsewhere), nor both together (a heading that comes late)
    explain.
    """
    wheels = model.wheels
    if wheels is None or wheels.aside_m is None or wheels.sideways_m is not None:
        return None
    chosen = model.covered(found.values)[1] & np.any(model.steps.information, axis=(1, 2))
    if int(chosen.sum()) < LEAST_SIDEWAYS_STEPS:
        return None
    seconds = (model.steps.second_ns - model.steps.first_ns)[chosen] * 1e-9
    yaw_rad = found.values[LASER_YAW]
    left = np.array([np.sin(yaw_rad), np.cos(yaw_rad)])
    ahead = np.array([np.cos(yaw_rad), -np.sin(yaw_rad)])
    way_m = model.steps.T_first_second[chosen, :2] @ ahead
    turn_rad = model.steps.T_first_second[chosen, 2]
    by = np.column_stack(
        [model.aside(found.values)[chosen], way_m, turn_rad, way_m * turn_rad / seconds]
    )
    missing_m = -(found.residual[chosen, :2] @ left)
    weights = np.ones(len(missing_m))
    for _ in range(SIDEWAYS_ROUNDS):
        information = by.T @ (weights[:, None] * by) + LEAST_INFORMATION * np.eye(4)
        numbers = np.linalg.solve(information, by.T @ (weights * missing_m))
        apart_m = missing_m - by @ numbers
        weights = tukey_weights(apart_m, LEAST_APART_M)
    share = float(numbers[0])
    sigma = scatter(apart_m, LEAST_APART_M) * float(np.sqrt(np.linalg.inv(information)[0, 0]))
    confirmed = CONFIRMED_SHARES[0] < share < CONFIRMED_SHARES[1] and sigma < CONFIRMED_SIGMA
    return share if confirmed else None


def _without_slip(model: Model, start: FloatArray, found: Fit) -> tuple[Fit, SlipSpells]:
    """Fitted again without the wheels where they slip, until it is plain where they do."""
    for _ in range(SLIP_ROUNDS):
        spells = find_spells(model, found.values)
        trusted = ~spells.distrusted
        if (trusted == model.trusted).all():
            break
        model.trusted = trusted
        found = fit(model, start)
    return found, spells


def _gyro_tells(steps: LaserSteps, alignment: Alignment) -> bool:
    """Whether it follows another stream, or nothing turns that it could follow."""
    pairs = (alignment.lidar_gyro, alignment.gyro_wheels)
    if any(pair is not None and pair.clear for pair in pairs):
        return True
    return hardly_turns(steps)


def hardly_turns(steps: LaserSteps) -> bool:
    """Whether the scans turn too little to tell whose turns are like theirs."""
    seconds = (steps.second_ns - steps.first_ns) * 1e-9
    return float(np.std(steps.T_first_second[:, 2] / seconds)) < HARDLY_TURNING_RAD_S


def _delays(stream: str, gyro: int, wheel: int) -> FloatArray:
    """(p,) how an unknown of both clocks enters what is said of a stream."""
    by = np.zeros(len(UNKNOWNS))
    by[gyro], by[wheel] = {"gyro": (1.0, 0.0), "wheel": (0.0, 1.0), "gyro_wheel": (-1.0, 1.0)}[
        stream
    ]
    return by


def _start(model: Model, T_base_laser: FloatArray | None, growth: float) -> FloatArray:
    """Gains by regression, the mounting as declared, everything else at nothing."""
    start = np.zeros(len(UNKNOWNS))
    start[[GYRO_GAIN, PATH_GAIN, TURN_GAIN]] = 1.0
    start[[GYRO_DRIFT, WHEEL_DRIFT]] = growth
    if T_base_laser is not None:
        start[LASER] = T_base_laser
    steps = model.steps
    T_wheels, turned = model.predicted(start)
    by_gyro, by_wheels = model.covered(start)
    if not np.any(steps.information):
        both = by_gyro & by_wheels
        start[GYRO_GAIN] = _gain(turned[both], T_wheels[both, 2])
        return start
    turn = steps.T_first_second[:, 2]
    start[GYRO_GAIN] = _gain(turned[by_gyro], turn[by_gyro])
    start[TURN_GAIN] = _gain(T_wheels[by_wheels, 2], turn[by_wheels])
    wheel_path = laser_path(replace(steps, T_first_second=T_wheels), start[LASER_YAW])
    start[[PATH_GAIN, LASER_YAW]] = _heading(
        wheel_path[by_wheels], steps.T_first_second[by_wheels], start[LASER_YAW], start[TURN_GAIN]
    )
    return start


def _heading(
    path_m: FloatArray, T_steps: FloatArray, declared_rad: float, turn_gain: float
) -> tuple[float, float]:
    """Gain of the path (n,) of the wheels, and the laser's yaw by the steps (n, 3) of the scans.

    Wheels with the right sign of turns have that of the path too; others may have either, and the
    yaw is then the one nearer to the declared.
    """
    square = float(path_m @ path_m)
    along = complex(path_m @ T_steps[:, 0], path_m @ T_steps[:, 1]) / square if square else 0.0
    if not np.isfinite(along) or abs(along) < LEAST_GAIN:
        return 1.0, declared_rad
    yaw_rad = -float(np.angle(along))
    away = np.cos(yaw_rad - declared_rad) < 0.0
    if away and turn_gain < 0.0:
        return -abs(along), yaw_rad + np.pi
    return abs(along), yaw_rad


def _gain(one: FloatArray, other: FloatArray) -> float:
    """The factor from the one to the other; 1 where the one is nothing."""
    square = float(one @ one)
    gain = float(one @ other) / square if square > 0.0 else 1.0
    return gain if np.isfinite(gain) and abs(gain) > LEAST_GAIN else 1.0


def _nothing_seen(wheels: IntegratedMotion) -> LaserSteps:
    """Steps by the wheels' clock of which no scan tells anything: the others are still compared."""
    begin, end = int(wheels.stamps_ns[0]), int(wheels.stamps_ns[-1])
    period_ns = max(PSEUDO_STEP_NS, (end - begin) // MOST_PSEUDO_STEPS)
    stamps = np.arange(begin, end, period_ns)
    count = max(stamps.size - 1, 1)
    first = np.arange(count)
    return LaserSteps(
        *("", first, first + 1, stamps[:count], stamps[:count] + period_ns),
        *(np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros(count, dtype=np.int64), 0.0),
    )


def _by_wheels(alignment: Alignment) -> Alignment:
    """With the wheels' clock as the reference."""
    between = alignment.gyro_wheels
    if between is None:
        return alignment
    gyro = Shift(-between.shift_ns, between.correlation, between.clear)
    return replace(alignment, lidar_gyro=gyro, lidar_wheels=Shift(0, 1.0, True))
