"""Does the simulated robot move as a real one must?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drive_worlds import hall

from slamsim.config.drive import DriveConfig, FollowConfig, LimitsConfig, RouteConfig
from slamsim.config.robot import DriveWheelsConfig, MotorConfig, RobotConfig
from slamsim.core.geometry import matrix_from_xyzw, wrap_angle, yaw_from_xyzw
from slamsim.core.types import Drive, EncoderStream, FloatArray
from slamsim.models.differential_drive import wheel_odometry
from slamsim.sim.drive.record import START_NS
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.world.model import FloorPatch, World

TICKS = 10_000_000


def _join(windows: list[Drive]) -> Drive:
    return Drive(
        *(
            np.concatenate([getattr(window, name) for window in windows])
            for name in Drive.__dataclass_fields__
        )
    )


def _robot(**parts: object) -> RobotModel:
    return build_robot(RobotConfig(**parts))  # type: ignore[arg-type]


def _play(
    folder: Path,
    rows: list[tuple[float, float, float]],
    robot: RobotModel | None = None,
    world: World | None = None,
    limits: LimitsConfig | None = None,
) -> Drive:
    """Drives twists (t_s, v_m_s, w_rad_s) in an empty hall."""
    path = folder / "twists.csv"
    lines = ["t_s,v_m_s,w_rad_s", *(",".join(str(value) for value in row) for row in rows)]
    path.write_text("\n".join(lines))
    config = DriveConfig(
        limits=limits or LimitsConfig(),
        route=RouteConfig(file=str(path)),
        follow=FollowConfig(standstill_s=0.5, final_standstill_s=0.5),
    )
    robot, world = robot or _robot(), world or hall()
    run = DriveRun(world, robot, plan_route(world, robot, config), config)
    driven = _join(list(run))
    assert run.outcome.finished, run.outcome
    return driven


def _odometry(driven: Drive, robot: RobotModel) -> FloatArray:
    """(n, 3) from exact wheel angles."""
    ticks = np.rint(driven.wheel_angles_rad / (2 * np.pi) * TICKS).astype(np.int64)
    stream = EncoderStream(driven.stamps_ns, ticks, TICKS, robot.wheel_radius_m, robot.track_m)
    return wheel_odometry(stream, driven.trajectory().planar().poses[0]).poses


def test_a_robot_at_rest_stays_at_rest(tmp_path: Path) -> None:
    driven = _play(tmp_path, [(0, 0, 0), (5, 0, 0)])
    assert np.ptp(driven.positions_m, axis=0).max() < 1e-4
    assert np.abs(driven.positions_m[:, 2]).max() < 2e-4
    assert np.abs(yaw_from_xyzw(driven.quats_xyzw)).max() < 1e-4


def test_a_metre_straight_ahead(tmp_path: Path) -> None:
    """Commanded 0.25 m/s for 4 s, speeding up and braking at 0.5 m/s^2 alike: one metre."""
    driven = _play(tmp_path, [(0, 0.25, 0), (4, 0, 0), (4.5, 0, 0)])
    assert driven.positions_m[-1, 0] == pytest.approx(1.0, rel=0.01)
    assert abs(driven.positions_m[-1, 1]) < 0.002
    assert np.rad2deg(abs(yaw_from_xyzw(driven.quats_xyzw))).max() < 0.2


def test_a_quarter_turn_on_the_spot(tmp_path: Path) -> None:
    driven = _play(tmp_path, [(0, 0, np.pi / 4), (2, 0, 0), (2.5, 0, 0)])
    assert np.rad2deg(yaw_from_xyzw(driven.quats_xyzw)[-1]) == pytest.approx(90.0, abs=1.0)
    assert np.linalg.norm(driven.positions_m[-1, :2]) < 0.005


BENDS = [(0.0, 0.4, 0.0), (2.0, 0.4, 0.8), (6.0, 0.2, -1.0), (9.0, 0.4, 0.3), (12.0, 0.0, 0.0)]


def test_on_a_grippy_floor_the_wheels_tell_where_the_robot_is(tmp_path: Path) -> None:
    robot = _robot()
    driven = _play(tmp_path, [*BENDS, (13, 0, 0)], robot)
    error = _odometry(driven, robot)[-1] - driven.trajectory().planar().poses[-1]
    assert np.linalg.norm(error[:2]) < 0.01
    assert np.rad2deg(abs(wrap_angle(error[2]))) < 0.5


def test_on_a_slippery_floor_they_do_not(tmp_path: Path) -> None:
    robot = _robot()
    patch = FloorPatch(-6.0, -6.0, 6.0, 6.0, 0.02)
    driven = _play(tmp_path, [*BENDS, (13, 0, 0)], robot, hall(patches=[patch]))
    error = _odometry(driven, robot)[-1] - driven.trajectory().planar().poses[-1]
    assert np.linalg.norm(error[:2]) > 0.1


def test_a_patch_acts_only_under_the_wheel_that_stands_on_it(tmp_path: Path) -> None:
    """A mu-split: the right wheel on ice, so the robot turns towards the slippery side."""
    ice = FloorPatch(-6.0, -6.0, 6.0, -0.01, 0.0)
    rows = [(0.0, 0.3, 0.0), (4.0, 0.0, 0.0), (5.0, 0.0, 0.0)]
    limits = LimitsConfig(max_acceleration_m_s2=1.0)
    driven = _play(tmp_path, rows, world=hall(patches=[ice]), limits=limits)
    assert np.rad2deg(yaw_from_xyzw(driven.quats_xyzw)).min() < -5.0
    dry = _play(tmp_path, rows, limits=limits)
    assert np.rad2deg(np.abs(yaw_from_xyzw(dry.quats_xyzw))).max() < 0.2


def test_the_last_of_overlapping_patches_counts(tmp_path: Path) -> None:
    ice = FloorPatch(-6.0, -6.0, 6.0, 6.0, 0.0)
    carpet = FloorPatch(-5.0, -5.0, 5.0, 5.0, 1.0)
    rows = [(0.0, 0.3, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
    on_carpet = _play(tmp_path, rows, world=hall(patches=[ice, carpet]))
    on_ice = _play(tmp_path, rows, world=hall(patches=[carpet, ice]))
    assert on_carpet.positions_m[-1, 0] == pytest.approx(0.6, abs=0.02)
    assert on_ice.positions_m[-1, 0] < 0.1


def test_commands_keep_to_the_acceleration_limits(tmp_path: Path) -> None:
    limits = LimitsConfig(max_acceleration_m_s2=0.3, max_yaw_acceleration_rad_s2=1.0)
    driven = _play(tmp_path, [(0, 0.5, 1.0), (3, -0.3, -1.5), (6, 0, 0)], limits=limits)
    rates = np.abs(np.diff(driven.commands, axis=0)).max(axis=0) * 40.0
    np.testing.assert_allclose(rates, [0.3, 1.0], rtol=1e-6)
    forward = np.cos(yaw := yaw_from_xyzw(driven.quats_xyzw)) * driven.linear_velocity_m_s[:, 0]
    forward += np.sin(yaw) * driven.linear_velocity_m_s[:, 1]
    gained = np.abs(np.diff(forward)) * 240.0
    assert gained.max() < 0.3 * 1.1
    turned = np.abs(np.diff(driven.angular_velocity_rad_s[:, 2])) * 240.0
    assert turned.max() < 1.0 * 1.1


def _effective_mass_kg(robot: RobotModel) -> float:
    """The mass and what the turning wheels (solid cylinders) and balls add to it."""
    bodies = [link.inertial for link in robot.description.links.values() if link.inertial]
    return sum(body.mass_kg for body in bodies) + 2 * 0.5 * 0.1 + 2 * 0.4 * 0.02


def test_the_largest_torque_limits_how_fast_the_robot_speeds_up(tmp_path: Path) -> None:
    """Two wheels of 0.01 N m at 35.2 mm push 0.57 N: a mass of 4.05 kg gains 0.14 m/s^2."""
    weak = _robot(motor=MotorConfig(max_torque_n_m=0.01))
    limits = LimitsConfig(max_acceleration_m_s2=5.0)
    driven = _play(tmp_path, [(0, 0.4, 0), (2, 0, 0), (6, 0, 0)], weak, limits=limits)
    time_s = (driven.stamps_ns - START_NS) * 1e-9
    speed = driven.linear_velocity_m_s[:, 0]
    gained = np.interp(1.5, time_s, speed) - np.interp(0.75, time_s, speed)
    expected = 2 * 0.01 / 0.0352 / _effective_mass_kg(weak)
    assert gained / 0.75 == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("kind", ["velocity", "pid", "ideal"])
def test_every_motor_reaches_the_commanded_speed(tmp_path: Path, kind: str) -> None:
    robot = _robot(motor=MotorConfig(kind=kind))  # type: ignore[arg-type]
    driven = _play(tmp_path, [(0, 0.3, 0), (4, 0, 0), (5, 0, 0)], robot)
    time_s = (driven.stamps_ns - START_NS) * 1e-9
    steady = (time_s > 3.0) & (time_s < 4.4)
    np.testing.assert_allclose(driven.wheel_speeds_rad_s[steady] * 0.0352, 0.3, atol=0.01)
    np.testing.assert_allclose(driven.linear_velocity_m_s[steady, 0], 0.3, atol=0.01)


def test_pid_lags_where_ideal_does_not(tmp_path: Path) -> None:
    def worst_lag_m_s(kind: str) -> float:
        robot = _robot(motor=MotorConfig(kind=kind))  # type: ignore[arg-type]
        driven = _play(tmp_path, [(0, 0.3, 0), (2, 0, 0), (3, 0, 0)], robot)
        error = driven.wheel_speeds_rad_s[:, 0] * 0.0352 - driven.commands[:, 0]
        return float(np.abs(error[6:]).max())

    assert worst_lag_m_s("pid") > 2.0 * worst_lag_m_s("ideal")


def test_wheel_friction_acts(tmp_path: Path) -> None:
    """With friction mu the robot brakes by at most about mu g times the driven wheels' load."""
    smooth = _robot(drive_wheels=DriveWheelsConfig(friction=0.02))
    limits = LimitsConfig(max_acceleration_m_s2=5.0)
    driven = _play(tmp_path, [(0, 0.4, 0), (3, 0, 0), (7, 0, 0)], smooth, limits=limits)
    speed = driven.linear_velocity_m_s[:, 0]
    gained = (speed[24:] - speed[:-24]) / 0.1
    assert 0.1 < gained.max() < 0.02 * 9.81 * 1.05
    slip_m_s = driven.wheel_speeds_rad_s[:, 0] * 0.0352 - speed
    assert slip_m_s.max() > 0.1


