"""The robot that drives, which is not quite the one that was designed."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import (
    RADIUS_M,
    ROTOR_KG_M2,
    SPRING,
    G,
    gain,
    mean,
    play,
    robot,
    whole,
)

from slamsim.config.robot import (
    DriveWheelsConfig,
    MotorConfig,
    RobotConfig,
    VariationConfig,
)
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.models.differential_drive import wheel_odometry
from slamsim.sim.drive.script import Command, read_encoders
from slamsim.sim.ground import Ground
from slamsim.sim.robot.as_built import drawn_robot
from slamsim.sim.robot.describe import urdf_text
from slamsim.sim.robot.model import WHEEL_JOINTS, build_robot
from slamsim.sim.robot.urdf import Description, Joint


@settings(max_examples=6, deadline=None)
@given(st.floats(0.97, 1.03), st.floats(0.95, 1.05), st.floats(0.95, 1.05))
def test_unequal_wheels_draw_the_circle_that_geometry_says(
    ratio: float, scale: float, track: float
) -> None:
    """And odometry from the nominal wheels sees them drive straight."""
    deviations = {"radius_ratio": ratio, "radius_scale": scale, "track_scale": track}
    model = robot({"suspension": SPRING, **deviations}, {"friction": 0.0})
    run = play(model, Ground(), Command(6.0, 0.2))
    wheels = DriveWheelsConfig(**deviations)  # type: ignore[arg-type]
    left_m, right_m = wheels.true_radii_m
    assert 0.5 * (left_m + right_m) == pytest.approx(RADIUS_M * scale)
    turning = mean(run.drive.wheel_speeds_rad_s, 1.0)
    np.testing.assert_allclose(turning, 0.2 / RADIUS_M, rtol=1e-4)
    expected = (right_m * turning[1] - left_m * turning[0]) / (wheels.track_m * wheels.track_scale)
    measured = mean(run.drive.angular_velocity_rad_s, 1.0)[2]
    assert measured == pytest.approx(expected, rel=0.02, abs=2e-5)
    assert np.abs(wheel_odometry(read_encoders(run.drive, model)).poses[-1, 1:]).max() < 0.002


@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.5])
def test_a_tyre_can_grip_less_or_more_across_its_direction(ratio: float) -> None:
    friction, slope = 0.2, math.radians(30.0)
    wheels: dict[str, object] = {"friction": friction, "lateral_friction_ratio": ratio}
    model = robot(wheels, {"friction": 0.0}, {"max_torque_n_m": 100.0})
    for yaw_rad, share in ((0.0, 1.0), (0.5 * math.pi, ratio)):
        start = (0.0, 0.0, yaw_rad)
        run = play(model, Ground(slope), Command(0.2, 0.0), start_pose=start, forces=True)
        assert run.forces is not None
        grip_n = share * friction * run.forces.wheel_load_n[12:].sum(axis=1).mean()
        pull_n = whole(model).mass_kg * G * math.sin(slope)
        slid = gain(run, 0.05, 0.19)[0] * whole(model).mass_kg
        assert slid == pytest.approx(grip_n - pull_n, rel=0.03)


def _turned_frames(description: Description) -> Description:
    """The same robot, with wheels whose axle is z of their own frames, as many descriptions say."""
    T = se3_from_parts(matrix_from_rpy(-0.5 * math.pi, 0.0, 0.0), np.zeros(3))
    T_new_old = np.linalg.inv(T).astype(np.float64)
    links, joints = dict(description.links), list[Joint]()
    for joint in description.joints:
        if joint.name in WHEEL_JOINTS:
            wheel = links[joint.child]
            assert wheel.inertial is not None
            links[wheel.name] = replace(
                wheel,
                inertial=wheel.inertial.seen_from(T_new_old),
                visuals=tuple(
                    replace(v, T_link_shape=T_new_old @ v.T_link_shape) for v in wheel.visuals
                ),
            )
            T_parent_child = joint.T_parent_child @ T
            axis = T_new_old[:3, :3] @ joint.axis
            joints.append(replace(joint, T_parent_child=T_parent_child, axis=axis))
        else:
            joints.append(joint)
    return replace(description, links=links, joints=tuple(joints))


def test_the_frames_of_a_description_do_not_matter(tmp_path: Path) -> None:
    config = RobotConfig(
        drive_wheels=DriveWheelsConfig(
            radius_ratio=1.02,
            track_scale=1.03,
            lateral_friction_ratio=0.4,
            friction=0.3,
            suspension=SPRING,
        ),
        motor=MotorConfig(rotor_inertia_kg_m2=ROTOR_KG_M2),
    )
    path = tmp_path / "turned.urdf"
    path.write_text(urdf_text(_turned_frames(build_robot(config).description)))
    foreign = build_robot(config.model_copy(update={"urdf_file": str(path)}))
    ends = [
        play(model, Ground(0.2), Command(1.5, 0.3, 0.6), start_pose=(0.0, 0.0, 0.9)).drive
        for model in (build_robot(config), foreign)
    ]
    np.testing.assert_allclose(ends[0].positions_m[-1], ends[1].positions_m[-1], atol=1e-4)
    np.testing.assert_allclose(ends[0].quats_xyzw[-1], ends[1].quats_xyzw[-1], atol=1e-4)


def test_a_variation_draws_each_quantity_by_itself() -> None:
    still = RobotConfig()
    assert drawn_robot(still, 7) == still
    varied = RobotConfig(
        variation=VariationConfig(radius=0.01, track=0.02),
        motor=MotorConfig(gear_friction_n_m=0.1),
    )
    drawn = [drawn_robot(varied, seed) for seed in range(200)]
    assert drawn[3] == drawn_robot(varied, 3)
    radii = np.log([one.drive_wheels.radius_scale for one in drawn])
    tracks = np.log([one.drive_wheels.track_scale for one in drawn])
    assert np.std(radii) == pytest.approx(0.01, rel=0.2)
    assert np.std(tracks) == pytest.approx(0.02, rel=0.2)
    assert abs(np.corrcoef(radii, tracks)[0, 1]) < 0.25
    assert {one.motor.gear_friction_n_m for one in drawn} == {0.1}
    other = varied.model_copy(update={"variation": VariationConfig(radius=0.01)})
    assert drawn_robot(other, 3).drive_wheels.radius_scale == drawn[3].drive_wheels.radius_scale
