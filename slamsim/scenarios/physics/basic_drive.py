"""Forth and back with growing speed, several times: where does the robot stop?"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import accumulate

import numpy as np

from slamsim.config.robot import MotorConfig, RobotConfig, VariationConfig
from slamsim.config.scenarios.robots import BasicDriveConfig
from slamsim.core.types import FloatArray
from slamsim.models.differential_drive import wheel_odometry
from slamsim.scenarios.base import Outcome, Scenario, Trial
from slamsim.scenarios.physics.basic_drive_findings import stops_found
from slamsim.scenarios.scripted import (
    SECONDS_OF_CORE,
    Tested,
    robot_motion,
    robots_under_test,
    run_seed,
    steps_at,
    straight_commands,
    true_poses,
)
from slamsim.sim.drive.script import read_encoders, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Ground
from slamsim.sim.robot.as_built import drawn_robot
from slamsim.sim.robot.model import build_robot

PATH_HZ = 10


def _trials(config: BasicDriveConfig, seed: int) -> Sequence[Trial]:
    """Every robot as often as it differs from run to run, and one of ideal motors."""
    lasting_s = 2 * len(config.speeds_m_s) * (config.drive_s + config.rest_s)
    return [
        Trial(
            f"{robot.name}, run {run + 1}",
            partial(
                drive_once,
                robot,
                config,
                run,
                run_seed(seed, "basic_drive", robot.name, str(run)),
            ),
            cost=SECONDS_OF_CORE * lasting_s,
        )
        for robot in _robots(config)
        for run in range(robot.runs(config.runs))
    ]


SCENARIO = Scenario[BasicDriveConfig](
    "Basic drive",
    lambda config: engine_parameters(config.physics),
    _trials,
    lambda config, outcomes: stops_found(
        config, outcomes, [robot.name for robot in _robots(config)]
    ),
)
"""The study's seventh scenario."""


def ideal_twin(robot: RobotConfig) -> Tested:
    """The robot without anything that makes it miss: equal wheels, motors that obey at once."""
    same = {"radius_ratio": 1.0, "radius_scale": 1.0, "track_scale": 1.0}
    wheels = robot.drive_wheels.model_copy(update=same)
    ideal = {"motor": MotorConfig(kind="ideal"), "variation": VariationConfig()}
    return Tested("ideal motors", robot.model_copy(update={"drive_wheels": wheels, **ideal}))


def _robots(config: BasicDriveConfig) -> list[Tested]:
    return [*robots_under_test(config.robot, config.beside), ideal_twin(config.robot)]


def drive_once(robot: Tested, config: BasicDriveConfig, run: int, seed: int) -> Outcome:
    """One run of one robot: its stops, true and by odometry."""
    model = build_robot(drawn_robot(robot.config, seed))
    commands = straight_commands(config)
    driven = scripted_run(model, Ground(friction=config.floor_friction), commands, config.physics)
    ends_s = np.array(list(accumulate(command.duration_s for command in commands)))
    at = steps_at(driven, ends_s[1::2])
    stops, told = (
        true_poses(driven)[at],
        wheel_odometry(read_encoders(driven.drive, model)).poses[at],
    )
    every = max(round(config.physics.rate_hz / PATH_HZ), 1)
    shown = run == 0 and robot.name != config.robot.name
    return Outcome(
        values={
            "robot": robot.name,
            "run": run + 1,
            "seed": seed,
            **_stop_values(stops, told),
        },
        motions=(robot_motion(robot.name, driven, model),) if shown else (),
        arrays={"stops": stops, "path_m": driven.drive.positions_m[::every, :2]},
    )


def _stop_values(stops: FloatArray, odometry: FloatArray) -> dict[str, float]:
    values: dict[str, float] = {}
    for number, (true, told) in enumerate(zip(stops, odometry, strict=True), start=1):
        values[f"stop_{number}_x_m"], values[f"stop_{number}_y_m"] = true[:2].tolist()
        values[f"stop_{number}_yaw_deg"] = float(np.degrees(true[2]))
        values[f"stop_{number}_odometry_x_m"] = float(told[0])
        values[f"stop_{number}_odometry_y_m"] = float(told[1])
    return values
