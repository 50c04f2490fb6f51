"""Wheel motors: how a commanded wheel speed becomes a torque."""

from __future__ import annotations

from typing import Protocol

from slamsim.config.robot import MotorConfig
from slamsim.sim.bullet import pybullet
from slamsim.sim.engine import Engine, hold_wheels

UNLIMITED_TORQUE_N_M = 1e5


class Motors(Protocol):
    """Both wheel motors. Speeds are (left, right) in rad/s."""

    every_step: bool
    """Whether ``update`` must be called before each physics step."""

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        """The speeds to reach from now on."""

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        """Set the torque for the next step from the measured speeds."""


class VelocityMotors:
    """Hold the speed as far as the torque reaches; solved together with the contacts."""

    every_step = False

    def __init__(self, engine: Engine, max_torque_n_m: float) -> None:
        self._engine, self._max_torque_n_m = engine, max_torque_n_m

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        hold_wheels(self._engine, speeds_rad_s, self._max_torque_n_m)

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        return None


class PidMotors:
    """Torque from the speed error; the integral stops growing while the torque is at its limit."""

    every_step = True

    def __init__(self, engine: Engine, config: MotorConfig, step_s: float) -> None:
        self._engine, self._config, self._step_s = engine, config, step_s
        self._target = (0.0, 0.0)
        self._integral = [0.0, 0.0]
        self._error = [0.0, 0.0]
        hold_wheels(engine, (0.0, 0.0), 0.0)

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        self._target = speeds_rad_s

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        pybullet.setJointMotorControlArray(
            self._engine.body,
            self._engine.wheels,
            pybullet.TORQUE_CONTROL,
            forces=[self._torque(side, measured_rad_s[side]) for side in (0, 1)],
            physicsClientId=self._engine.client,
        )

    def _torque(self, side: int, measured_rad_s: float) -> float:
        gains, limit = self._config, self._config.max_torque_n_m
        error = self._target[side] - measured_rad_s
        change = (error - self._error[side]) / self._step_s
        integral = self._integral[side] + error * self._step_s
        torque = (
            gains.pid_proportional * error
            + gains.pid_integral * integral
            + gains.pid_derivative * change
        )
        self._error[side] = error
        if abs(torque) <= limit:
            self._integral[side] = integral
        return max(-limit, min(limit, torque))


def build_motors(engine: Engine, config: MotorConfig, step_s: float) -> Motors:
    """The motors of a configuration; step_s is the physics step."""
    if config.kind == "pid":
        return PidMotors(engine, config, step_s)
    torque_n_m = UNLIMITED_TORQUE_N_M if config.kind == "ideal" else config.max_torque_n_m
    return VelocityMotors(engine, torque_n_m)
