"""Up a slope: how far does the robot come, does it slide, does it tip over when it is held?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.robots import ClimbConfig, HandConfig, RampConfig
from slamsim.core.types import GRAVITY_M_S2, FloatArray, Trajectory
from slamsim.scenarios.base import BodyMotion, Outcome, Scenario, Solid, Trial
from slamsim.scenarios.physics.ramp_findings import ramp_found
from slamsim.scenarios.scripted import SECONDS_OF_CORE, duration_s, robot_motion, true_poses
from slamsim.sim.drive.script import Command, ScriptedRun, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Block, Ground
from slamsim.sim.robot.model import RobotModel, build_robot

WALL_M = (0.1, 2.0, 0.5)
RAMP_M = (4.0, 1.0, 0.02)
"""What is drawn, and stands behind the robot: length, width and thickness."""
SHOWN = {("proportional", 20.0), ("velocity", 36.0)}
"""(motors, slope in degrees) of the runs that are drawn: one that climbs and one that slides."""


def _trials(config: RampConfig, seed: int) -> Sequence[Trial]:
    """Each kind of motor on each slope, then held by a hand, on springs and without."""
    climbs = [
        Trial(
            f"{name} motors, {slope_deg:g}°",
            partial(climb, name, climbed, slope_deg, config),
            SECONDS_OF_CORE * config.duration_s,
        )
        for name, climbed in config.climbs.items()
        for slope_deg in config.slopes_deg
    ]
    return [*climbs, *(_held_trials(config, config.hand) if config.hand else [])]


SCENARIO = Scenario[RampConfig](
    "Ramp", lambda config: engine_parameters(config.physics), _trials, ramp_found
)
"""The study's fifth scenario."""


def _held_trials(config: RampConfig, hand: HandConfig) -> list[Trial]:
    return [
        Trial(
            _held_label(sprung, slope_deg),
            partial(hold, sprung, slope_deg, hand, config),
            SECONDS_OF_CORE * hand.duration_s,
        )
        for sprung in (True, False)
        for slope_deg in hand.slopes_deg
    ]


@dataclass(frozen=True, slots=True)
class _Push:
    """What pulls a robot down the slope, and what its tyres can hold against it."""

    needed_n: float
    available_n: float


def climb(name: str, climbed: ClimbConfig, slope_deg: float, config: RampConfig) -> Outcome:
    """One drive up one slope."""
    model = build_robot(config.robot.model_copy(update={"motor": climbed.motor}))
    back_m = model.footprint_radius_m + config.wall_behind_m
    wall = Block(WALL_M, 0.0, (-back_m - 0.5 * WALL_M[0], 0.0, 0.5 * WALL_M[2]))
    ground = Ground(math.radians(slope_deg), climbed.floor_friction, blocks=(wall,))
    start = (0.0, 0.0, math.radians(config.start_yaw_deg))
    command = Command(config.duration_s, config.speed_m_s)
    run = scripted_run(model, ground, [command], config.physics, start_pose=start, forces=True)
    push = _push(run, model, climbed.floor_friction, ground.slope_rad)
    poses = true_poses(run)
    label = f"{name} motors, {slope_deg:g}°"
    return Outcome(
        values={
            "held": False,
            "motor": name,
            "slope_deg": slope_deg,
            "travel_m": float(poses[-1, 0]),
            "sideways_m": _sideways_m(run),
            "yaw_deg": float(np.degrees(poses[-1, 2])),
            "pitch_deg": float(pitches_deg(run)[-1]),
            "push_needed_n": push.needed_n,
            "push_available_n": push.available_n,
            "ended": run.ended,
            "ended_after_s": duration_s(run),
        },
        motions=shown_on_slope(label, run, model, ground) if (name, slope_deg) in SHOWN else (),
    )


def hold(sprung: bool, slope_deg: float, hand: HandConfig, config: RampConfig) -> Outcome:
    """The wheels push, the hand does not give way: does the front rise?"""
    model = build_robot(_loaded(config.robot, hand, sprung))
    ground = Ground(math.radians(slope_deg), hand_height_m=hand.height_m)
    command = Command(hand.duration_s, config.speed_m_s)
    run = scripted_run(model, ground, [command], config.physics)
    return Outcome(
        values={
            "held": True,
            "springs": sprung,
            "slope_deg": slope_deg,
            "pitch_deg": float(pitches_deg(run).min()),
            "ended": run.ended,
            "ended_after_s": duration_s(run),
        },
        motions=shown_on_slope(_held_label(sprung, slope_deg), run, model, ground)
        if slope_deg == max(hand.slopes_deg)
        else (),
    )


def shown_on_slope(
    label: str, run: ScriptedRun, model: RobotModel, ground: Ground
) -> tuple[BodyMotion, ...]:
    """The robot, the ramp and what stands on it, seen by an upright observer."""
    length_m, width_m, thick_m = RAMP_M
    below = np.array([[0.4 * length_m, 0.0, -0.5 * thick_m]])
    level = Trajectory(np.zeros(1, dtype=np.int64), below, np.array([[0.0, 0.0, 0.0, 1.0]]))
    shown = [
        robot_motion(label, run, model),
        BodyMotion("ramp", Solid("box", (length_m, width_m, thick_m)), level),
        *(
            BodyMotion("wall", Solid("box", block.size_m), way)
            for block, way in zip(ground.blocks, run.blocks, strict=True)
        ),
    ]
    up = Rotation.from_euler("y", -ground.slope_rad)
    return tuple(replace(one, T_map_body=_turned(one.T_map_body, up)) for one in shown)


def _turned(way: Trajectory, rotation: Rotation) -> Trajectory:
    quats = (rotation * Rotation.from_quat(way.quats_xyzw)).as_quat()
    return Trajectory(way.stamps_ns, rotation.apply(way.positions_m), quats)


def _held_label(sprung: bool, slope_deg: float) -> str:
    return f"held at {slope_deg:g}°, {'on springs' if sprung else 'rigid'}"


def _loaded(robot: RobotConfig, hand: HandConfig, sprung: bool) -> RobotConfig:
    springs = hand.suspension if sprung else None
    wheels = robot.drive_wheels.model_copy(update={"suspension": springs})
    load = robot.weight.model_copy(update={"mass_kg": robot.weight.mass_kg + hand.load_kg})
    return robot.model_copy(update={"drive_wheels": wheels, "weight": load})


def _push(run: ScriptedRun, model: RobotModel, floor: float, slope_rad: float) -> _Push:
    """From the loads that were felt, in the middle of the run."""
    assert run.forces is not None
    loads_n = run.forces.wheel_load_n.sum(axis=1)
    weight_n = GRAVITY_M_S2 * model.description.whole().mass_kg
    return _Push(
        weight_n * math.sin(slope_rad), float(np.median(loads_n)) * floor * model.wheel_friction
    )


def _sideways_m(run: ScriptedRun) -> float:
    """The farthest from the line on which it was placed."""
    poses = true_poses(run)
    x_m, y_m, yaw_rad = poses[0]
    across = np.array([-math.sin(yaw_rad), math.cos(yaw_rad)])
    return float(np.abs((poses[:, :2] - [x_m, y_m]) @ across).max())


def pitches_deg(run: ScriptedRun) -> FloatArray:
    """(n,) about the robot's y axis; negative where the front is up."""
    x, y, z, w = run.drive.quats_xyzw.T
    return np.asarray(np.degrees(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))))
