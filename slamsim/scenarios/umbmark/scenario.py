"""UMBmark: squares driven both ways, odometry errors before and after calibration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import accumulate
from typing import cast

import numpy as np

from slamsim.config.scenarios.robots import UmbmarkConfig
from slamsim.models.differential_drive import metres_per_tick, wheel_odometry
from slamsim.scenarios.base import Outcome, Scenario, Trial, Value
from slamsim.scenarios.scripted import (
    SECONDS_OF_CORE,
    Tested,
    corner_deg,
    robot_motion,
    robots_under_test,
    run_seed,
    square_commands,
    steps_at,
    true_poses,
)
from slamsim.scenarios.umbmark.findings import KNOWN, squares_found
from slamsim.sim.drive.script import read_encoders, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Ground
from slamsim.sim.robot.as_built import drawn_robot
from slamsim.sim.robot.model import build_robot


def _trials(config: UmbmarkConfig, seed: int) -> Sequence[Trial]:
    """Squares of each robot, and single corners on tyres of several frictions."""
    return [*_squares(config, seed), *_corners(config)]


SCENARIO = Scenario[UmbmarkConfig](
    "UMBmark", lambda config: engine_parameters(config.physics), _trials, squares_found
)
"""The study's eighth scenario, with the calibration that it leaves out."""


def known_faults(config: UmbmarkConfig) -> Tested:
    """The robot with the unequal wheels and the track that calibration is to find."""
    faults = {"radius_ratio": config.known_diameter_ratio, "track_scale": config.known_track_ratio}
    wheels = config.robot.drive_wheels.model_copy(update=faults)
    changed = {"drive_wheels": wheels, "variation": config.known_variation}
    return Tested(KNOWN, config.robot.model_copy(update=changed))


def _squares(config: UmbmarkConfig, seed: int) -> list[Trial]:
    robot, *others = robots_under_test(config.robot, config.beside)
    first_m = config.sides_m[0]
    squares = [
        *((robot, side_m, 1) for side_m in config.sides_m),
        *((other, first_m, other.runs(config.sets)) for other in others),
        (known_faults(config), first_m, 2),
    ]
    return [
        _square_trial(config, seed, tested, side_m, number, left, run)
        for tested, side_m, sets in squares
        for number in range(1, sets + 1)
        for left in (False, True)
        for run in range(1, tested.runs(config.runs) + 1)
    ]


def _square_trial(
    config: UmbmarkConfig,
    seed: int,
    robot: Tested,
    side_m: float,
    number: int,
    left: bool,
    run: int,
) -> Trial:
    way = "counter-clockwise" if left else "clockwise"
    label = f"{robot.name}, {side_m:g} m, set {number}, {way}, run {run}"
    lasting_s = sum(c.duration_s for c in square_commands(config, side_m, left=left))
    told: dict[str, Value] = {
        "robot": robot.name,
        "side_m": side_m,
        "set": number,
        "way": way,
        "run": run,
    }
    return Trial(
        label,
        partial(drive_square, robot, config, told, run_seed(seed, "umbmark", label)),
        cost=SECONDS_OF_CORE * lasting_s,
    )


def drive_square(
    robot: Tested, config: UmbmarkConfig, told: dict[str, Value], seed: int
) -> Outcome:
    """One square: where it truly ends, where odometry has it end, how far corners turned.

    told: side_m, way and what else tells the square from its like.
    """
    side_m, left = cast(float, told["side_m"]), told["way"] == "counter-clockwise"
    model = build_robot(drawn_robot(robot.config, seed))
    commands = square_commands(config, side_m, left=left)
    driven = scripted_run(model, Ground(friction=config.floor_friction), commands, config.physics)
    ends = steps_at(driven, np.array(list(accumulate(c.duration_s for c in commands))))
    every = max(round(config.physics.rate_hz / config.odometry_hz), 1)
    encoders = read_encoders(driven.drive, model, config.ticks_per_revolution, every)
    true, odometry = true_poses(driven), wheel_odometry(encoders).poses
    error_m = true[-1, :2] - odometry[-1, :2]
    tick_m = metres_per_tick(encoders.ticks_per_revolution, encoders.wheel_radius_m)
    shown = told["run"] == 1 and told["set"] == 1 and side_m == config.sides_m[0]
    return Outcome(
        values={
            **told,
            "seed": seed,
            "end_x_m": float(true[-1, 0]),
            "end_y_m": float(true[-1, 1]),
            "error_x_m": float(error_m[0]),
            "error_y_m": float(error_m[1]),
            "corner_deg": corner_deg(true[ends, 2]),
            "odometry_corner_deg": corner_deg(np.unwrap(odometry[:, 2])[ends // every]),
        },
        motions=(robot_motion(robot.name, driven, model),) if shown else (),
        arrays={
            "rolled_m": np.diff(encoders.ticks, axis=0) * tick_m,
            "end_m": true[-1, :2],
            "track_m": np.array(encoders.track_m),
            "path_m": true[:: 10 * every, :2],
        },
    )


def _corners(config: UmbmarkConfig) -> list[Trial]:
    return [
        Trial(
            f"corner, friction {friction:g}, supports {'dragged' if dragged else 'rolling'}",
            partial(turn_corner, config, friction, dragged),
            cost=SECONDS_OF_CORE * 4.0,
        )
        for dragged in (False, True)
        for friction in config.frictions
    ]


def turn_corner(config: UmbmarkConfig, friction: float, dragged: bool) -> Outcome:
    """One corner of the robot on tyres, and if dragged on stuck supports, of this friction."""
    robot = config.robot
    wheels = robot.drive_wheels.model_copy(update={"friction": friction})
    stuck = {"rolling": False, "friction": friction} if dragged else {}
    supports = robot.support_wheels.model_copy(update=stuck)
    model = build_robot(
        robot.model_copy(update={"drive_wheels": wheels, "support_wheels": supports})
    )
    commands = square_commands(config, config.sides_m[0], left=True)[2:4]
    driven = scripted_run(model, Ground(), commands, config.physics)
    told_rad = np.unwrap(wheel_odometry(read_encoders(driven.drive, model)).poses[:, 2])
    return Outcome(
        values={
            "robot": robot.name,
            "friction": friction,
            "dragged": dragged,
            "corner_deg": float(np.degrees(true_poses(driven)[-1, 2])),
            "odometry_corner_deg": float(np.degrees(told_rad[-1])),
        }
    )
