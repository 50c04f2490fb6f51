"""One wheel on a slippery floor: does the robot turn to that side, and how far?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.robots import MuSplitConfig
from slamsim.scenarios.base import Outcome, Scenario, Trial
from slamsim.scenarios.physics.mu_split_findings import split_found
from slamsim.scenarios.scripted import SECONDS_OF_CORE, robot_motion, true_poses
from slamsim.sim.drive.script import CONTROL_HZ, Command, Forces, ScriptedRun, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Ground
from slamsim.sim.robot.model import RobotModel, build_robot

SHOWN = (0.0, 0.1)
"""Frictions under the right wheel whose runs are drawn: none, and hardly any."""


@dataclass(frozen=True, slots=True)
class _Case:
    """motor: its kind. right: friction under the right wheel. support: of dragged supports."""

    motor: str
    right: float
    support: float | None = None

    @property
    def label(self) -> str:
        dragged = "" if self.support is None else f", supports dragged with {self.support:g}"
        return f"{self.motor} motors, right wheel on {self.right:g}{dragged}"

    def robot(self, config: MuSplitConfig) -> RobotConfig:
        robot = config.robot
        motor = robot.motor.model_copy(update={"kind": self.motor})
        supports = robot.support_wheels
        if self.support is not None:
            stuck = {"friction": self.support, "rolling": False}
            supports = supports.model_copy(update=stuck)
        return robot.model_copy(update={"motor": motor, "support_wheels": supports})


def _trials(config: MuSplitConfig, seed: int) -> Sequence[Trial]:
    """Each motor on each friction; on the lowest one, each drag of the supports as well."""
    cost = SECONDS_OF_CORE * config.duration_s
    return [
        Trial(case.label, partial(drive_split, case, config), cost=cost) for case in _cases(config)
    ]


SCENARIO = Scenario[MuSplitConfig](
    "µ-split", lambda config: engine_parameters(config.physics), _trials, split_found
)
"""The study's fourth scenario."""


def _cases(config: MuSplitConfig) -> list[_Case]:
    lowest = min(config.right_frictions)
    return [
        *(_Case(motor, right) for motor in config.motors for right in config.right_frictions),
        *(_Case(config.motors[0], lowest, support) for support in config.support_frictions),
    ]


def drive_split(case: _Case, config: MuSplitConfig) -> Outcome:
    """One run."""
    model = build_robot(case.robot(config))
    under = (config.left_friction / model.wheel_friction, case.right / model.wheel_friction)
    command = Command(config.duration_s, config.speed_m_s)
    run = scripted_run(model, Ground(under_wheels=under), [command], config.physics, forces=True)
    poses = true_poses(run)
    assert run.forces is not None
    shown = case.motor == config.motors[0] and case.right in SHOWN and case.support is None
    return Outcome(
        values={
            "motor": case.motor,
            "right_friction": case.right,
            "support_friction": case.support,
            "end_x_m": float(poses[-1, 0]),
            "end_y_m": float(poses[-1, 1]),
            "yaw_deg": float(np.degrees(poses[-1, 2])),
            "direction_deg": direction_deg(run),
            "turn_by_theory_deg": turn_by_theory_deg(model, case, config, run.forces),
            "right_wheel_load_n": typical_load_n(run.forces),
            "ended": run.ended,
        },
        motions=(robot_motion(case.label, run, model),) if shown else (),
        arrays={"path_m": poses[:: max(config.physics.rate_hz // 20, 1), :2]},
    )


def direction_deg(run: ScriptedRun) -> float:
    """How far the direction of motion has turned from where the robot looked at first."""
    velocity = run.drive.linear_velocity_m_s[:, :2]
    moving = np.linalg.norm(velocity, axis=1) > 0.01
    if not moving.any():
        return 0.0
    turning = np.unwrap(np.arctan2(velocity[moving, 1], velocity[moving, 0]))
    return float(np.degrees(turning[-1]))


def turn_by_theory_deg(
    model: RobotModel, case: _Case, config: MuSplitConfig, forces: Forces
) -> float | None:
    """The turn while the right wheel slips and the left one holds.

    Getting going sets the robot turning about the left contact, with ``m v d / 2`` of angular
    momentum L. The slipping wheel brakes that at distance d with a moment M from the first
    instant on, and so do the supports, which roll along and are dragged across. With L building
    up evenly over a time T the robot turns by ``L (L - T M) / (2 I M)``. None where nothing
    brakes, or T is not known.
    """
    load_n, (front_n, rear_n) = typical_load_n(forces), np.median(forces.support_load_n, axis=0)
    feet = model.description.placements()
    dragged = front_n * abs(feet["caster_front_link"][0, 3])
    dragged += rear_n * abs(feet["caster_rear_link"][0, 3])
    braking_n_m = case.right * load_n * model.track_m + model.support_friction * dragged
    going_s = _getting_going_s(model, case, config, forces)
    if braking_n_m == 0.0 or going_s is None:
        return None
    momentum = _momentum(model, config.speed_m_s)
    left_over = max(momentum - going_s * braking_n_m, 0.0)
    turned = momentum * left_over / (2.0 * _inertia_about_left(model) * braking_n_m)
    return float(-np.degrees(turned))


def _getting_going_s(
    model: RobotModel, case: _Case, config: MuSplitConfig, forces: Forces
) -> float | None:
    """Until the left tyre has the commanded speed: its grip takes so long, its motor may longer."""
    if case.motor == "pid" or config.left_friction == 0.0:
        return None
    turning_rad_s = _momentum(model, config.speed_m_s) / _inertia_about_left(model)
    centre_m_s = config.speed_m_s - 0.5 * model.track_m * turning_rad_s
    grip_n = config.left_friction * float(np.median(forces.wheel_load_n[:, 0]))
    gripping_s = model.description.whole().mass_kg * centre_m_s / grip_n
    return max(gripping_s, 1.0 / CONTROL_HZ if case.motor == "velocity" else 0.0)


def typical_load_n(forces: Forces) -> float:
    """On the right wheel."""
    return float(np.median(forces.wheel_load_n[:, 1]))


def _momentum(model: RobotModel, speed_m_s: float) -> float:
    return model.description.whole().mass_kg * speed_m_s * 0.5 * model.track_m


def _inertia_about_left(model: RobotModel) -> float:
    """kg m^2, about the vertical through the left wheel's point of contact."""
    whole = model.description.whole()
    arm_m = np.array([whole.centre_m[0], whole.centre_m[1] - 0.5 * model.track_m])
    return float(whole.inertia_kg_m2[2, 2] + whole.mass_kg * (arm_m @ arm_m))
