"""The robot model: built from its configuration, and refused where it is not sane."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.config.bundled import find_input
from slamsim.config.loading import load_model
from slamsim.config.robot import CylinderConfig, MountConfig, RobotConfig
from slamsim.core.geometry import matrix_from_rpy
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.sim.robot.describe import describe, rpy_from_matrix, urdf_text, weld_fixed_joints
from slamsim.sim.robot.inertia import join
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.sim.robot.urdf import Description, read_description
from slamsim.sim.robot.validate import lowest_point_m, rolling_links


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return build_robot(RobotConfig())


def test_the_reference_robots_numbers(robot: RobotModel) -> None:
    assert robot.wheel_radius_m == pytest.approx(0.0352)
    assert robot.track_m == pytest.approx(0.230)
    assert robot.footprint_radius_m == pytest.approx(0.17575)
    total_kg = sum(
        link.inertial.mass_kg for link in robot.description.links.values() if link.inertial
    )
    assert 3.5 < total_kg < 6.5


def test_the_shipped_file_is_the_default_robot(robot: RobotModel) -> None:
    shipped = load_model(RobotConfig, find_input("configs/robots", "turtlebot2"))
    assert build_robot(shipped).urdf == robot.urdf


def test_every_wheel_rolls_and_touches_the_floor(robot: RobotModel) -> None:
    placed = robot.description.placements()
    wheels = rolling_links(robot.description)
    assert len(wheels) == 4
    for name in wheels:
        lowest = lowest_point_m(robot.description.links[name], placed[name])
        assert abs(lowest) < 1e-9, name


angles = st.floats(min_value=-180.0, max_value=180.0)


@settings(max_examples=30)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.15, 0.3), angles, angles, angles)
def test_a_lidar_mounted_in_six_degrees_of_freedom_is_where_it_was_put(
    x: float, y: float, z: float, roll: float, pitch: float, yaw: float
) -> None:
    mount = MountConfig(x_m=x, y_m=y, z_m=z, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw)
    config = RobotConfig()
    config = config.model_copy(update={"lidar": config.lidar.model_copy(update={"mount": mount})})
    T = build_robot(config).T_base_laser
    np.testing.assert_allclose(T[:3, 3], [x, y, z], atol=1e-9)
    expected = matrix_from_rpy(*np.radians([roll, pitch, yaw]))
    np.testing.assert_allclose(T[:3, :3], expected, atol=1e-8)


@given(angles, st.one_of(angles, st.sampled_from([-90.0, 90.0])), angles)
def test_roll_pitch_yaw_of_any_rotation(roll: float, pitch: float, yaw: float) -> None:
    rotation = matrix_from_rpy(*np.radians([roll, pitch, yaw]))
    np.testing.assert_allclose(matrix_from_rpy(*rpy_from_matrix(rotation)), rotation, atol=1e-7)


def test_static_transforms_lead_to_every_frame(robot: RobotModel) -> None:
    placed = {"base_footprint": np.eye(4)}
    for joint in robot.static_transforms:
        placed[joint.child] = placed[joint.parent] @ joint.T_parent_child
    np.testing.assert_allclose(placed["laser_link"], robot.T_base_laser, atol=1e-12)
    np.testing.assert_allclose(placed["imu_link"], robot.T_base_imu, atol=1e-12)


def test_welding_keeps_mass_centre_and_inertia(robot: RobotModel) -> None:
    def whole(description: Description) -> list[float]:
        placed = description.placements()
        body = join(
            [
                link.inertial.seen_from(placed[name])
                for name, link in description.links.items()
                if link.inertial
            ]
        )
        return [body.mass_kg, *body.centre_m.tolist(), *body.inertia_kg_m2.ravel().tolist()]

    welded = weld_fixed_joints(robot.description)
    assert set(welded.links) == {"base_footprint", *rolling_links(robot.description)}
    np.testing.assert_allclose(whole(welded), whole(robot.description), rtol=1e-9, atol=1e-12)


def test_a_description_survives_writing_and_reading(robot: RobotModel) -> None:
    assert urdf_text(read_description(robot.urdf, "x")) == robot.urdf


def _refusal(tmp_path: Path, text: str) -> str:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(InputRefused) as refused:
        build_robot(RobotConfig(urdf_file=str(path)))
    assert str(path) in str(refused.value)
    return str(refused.value)


def test_a_foreign_description_is_taken(tmp_path: Path, robot: RobotModel) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(robot.urdf)
    assert build_robot(RobotConfig(urdf_file=str(path))).track_m == robot.track_m


def test_no_such_description() -> None:
    with pytest.raises(NotFound, match=r"nowhere\.urdf"):
        build_robot(RobotConfig(urdf_file="nowhere.urdf"))


def test_the_studys_default_inertia_on_a_camera_is_refused(
    tmp_path: Path, robot: RobotModel
) -> None:
    text = robot.urdf.replace(
        'ixx="5.235e-05" ixy="0" ixz="0" iyy="7.5e-06" iyz="0" izz="5.235e-05"',
        'ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"',
    )
    assert text != robot.urdf
    message = _refusal(tmp_path, text)
    assert "camera_link" in message
    assert "5.235e-05" in message


def test_the_studys_support_wheel_in_the_air_is_refused(tmp_path: Path, robot: RobotModel) -> None:
    text = robot.urdf.replace('xyz="0.115 0 -0.0176"', 'xyz="0.115 0 -0.0106"')
    assert text != robot.urdf
    message = _refusal(tmp_path, text)
    assert "caster_front_link" in message
    assert "7.00 mm above the floor" in message


def test_the_studys_fixed_support_wheel_is_refused(tmp_path: Path, robot: RobotModel) -> None:
    text = re.sub(r'(caster_rear_joint" type=)"continuous"', r'\1"fixed"', robot.urdf)
    message = _refusal(tmp_path, text)
    assert "caster_rear_link: this wheel is fixed" in message


def test_wheels_on_one_spot_hold_no_robot(tmp_path: Path, robot: RobotModel) -> None:
    places = (
        ('xyz="0.115 0 -0.0176"', 'xyz="0 0.115 -0.0176"'),
        ('xyz="-0.135 0 -0.0176"', 'xyz="0 0.115 -0.0176"'),
    )
    text = robot.urdf
    for place, same in places:
        assert place in text
        text = text.replace(place, same)
    assert "would topple" in _refusal(tmp_path, text)


def test_a_drive_wheel_below_the_floor_is_refused(tmp_path: Path, robot: RobotModel) -> None:
    text = robot.urdf.replace('xyz="0 0.115 0"', 'xyz="0 0.115 -0.002"')
    assert "wheel_left_link: the wheel's lowest point is 2.00 mm below" in _refusal(tmp_path, text)


@pytest.mark.parametrize(
    ("pattern", "replacement", "words"),
    [
        (r'<mass value="2.35"/>', '<mass value="900"/>', "body_link: mass 900 kg"),
        (r'<mass value="2.35"/>', '<mass value="0"/>', "body_link"),
        (r'izz="0.0362934734375"', 'izz="0.09"', "triangle inequality"),
        (r'<sphere radius="0.0352"/>', '<mesh filename="w.stl"/>', "collision"),
        (r'name="wheel_left_joint" type="continuous"', 'name="w" type="continuous"', "no joint"),
        (r'"laser_link"', '"scanner"', "no link laser_link"),
        (r'xyz="-0.135 0', 'xyz="0.06 0', "topple"),
        (r"</robot>", '<link name="second_root"/></robot>', "root"),
        (r"</robot>", "", "robot"),
        (r'<mass value="0.1"/>', '<mass value="nan"/>', "mass"),
    ],
)
def test_other_faults_are_named(
    tmp_path: Path, robot: RobotModel, pattern: str, replacement: str, words: str
) -> None:
    trimesh.creation.box().export(tmp_path / "w.stl")
    text = re.sub(pattern, replacement, robot.urdf)
    assert text != robot.urdf
    assert words in _refusal(tmp_path, text)


def test_a_configured_robot_is_checked_too() -> None:
    low = CylinderConfig(radius_m=0.17, height_m=0.1, mass_kg=2.0, bottom_z_m=0.0)
    with pytest.raises(InputRefused, match="body_link: does not roll"):
        build_robot(RobotConfig(base=low))
    heavy = CylinderConfig(radius_m=0.05, height_m=0.1, mass_kg=9.0, x_m=0.5, bottom_z_m=0.14)
    with pytest.raises(InputRefused, match="topple"):
        build_robot(RobotConfig(weight=heavy))


def test_describing_needs_no_physics_engine() -> None:
    assert describe(RobotConfig()).root == "base_footprint"
