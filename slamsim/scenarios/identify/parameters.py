"""Robot parameters to identify, with their prior standard deviations."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.measurements import ParameterName, PriorConfig
from slamsim.core.types import FloatArray

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
        """Every parameter by its name."""
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
