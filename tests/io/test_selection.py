"""Topics and frames of anybody's robot: chosen by rule, chosen by option, or refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_data import ROS2, SCANS, START_NS, Message, Robot, as_mcap

from slamsim.guard.errors import OverrideRefused
from slamsim.io.open import open_recording, read_log, read_recording
from slamsim.io.selection import Selection

ROBOT = Robot(ROS2)
STEP_NS = 20_000_000


def odometry(topic: str, count: int, speed: float = 1.0, child: str = "base_footprint",
             frame: str = "odom") -> list[Message]:  # fmt: skip
    messages = []
    for i in range(count):
        stamp_ns = START_NS + STEP_NS * i
        message = ROBOT.odometry(stamp_ns, speed * 0.02 * i, child)
        message.header.frame_id = frame
        messages.append((topic, stamp_ns, message))
    return messages


def imus(topic: str = "/imu", count: int = 60, rate: float = 0.1) -> list[Message]:
    stamps = [START_NS + STEP_NS * i for i in range(count)]
    return [(topic, t, ROBOT.imu(t, rate)) for t in stamps]


def made(folder: Path, *messages: list[Message], mount: bool = True) -> Path:
    all_ = [each for some in messages for each in some] + ([ROBOT.mounting()] if mount else [])
    folder.mkdir(exist_ok=True)
    return as_mcap(folder / "a.mcap", sorted(all_, key=lambda message: message[1]))


def reach_m(path: Path, wanted: Selection | None = None) -> float:
    log = read_log(path, wanted or Selection())
    assert log.odometry is not None
    return float(log.odometry.poses[-1, 0])


def test_with_an_imu_raw_odometry_is_read_and_without_one_the_fused(tmp_path: Path) -> None:
    raw, fused = odometry("/odom", 60, 1.0), odometry("/odometry/filtered", 80, 2.0)
    both = made(tmp_path / "imu", ROBOT.scans(), raw, fused, imus())
    alone = made(tmp_path / "none", ROBOT.scans(), raw, fused)

    assert reach_m(both) == pytest.approx(0.02 * 59)
    told = read_log(both).sources
    assert "odometry from /odom (not /odometry/filtered: fused odometry would count" in told
    assert told.endswith("--odom-topic chooses another") and "\n" not in told
    assert reach_m(alone) == pytest.approx(2 * 0.02 * 79)
    assert "odometry from /odometry/filtered (not /odom: without an IMU" in read_log(alone).sources
    assert reach_m(both, Selection(odometry="/odometry/filtered")) == pytest.approx(2 * 0.02 * 79)
    assert reach_m(alone, Selection(odometry="odom")) == pytest.approx(0.02 * 59)


def test_odometry_in_a_maps_frame_is_read_last(tmp_path: Path) -> None:
    jumping = odometry("/global", 90, 3.0, frame="map")
    path = made(tmp_path, ROBOT.scans(), odometry("/wheels", 30), jumping)
    assert reach_m(path) == pytest.approx(0.02 * 29)
    assert "odometry in a map's frame jumps" in read_log(path).sources


def test_the_chosen_topic_alone_is_read_by_every_consumer(tmp_path: Path) -> None:
    path = made(tmp_path, ROBOT.scans(), imus("/imu/a"), imus("/imu/b", 90, 0.3))
    recording = read_recording(path, Selection(imu="imu/a"))
    assert [imu.topic for imu in recording.imus] == ["/imu/a"]
    assert "/imu/b" not in repr(recording.topics)
    log = read_log(path, Selection(imu="/imu/a"))
    assert log.imu is not None
    np.testing.assert_allclose(log.imu.angular_velocity_rad_s[:, 2], 0.1)


def test_of_three_lidars_the_two_that_are_chosen_are_read(tmp_path: Path) -> None:
    beside = [(name, t, ROBOT.scan(t)) for name in ("/rear", "/left") for _, t, _ in ROBOT.scans()]
    path = made(tmp_path, ROBOT.scans(), beside, odometry("/odom", 60))
    opened = open_recording(path, Selection(("/rear", "front/scan")))
    assert {scans.topic for scans in opened.recording.scans} == {"/rear", "/front/scan"}
    assert "/left" not in opened.log().sources


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        (Selection(("/front/scna",)), r"--scan-topic '/front/scna': .* nearest .* is /front/scan"),
        (Selection(("/odom",)), r"holds nav_msgs/msg/Odometry, .*LaserScan is needed, .*/front"),
        (Selection(odometry="/odm"), r"--odom-topic '/odm': .* is /odom"),
        (Selection(imu="/imu"), r"--imu-topic '/imu': .* holds no sensor_msgs/msg/Imu at all"),
        (Selection(base_frame="base_lin"), r"--base-frame 'base_lin': .* nearest is base_link"),
        (Selection(base_frame="gripper"), r"no transforms .* join gripper to base_footprint"),
    ],
)
def test_what_is_not_there_is_refused_with_the_nearest(
    tmp_path: Path, wanted: Selection, told: str
) -> None:
    arm = ROBOT.tf(ROBOT.transform(START_NS, ("arm", "gripper"), 0.1))
    apart: list[Message] = [("/tf_static", START_NS, arm)]
    path = made(tmp_path, ROBOT.scans(), odometry("/odom", 60), apart)
    with pytest.raises(OverrideRefused, match=told) as refusal:
        read_log(path, wanted)
    assert refusal.value.exit_code == 2


def test_odometry_moves_to_the_base_frame_that_is_named(tmp_path: Path) -> None:
    """A base 0.3 m behind what the odometry moves, turned by a right angle."""
    turned = ROBOT.tf(ROBOT.transform(START_NS, ("base_footprint", "rear"), -0.3, np.pi / 2))
    path = made(tmp_path, ROBOT.scans(), odometry("/odom", 60), [("/tf_static", START_NS, turned)])
    log = read_log(path, Selection(base_frame="rear"))
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.poses[:, 0], 0.02 * np.arange(60) - 0.3)
    np.testing.assert_allclose(log.odometry.poses[:, 2], np.pi / 2)
    usual = read_log(path)
    T_base_rear = np.eye(4)
    T_base_rear[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    T_base_rear[0, 3] = -0.3
    np.testing.assert_allclose(T_base_rear @ log.T_base_laser, usual.T_base_laser, atol=1e-12)


def test_of_several_robots_the_odometry_is_that_of_the_scans(tmp_path: Path) -> None:
    messages = [
        [*odometry(f"/{robot}/odom", 60, speed), *imus(f"/{robot}/imu", 60, speed)]
        for robot, speed in (("robot0", 1.0), ("robot1", 2.0))
    ]
    scans = [
        (f"/{robot}/scan", t, m) for robot in ("robot0", "robot1") for _, t, m in ROBOT.scans()
    ]
    path = made(tmp_path, scans, *messages)
    assert reach_m(path) == pytest.approx(0.02 * 59)
    log = read_log(path, Selection(("/robot1/scan",)))
    assert log.odometry is not None and log.imu is not None
    assert log.odometry.poses[-1, 0] == pytest.approx(2 * 0.02 * 59)
    np.testing.assert_allclose(log.imu.angular_velocity_rad_s[:, 2], 2.0)
    assert reach_m(path, Selection(("/robot1/scan",), "/robot0/odom")) == pytest.approx(0.02 * 59)


def test_a_namespaced_robot_with_transforms_alone(tmp_path: Path) -> None:
    """Every topic and frame under /robot1, no Odometry topic."""
    static = ROBOT.tf(ROBOT.transform(START_NS, ("robot1/base_link", "robot1/laser"), 0.3))
    messages: list[Message] = [("/robot1/tf_static", START_NS, static)]
    for i in range(60):
        t = START_NS + STEP_NS * i
        moved = ROBOT.tf(ROBOT.transform(t, ("robot1/odom", "robot1/base_link"), 0.1 * i))
        messages.append(("/robot1/tf", t, moved))
    scans: list[tuple[str, int, Any]] = [
        ("/robot1/scan", t, ROBOT.scan(t, frame="robot1/laser")) for _, t, _ in ROBOT.scans()
    ]
    log = read_log(made(tmp_path, messages, scans, mount=False))
    assert log.odometry is not None and len(log.scans) == SCANS
    np.testing.assert_allclose(log.odometry.poses[:, 0], 0.1 * np.arange(60), atol=1e-12)
    np.testing.assert_allclose(log.T_base_laser[0, 3], 0.3)
    assert "odometry from the transforms robot1/odom -> robot1/base_link" in log.sources
