"""Robot parameters to identify, and the robot in closed form: what its wheels make of open-loop
commands, run by run, and the figures that are measured on it.

A wheel turns at its commanded rim speed, less what the gear's friction takes from a proportional
controller: the same at any speed, and more as the battery runs down. Whatever scrubs as the robot
turns brakes one wheel and pushes the other, so that a soft controller yields to it. Nothing slips
but what the effective track stands for. Thousands of runs take milliseconds: a fit can afford them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.measurements import FigureConfig, MeasuredRamp, ParameterName, PriorConfig
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.models.differential_drive import chord_of, forward_and_turn, left_and_right
from slamsim.sim.drive.script import Command

VARYING = ("radius_ratio", "track", "gear_friction", "gear_friction_ratio")
"""What differs from run to run, as in the configuration of a robot's variation."""


@dataclass(frozen=True, slots=True, eq=False)
class Wheels:
    """The wheels of n runs. rolling: (n, 2) true over nominal radius, left and right.

    droops_m_s: (n, 2) rim speed lost with a full battery, of which sag_per_s is lost each second.
    track_scale: (n,) true effective track over nominal. yielding_m_s: by how much scrubbing brings
    the speeds of the two tyres nearer to each other, at most until they are equal.
    """

    rolling: FloatArray
    droops_m_s: FloatArray
    track_scale: FloatArray
    sag_per_s: float = 0.0
    yielding_m_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Poses (n, m + 1, 3) before the first and after each of m commands; yaw is not wrapped."""

    true: FloatArray
    odometry: FloatArray


def wheels_of(
    values: Mapping[ParameterName, float], draws: FloatArray, scrub_n_m2: float = 0.0
) -> Wheels:
    """The wheels of runs that differ by draws (n, 4): standard normal, one column per VARYING.

    scrub_n_m2: motor gain times yielding_m_s.
    """

    def varied(name: ParameterName, variation: ParameterName, column: int) -> FloatArray:
        return np.asarray(values[name] * np.exp(values[variation] * draws[:, column]))

    radius_ratio = varied("radius_ratio", "variation_radius_ratio", 0)
    droop_m_s = varied("droop_m_s", "variation_gear_friction", 2)
    droop_ratio = varied("gear_friction_ratio", "variation_gear_friction_ratio", 3)
    return Wheels(
        rolling=values["radius_scale"] * _pair(np.ones(len(draws)), radius_ratio),
        droops_m_s=_pair(droop_m_s, droop_ratio),
        track_scale=varied("track_scale", "variation_track", 1),
        sag_per_s=values["battery_sag_per_min"] / 60.0,
        yielding_m_s=scrub_n_m2 / values["motor_gain_n_m_s"],
    )


def _pair(mean: FloatArray, ratio: FloatArray) -> FloatArray:
    """(n, 2) left and right of that mean, right over left of that ratio."""
    left = 2.0 * mean / (1.0 + ratio)
    return np.column_stack([left, left * ratio])


def driven(wheels: Wheels, commands: Sequence[Command], track_m: float) -> Motions:
    """Where commands take the wheels. track_m: nominal, as driver and odometry believe it."""
    count = len(wheels.track_scale)
    nominal_m, true_m = np.full(count, track_m), track_m * wheels.track_scale
    true, odometry, begun_s = np.zeros((count, 3)), np.zeros((count, 3)), 0.0
    trues, odometries = [true], [odometry]
    for command in commands:
        wanted_m_s = np.array(left_and_right(command.speed_m_s, command.yaw_rate_rad_s, track_m))
        voltage = max(1.0 - wheels.sag_per_s * (begun_s + 0.5 * command.duration_s), 0.01)
        held_m_s = np.maximum(np.abs(wanted_m_s) - wheels.droops_m_s / voltage, 0.0)
        free_m_s = np.sign(wanted_m_s) * held_m_s * wheels.rolling
        rolled_m = _scrubbed(free_m_s, wheels.yielding_m_s / voltage) * command.duration_s
        odometry = _after_arc(odometry, rolled_m / wheels.rolling, nominal_m)
        true = _after_arc(true, rolled_m, true_m)
        begun_s += command.duration_s
        trues.append(true)
        odometries.append(odometry)
    return Motions(np.stack(trues, axis=1), np.stack(odometries, axis=1))


def _scrubbed(speeds_m_s: FloatArray, yielding_m_s: float) -> FloatArray:
    """(n, 2) speeds of both tyres, nearer to each other but not beyond."""
    half = 0.5 * (speeds_m_s[:, 1] - speeds_m_s[:, 0])
    nearer = np.clip(half, -0.5 * yielding_m_s, 0.5 * yielding_m_s)
    return np.asarray(speeds_m_s + np.column_stack([nearer, -nearer]))


def _after_arc(poses: FloatArray, rolled_m: FloatArray, track_m: FloatArray) -> FloatArray:
    """(n, 3) poses after wheels rolled (n, 2) at constant speeds."""
    forward_m, turned = forward_and_turn(rolled_m, track_m).T
    return np.asarray(poses + np.column_stack([*chord_of(forward_m, turned, poses[:, 2]), turned]))


_UNIT = re.compile(r"(_n)?_m(_s)?$|_per_min$")


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of the robot: its logarithm is normal about that of value, with sigma.

    words: what it is. why: where the prior comes from.
    """

    name: ParameterName
    words: str
    value: float
    sigma: float
    why: str

    @property
    def short(self) -> str:
        """Its name as words, without a unit."""
        return _UNIT.sub("", self.name).replace("_", " ")

    def shown(self, value: float, sigma: float) -> str:
        """A value of it, known to sigma in its logarithm, as text."""
        if sigma >= 0.3:
            return f"{value:.3g} (× or ÷ {np.exp(sigma):.2g})"
        digits = max(0, 1 - int(np.floor(np.log10(value * sigma))))
        return f"{value:.{digits}f} ± {value * sigma:.{digits}f}"


