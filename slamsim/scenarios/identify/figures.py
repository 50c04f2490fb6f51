"""From runs, computed or simulated, to the figures that are measured on a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slamsim.config.measurements import FigureConfig, MeasuredRamp, ParameterName
from slamsim.core.types import GRAVITY_M_S2, FloatArray


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
