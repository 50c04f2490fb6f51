"""The parameters of the fit as a robot that can be driven, and its runs in the physics engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import accumulate

import numpy as np

from slamsim.config.measurements import MeasurementsConfig, ParameterName
from slamsim.config.robot import MotorConfig, RobotConfig, VariationConfig
from slamsim.config.scenarios.robots import SCENARIO_PHYSICS
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.models.differential_drive import wheel_odometry
from slamsim.scenarios.base import Findings, Outcome, Row, Scenario, Trial
from slamsim.scenarios.identify.model import VARYING, Body, Runs
from slamsim.scenarios.run import Chosen, Listener, run_scenarios
from slamsim.scenarios.scripted import (
    SECONDS_OF_CORE,
    corner_deg,
    square_commands,
    steps_at,
    straight_commands,
    true_poses,
)
from slamsim.sim.drive.script import Command, read_encoders, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Ground
from slamsim.sim.robot.as_built import multiplied
from slamsim.sim.robot.model import build_robot

STRAIGHT, WAYS = "straight", ("clockwise", "counter-clockwise")
TURNING_S, TURNING_RAD_S = 2.0, 1.0
"""A turn on the spot, of which the second half is steady."""


def robot_at(values: Mapping[ParameterName, float], nominal: RobotConfig, name: str) -> RobotConfig:
    """The robot of these parameters, with a proportional motor controller."""
    wheels = nominal.drive_wheels
    gain = values["motor_gain_n_m_s"]
    true_wheels = {
        "radius_ratio": values["radius_ratio"],
        "radius_scale": values["radius_scale"],
        "track_scale": values["track_scale"],
        "friction": values["tyre_friction"],
    }
    motor = {
        "kind": "pid",
        "pid_proportional": gain,
        "pid_integral": 0.0,
        "pid_derivative": 0.0,
        "gear_friction_n_m": gain * values["droop_m_s"] / wheels.radius_m,
        "gear_friction_ratio": values["gear_friction_ratio"],
        "battery_sag_per_min": values["battery_sag_per_min"],
        "max_torque_n_m": values["max_torque_n_m"],
    }
    variation = VariationConfig(
        radius_ratio=values["variation_radius_ratio"],
        track=values["variation_track"],
        gear_friction=values["variation_gear_friction"],
        gear_friction_ratio=values["variation_gear_friction_ratio"],
    )
    return nominal.model_copy(
        update={
            "name": name,
            "drive_wheels": wheels.model_copy(update=true_wheels),
            "motor": MotorConfig.model_validate({**nominal.motor.model_dump(), **motor}),
            "variation": variation,
        }
    )


def varied(robot: RobotConfig, draws: FloatArray) -> RobotConfig:
    """The robot of one run. draws: (4,) standard normal, one for each of VARYING."""
    return multiplied(
        robot,
        {
            name: float(np.exp(getattr(robot.variation, name) * z))
            for name, z in zip(VARYING, draws.tolist(), strict=True)
        },
    )


def weighed(robot: RobotConfig) -> Body:
    """Mass, weight on the driven wheels and scrubbing, as the robot turns in the engine.

    Raises SlamsimError for a robot that does not turn.
    """
    as_drawn = robot.model_copy(update={"variation": VariationConfig()})
    held = robot.motor.model_copy(update={"kind": "velocity", "gear_friction_n_m": 0.0})
    model = build_robot(as_drawn.model_copy(update={"motor": held}))
    turning = scripted_run(
        model, Ground(), [Command(TURNING_S, 0.0, TURNING_RAD_S)], SCENARIO_PHYSICS, forces=True
    )
    if turning.ended or turning.forces is None:
        raise SlamsimError(f"the robot {robot.name} does not turn on the spot: {turning.ended}")
    steady = slice(len(turning.drive) // 2, None)
    driven_n = float(turning.forces.wheel_load_n[steady].sum(axis=1).mean())
    carried_n = float(turning.forces.support_load_n[steady].sum(axis=1).mean())
    torque_n_m = float(np.abs(turning.forces.motor_torque_n_m[steady]).mean())
    return Body(
        mass_kg=model.description.whole().mass_kg,
        wheel_radius_m=model.wheel_radius_m,
        track_m=model.track_m,
        driven_share=driven_n / (driven_n + carried_n),
        scrub_n_m=torque_n_m / model.wheel_radius_m * model.track_m,
    )


def simulated(
    config: MeasurementsConfig,
    robot: RobotConfig,
    draws: FloatArray,
    listen: Listener,
    jobs: int | None,
) -> tuple[Runs, tuple[Row, ...]]:
    """The measured experiments in the physics engine, and the row of each of its runs.

    draws: (m, runs, 4) as of an Experiment. Runs of the same draws are driven once. Raises
    SlamsimError naming the first run that failed.
    """
    check = Scenario[MeasurementsConfig](
        "Check in the physics engine",
        lambda _: engine_parameters(SCENARIO_PHYSICS),
        partial(_trials, robot, draws),
        lambda *_: Findings("", {}, ()),
    )
    (result,) = run_scenarios([Chosen(robot.name, check, config)], 0, jobs=jobs, listen=listen)
    if result.failures:
        label, reason = result.failures[0]
        raise SlamsimError(f"{robot.name}, {label}: {reason}")
    return _gathered(config, draws, result.rows), result.rows


def _gathered(config: MeasurementsConfig, draws: FloatArray, rows: Sequence[Row]) -> Runs:
    """The rows in the order of the draws."""
    of_run = {(row["script"], row["draws"]): row for row in rows}
    parts = _parts(config, draws)

    def column(script: str, key: str) -> FloatArray:
        """(m, n) of the runs of one script."""
        values = [[of_run[script, _key(draw)][key] for draw in some] for some in parts[script]]
        return np.array(values, dtype=np.float64)

    def places(script: str, key: str) -> FloatArray:
        """(m, n, 2)."""
        return np.stack([column(script, f"{key}_{axis}_m") for axis in "xy"], axis=-1)

    stops = range(1, 2 * len(config.basic_drive.speeds_m_s) + 1)
    return Runs(
        np.stack([places(STRAIGHT, f"stop_{stop}") for stop in stops], axis=2),
        np.stack([places(way, "error") for way in WAYS], axis=1),
        np.stack([column(way, "corner_deg") for way in WAYS], axis=1),
    )


def _parts(config: MeasurementsConfig, draws: FloatArray) -> dict[str, FloatArray]:
    """(m, n, 4) draws of each script's runs."""
    straights = config.basic_drive.runs
    clockwise = straights + config.umbmark.runs
    parts = draws[:, :straights], draws[:, straights:clockwise], draws[:, clockwise:]
    return dict(zip((STRAIGHT, *WAYS), parts, strict=True))


