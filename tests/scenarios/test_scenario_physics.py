"""Collision and integrator beside geometry and closed forms; what all three have in common."""

from __future__ import annotations

import itertools
import math
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenario_small import DROPS, FALLS, STACKS, holds, plain, run_all

from slamsim.config.base import Config
from slamsim.config.drive import PhysicsConfig
from slamsim.config.loading import load_model
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.bodies import (
    CollisionConfig,
    IntegratorConfig,
    SolverConfig,
    StackingConfig,
)
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.guard.errors import OverrideRefused
from slamsim.scenarios.base import Scenario
from slamsim.scenarios.physics import collision, integrator, stacking
from slamsim.scenarios.physics.collision import face_normals, penetrations_m, start_places
from slamsim.sim.bodies import BurstApart, FreeBodies
from slamsim.sim.drive.script import Command, scripted_run
from slamsim.sim.ground import Ground
from slamsim.sim.robot.model import build_robot

BUNDLED = Path(__file__).parents[2] / "configs" / "scenarios"


@pytest.mark.parametrize("model", [StackingConfig, CollisionConfig, IntegratorConfig])
def test_the_bundled_file_says_the_defaults(model: type[Config]) -> None:
    name = model.__name__.removesuffix("Config").lower()
    assert load_model(model, BUNDLED / f"{name}.yaml") == model()


