"""Basic drive and UMBmark in the physics engine, short, and what they say of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slamsim.config.drive import PhysicsConfig
from slamsim.config.measurements import load_measurements
from slamsim.config.robot import VariationConfig
from slamsim.config.scenarios.robots import SCENARIO_ROBOT, BasicDriveConfig, UmbmarkConfig
from slamsim.scenarios.base import Findings, Outcome
from slamsim.scenarios.physics.basic_drive import SCENARIO as BASIC_DRIVE
from slamsim.scenarios.scripted import robots_under_test, square_commands, straight_commands
from slamsim.scenarios.umbmark.scenario import SCENARIO as UMBMARK

COARSE = PhysicsConfig(rate_hz=120, solver_iterations=20)
VARYING_ROBOT = SCENARIO_ROBOT.model_copy(
    update={"variation": VariationConfig(radius_ratio=0.01, track=0.02)}
)
BASIC = BasicDriveConfig(
    speeds_m_s=(0.3,), drive_s=2.0, rest_s=0.5, runs=2, robot=VARYING_ROBOT, beside=(),
    physics=COARSE,
)  # fmt: skip
SQUARES = UmbmarkConfig(
    sides_m=(0.3,), runs=2, sets=2, rest_s=0.25, beside=(), physics=COARSE, frictions=(1.4,)
)


@pytest.fixture(scope="module")
def straight() -> list[Outcome]:
    return [trial.run() for trial in BASIC_DRIVE.trials(BASIC, 3)]


@pytest.fixture(scope="module")
def squares() -> list[Outcome]:
    return [trial.run() for trial in UMBMARK.trials(SQUARES, 3)]


def finite(findings: Findings) -> bool:
    return all(isinstance(v, str) or np.isfinite(v or 0.0) for v in findings.numbers.values())


def test_ideal_motors_stop_where_theory_has_it_and_others_near(straight: list[Outcome]) -> None:
    findings = BASIC_DRIVE.conclude(BASIC, straight)
    assert findings.verdicts[0].holds
    assert finite(findings)
    for outcome in straight:
        assert outcome.values["stop_1_x_m"] == pytest.approx(0.6, abs=0.02)
        assert outcome.values["stop_2_x_m"] == pytest.approx(0.0, abs=0.02)


def test_runs_differ_and_come_again_for_their_seed(straight: list[Outcome]) -> None:
    first, second = straight[:2]
    assert first.values["stop_1_y_m"] != second.values["stop_1_y_m"]
    again = BASIC_DRIVE.trials(BASIC, 3)[0].run()
    assert again.values == first.values
    assert BASIC_DRIVE.trials(BASIC, 4)[0].run().values != first.values


def test_a_robot_that_is_always_the_same_drives_once() -> None:
    plain = BASIC.model_copy(update={"robot": SCENARIO_ROBOT})
    labels = [trial.label for trial in BASIC_DRIVE.trials(plain, 0)]
    assert labels == ["turtlebot2, run 1", "ideal motors, run 1"]


@pytest.mark.long
def test_calibration_finds_the_faults_and_makes_errors_small(squares: list[Outcome]) -> None:
    findings = UMBMARK.conclude(SQUARES, squares)
    numbers = findings.numbers
    assert numbers["known_faults_diameter_ratio"] == pytest.approx(1.01, abs=0.002)
    assert numbers["known_faults_track_ratio"] == pytest.approx(1.03, abs=0.01)
    improvement = numbers["known_faults_improvement"]
    assert isinstance(improvement, float)
    assert improvement > 3.0
    assert finite(findings)


def test_a_tyre_that_is_not_overloaded_turns_the_whole_corner(squares: list[Outcome]) -> None:
    corners = [o.values["corner_deg"] for o in squares if "friction" in o.values]
    assert len(corners) == 2
    assert corners == pytest.approx([90.0, 90.0], abs=0.5)


@pytest.mark.parametrize("kept", [0, 1, 3])
def test_findings_bear_missing_outcomes(
    kept: int, straight: list[Outcome], squares: list[Outcome]
) -> None:
    assert finite(BASIC_DRIVE.conclude(BASIC, straight[:kept]))
    assert finite(UMBMARK.conclude(SQUARES, squares[:kept]))


def test_scripts_last_whole_ticks_and_cover_what_they_are_told() -> None:
    for left in (True, False):
        commands = square_commands(SQUARES, 2.0, left=left)
        sides, corners = commands[0::4], commands[2::4]
        assert sum(c.duration_s * c.speed_m_s for c in sides) == pytest.approx(8.0)
        turned = sum(c.duration_s * c.yaw_rate_rad_s for c in corners)
        assert turned == pytest.approx(2.0 * math.pi if left else -2.0 * math.pi)
        ticks = np.array([c.duration_s for c in commands]) * 40.0
        np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    there_and_back = straight_commands(BasicDriveConfig())
    assert sum(c.duration_s * c.speed_m_s for c in there_and_back) == pytest.approx(0.0)
    assert len(there_and_back) == 12


def test_a_robot_is_tested_once_under_each_name() -> None:
    robots = robots_under_test(SCENARIO_ROBOT, ("turtlebot2_identified", "turtlebot2"))
    assert [robot.name for robot in robots] == ["turtlebot2", "turtlebot2_identified"]


def test_the_study_is_measured_with_the_script_of_the_scenario() -> None:
    study, scenario = load_measurements("turtlebot2_study"), BasicDriveConfig()
    assert study.basic_drive.speeds_m_s == scenario.speeds_m_s
    assert (study.basic_drive.drive_s, study.basic_drive.rest_s) == (20.0, 5.0)
    squares = UmbmarkConfig()
    assert study.umbmark.yaw_rate_rad_s == squares.yaw_rate_rad_s
    assert (study.umbmark.side_m, study.umbmark.runs) == (squares.sides_m[0], squares.runs)