def test_velocities_are_the_derivatives_of_the_poses(tmp_path: Path) -> None:
    driven = _play(tmp_path, [*BENDS, (13, 0, 0)])
    step_s = 1.0 / 240.0
    moved = (driven.positions_m[2:] - driven.positions_m[:-2]) / (2 * step_s)
    np.testing.assert_allclose(moved, driven.linear_velocity_m_s[1:-1], atol=0.01)
    yaw = np.unwrap(yaw_from_xyzw(driven.quats_xyzw))
    turned = (yaw[2:] - yaw[:-2]) / (2 * step_s)
    np.testing.assert_allclose(turned, driven.angular_velocity_rad_s[1:-1, 2], atol=0.05)
    rolled = (driven.wheel_angles_rad[2:] - driven.wheel_angles_rad[:-2]) / (2 * step_s)
    np.testing.assert_allclose(rolled, driven.wheel_speeds_rad_s[1:-1], atol=0.3)


def test_base_footprint_stays_on_the_floor_and_between_the_wheels(tmp_path: Path) -> None:
    """base_footprint moves along its own x axis only, to the slip: it is not the centre of mass,
    which swings sideways in bends."""
    driven = _play(tmp_path, [*BENDS, (13, 0, 0)])
    rotation = matrix_from_xyzw(driven.quats_xyzw)
    sideways = np.einsum("ni,ni->n", rotation[:, :, 1], driven.linear_velocity_m_s)
    assert np.abs(sideways).max() < 0.004
    assert np.abs(driven.positions_m[:, 2]).max() < 5e-4


def test_no_energy_from_nowhere(tmp_path: Path) -> None:
    """What the robot's motion holds, the motors have put in: torque limit times angle turned."""
    weak = _robot(motor=MotorConfig(max_torque_n_m=0.01))
    limits = LimitsConfig(max_acceleration_m_s2=5.0)
    driven = _play(tmp_path, [(0, 0.5, 0), (3, 0, 0), (6, 0, 0)], weak, limits=limits)
    speeding_up = (driven.stamps_ns - START_NS) * 1e-9 < 3.4
    kinetic_j = 0.5 * _effective_mass_kg(weak) * driven.linear_velocity_m_s[:, 0] ** 2
    turned_rad = np.abs(driven.wheel_angles_rad - driven.wheel_angles_rad[0]).sum(axis=1)
    work_j = 0.01 * turned_rad
    assert np.all(kinetic_j[speeding_up] <= 1.02 * work_j[speeding_up] + 1e-4)
    assert kinetic_j[speeding_up].max() > 0.3
