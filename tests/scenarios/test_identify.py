"""Identification on robots whose parameters are known, in closed form."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.config.loading import load_model
from slamsim.config.measurements import MeasurementsConfig, load_measurements
from slamsim.config.robot import RobotConfig
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.scenarios.identify.fit import (
    Experiment,
    FigurePrediction,
    drawn,
    foreseen,
    most_likely,
)
from slamsim.scenarios.identify.model import (
    KNOWN_BEFOREHAND,
    VARYING,
    Body,
    Wheels,
    driven,
    space_with,
    wheels_of,
)
from slamsim.scenarios.identify.robot import robot_at, varied
from slamsim.sim.drive.script import Command
from slamsim.sim.robot.as_built import drawn_robot

BODY = Body(mass_kg=4.0, wheel_radius_m=0.0352, track_m=0.23, driven_share=0.7, scrub_n_m=0.02)
TRACK_M = 0.23


def equal_wheels(**changed: FloatArray | float) -> Wheels:
    plain = {
        "rolling": np.ones((1, 2)),
        "droops_m_s": np.zeros((1, 2)),
        "track_scale": np.ones(1),
    }
    return Wheels(**{**plain, **changed})  # type: ignore[arg-type]


@given(st.floats(0.05, 0.5), st.floats(-2.0, 2.0), st.floats(0.9, 1.1))
def test_a_robot_on_a_circle_is_where_geometry_has_it(
    speed_m_s: float, rate_rad_s: float, track_scale: float
) -> None:
    wheels = equal_wheels(track_scale=np.array([track_scale]))
    ends = driven(wheels, [Command(3.0, speed_m_s, rate_rad_s)], TRACK_M)
    for pose, rate in ((ends.odometry, rate_rad_s), (ends.true, rate_rad_s / track_scale)):
        x, y, yaw = pose[0, -1]
        assert yaw == pytest.approx(3.0 * rate)
        if abs(rate) > 1e-3:
            radius_m = speed_m_s / rate
            assert x == pytest.approx(radius_m * math.sin(yaw), abs=1e-9)
            assert y == pytest.approx(radius_m * (1.0 - math.cos(yaw)), abs=1e-9)


def test_gear_friction_takes_the_same_speed_at_any_speed_and_more_of_an_empty_battery() -> None:
    script = [Command(10.0, 0.2), Command(10.0, 0.3), Command(10.0, -0.3), Command(10.0, 0.01)]
    slow = driven(equal_wheels(droops_m_s=np.full((1, 2), 0.02)), script, TRACK_M).true[0, :, 0]
    np.testing.assert_allclose(np.diff(slow), [1.8, 2.8, -2.8, 0.0], atol=1e-12)
    sagging = equal_wheels(droops_m_s=np.full((1, 2), 0.02), sag_per_s=0.01)
    assert driven(sagging, script[:1], TRACK_M).true[0, -1, 0] == pytest.approx(2.0 - 0.2 / 0.95)


def test_scrubbing_tyres_hold_a_soft_robot_straight_but_never_turn_it_round() -> None:
    unequal = np.array([[0.99, 1.01]])
    ends = [
        driven(
            equal_wheels(rolling=unequal, yielding_m_s=yielding),
            [Command(10.0, 0.2)],
            TRACK_M,
        ).true[0, -1, 2]
        for yielding in (0.0, 0.002, 0.004, 1.0)
    ]
    assert ends[0] > ends[1] > 0.0
    np.testing.assert_allclose(ends[2:], 0.0, atol=1e-12)


def measurements(sigma: float = 0.01) -> MeasurementsConfig:
    """Everything that a careful user can measure, with values to be filled in."""
    stops: list[dict[str, object]] = [
        {"quantity": f"basic_drive.{what}", "stop": stop}
        for what in ("stop_x_m", "stop_y_m")
        for stop in (1, 3, 5)
    ]
    squares: list[dict[str, object]] = [
        {"quantity": f"umbmark.{way}_{axis}_m"}
        for way in ("clockwise", "counter_clockwise")
        for axis in "xy"
    ]
    others: list[dict[str, object]] = [
        {"quantity": "umbmark.corner_deg"},
        {"quantity": "umbmark.spread_m"},
    ]
    figures = [
        {"value": 0.5, "sigma": sigma, "source": "made up", **figure}
        for figure in (*stops, *squares, *others)
    ]
    return MeasurementsConfig.model_validate({"name": "made_up", "figures": figures})


def filled(config: MeasurementsConfig, prediction: FigurePrediction) -> MeasurementsConfig:
    pairs = zip(config.figures, prediction.values.tolist(), strict=True)
    figures = tuple(figure.model_copy(update={"value": value}) for figure, value in pairs)
    return config.model_copy(update={"figures": figures})


def test_a_synthetic_robot_is_found_again() -> None:
    blank, names = measurements(), [parameter.name for parameter in KNOWN_BEFOREHAND]
    draws = drawn(blank, 6)
    space = space_with({})
    truth = space.values(np.zeros(len(space)))
    truth |= {"radius_ratio": 1.007, "track_scale": 1.12, "droop_m_s": 0.016}
    at = space.point(truth)
    config = filled(blank, Experiment(blank, BODY, draws).predict(at))
    experiment = Experiment(config, BODY, draws)
    (fit, *_) = most_likely(experiment, [np.zeros(len(space))])
    sigmas = np.sqrt(np.diag(fit.covariance))
    for name in ("radius_ratio", "track_scale", "droop_m_s"):
        i = names.index(name)
        assert abs(fit.z[i] - at[i]) < max(2.0 * sigmas[i], 0.1), name
        assert sigmas[i] < 0.7, f"{name} is told of by the figures"
    untold = names.index("max_torque_n_m")
    assert sigmas[untold] == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(fit.prediction.values, [f.value for f in config.figures], atol=0.1)


@pytest.mark.long
def test_without_its_scenario_a_figure_is_foreseen_with_honest_doubt() -> None:
    blank = measurements()
    draws, space = drawn(blank, 4), space_with({})
    truth = space.values(np.zeros(len(space))) | {"track_scale": 1.1, "droop_m_s": 0.02}
    config = filled(blank, Experiment(blank, BODY, draws).predict(space.point(truth)))
    experiment = Experiment(config, BODY, draws)
    straight = np.array([figure.scenario == "basic_drive" for figure in config.figures])
    (fit, *_) = most_likely(experiment, [np.zeros(len(space))], straight)
    told = foreseen(experiment, fit)
    off = (told.means - [figure.value for figure in config.figures]) / told.sigmas
    assert np.abs(off).max() < 3.0
    assert told.sigmas[~straight][:4].min() > 0.1, "the effective track was never seen"


def test_a_bound_that_is_kept_pulls_at_nothing() -> None:
    figure = {
        "quantity": "ramp.slides_from_deg",
        "value": 80.0,
        "sigma": 1.0,
        "bound": "at_most",
        "source": "made up",
    }
    config = MeasurementsConfig.model_validate({"name": "made_up", "figures": [figure]})
    experiment = Experiment(config, BODY, drawn(config, 2))
    (fit,) = most_likely(experiment, [np.zeros(len(experiment.space))])
    np.testing.assert_allclose(fit.z, 0.0, atol=1e-6)
    np.testing.assert_allclose(fit.covariance, np.eye(len(fit.z)), atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4), st.integers(0, 10))
def test_the_robot_that_drives_has_the_wheels_of_the_closed_form(
    draws: list[float], seed: int
) -> None:
    space = space_with({})
    values = space.values(np.random.default_rng(seed).standard_normal(len(space)))
    robot = varied(robot_at(values, RobotConfig(), "one"), np.array(draws))
    wheels = wheels_of(values, np.array([draws]))
    radius_m = robot.drive_wheels.radius_m
    np.testing.assert_allclose(robot.drive_wheels.true_radii_m, radius_m * wheels.rolling[0])
    assert robot.drive_wheels.track_scale == pytest.approx(wheels.track_scale[0])
    assert robot.drive_wheels.track_m == pytest.approx(TRACK_M)
    droops_m_s = radius_m * np.array(robot.motor.gear_frictions_n_m) / robot.motor.pid_proportional
    np.testing.assert_allclose(droops_m_s, wheels.droops_m_s[0])


def test_runs_vary_by_what_a_drawn_robot_varies_by() -> None:
    space = space_with({})
    robot = robot_at(space.values(np.zeros(len(space))), RobotConfig(), "one")
    one = drawn_robot(robot, 5)
    pairs = {
        "radius_ratio": (one.drive_wheels.radius_ratio, robot.drive_wheels.radius_ratio),
        "track": (one.drive_wheels.track_scale, robot.drive_wheels.track_scale),
        "gear_friction": (one.motor.gear_friction_n_m, robot.motor.gear_friction_n_m),
        "gear_friction_ratio": (one.motor.gear_friction_ratio, robot.motor.gear_friction_ratio),
    }
    draws = [math.log(a / b) / getattr(robot.variation, name) for name, (a, b) in pairs.items()]
    assert tuple(pairs) == VARYING
    same = varied(robot, np.array(draws))
    assert same.drive_wheels.true_radii_m == pytest.approx(one.drive_wheels.true_radii_m)
    assert same.motor.gear_frictions_n_m == pytest.approx(one.motor.gear_frictions_n_m)


GOOD = {"quantity": "umbmark.e_max_m", "value": 1.0, "sigma": 0.1, "source": "tape"}


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"quantity": "umbmark.emax_m"}, "umbmark.e_max_m"),
        ({"quantity": "basic_drive.stop_x_m"}, "needs stop"),
        ({"stop": 2}, "has no stop"),
        ({"quantity": "basic_drive.stop_x_m", "stop": 7}, "6 stops"),
        ({"quantity": "ramp.travel_m"}, "needs slope_deg"),
        ({"quantity": "ramp.travel_m", "slope_deg": 90.0}, "90"),
        ({"value": -1.0}, "negative"),
        ({"quantity": "umbmark.corner_deg", "value": 1e3}, "degrees"),
        ({"sigma": 0.0}, "greater than 0"),
        ({"value": ".nan"}, "value"),
        ({"source": ""}, "source"),
        ({"unit": "m"}, "unit"),
    ],
)
def test_a_bad_figure_is_refused_with_its_place(
    tmp_path: Path, changed: dict[str, object], told: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump({"name": "bad", "figures": [{**GOOD, **changed}]}))
    with pytest.raises(InputRefused, match=told) as refused:
        load_measurements(str(path))
    assert refused.value.where.startswith("line")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name: x\nfigures: []\n", "figures"),
        ("name: x\n", "figures"),
        ("", "empty"),
        (yaml.safe_dump({"name": "x", "figures": [GOOD, {**GOOD}]}), "twice"),
        (yaml.safe_dump({"name": "../x", "figures": [GOOD]}), "name"),
        (
            yaml.safe_dump({"name": "x", "figures": [GOOD], "priors": {"track": {}}}),
            "priors",
        ),
    ],
)
def test_bad_measurements_are_refused(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputRefused, match=told):
        load_measurements(str(path))


def test_measurements_come_by_name_and_their_robot_too() -> None:
    config = load_measurements("turtlebot2_study", ["umbmark.yaw_rate_rad_s=0.5"])
    assert config.robot.name == "turtlebot2"
    assert config.umbmark.yaw_rate_rad_s == 0.5
    with pytest.raises(NotFound, match="turtlebot2_study"):
        load_measurements("turtlebot2_stud")


def test_priors_may_be_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    prior = {"value": 1.2, "sigma": 0.01, "why": "measured with a tape"}
    path.write_text(
        yaml.safe_dump({"name": "own", "figures": [GOOD], "priors": {"track_scale": prior}})
    )
    config = load_measurements(str(path))
    assert space_with(config.priors).values(np.zeros(13))["track_scale"] == pytest.approx(1.2)


def test_the_bundled_identified_robot_is_a_robot() -> None:
    path = Path(__file__).parents[2] / "configs/robots/turtlebot2_identified.yaml"
    robot = load_model(RobotConfig, path)
    assert robot.name == "turtlebot2_identified"
    assert robot.motor.kind == "pid"


@pytest.mark.slow
def test_a_users_own_robot_from_figures_to_a_file_that_drives(tmp_path: Path) -> None:
    squares = {"side_m": 0.4, "runs": 2, "rest_s": 0.25}
    own = {
        "name": "mine",
        "basic_drive": {"speeds_m_s": [0.3], "drive_s": 2.0, "rest_s": 0.5, "runs": 2},
        "umbmark": squares,
        "figures": [
            {
                "quantity": "basic_drive.stop_x_m",
                "stop": 1,
                "value": 0.55,
                "sigma": 0.005,
                "source": "tape",
            },
            {"quantity": "umbmark.corner_deg", "value": 75.0, "sigma": 1.0, "source": "tape"},
        ],
    }
    path, file = tmp_path / "mine.yaml", tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(own))
    done = subprocess.run(
        [
            *(
                sys.executable,
                "-c",
                "from slamsim.entry import main; main()",
                "identify",
                str(path),
            ),
            *("--out", str(tmp_path / "out"), "--robot-file", str(file), "--json"),
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    numbers = json.loads(done.stdout)["scenarios"]["identify"]["numbers"]
    assert numbers["simulated basic_drive.stop_x_m 1"] == pytest.approx(0.55, abs=0.02)
    assert numbers["simulated umbmark.corner_deg"] == pytest.approx(75.0, abs=3.0)
    robot = load_model(RobotConfig, file)
    assert robot.name == "mine_identified"
    assert robot.drive_wheels.track_scale == pytest.approx(numbers["track_scale"], rel=1e-5)
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
