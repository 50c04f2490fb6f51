"""Detects lengths in a unit other than metres: ranges against wheels, and against room sizes.

If path by scans over path by wheels is the ratio of two units, one of them is wrong. Which one
follows from what each would mean: how large a room is, how fast a robot drives, how large its
wheels are, how far lidars see, where the laser sits on the base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.calibration.model import LASER_X, LASER_Y, PATH_GAIN
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.scan_sample import positive, sample_scans
from slamsim.core.types import FloatArray
from slamsim.recording import Recording, ScanLayout
from slamsim.slam.laser.scan_motion import ScanMotions

Side = Literal["ranges", "wheels"]

METRES: dict[str, float] = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "inches": 0.0254,
    "feet": 0.3048,
}
SAME = 0.06
"""A ratio this near to that of two units, as a share, is meant to be it."""

RADIUS_ALONE = 0.1
"""Turns by the wheels that are off by nearly the same, as a share: only their radius is."""

ROOM_M, REACH_M = (0.3, 30.0), (1.0, 300.0)
SPEED_M_S, RADIUS_M = (0.03, 3.0), (0.01, 0.5)
"""Usual: the median range, the largest range of a lidar, nearly the highest speed of a robot,
and the radius of a wheel."""

BEYOND_SHARE, BEYOND = 2e-3, 0.5
LEVER_M = 0.1
UNLIKELY = 0.25
"""How implausible, in decades: ranges beyond the declared limit; and numbers too small, for most
units are smaller than a metre. A laser ``LEVER_M`` from where it is declared counts one decade."""


@dataclass(frozen=True, slots=True)
class WrongUnit:
    """metres: what one of the unit is. ratio: path by scans over path by wheels, of the recorded
    numbers, and its sigma; nan without wheels. radius_alone: whether the track is in metres."""

    side: Side
    topic: str
    metres: float
    ratio: tuple[float, float]
    radius_alone: bool = False
    limits_too: bool = False

    @property
    def name(self) -> str:
        """Of the unit, in words."""
        for unit, metres in METRES.items():
            if abs(np.log(self.metres / metres)) < SAME:
                return unit
        return f"multiples of {self.metres:.4g} m"


@dataclass(frozen=True, slots=True)
class _World:
    """What the recorded numbers say: the median range and the largest one, the speed by the wheels
    and their radius, where the laser is declared (2,) and found (2,), in recorded ranges."""

    layout: ScanLayout
    median: float
    largest: float
    speed: float
    radius: float
    declared: FloatArray | None
    found: FloatArray


def wrong_unit(
    recording: Recording, motions: ScanMotions | None, calibration: Calibration
) -> WrongUnit | None:
    """Whose lengths are not metres; None if both agree and make a usual room.

    calibration: of the recording as it is, in which ranges were taken as
    ``motions.metres_per_unit`` metres.
    """
    world = None if motions is None else _world(recording, motions, calibration)
    if world is None or motions is None:
        return None
    topic, wheels, taken = motions.topic, calibration.model.wheels, motions.metres_per_unit
    limits_too = _decades_outside(world.layout.range_max_m, REACH_M) > 0.0
    gain, sigma = calibration.value("path_gain"), float(calibration.fit.sigmas[PATH_GAIN])
    if wheels is None or not calibration.comparable or not 0.0 < 10.0 * sigma < gain:
        if taken == 1.0 or _decades_outside(world.largest, REACH_M) == 0.0:
            return None
        return WrongUnit("ranges", topic, taken, (np.nan, np.nan), limits_too=limits_too)
    wheel_metres = ratio_of_units(gain / taken)
    if wheel_metres is None:
        return None
    ratio = gain / taken, sigma / taken
    turned = calibration.value("turn_gain")
    if turned > 0.0 and abs(np.log(turned / gain)) < RADIUS_ALONE < abs(np.log(turned)):
        return WrongUnit("wheels", wheels.topic, wheel_metres, ratio, radius_alone=True)
    of_ranges = _implausibility(world, 1.0 / wheel_metres, 1.0)
    if of_ranges < _implausibility(world, 1.0, wheel_metres):
        return WrongUnit("ranges", topic, 1.0 / wheel_metres, ratio, limits_too=limits_too)
    return WrongUnit("wheels", wheels.topic, wheel_metres, ratio)


def in_metres(
    calibration: Calibration, unit: WrongUnit | None, metres_per_unit: float
) -> Calibration:
    """All fitted again with the right unit; metres_per_unit: by which ranges were multiplied."""
    if unit is None:
        return calibration
    inputs, of_ranges = calibration.inputs, unit.side == "ranges"
    factor = (unit.metres if of_ranges else 1.0) / metres_per_unit
    wheels = inputs.wheels if of_ranges or inputs.wheels is None else _scaled(inputs.wheels, unit)
    found = calibrate_inputs(replace(inputs, steps=_longer(inputs.steps, factor), wheels=wheels))
    return found if found is not None else calibration


def _longer(steps: LaserSteps, factor: float) -> LaserSteps:
    scale = np.array([factor, factor, 1.0])
    return replace(
        steps,
        T_first_second=steps.T_first_second * scale,
        information=steps.information / (scale[:, None] * scale),
    )


def _scaled(wheels: IntegratedMotion, unit: WrongUnit) -> IntegratedMotion:
    """With lengths in metres: of the radius alone turns shrink as well, else the track."""
    both = np.array([unit.metres, unit.metres if unit.radius_alone else 1.0])
    track = 1.0 if unit.radius_alone else unit.metres
    aside, sideways = (
        None if steps_m is None else steps_m * unit.metres
        for steps_m in (wheels.aside_m, wheels.sideways_m)
    )
    return replace(
        wheels,
        totals=wheels.totals * both,
        aside_m=aside,
        sideways_m=sideways,
        reading=wheels.reading * both,
        track_m=wheels.track_m * track,
    )


def ratio_of_units(ratio: float) -> float | None:
    """The ratio of two units that this one is meant to be."""
    ratios = [*METRES.values(), *(1.0 / one for one in METRES.values())]
    nearest = min(ratios, key=lambda one: abs(np.log(ratio / one)))
    return nearest if abs(np.log(ratio / nearest)) < SAME else None


def _world(recording: Recording, motions: ScanMotions, calibration: Calibration) -> _World | None:
    scans = next(scans for scans in recording.scans if scans.topic == motions.topic)
    sample, wheels = sample_scans(scans), calibration.model.wheels
    readings = np.zeros(0) if sample is None else positive(sample)
    if sample is None or not readings.size or not calibration.scans_count:
        return None
    speed, radius = 1.0, 0.1
    if wheels is not None:
        speeds = np.abs(np.diff(wheels.totals[:, 0]) / np.diff(wheels.times_s))
        speed = float(np.quantile(speeds, 0.9))
        radii = [t.wheel_radius_m for t in recording.ticks if t.topic == wheels.topic]
        radius = next(iter(radii), radius)
    declared = calibration.inputs.T_base_laser
    return _World(
        sample.layout,
        float(np.median(readings)),
        float(np.quantile(readings, 1.0 - BEYOND_SHARE)),
        speed,
        radius,
        None if declared is None else declared[:2],
        calibration.fit.values[[LASER_X, LASER_Y]] / motions.metres_per_unit,
    )


def _implausibility(world: _World, range_metres: float, wheel_metres: float) -> float:
    """How implausible the world is, in decades, if one of either unit is so many metres."""
    reach = world.layout.range_max_m
    decades = _decades_outside(world.median * range_metres, ROOM_M)
    decades += min(_decades_outside(reach * one, REACH_M) for one in (1.0, range_metres))
    decades += BEYOND * (world.largest * range_metres > max(reach, reach * range_metres))
    decades += _decades_outside(world.speed * wheel_metres, SPEED_M_S)
    decades += _decades_outside(world.radius * wheel_metres, RADIUS_M)
    decades += UNLIKELY * (range_metres > 1.0 or wheel_metres > 1.0)
    if world.declared is not None:
        apart = np.abs(world.found * range_metres - world.declared).max()
        decades += min(float(apart) / LEVER_M, 1.0)
    return decades


def _decades_outside(value: float, usual: tuple[float, float]) -> float:
    """Decades outside of what is usual."""
    if not value > 0.0:
        return 0.0
    return float(max(np.log10(usual[0] / value), np.log10(value / usual[1]), 0.0))