KNOWN_BEFOREHAND = (
    Parameter("radius_scale", "mean wheel radius over nominal", 1.0, 0.01,
              "the loaded radius of a tyre is known to some tenths of a millimetre"),
    Parameter("radius_ratio", "wheel radius, right over left", 1.0, 0.005,
              "rubber tyres of one batch differ by some tenths of a per cent (Borenstein & Feng)"),
    Parameter("track_scale", "effective track over nominal", 1.02, 0.12,
              "Borenstein & Feng find some per cent; slip in a turn on the spot may add more"),
    Parameter("droop_m_s", "rim speed lost to gear friction, m/s", 0.01, 1.0,
              "nothing for a good controller, centimetres a second for a proportional one"),
    Parameter("gear_friction_ratio", "gear friction, right over left", 1.0, 0.1,
              "two gears of one kind"),
    Parameter("battery_sag_per_min", "share of the voltage lost per minute", 0.002, 1.0,
              "a battery loses a tenth of its voltage in an hour"),
    Parameter("motor_gain_n_m_s", "torque per speed error, N m s/rad", 0.1, 1.0,
              "between a slack and a stiff controller of a robot of this size"),
    Parameter("max_torque_n_m", "largest torque at a wheel, N m", 1.6, 0.3,
              "motor data sheet: 33 mN m at stall, gear ratio 49.6"),
    Parameter("tyre_friction", "Coulomb coefficient, tyre on floor", 0.9, 0.3,
              "rubber on hard, dry floors: 0.6 to 1.3"),
    Parameter("variation_radius_ratio", "radius ratio, from run to run", 0.001, 0.7,
              "load and temperature of the tyres"),
    Parameter("variation_track", "effective track, from run to run", 0.03, 0.8,
              "as large as what slip adds to the track at all"),
    Parameter("variation_gear_friction", "gear friction, from run to run", 0.05, 0.7,
              "temperature and grease"),
    Parameter("variation_gear_friction_ratio", "gear friction ratio, from run to run", 0.03, 0.7,
              "temperature and grease"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ParameterSpace:
    """All parameters with their priors; a point z counts prior sigmas from the most likely."""

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.parameters)

    def values(self, z: FloatArray) -> dict[ParameterName, float]:
        """Every parameter by its name. z: (k,) in prior sigmas."""
        return {
            parameter.name: float(parameter.value * np.exp(parameter.sigma * at))
            for parameter, at in zip(self.parameters, z.tolist(), strict=True)
        }

    def point(self, values: Mapping[ParameterName, float]) -> FloatArray:
        """(p,) the z of values, the inverse of ``values``."""
        return np.array([np.log(values[p.name] / p.value) / p.sigma for p in self.parameters])


def space_with(priors: Mapping[ParameterName, PriorConfig]) -> ParameterSpace:
    """The space, with other priors where there are any."""
    return ParameterSpace(
        tuple(
            replace(known, value=given.value, sigma=given.sigma, why=given.why)
            if (given := priors.get(known.name)) is not None
            else known
            for known in KNOWN_BEFOREHAND
        )
    )


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """What m repetitions of a whole experiment came to.

    stops_m: (m, runs, stops, 2). errors_m: (m, 2, runs, 2) true less odometry end of squares,
    clockwise first. corners_deg: (m, 2, runs) mean true turn of the corners.
    """

    stops_m: FloatArray
    errors_m: FloatArray
    corners_deg: FloatArray


@dataclass(frozen=True, slots=True)
class Body:
    """What a robot weighs on its wheels.

    driven_share: of its weight, on the driven wheels. scrub_n_m: moment against turning on the
    spot, by supports that are dragged and tyres that are twisted.
    """

    mass_kg: float
    wheel_radius_m: float
    track_m: float
    driven_share: float
    scrub_n_m: float

    @property
    def scrub_n_m2(self) -> float:
        """Motor gain times the difference of the tyres' speeds that scrubbing takes."""
        return 2.0 * self.wheel_radius_m**2 * self.scrub_n_m / self.track_m


def figure_values(figure: FigureConfig, runs: Runs) -> FloatArray:
    """(m,) the figure in each repetition; not for the ramp."""
    if figure.stop is not None:
        return _stop(figure.quantity.partition(".")[2], runs.stops_m[:, :, figure.stop - 1])
    centres_m = runs.errors_m.mean(axis=2)
    if figure.quantity == "umbmark.corner_deg":
        return np.asarray(runs.corners_deg.mean(axis=(1, 2)))
    if figure.quantity == "umbmark.e_max_m":
        return np.asarray(np.linalg.norm(centres_m, axis=-1).max(axis=1))
    if figure.quantity == "umbmark.spread_m":
        apart_m = runs.errors_m[:, :, :, None] - runs.errors_m[:, :, None]
        return np.asarray(np.linalg.norm(apart_m, axis=-1).max(axis=(1, 2, 3)))
    direction = 1 if "counter" in figure.quantity else 0
    return np.asarray(centres_m[:, direction, 0 if figure.quantity.endswith("x_m") else 1])


def _stop(what: str, places_m: FloatArray) -> FloatArray:
    """places_m: (m, runs, 2)."""
    if what == "stop_scatter_m":
        apart_m = places_m - places_m.mean(axis=1, keepdims=True)
        return np.asarray(np.sqrt(np.square(apart_m).sum(axis=-1).mean(axis=1)))
    return np.asarray(places_m[:, :, 0 if what == "stop_x_m" else 1].mean(axis=1))


def ramp_value(
    figure: FigureConfig, values: Mapping[ParameterName, float], body: Body, ramp: MeasuredRamp
) -> float:
    """A figure of the ramp, by the balance of forces on it."""
    radius_m, gain = body.wheel_radius_m, values["motor_gain_n_m_s"]
    friction_n_m = gain * values["droop_m_s"] / radius_m
    steepest_n_m = 0.5 * body.mass_kg * GRAVITY_M_S2 * radius_m
    if figure.quantity == "ramp.slides_from_deg":
        return float(np.degrees(np.arctan(values["tyre_friction"] * body.driven_share)))
    spare = (values["max_torque_n_m"] - friction_n_m) / steepest_n_m
    stalls_deg = float(np.degrees(np.arcsin(np.clip(spare, 0.0, 1.0))))
    if figure.slope_deg is None:
        return stalls_deg
    slowed_m_s = radius_m * steepest_n_m * np.sin(np.radians(figure.slope_deg)) / gain
    left_m_s = max(ramp.speed_m_s - values["droop_m_s"] - float(slowed_m_s), 0.0)
    return left_m_s * ramp.drive_s if figure.slope_deg < stalls_deg else 0.0
