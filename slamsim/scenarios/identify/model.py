"""A robot in closed form: what its wheels make of open-loop commands, run by run.

A wheel turns at its commanded rim speed, less what the gear's friction takes from a proportional
controller: the same at any speed, and more as the battery runs down. Whatever scrubs as the robot
turns brakes one wheel and pushes the other, so that a soft controller yields to it. Nothing slips
but what the effective track stands for. Thousands of runs take milliseconds: a fit can afford them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.measurements import ParameterName
from slamsim.core.types import FloatArray
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
