"""Motors, gears and batteries against what mechanics says; runs that vary."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import PROPORTIONAL, RADIUS_M, SPRING, G, mean, play, robot, whole

from slamsim.sim.drive.script import Command
from slamsim.sim.ground import Ground


@settings(max_examples=8, deadline=None)
@given(st.floats(0.0, 0.15), st.floats(0.8, 1.25), st.floats(0.15, 0.4))
def test_gear_friction_over_gain_is_what_a_proportional_motor_lacks(
    friction_n_m: float, ratio: float, speed_m_s: float
) -> None:
    gears = {"gear_friction_n_m": friction_n_m, "gear_friction_ratio": ratio}
    model = robot(supports={"friction": 0.0}, motor={**PROPORTIONAL, **gears})
    run = play(model, Ground(), Command(3.0, speed_m_s))
    turning = mean(run.drive.wheel_speeds_rad_s, 2.8)
    lacking = np.array(model.motor.gear_frictions_n_m) / 0.2
    np.testing.assert_allclose(turning, speed_m_s / RADIUS_M - lacking, atol=0.005)


def test_too_little_torque_does_not_overcome_gear_friction() -> None:
    model = robot(motor={**PROPORTIONAL, "gear_friction_n_m": 0.2})
    run = play(model, Ground(), Command(2.0, 0.034))
    assert np.abs(run.drive.positions_m[-1]).max() < 1e-3


@pytest.mark.parametrize("kind", ["velocity", "pid"])
def test_gear_friction_holds_or_hinders(kind: str) -> None:
    """On a slope it adds to the motor's torque at rest, and is lost from it on the way up."""
    strength = {"kind": kind, "max_torque_n_m": 0.2, "gear_friction_n_m": 0.1}
    model = robot({"suspension": SPRING}, motor=strength)
    weight_n = whole(model).mass_kg * G

    def steepest(torque_n_m: float) -> float:
        return math.asin(2.0 * torque_n_m / RADIUS_M / weight_n)

    held = play(model, Ground(steepest(0.27)), Command(2.0, 0.0))
    assert abs(held.drive.linear_velocity_m_s[-1, 0]) < 0.005
    assert play(model, Ground(steepest(0.08)), Command(3.0, 0.2)).drive.positions_m[-1, 0] > 0.1
    assert play(model, Ground(steepest(0.13)), Command(3.0, 0.2)).drive.positions_m[-1, 0] < 0.1


@pytest.mark.parametrize("load", [0.2, 0.5])
def test_the_torque_of_a_dc_motor_falls_with_its_speed(load: float) -> None:
    """Up a slope it turns as fast as its line has the torque for, from a voltage that sags."""
    line = {"max_torque_n_m": 0.5, "no_load_speed_rad_s": 10.0}
    for sag, voltage in ((0.0, 1.0), (1.0, 1.0 - 3.9 / 60.0)):
        model = robot({"suspension": SPRING}, motor={**line, "battery_sag_per_min": sag})
        slope = math.asin(load * 0.5 * 2.0 / RADIUS_M / (whole(model).mass_kg * G))
        run = play(model, Ground(slope), Command(4.0, 1.0))
        turning = mean(run.drive.wheel_speeds_rad_s, 3.8)
        np.testing.assert_allclose(turning, 10.0 * (voltage - load), rtol=0.02)


def test_a_sagging_battery_weakens_the_gain() -> None:
    sag = {**PROPORTIONAL, "gear_friction_n_m": 0.1, "battery_sag_per_min": 1.0}
    run = play(robot(motor=sag), Ground(), Command(12.0, 0.3))
    lacking = 0.1 / (0.2 * (1.0 - 11.9 / 60.0))
    turning = mean(run.drive.wheel_speeds_rad_s, 11.8)
    np.testing.assert_allclose(turning, 0.3 / RADIUS_M - lacking, atol=0.005)
