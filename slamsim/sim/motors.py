"""Wheel motors: how a commanded wheel speed becomes a torque."""

from __future__ import annotations

from typing import Protocol

from slamsim.config.robot import MotorConfig
from slamsim.sim.bullet import pybullet
from slamsim.sim.engine import Engine, hold_wheels

UNLIMITED_TORQUE_N_M = 1e5


class Motors(Protocol):
    """Both wheel motors. Speeds are (left, right) in rad/s."""

    busy: bool
    """Whether ``update`` must be called before the next physics step."""

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        """The speeds to reach from now on."""

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        """Prepare the next step, given the measured speeds."""


class VelocityMotors:
    """Hold the speed as far as the torque reaches; solved together with the contacts.

    A new speed is approached evenly over one control tick: as a step it would be a blow of
    several m/s^2, which an accelerometer on the robot would feel at every tick.
    """

    def __init__(self, engine: Engine, max_torque_n_m: float, steps_per_tick: int) -> None:
        self._engine, self._max_torque_n_m = engine, max_torque_n_m
        self._steps_per_tick, self._steps_left = steps_per_tick, 0
        self._left = self._right = self._left_step = self._right_step = 0.0
        self._target = (0.0, 0.0)
        self.busy = False
        hold_wheels(engine, self._target, max_torque_n_m)

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        self._target = speeds_rad_s
        self._left_step = (speeds_rad_s[0] - self._left) / self._steps_per_tick
        self._right_step = (speeds_rad_s[1] - self._right) / self._steps_per_tick
        self._steps_left, self.busy = self._steps_per_tick, True

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        self._steps_left -= 1
        if self._steps_left == 0:
            # Exactly the target: at rest the wheels must not keep a rounding error's speed.
            self._left, self._right = self._target
            self.busy = False
        else:
            self._left += self._left_step
            self._right += self._right_step
        hold_wheels(self._engine, (self._left, self._right), self._max_torque_n_m)


class IdealMotors:
    """Take the commanded speed at once, whatever torque that needs."""

    busy = False

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.command((0.0, 0.0))

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        hold_wheels(self._engine, speeds_rad_s, UNLIMITED_TORQUE_N_M)

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        return None


class PidMotors:
    """Torque from the speed error; the integral stops growing while the torque is at its limit."""

    busy = True

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


def build_motors(engine: Engine, config: MotorConfig, step_s: float, steps_per_tick: int) -> Motors:
    """The motors of a configuration. step_s: physics step; steps_per_tick: per control tick."""
    if config.kind == "pid":
        return PidMotors(engine, config, step_s)
    if config.kind == "ideal":
        return IdealMotors(engine)
    return VelocityMotors(engine, config.max_torque_n_m, steps_per_tick)
