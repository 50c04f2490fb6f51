"""Wheel motors: how a commanded wheel speed becomes a torque.

Gears take their friction from that torque, a DC motor has less of it the faster it turns, and a
battery that runs down lowers both torque and speed.
"""

from __future__ import annotations

from typing import Protocol

from slamsim.config.robot import MotorConfig
from slamsim.sim.bullet import pybullet
from slamsim.sim.robot.chassis import Engine, hold_wheels

UNLIMITED_TORQUE_N_M = 1e5
"""Of an ideal motor: no load that is simulated holds it."""
STANDING_RAD_S = 1e-3
"""Slower wheels stand: their direction is that in which they are to turn."""


class Motors(Protocol):
    """Both wheel motors. Speeds are (left, right) in rad/s."""

    busy: bool
    """Whether ``update`` must be called before the next physics step."""

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        """The speeds to reach from now on."""

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        """Prepare the next step, given the measured speeds."""


class Supply:
    """What battery and motor can give at each instant of a drive."""

    def __init__(self, config: MotorConfig, step_s: float) -> None:
        self._torque_n_m, self._no_load_rad_s = config.max_torque_n_m, config.no_load_speed_rad_s
        self._sag_per_step = config.battery_sag_per_min * step_s / 60.0
        self.constant = config.no_load_speed_rad_s is None and config.battery_sag_per_min == 0.0
        self.voltage = 1.0
        """Share of the full battery's."""

    def step(self) -> None:
        """One time step passes."""
        self.voltage = max(self.voltage - self._sag_per_step, 0.0)

    def torque_n_m(self, speed_rad_s: float) -> float:
        """The largest torque; the speed counts positive in the torque's direction.

        A motor that is turned backwards or brakes has its standstill torque, no more: its
        controller limits the current.
        """
        available = self._torque_n_m * self.voltage
        if self._no_load_rad_s is not None and speed_rad_s > 0.0:
            available -= self._torque_n_m * speed_rad_s / self._no_load_rad_s
        return max(available, 0.0)


class VelocityMotors:
    """Hold the speed as far as the torque reaches; solved together with the contacts.

    A new speed is approached evenly over one control tick: as a step it would be a blow of
    several m/s^2, which an accelerometer on the robot would feel at every tick.
    """

    def __init__(
        self, engine: Engine, config: MotorConfig, step_s: float, steps_per_tick: int
    ) -> None:
        self._engine, self._supply = engine, Supply(config, step_s)
        self._friction_n_m = config.gear_frictions_n_m
        self._steps_per_tick, self._steps_left = steps_per_tick, 0
        self._left = self._right = self._left_step = self._right_step = 0.0
        self._target = (0.0, 0.0)
        self._constant = self._supply.constant and config.gear_friction_n_m == 0.0
        self.busy = not self._constant
        hold_wheels(engine, self._target, self._limits_n_m(self._target))

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        self._target = speeds_rad_s
        self._left_step = (speeds_rad_s[0] - self._left) / self._steps_per_tick
        self._right_step = (speeds_rad_s[1] - self._right) / self._steps_per_tick
        self._steps_left, self.busy = self._steps_per_tick, True

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        self._supply.step()
        self._steps_left -= 1
        if self._steps_left <= 0:
            # Exactly the target: at rest the wheels must not keep a rounding error's speed.
            self._left, self._right = self._target
            self.busy = not self._constant
        else:
            self._left += self._left_step
            self._right += self._right_step
        speeds_rad_s = self._left, self._right
        hold_wheels(self._engine, speeds_rad_s, self._limits_n_m(measured_rad_s))

    def _limits_n_m(self, measured_rad_s: tuple[float, float]) -> tuple[float, float]:
        left = self._limit_n_m(self._left, measured_rad_s[0], self._friction_n_m[0])
        right = self._limit_n_m(self._right, measured_rad_s[1], self._friction_n_m[1])
        return left, right

    def _limit_n_m(self, target: float, measured: float, friction_n_m: float) -> float:
        """Friction hinders a motor that turns its wheel and helps one that brakes or holds it."""
        along = measured if target >= measured else -measured
        turning = target != 0.0 if abs(measured) < STANDING_RAD_S else along > 0.0
        torque_n_m = self._supply.torque_n_m(along)
        return max(torque_n_m - friction_n_m if turning else torque_n_m + friction_n_m, 0.0)


class IdealMotors:
    """Take the commanded speed at once, whatever torque that needs."""

    busy = False

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.command((0.0, 0.0))

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        hold_wheels(self._engine, speeds_rad_s, (UNLIMITED_TORQUE_N_M, UNLIMITED_TORQUE_N_M))

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        return None


class PidMotors:
    """Torque from the speed error; the integral stops growing while the torque is at its limit.

    Gear friction is a motor of PyBullet's own that holds the wheel with so much torque and no
    more: it is solved with the contacts, so that it sticks where it should.
    """

    busy = True

    def __init__(self, engine: Engine, config: MotorConfig, step_s: float) -> None:
        self._engine, self._config, self._step_s = engine, config, step_s
        self._supply = Supply(config, step_s)
        self._target = (0.0, 0.0)
        self._integral = [0.0, 0.0]
        self._error = [0.0, 0.0]
        hold_wheels(engine, (0.0, 0.0), config.gear_frictions_n_m)

    def command(self, speeds_rad_s: tuple[float, float]) -> None:
        self._target = speeds_rad_s

    def update(self, measured_rad_s: tuple[float, float]) -> None:
        self._supply.step()
        pybullet.setJointMotorControlArray(
            self._engine.body,
            self._engine.wheels,
            pybullet.TORQUE_CONTROL,
            forces=[self._torque(side, measured_rad_s[side]) for side in (0, 1)],
            physicsClientId=self._engine.client,
        )

    def _torque(self, side: int, measured_rad_s: float) -> float:
        gains = self._config
        error = self._target[side] - measured_rad_s
        change = (error - self._error[side]) / self._step_s
        integral = self._integral[side] + error * self._step_s
        torque = (
            gains.pid_proportional * error
            + gains.pid_integral * integral
            + gains.pid_derivative * change
        ) * self._supply.voltage
        self._error[side] = error
        limit = self._supply.torque_n_m(measured_rad_s if torque > 0.0 else -measured_rad_s)
        if abs(torque) <= limit:
            self._integral[side] = integral
        return max(-limit, min(limit, torque))


def build_motors(engine: Engine, config: MotorConfig, step_s: float, steps_per_tick: int) -> Motors:
    """The motors of a configuration. step_s: physics step; steps_per_tick: per control tick."""
    if config.kind == "pid":
        return PidMotors(engine, config, step_s)
    if config.kind == "ideal":
        return IdealMotors(engine)
    return VelocityMotors(engine, config, step_s, steps_per_tick)
