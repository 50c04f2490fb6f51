"""Scenarios mu-split, ramp and friction-turn: rules in words, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.config.base import Config
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.loading import load_scenarios
from slamsim.config.scenarios.robots import (
    BoxConfig,
    FrictionTurnConfig,
    HandConfig,
    MuSplitConfig,
    RampConfig,
)
from slamsim.guard.errors import SlamsimError
from slamsim.scenarios.base import Findings, Outcome, Scenario, Verdict
from slamsim.scenarios.physics import friction_turn, mu_split, ramp
from slamsim.scenarios.rows import number
from slamsim.sim.robot.model import build_robot

TYPES: dict[str, type[Config]] = {
    "mu_split": MuSplitConfig,
    "ramp": RampConfig,
    "friction_turn": FrictionTurnConfig,
}


def outcomes_of(scenario: Scenario[Any], config: Any) -> list[Outcome]:
    return [trial.run() for trial in scenario.trials(config, 0)]


def verdict(findings: Findings, words: str) -> Verdict:
    (found,) = [one for one in findings.verdicts if words in one.statement]
    return found


def require_finite(outcomes: Sequence[Outcome]) -> None:
    for one in outcomes:
        for key, value in one.values.items():
            assert not isinstance(value, float) or math.isfinite(value), key


SPLIT = MuSplitConfig(
    right_frictions=(0.05, 0.2, 1.4), motors=("velocity",), support_frictions=(), duration_s=2.0
)


def test_on_a_split_floor_the_robot_turns_as_mechanics_says() -> None:
    outcomes = outcomes_of(mu_split.SCENARIO, SPLIT)
    require_finite(outcomes)
    for one in outcomes[:2]:
        theory_deg = number(one.values, "turn_by_theory_deg")
        assert number(one.values, "direction_deg") == pytest.approx(theory_deg, rel=0.05)
    assert abs(number(outcomes[2].values, "direction_deg")) < 0.01
    found = mu_split.SCENARIO.conclude(SPLIT, outcomes)
    assert verdict(found, "same friction on both sides").holds
    assert verdict(found, "near 1.96 m ahead").holds is None


def test_what_was_not_run_is_not_judged() -> None:
    for scenario, config in (
        (mu_split.SCENARIO, SPLIT),
        (ramp.SCENARIO, RampConfig()),
        (friction_turn.SCENARIO, FrictionTurnConfig()),
    ):
        findings = scenario.conclude(config, [])  # type: ignore[arg-type]
        assert not [one for one in findings.verdicts if one.holds]


CLIMBS = {name: RampConfig().climbs[name] for name in ("ideal", "proportional")}
RAMP = RampConfig(
    slopes_deg=(0.0, 20.0, 40.0),
    climbs=CLIMBS,
    duration_s=4.0,
    hand=HandConfig(slopes_deg=(45.0,), duration_s=1.5),
)


def test_a_ramp_costs_the_motor_that_gives_way_and_not_the_ideal_one() -> None:
    outcomes = outcomes_of(ramp.SCENARIO, RAMP)
    require_finite(outcomes)
    rows = {(one.values.get("motor"), one.values["slope_deg"]): one.values for one in outcomes}
    assert number(rows["ideal", 20.0], "travel_m") == pytest.approx(0.8, abs=0.01)
    flat_m, steep_m = (number(rows["proportional", s], "travel_m") for s in (0.0, 20.0))
    assert steep_m < flat_m - 0.05
    assert number(rows["proportional", 40.0], "travel_m") < 0.0  # no hold: back to the wall
    found = ramp.SCENARIO.conclude(RAMP, outcomes)
    assert verdict(found, "climbs where friction").holds
    assert verdict(found, "on springs tips over").holds
    assert verdict(found, "Without springs").holds


def test_the_weight_along_the_slope_is_that_of_the_robot() -> None:
    one = ramp.climb("ideal", CLIMBS["ideal"], 20.0, RAMP.model_copy(update={"duration_s": 0.5}))
    model = build_robot(RAMP.robot)
    mass_kg = sum(
        link.inertial.mass_kg for link in model.description.links.values() if link.inertial
    )
    expected_n = mass_kg * 9.80665 * math.sin(math.radians(20.0))
    assert number(one.values, "push_needed_n") == pytest.approx(expected_n)


@pytest.mark.long
@given(angle_deg=st.floats(1.0, 89.0), approach_m=st.floats(0.0, 5.0), width_m=st.floats(0.1, 5.0))
def test_the_box_is_touched_after_the_approach(
    angle_deg: float, approach_m: float, width_m: float
) -> None:
    model = build_robot(RobotConfig())
    box = friction_turn.box_in_the_way(
        BoxConfig(side_angle_deg=angle_deg, width_m=width_m), model, approach_m
    )
    corners_m = friction_turn.corners_m(box)
    assert np.allclose(corners_m[0], corners_m[-1])
    middle_m = np.array([approach_m, 0.0])
    gaps_m = [_distance_m(middle_m, start, end) for start, end in pairwise(corners_m)]
    assert min(gaps_m) == pytest.approx(model.footprint_radius_m, abs=1e-9)
    touched = corners_m[1 + int(np.argmin(gaps_m))] - corners_m[int(np.argmin(gaps_m))]
    slant_deg = math.degrees(math.atan2(abs(touched[1]), abs(touched[0])))
    assert slant_deg == pytest.approx(angle_deg, abs=1e-6)


def _distance_m(point: Any, start: Any, end: Any) -> float:
    """From a point to a segment."""
    along = (end - start) / np.linalg.norm(end - start)
    foot = np.clip((point - start) @ along, 0.0, float(np.linalg.norm(end - start)))
    return float(np.linalg.norm(point - (start + foot * along)))


def test_friction_turns_the_robot_towards_the_box_once_it_touches() -> None:
    config = FrictionTurnConfig(
        motors=("pid",), body_frictions=(1.4,), approach_s=0.5, duration_s=2.5
    )
    (one,) = outcomes_of(friction_turn.SCENARIO, config)
    require_finite([one])
    assert number(one.values, "contact_s") == pytest.approx(0.5, abs=0.1)
    before = one.arrays["turned_deg"][one.arrays["since_start_s"] < 0.4]
    assert np.abs(before).max() < 0.2
    assert number(one.values, "turned_deg") > 5.0


@pytest.mark.parametrize(
    ("key", "override", "words"),
    [
        ("mu_split", "right_frictions=[-0.1]", "right_frictions"),
        ("mu_split", "motors=[steam]", "motors"),
        ("mu_split", "duration_s=0", "duration_s"),
        ("ramp", "slopes_deg=[90]", "slopes_deg"),
        ("ramp", "hand.slopes_deg=[-5]", "slopes_deg"),
        ("ramp", "climbs={}", "climbs"),
        ("friction_turn", "box.side_angle_deg=0", "side_angle_deg"),
        ("friction_turn", "box.mass_kg=-1", "mass_kg"),
        ("friction_turn", "body_friction=0.3", "body_frictions"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(key: str, override: str, words: str) -> None:
    with pytest.raises(SlamsimError, match=words):
        load_scenarios({key: TYPES[key]}, overrides=[override])
