"""Scripted runs against what mechanics says, in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import (
    FREE,
    HALF_TRACK_M,
    RADIUS_M,
    RATE_HZ,
    ROTOR_KG_M2,
    SPRING,
    G,
    gain,
    loads_n,
    mean,
    play,
    robot,
    rolling_mass_kg,
    whole,
)

from slamsim.config.robot import (
    SuspensionConfig,
)
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.guard.errors import SlamsimError
from slamsim.sim.drive.script import Command
from slamsim.sim.ground import Block, Ground
from slamsim.sim.robot.inertia import Inertial
from slamsim.sim.robot.model import RobotModel
from slamsim.world.model import FloorPatch


@pytest.mark.parametrize("slope_deg", [3.0, 15.0])
@pytest.mark.parametrize("suspension", [None, SPRING])
def test_free_wheels_roll_down_and_no_energy_comes_from_nowhere(
    slope_deg: float, suspension: SuspensionConfig | None
) -> None:
    model = robot({"suspension": suspension}, motor=FREE)
    slope = math.radians(slope_deg)
    run = play(model, Ground(slope), Command(2.0, 0.0))
    pull_n = whole(model).mass_kg * G * math.sin(slope)
    assert gain(run, 0.5, 1.9)[0] == pytest.approx(-pull_n / rolling_mass_kg(model), rel=0.01)
    fallen_j = -pull_n * run.drive.positions_m[:, 0]
    kinetic_j = 0.5 * rolling_mass_kg(model) * run.drive.linear_velocity_m_s[:, 0] ** 2
    assert np.all(kinetic_j <= 1.01 * fallen_j + 0.005)


def locked(friction: float) -> RobotModel:
    """All four wheels are stuck and grip alike."""
    return robot(
        {"friction": friction},
        {"rolling": False, "friction": friction},
        {"max_torque_n_m": 100.0},
    )


@pytest.mark.parametrize("friction", [0.15, 0.5])
def test_it_holds_until_the_slopes_tangent_is_the_friction(friction: float) -> None:
    steepest = math.atan(friction)
    held = play(locked(friction), Ground(0.98 * steepest), Command(2.0, 0.0))
    assert np.abs(held.drive.positions_m[-1, :2]).max() < 0.001
    slid = play(locked(friction), Ground(1.03 * steepest), Command(2.0, 0.0))
    assert slid.drive.positions_m[-1, 0] < -0.05


@settings(max_examples=12, deadline=None)
@given(st.floats(0.05, 0.6), st.floats(1.2, 2.0), st.floats(-math.pi, math.pi))
def test_a_locked_robot_slides_alike_in_every_heading(
    friction: float, steepness: float, yaw_rad: float
) -> None:
    slope = min(steepness * math.atan(friction), 0.6)
    run = play(locked(friction), Ground(slope), Command(0.6, 0.0), start_pose=(0.0, 0.0, yaw_rad))
    expected = G * (math.sin(slope) - friction * math.cos(slope))
    along, across, _ = gain(run, 0.2, 0.55)
    assert -along == pytest.approx(expected, rel=0.03, abs=0.05)
    assert abs(across) < 0.05 * G * friction + 0.05


@pytest.mark.parametrize("torque_n_m", [0.02, 0.1])
@pytest.mark.parametrize("rotor_kg_m2", [0.0, ROTOR_KG_M2])
def test_the_largest_torque_speeds_up_mass_and_rotors(
    torque_n_m: float, rotor_kg_m2: float
) -> None:
    model = robot(motor={"max_torque_n_m": torque_n_m, "rotor_inertia_kg_m2": rotor_kg_m2})
    run = play(model, Ground(), Command(0.6, 5.0))
    expected = 2.0 * torque_n_m / RADIUS_M / rolling_mass_kg(model)
    assert gain(run, 0.1, 0.55)[0] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("torque_n_m", [0.1, 0.3])
def test_the_steepest_slope_is_where_the_torque_holds_the_weight(torque_n_m: float) -> None:
    model = robot({"suspension": SPRING}, motor={"max_torque_n_m": torque_n_m})
    steepest = math.asin(2.0 * torque_n_m / RADIUS_M / (whole(model).mass_kg * G))
    up = play(model, Ground(0.95 * steepest), Command(4.0, 0.1))
    down = play(model, Ground(1.05 * steepest), Command(4.0, 0.1))
    assert up.drive.positions_m[-1, 0] > 0.2
    assert down.drive.positions_m[-1, 0] < -0.2


@pytest.mark.parametrize("slope_deg", [-6.0, 0.0, 6.0])
def test_sprung_wheels_carry_what_statics_gives_them(slope_deg: float) -> None:
    model = robot({"suspension": SPRING})
    run = play(model, Ground(math.radians(slope_deg)), Command(1.5, 0.0), forces=True)
    assert run.forces is not None
    wheels_n, front_n, rear_n = loads_n(model, math.radians(slope_deg))
    np.testing.assert_allclose(mean(run.forces.wheel_load_n, 1.0), 0.5 * wheels_n, rtol=0.01)
    supports_n = mean(run.forces.support_load_n, 1.0)
    np.testing.assert_allclose(supports_n, [front_n, rear_n], rtol=0.02, atol=0.05)
    assert np.abs(run.drive.positions_m[:, 2]).max() < 0.001
    assert np.all(run.forces.body_load_n == 0.0)


@pytest.mark.parametrize("stiffness_n_m", [400.0, 1500.0])
def test_a_spring_gives_way_by_load_over_stiffness(stiffness_n_m: float) -> None:
    """Preloaded with more than the weight, it lifts the body until it carries what is there."""
    spring = SuspensionConfig(preload_n=24.0, stiffness_n_m=stiffness_n_m, travel_m=0.02)
    model = robot({"suspension": spring})
    run = play(model, Ground(), Command(1.5, 0.0), forces=True)
    assert run.forces is not None
    carried_n = mean(run.forces.wheel_load_n, 1.0)[0] - 0.1 * G
    expected_m = (24.0 - carried_n) / stiffness_n_m
    assert expected_m > 0.002
    assert run.drive.positions_m[-1, 2] == pytest.approx(expected_m, rel=0.02)


def test_springs_that_are_too_hard_for_the_step_are_refused() -> None:
    model = robot({"suspension": SuspensionConfig(stiffness_n_m=50_000.0)})
    with pytest.raises(SlamsimError, match="too hard"):
        play(model, Ground(), Command(1.0, 0.0))


@pytest.mark.parametrize("mass_kg", [4.0, 40.0])
def test_a_collision_keeps_the_momentum(mass_kg: float) -> None:
    """At speed onto ice, where nothing but the block can push the robot."""
    ice = FloorPatch(0.15, -5.0, 20.0, 5.0, 0.0)
    block = Block((0.4, 1.0, 0.4), mass_kg, (0.9, 0.0, 0.2), friction=0.0)
    model = robot()
    run = play(model, Ground(patches=(ice,), blocks=(block,)), Command(2.0, 0.5))
    moved_m = np.diff(run.blocks[0].positions_m[:, 0]) * RATE_HZ
    momentum = whole(model).mass_kg * run.drive.linear_velocity_m_s[1:, 0] + mass_kg * moved_m
    on_ice = run.drive.positions_m[1:, 0] > 0.32
    assert moved_m.max() > 0.03
    assert np.ptp(momentum[on_ice]) < 0.02 * momentum[on_ice].mean()


def test_on_the_spot_low_friction_turns_the_robot_no_faster() -> None:
    """Both wheels slip: the friction of their load, at half the track, turns the inertia."""
    friction = 0.05
    model = robot(
        {"suspension": SPRING, "friction": friction}, {"friction": 0.0}, {"kind": "ideal"}
    )
    run = play(model, Ground(), Command(0.5, 0.0, 5.0))
    moment_n_m = friction * loads_n(model, 0.0)[0] * HALF_TRACK_M
    expected = moment_n_m / whole(model).inertia_kg_m2[2, 2]
    turned = run.drive.angular_velocity_rad_s[:, 2]
    assert (turned[108] - turned[12]) / 0.4 == pytest.approx(expected, rel=0.03)


def test_supports_that_are_dragged_cost_torque() -> None:
    friction = 0.3
    model = robot({"suspension": SPRING}, {"friction": friction, "rolling": False})
    run = play(model, Ground(), Command(1.5, 0.2), forces=True)
    assert run.forces is not None
    dragged_n = mean(run.forces.support_load_n, 1.0).sum() * friction
    expected = 0.5 * dragged_n * RADIUS_M
    np.testing.assert_allclose(mean(run.forces.motor_torque_n_m, 1.0), expected, rtol=0.05)


COMMANDS = (Command(1.0, 0.3, 0.5), Command(1.0, 0.1, -1.0), Command(1.0, -0.2, 0.4))


@pytest.mark.parametrize(("suspension", "apart"), [(SPRING, 1e-4), (None, 0.02)])
def test_mirrored_commands_draw_a_mirrored_path(
    suspension: SuspensionConfig | None, apart: float
) -> None:
    """Nearly so without springs: what four rigid wheels carry is then the solver's choice."""
    model = robot({"suspension": suspension})
    ends = []
    for side in (1.0, -1.0):
        commands = [Command(c.duration_s, c.speed_m_s, side * c.yaw_rate_rad_s) for c in COMMANDS]
        driven = play(model, Ground(), *commands).drive
        ends.append([*driven.positions_m[-1], yaw_from_xyzw(driven.quats_xyzw)[-1]])
    np.testing.assert_allclose(ends[0], np.array(ends[1]) * [1.0, -1.0, 1.0, -1.0], atol=apart)


