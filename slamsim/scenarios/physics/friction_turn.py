"""Against a heavy box at a small angle: does friction turn the robot towards it?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from slamsim.config.scenarios.robots import BoxConfig, FrictionTurnConfig
from slamsim.core.types import FloatArray
from slamsim.scenarios.base import (
    BodyMotion,
    Chart,
    Findings,
    Outcome,
    ResultTable,
    Scenario,
    Series,
    Solid,
    Trial,
    Verdict,
)
from slamsim.scenarios.rows import having, number
from slamsim.scenarios.scripted import SECONDS_OF_CORE, robot_motion, true_poses
from slamsim.sim.drive.script import Command, scripted_run
from slamsim.sim.engine import engine_parameters
from slamsim.sim.ground import Block, Ground
from slamsim.sim.robot.model import RobotModel, build_robot

SHOWN_HZ = 20


def _trials(config: FrictionTurnConfig, seed: int) -> Sequence[Trial]:
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


STUDY_CONTACT_S = 1.3
STUDY_SINCE_START_S = (0.1, 1.3, 2.0, 2.9)
STUDY_TURNED_DEG = (0.0, 0.0, 4.0, 24.0)
"""Unity: 20 degrees between side and driving direction at 0.1 s, 24 at 2.0 s; turned by 24 since
the contact at 2.9 s."""
CONTACT_TOLERANCE_S = 0.1
"""The study tells tenths of a second. That the box stands so far away is part of the set-up."""
NEAR_DEG = 10.0
"""Half of the angle at which the robot meets the box."""
TOWARDS_DEG = 5.0
"""A quarter of that angle; the blow of the first touch alone turns it by less."""

_SUMMARY = (
    "The robot drives against the side of a heavy box at 20°. The box holds the point that touches "
    "it while the wheels push on, and so the robot turns towards the box."
)


def turn_found(config: FrictionTurnConfig, outcomes: Sequence[Outcome]) -> Findings:
    """outcomes: every motor on every friction between body and box."""
    main = having(outcomes, body_friction=config.body_frictions[0])
    return Findings(
        summary=f"{_SUMMARY}{_told(main)}",
        numbers={
            f"{one.values['motor']}_turned_deg_at_2.9_s": _turned_at(one, STUDY_SINCE_START_S[-1])
            for one in main
        },
        verdicts=tuple(verdict for one in main for verdict in _verdicts(one)),
        tables=(_table(outcomes),),
        charts=(_turn_chart(main), _path_chart(main)),
    )


def _told(main: Sequence[Outcome]) -> str:
    turns = ", ".join(
        f"{_turned_at(one, STUDY_SINCE_START_S[-1]):.0f}° with {one.values['motor']} motors"
        for one in main
    )
    unity_deg = STUDY_TURNED_DEG[-1]
    return f" After 2.9 s it has turned by {turns}; Unity {unity_deg:.0f}°." if turns else ""


def _turned_at(one: Outcome, since_start_s: float) -> float:
    """By then; the last known turn if the run ended before."""
    arrays = one.arrays
    return float(np.interp(since_start_s, arrays["since_start_s"], arrays["turned_deg"]))


def _verdicts(one: Outcome) -> list[Verdict]:
    row, motor = one.values, one.values["motor"]
    contact_s, turned_deg = row["contact_s"], number(row, "turned_deg")
    later_deg = [_turned_at(one, since_s) for since_s in STUDY_SINCE_START_S[2:]]
    off_deg = max(
        abs(ours - theirs) for ours, theirs in zip(later_deg, STUDY_TURNED_DEG[2:], strict=True)
    )
    return [
        Verdict(
            f"With {motor} motors the robot turns towards the box",
            "study",
            contact_s is not None and turned_deg > TOWARDS_DEG,
            f"by {turned_deg:.0f}° at the end",
        ),
        Verdict(
            f"With {motor} motors it touches the box after {STUDY_CONTACT_S:g} s and turns as in "
            f"Unity, within {NEAR_DEG:.0f}°",
            "study",
            contact_s is not None
            and abs(number(row, "contact_s") - STUDY_CONTACT_S) < CONTACT_TOLERANCE_S
            and off_deg < NEAR_DEG,
            "it never touched the box"
            if contact_s is None
            else f"contact at {contact_s:.2f} s; {later_deg[0]:.0f}° at 2.0 s (Unity 4°), "
            f"{later_deg[1]:.0f}° at 2.9 s (Unity 24°)",
        ),
    ]


def _table(outcomes: Sequence[Outcome]) -> ResultTable:
    rows = tuple(
        (
            str(row["motor"]),
            f"{row['body_friction']:g}",
            "never" if row["contact_s"] is None else f"{row['contact_s']:.2f}",
            *(f"{_turned_at(one, since_s):.1f}" for since_s in STUDY_SINCE_START_S[2:]),
            f"{row['turned_deg']:.1f}",
            f"{1e3 * number(row, 'box_moved_m'):.1f}",
        )
        for one in outcomes
        for row in (one.values,)
    )
    header = (
        "motors",
        "friction",
        "contact [s]",
        "turned at 2.0 s [°]",
        "at 2.9 s [°]",
        "at the end [°]",
        "box moved [mm]",
    )
    return ResultTable("Turn by friction between robot and box", header, rows)


def _turn_chart(outcomes: Sequence[Outcome]) -> Chart:
    ours = [
        Series(
            f"{one.values['motor']} motors",
            "slamsim",
            one.arrays["since_start_s"],
            one.arrays["turned_deg"],
            dashed=number_of > 0,
        )
        for number_of, one in enumerate(outcomes)
    ]
    unity = Series(
        "Unity",
        "unity",
        np.array(STUDY_SINCE_START_S),
        np.array(STUDY_TURNED_DEG),
        "line+points",
    )
    return Chart("Turn towards the box", "time [s]", "turned [°]", (*ours, unity))


def _path_chart(outcomes: Sequence[Outcome]) -> Chart:
    paths = [
        Series(f"{one.values['motor']} motors", "slamsim", *one.arrays["path_m"].T)
        for one in outcomes
    ]
    box = [Series("box", "theory", *one.arrays["corners_m"].T) for one in outcomes[:1]]
    return Chart("Path along the box", "x [m]", "y [m]", (*paths, *box), equal=True)


SCENARIO = Scenario[FrictionTurnConfig](
    "Friction turn", lambda config: engine_parameters(config.physics), _trials, turn_found
)
"""The study's sixth scenario."""