def _trials(
    robot: RobotConfig, draws: FloatArray, config: MeasurementsConfig, seed: int
) -> Sequence[Trial]:
    """The experiments, so that they run side by side; nothing else is random."""
    squares, side_m = config.umbmark, config.umbmark.side_m
    commands = {
        STRAIGHT: straight_commands(config.basic_drive),
        **{way: square_commands(squares, side_m, left=way == WAYS[1]) for way in WAYS},
    }
    return [
        Trial(
            f"{script}, {key}",
            partial(_play, varied(robot, draw), script, key, commands[script]),
            cost=SECONDS_OF_CORE * sum(command.duration_s for command in commands[script]),
        )
        for script, some in _parts(config, draws).items()
        for key, draw in {_key(draw): draw for draw in some.reshape(-1, len(VARYING))}.items()
    ]


def _key(draw: FloatArray) -> str:
    return " ".join(f"{z:.4f}" for z in draw.tolist())


def _play(robot: RobotConfig, script: str, key: str, commands: Sequence[Command]) -> Outcome:
    """One run: all that any figure asks of it."""
    model = build_robot(robot)
    run = scripted_run(model, Ground(), commands, SCENARIO_PHYSICS)
    ends = steps_at(run, np.array(list(accumulate(command.duration_s for command in commands))))
    true = true_poses(run)
    values: dict[str, float | str] = {"script": script, "draws": key}
    if script == STRAIGHT:
        for number, (x_m, y_m) in enumerate(true[ends[1::2], :2].tolist(), start=1):
            values[f"stop_{number}_x_m"], values[f"stop_{number}_y_m"] = x_m, y_m
    else:
        told = wheel_odometry(read_encoders(run.drive, model)).poses
        values["error_x_m"], values["error_y_m"] = (true[-1, :2] - told[-1, :2]).tolist()
        values["corner_deg"] = corner_deg(true[ends, 2])
        values["odometry_corner_deg"] = corner_deg(np.unwrap(told[:, 2])[ends])
    return Outcome(values)