def test_the_same_run_twice_is_the_same_run() -> None:
    ground = Ground(0.1, blocks=(Block((0.3, 0.3, 0.3), 5.0, (0.6, 0.05, 0.15)),))
    first, second = (play(robot(), ground, *COMMANDS).drive for _ in range(2))
    assert np.array_equal(first.positions_m, second.positions_m)


def test_a_hand_holds_a_sprung_robot_and_its_front_rises() -> None:
    """The springs push on while the body leans; without them the wheels lift at once."""

    def raised_deg(suspension: SuspensionConfig | None) -> float:
        model = robot({"suspension": suspension})
        ground = Ground(math.radians(30.0), hand_height_m=0.05)
        run = play(model, ground, Command(2.0, 0.2))
        x, y, z, w = run.drive.quats_xyzw.T
        assert np.abs(run.drive.positions_m[:, 0]).max() < 0.03
        return float(-np.degrees(np.arcsin(2.0 * (w * y - z * x))).min())

    assert raised_deg(SPRING) > 3.0
    assert raised_deg(None) < 0.2


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Ground(slope_rad=math.radians(90.0)),
        lambda: Ground(friction=-0.1),
        lambda: Ground(patches=(FloorPatch(0.0, 0.0, 1.0, 1.0, math.nan),)),
        lambda: Block((1.0, 0.0, 1.0), 1.0, (0.0, 0.0, 0.0)),
        lambda: Block((1.0, 1.0, 1.0), -1.0, (0.0, 0.0, 0.0)),
        lambda: Command(1.0, math.nan),
        lambda: Command(-1.0, 0.1),
        lambda: play(robot(), Ground()),
        lambda: play(robot(), Ground(), Command(1e9, 0.1)),
    ],
)
def test_what_cannot_be_is_refused(wrong: object) -> None:
    with pytest.raises(SlamsimError):
        wrong()  # type: ignore[operator]


@settings(max_examples=15, deadline=None)
@given(st.floats(-30.0, 30.0), st.floats(-60.0, 60.0), st.floats(-1e4, 1e4))
def test_physics_that_bursts_ends_with_a_reason(
    mass_power: float, inertia_power: float, speed: float
) -> None:
    """Wheels as no validation lets them pass: it ends early and says why, or gives numbers."""
    model = robot(motor={"max_torque_n_m": 1000.0})
    body = Inertial(10.0**mass_power, np.zeros(3), 10.0**inertia_power * np.eye(3))
    burst = {
        name: replace(link, inertial=body)
        for name, link in model.body.links.items()
        if name.startswith("wheel")
    }
    links = {**model.body.links, **burst}
    try:
        run = play(
            replace(model, body=replace(model.body, links=links)), Ground(), Command(0.5, speed)
        )
    except SlamsimError as error:
        assert "not a number" in str(error)
        return
    assert np.isfinite(run.drive.positions_m).all()
    assert run.ended in {"", "tipped over", "left the floor", "not a number"}
    assert run.ended or len(run.drive) == 120