@pytest.mark.parametrize(
    ("model", "change"),
    [
        (StackingConfig, "steps.first_s=0"),
        (StackingConfig, "steps.last_s=1"),
        (StackingConfig, "steps.by_s=0"),
        (StackingConfig, "steps={first_s: 0.02, last_s: 0.01, by_s: 0.001}"),
        (StackingConfig, "box_size_m=[1.0, -1.0, 1.0]"),
        (StackingConfig, "friction=-0.1"),
        (StackingConfig, "max_boxes=0"),
        (StackingConfig, "max_boxes=1"),
        (StackingConfig, "misplacement_m=0.3"),
        (StackingConfig, "other_solvers.standard={}"),
        (StackingConfig, "other_steps_s=[0.02, 0.02]"),
        (CollisionConfig, "sphere_radius_m=-0.5"),
        (CollisionConfig, "slope_deg=90"),
        (CollisionConfig, "repeats=0"),
        (CollisionConfig, "solver.substeps=0"),
        (IntegratorConfig, "duration_s=.nan"),
        (IntegratorConfig, "other_steps_s=[1.0]"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_key(model: type[Config], change: str) -> None:
    name = model.__name__.removesuffix("Config").lower()
    with pytest.raises(OverrideRefused, match=change.partition("=")[0].partition(".")[0]):
        load_model(model, BUNDLED / f"{name}.yaml", [change])


@settings(max_examples=60)
@given(
    st.lists(st.tuples(*[st.floats(-3, 3)] * 3), min_size=1, max_size=6),
    st.floats(0.1, 2.0),
    st.floats(5.0, 80.0),
)
def test_penetrations_are_those_of_every_pair_one_by_one(
    places: list[tuple[float, float, float]], radius_m: float, slope_deg: float
) -> None:
    normals = face_normals(slope_deg)
    in_planes = [
        radius_m - sum(n * x for n, x in zip(normal, place, strict=True))
        for normal in normals.tolist()
        for place in places
    ]
    in_spheres = [2 * radius_m - math.dist(a, b) for a, b in itertools.combinations(places, 2)]
    found = penetrations_m(np.array(places), radius_m, normals)
    assert found == pytest.approx((max(0.0, *in_planes), max([0.0, *in_spheres])), abs=1e-12)


@pytest.mark.parametrize("slope_deg", [10.0, 45.0, 75.0])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_spheres_begin_apart_and_where_the_fall_is_asked_for(count: int, slope_deg: float) -> None:
    config = CollisionConfig(
        spheres_per_edge=count, slope_deg=slope_deg, misplacement_m=0.2, fall_m=0.7
    )
    places = start_places(config, seed=3, repeat=1)
    assert places.shape == (count**3, 3)
    assert penetrations_m(places, config.sphere_radius_m, face_normals(slope_deg)) == (0.0, 0.0)
    nearest_m = (places @ face_normals(slope_deg).T).min() - config.sphere_radius_m
    assert 0.7 - 1e-9 <= nearest_m < 0.7 + 4 * 0.2
    assert not np.array_equal(places, start_places(config, seed=3, repeat=2))


def test_what_falling_spheres_say() -> None:
    outcomes = run_all(collision.SCENARIO, DROPS)
    findings = collision.SCENARIO.conclude(DROPS, outcomes)
    assert plain(findings)
    assert holds(findings, "mean penetration of sphere and sphere") is True
    assert holds(findings, "The least penetration is 0") is True
    assert holds(findings, "list of contacts") is True
    assert holds(findings, "more energy") is True
    (shown,) = (outcome for outcome in outcomes if outcome.motions)
    assert len(shown.motions) == 4 + 8
    for face, normal in zip(shown.motions[:4], face_normals(DROPS.slope_deg), strict=True):
        above = _axis_z(face.T_map_body.quats_xyzw[0])
        assert above == pytest.approx(normal) and len(face.T_map_body) == 1


def _axis_z(quat_xyzw: FloatArray) -> FloatArray:
    x, y, z, w = quat_xyzw
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def test_a_fall_has_the_error_of_semi_implicit_euler() -> None:
    """The closed form of its sums; 0.007 and 0.009 do not divide 10 s."""
    for step_s in (0.004, 0.007, 0.009):
        values = integrator.fall(FALLS, "standard", step_s).values
        steps = math.floor(10.0 / step_s + 1e-9)
        assert values["end_s"] == pytest.approx(steps * step_s)
        expected_m = GRAVITY_M_S2 * step_s**2 * steps * (steps + 1) / 2
        assert values["fall_m"] == pytest.approx(expected_m, rel=1e-12)
        error_m = GRAVITY_M_S2 * steps * step_s**2 / 2
        assert values["error_m"] == pytest.approx(error_m, rel=1e-6)
        assert values["energy_error_j"] == pytest.approx(-GRAVITY_M_S2 * error_m, rel=1e-6)


def test_what_falls_say() -> None:
    findings = integrator.SCENARIO.conclude(FALLS, run_all(integrator.SCENARIO, FALLS))
    assert plain(findings)
    assert all(verdict.holds for verdict in findings.verdicts)
    assert findings.numbers["slope_m_s"] == pytest.approx(GRAVITY_M_S2 * 5.0, rel=1e-6)


def test_damping_is_found_out() -> None:
    config = FALLS.model_copy(update={"solver": SolverConfig(damping=0.04), "other_solvers": {}})
    findings = integrator.SCENARIO.conclude(config, run_all(integrator.SCENARIO, config))
    assert plain(findings) and holds(findings, "within 1 %") is False
    assert holds(findings, "proportional") is False


@pytest.mark.parametrize(
    ("scenario", "config"),
    [(stacking.SCENARIO, STACKS), (collision.SCENARIO, DROPS), (integrator.SCENARIO, FALLS)],
)
def test_an_explosion_is_a_row_with_a_reason(
    scenario: Scenario[Any], config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    def burst(self: FreeBodies, steps: int = 1) -> None:
        raise BurstApart("the bodies burst apart")

    monkeypatch.setattr(FreeBodies, "advance", burst)
    outcomes = [trial.run() for trial in scenario.trials(config, 0)[:2]]
    for outcome in outcomes:
        numbers = [value for value in outcome.values.values() if isinstance(value, float)]
        assert all(math.isfinite(number) for number in numbers)
        assert "burst apart" in cast(str, outcome.values["reason"])
    assert plain(scenario.conclude(config, outcomes))


@pytest.mark.parametrize(
    ("scenario", "config"),
    [(stacking.SCENARIO, STACKS), (collision.SCENARIO, DROPS), (integrator.SCENARIO, FALLS)],
)
def test_nothing_at_all_is_concluded_from_nothing(scenario: Scenario[Any], config: Config) -> None:
    findings = scenario.conclude(config, [])
    assert plain(findings)
    assert {verdict.holds for verdict in findings.verdicts} == {None}


def test_another_process_finds_the_same_rows() -> None:
    config = STACKS.model_copy(update={"misplacement_m": 0.01, "duration_s": 3.0})
    trials = [
        *stacking.SCENARIO.trials(config, 5)[1:2],
        *collision.SCENARIO.trials(DROPS, 5)[-1:],
    ]
    code = (
        "import pickle, sys; trials = pickle.load(sys.stdin.buffer);"
        "sys.stdout.buffer.write(pickle.dumps([trial.run().values for trial in trials]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=pickle.dumps(trials),
        capture_output=True,
        check=True,
        timeout=120,
    )
    assert pickle.loads(done.stdout) == [trial.run().values for trial in trials]
    assert collision.SCENARIO.trials(DROPS, 6)[-1].run().values != trials[1].run().values


def test_what_ran_before_in_the_process_changes_nothing() -> None:
    """Bullet keeps one reach of contacts for all its worlds, which the robot's engine widens."""
    config = STACKS.model_copy(update={"misplacement_m": 0.01, "duration_s": 1.0})
    (trial,) = stacking.SCENARIO.trials(config, 5)[1:2]
    alone = trial.run().values
    ground, command = Ground(), Command(0.1, 0.2)
    scripted_run(build_robot(RobotConfig()), ground, [command], PhysicsConfig())
    assert trial.run().values == alone


@pytest.mark.parametrize("scenario", [stacking, collision, integrator])
def test_labels_are_unlike_each_other(scenario: Any) -> None:
    name = scenario.__name__.rsplit(".", maxsplit=1)[-1]
    model = {"stacking": StackingConfig, "collision": CollisionConfig}.get(name, IntegratorConfig)
    labels = [trial.label for trial in scenario.SCENARIO.trials(model(), 0)]
    assert len(labels) == len(set(labels))
