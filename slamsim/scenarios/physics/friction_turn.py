"""Against a heavy box at a small angle: does friction turn the robot towards it?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from slamsim.config.scenarios.friction_turn import BoxConfig, FrictionTurnConfig
from slamsim.core.types import FloatArray
from slamsim.scenarios.base import BodyMotion, Findings, Outcome, Row, Solid, Trial
from slamsim.scenarios.physics.friction_turn_findings import turn_found
from slamsim.scenarios.repeats import SECONDS_OF_CORE, robot_motion, true_poses
from slamsim.sim.drive.script import Command, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Block, Ground
from slamsim.sim.robot.model import RobotModel, build_robot

SHOWN_HZ = 20


class FrictionTurn:
    """The study's sixth scenario."""

    title = "Friction turn"

    def engine(self, config: FrictionTurnConfig) -> Row:
        return engine_parameters(config.physics)

    def trials(self, config: FrictionTurnConfig, seed: int) -> Sequence[Trial]:
        """Each motor on each friction."""
        return [
            Trial(
                f"{motor} motors, friction {friction:g}",
                partial(drive_against, motor, friction, config),
                SECONDS_OF_CORE * config.duration_s,
            )
            for motor in config.motors
            for friction in config.body_frictions
        ]

    def conclude(self, config: FrictionTurnConfig, outcomes: Sequence[Outcome]) -> Findings:
        return turn_found(config, outcomes)


def drive_against(motor: str, friction: float, config: FrictionTurnConfig) -> Outcome:
    """One run."""
    motors = config.robot.motor.model_copy(update={"kind": motor})
    changed = {"motor": motors, "body_friction": friction}
    model = build_robot(config.robot.model_copy(update=changed))
    box = box_in_the_way(config.box, model, config.approach_s * config.speed_m_s)
    command = Command(config.duration_s, config.speed_m_s)
    run = scripted_run(model, Ground(blocks=(box,)), [command], config.physics)
    stamps_s = 1e-9 * (run.drive.stamps_ns - run.drive.stamps_ns[0])
    poses = true_poses(run)
    turned_deg = np.degrees(poses[:, 2] - poses[0, 2])
    touches = run.drive.wall_contact
    contact_s = float(stamps_s[np.argmax(touches)]) if touches.any() else None
    shown = friction == config.body_frictions[0]
    label = f"{motor} motors, friction {friction:g}"
    place = BodyMotion("box", Solid("box", box.size_m), run.blocks[0])
    every = max(config.physics.rate_hz // SHOWN_HZ, 1)
    return Outcome(
        values={
            "motor": motor,
            "body_friction": friction,
            "contact_s": contact_s,
            "turned_deg": float(turned_deg[-1]),
            "end_x_m": float(poses[-1, 0]),
            "end_y_m": float(poses[-1, 1]),
            "box_moved_m": float(np.linalg.norm(np.ptp(run.blocks[0].positions_m, axis=0))),
            "ended": run.ended,
        },
        motions=(robot_motion(label, run, model), place) if shown else (),
        arrays={
            "since_start_s": stamps_s[::every],
            "turned_deg": turned_deg[::every],
            "path_m": poses[::every, :2],
            "corners_m": corners_m(box),
        },
    )


def box_in_the_way(config: BoxConfig, model: RobotModel, approach_m: float) -> Block:
    """On the robot's left; its middle is touched when the robot has come so far along x."""
    angle_rad = math.radians(config.side_angle_deg)
    outwards = np.array([math.sin(angle_rad), math.cos(angle_rad)])
    radius_m = model.footprint_radius_m
    centre_m = np.array([approach_m, 0.0]) + outwards * (radius_m + 0.5 * config.width_m)
    return Block(
        size_m=(config.length_m, config.width_m, config.height_m),
        mass_kg=config.mass_kg,
        position_m=(float(centre_m[0]), float(centre_m[1]), 0.5 * config.height_m),
        yaw_rad=-angle_rad,
    )


def corners_m(box: Block) -> FloatArray:
    """(5, 2) its outline on the floor, closed."""
    half = 0.5 * np.array(box.size_m[:2])
    around = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * half
    cos, sin = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    return np.asarray(around @ np.array([[cos, sin], [-sin, cos]]) + box.position_m[:2])


SCENARIO = FrictionTurn()
