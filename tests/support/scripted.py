"""Robots that play scripts, and what statics says of them."""

from __future__ import annotations

import math

import numpy as np

from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import (
    DriveWheelsConfig,
    MotorConfig,
    RobotConfig,
    SupportWheelsConfig,
    SuspensionConfig,
)
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.sim.drive.script import Command, ScriptedRun, scripted_run
from slamsim.sim.ground import Ground
from slamsim.sim.robot.inertia import Inertial, join
from slamsim.sim.robot.model import RobotModel, build_robot

G = GRAVITY_M_S2
PHYSICS = PhysicsConfig(solver_iterations=20)
RATE_HZ = 240
ROTOR_KG_M2 = 0.0012
RADIUS_M, HALF_TRACK_M = 0.0352, 0.115
FRONT_M, REAR_M = 0.115, 0.135
SPRING = SuspensionConfig()
FREE = {"kind": "pid", "pid_proportional": 0.0, "pid_integral": 0.0}
PROPORTIONAL = {"kind": "pid", "pid_proportional": 0.2, "pid_integral": 0.0}


def robot(
    wheels: dict[str, object] | None = None,
    supports: dict[str, object] | None = None,
    motor: dict[str, object] | None = None,
) -> RobotModel:
    config = RobotConfig(
        drive_wheels=DriveWheelsConfig(**wheels or {}),  # type: ignore[arg-type]
        support_wheels=SupportWheelsConfig(**supports or {}),  # type: ignore[arg-type]
        motor=MotorConfig(**{"rotor_inertia_kg_m2": ROTOR_KG_M2, **(motor or {})}),  # type: ignore[arg-type]
    )
    return build_robot(config)


def whole(model: RobotModel) -> Inertial:
    placed = model.body.placements()
    links = model.body.links.items()
    return join([link.inertial.seen_from(placed[n]) for n, link in links if link.inertial])


def rolling_mass_kg(model: RobotModel) -> float:
    """The mass and what everything that turns while it rolls adds to it."""
    wheel = 0.5 * 0.1 + model.motor.rotor_inertia_kg_m2 / RADIUS_M**2
    return whole(model).mass_kg + 2.0 * wheel + 2.0 * 0.4 * 0.02


def play(model: RobotModel, ground: Ground, *commands: Command, **options: object) -> ScriptedRun:
    return scripted_run(model, ground, commands, PHYSICS, **options)  # type: ignore[arg-type]


def gain(run: ScriptedRun, begin_s: float, end_s: float) -> FloatArray:
    """(3,) mean acceleration between two instants."""
    first, last = round(begin_s * RATE_HZ), round(end_s * RATE_HZ)
    velocity = run.drive.linear_velocity_m_s
    return np.asarray((velocity[last] - velocity[first]) / (end_s - begin_s))


def mean(values: FloatArray, begin_s: float) -> FloatArray:
    return np.asarray(values[round(begin_s * RATE_HZ) :].mean(axis=0))


def loads_n(model: RobotModel, slope: float) -> tuple[float, float, float]:
    """(both drive wheels, front, rear) by the balance of forces and of moments."""
    body, cos, sin = whole(model), math.cos(slope), math.sin(slope)
    wheels_n = 2.0 * (SPRING.preload_n + 0.1 * G * cos)
    weight_n = body.mass_kg * G
    moment_n_m = weight_n * (float(body.centre_m[0]) * cos - float(body.centre_m[2]) * sin)
    supports_n = weight_n * cos - wheels_n
    front_n = (moment_n_m + REAR_M * supports_n) / (FRONT_M + REAR_M)
    return wheels_n, front_n, supports_n - front_n
