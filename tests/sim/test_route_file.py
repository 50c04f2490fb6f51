"""Routes from files: what is read, what is refused, what is driven."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drive_worlds import hall

from slamsim.config.drive import DriveConfig, FollowConfig, RouteConfig
from slamsim.config.robot import RobotConfig
from slamsim.core.geometry import wrap_angle
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.route_file import PoseRoute, TwistRoute, read_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import build_robot

ROBOT = build_robot(RobotConfig())


def _file(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_poses_from_yaml_and_csv_are_the_same(tmp_path: Path) -> None:
    yaml = _file(
        tmp_path,
        "r.yaml",
        "poses:\n- {x_m: 1, y_m: 2.5, yaw_deg: 90}\n- {x_m: -1.5, y_m: 0, yaw_deg: -45}\n",
    )
    degrees = _file(tmp_path, "d.csv", "x_m,y_m,yaw_deg\n1,2.5,90\n-1.5,0,-45\n")
    radians = _file(
        tmp_path,
        "r.csv",
        f"# a comment\nx_m, y_m, yaw_rad\n1,2.5,{np.pi / 2}\n\n-1.5,0,-0.785398163\n",
    )
    for path in (yaml, degrees, radians):
        route = read_route(path)
        assert isinstance(route, PoseRoute)
        np.testing.assert_array_equal(route.points_m, [[1.0, 2.5], [-1.5, 0.0]])
        np.testing.assert_allclose(route.yaws_rad, [np.pi / 2, -np.pi / 4], atol=1e-8)


def test_poses_without_heading(tmp_path: Path) -> None:
    route = read_route(_file(tmp_path, "r.csv", "x_m,y_m\n1,2\n"))
    assert isinstance(route, PoseRoute)
    assert np.isnan(route.yaws_rad).all()


def test_twists_from_yaml_and_csv_are_the_same(tmp_path: Path) -> None:
    yaml = _file(
        tmp_path,
        "r.yaml",
        "twists:\n- {t_s: 0, v_m_s: 0.2, w_rad_s: 0}\n- {t_s: 2.5, v_m_s: 0, w_rad_s: 0}\n",
    )
    csv = _file(tmp_path, "r.csv", "t_s,v_m_s,w_rad_s\n0,0.2,0\n2.5,0,0\n")
    for path in (yaml, csv):
        route = read_route(path)
        assert isinstance(route, TwistRoute)
        np.testing.assert_array_equal(route.twists, [[0.0, 0.2, 0.0], [2.5, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("r.csv", "", "must name the columns"),
        ("r.csv", "x,y\n1,2\n", "must name the columns"),
        ("r.csv", "x_m,y_m\n", "0 rows"),
        ("r.csv", "x_m,y_m\n1,2\n3\n", "line 3"),
        ("r.csv", "x_m,y_m\n1,nan\n", "finite"),
        ("r.csv", "x_m,y_m\n1,two\n", "finite"),
        ("r.csv", "t_s,v_m_s,w_rad_s\n0,1,0\n0,1,0\n", "growing"),
        ("r.csv", "t_s,v_m_s,w_rad_s\n1,1,0\n2,1,0\n", "growing from 0"),
        ("r.csv", "t_s,v_m_s,w_rad_s\n0,0.1,0\n", "at least 2"),
        ("r.yaml", "poses: []\n", "either poses or twists"),
        ("r.yaml", "poses:\n- {x_m: 1}\n", "y_m"),
        ("r.yaml", "poses:\n- {x_m: 1, y_m: 1, yaw: 2}\n", "yaw"),
        ("r.yaml", "- 1\n", "r.yaml"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(
    tmp_path: Path, name: str, text: str, words: str
) -> None:
    path = _file(tmp_path, name, text)
    with pytest.raises(InputRefused) as refused:
        read_route(path)
    assert words in str(refused.value)
    assert name in str(refused.value)


def test_no_such_file() -> None:
    config = DriveConfig(route=RouteConfig(file="nowhere.csv"))
    with pytest.raises(NotFound, match="nowhere"):
        plan_route(hall(), ROBOT, config)


def test_a_pose_in_a_wall_is_refused_with_the_room(tmp_path: Path) -> None:
    path = _file(tmp_path, "r.csv", "x_m,y_m\n2,0\n5.9,0\n")
    config = DriveConfig(route=RouteConfig(file=str(path)))
    with pytest.raises(SlamsimError, match=r"pose 2, \(5\.9, 0\).*room for a radius of 0\.\d+ m"):
        plan_route(hall(), ROBOT, config)


def test_twists_beyond_the_limits_are_refused(tmp_path: Path) -> None:
    path = _file(tmp_path, "r.csv", "t_s,v_m_s,w_rad_s\n0,3,0\n1,0,0\n")
    config = DriveConfig(route=RouteConfig(file=str(path)))
    with pytest.raises(InputRefused, match=r"up to 3 m/s, drive\.limits allow 0\.5 m/s"):
        plan_route(hall(), ROBOT, config)


def test_a_square_is_driven_pose_by_pose(tmp_path: Path) -> None:
    rows = "2,0,90\n2,2,180\n0,2,-90\n0,0,0\n0,0,135\n"
    path = _file(tmp_path, "square.csv", "x_m,y_m,yaw_deg\n" + rows)
    config = DriveConfig(route=RouteConfig(file=str(path)), follow=FollowConfig(standstill_s=0.5))
    world = hall()
    route = plan_route(world, ROBOT, config)
    assert route.length_m == pytest.approx(8.0, abs=0.01)
    run = DriveRun(world, ROBOT, route, config)
    poses = np.vstack([window.trajectory().planar().poses for window in run])
    assert run.outcome.finished, run.outcome
    for x, y in ((2, 0), (2, 2), (0, 2)):
        assert np.linalg.norm(poses[:, :2] - [x, y], axis=1).min() < 0.05
    assert np.linalg.norm(poses[-1, :2]) < 0.05
    assert abs(np.rad2deg(wrap_angle(poses[-1, 2] - np.radians(135.0)))) < 4.0
    off_path = np.minimum.reduce([np.abs(poses[:, i] - at) for i in (0, 1) for at in (0.0, 2.0)])
    assert off_path.max() < 0.08
