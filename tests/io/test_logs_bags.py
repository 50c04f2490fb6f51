"""Reading recordings: our own comes back the same, foreign ones in every ROS format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_data import (
    IMUS,
    ROS1,
    ROS2,
    SCANS,
    START_NS,
    Message,
    Robot,
    as_mcap,
    as_ros1,
    as_rosbag2,
)
from log_data import drive, header, readings
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin

from slamsim.core.types import Log
from slamsim.guard.errors import OverrideRefused, SlamsimError
from slamsim.io.bag2.writer import MCAP_NAME
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import read_log, read_recording, read_truth, survey_recording
from slamsim.io.selection import Selection
from slamsim.models.differential_drive import wheel_odometry
from slamsim.recording import RawScans
from slamsim.simulation.log_writer import LogWriter

ROBOT1, ROBOT2 = Robot(ROS1), Robot(ROS2)


@pytest.fixture(scope="module")
def own_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("run")
    with LogWriter(run / "log", header()) as writer:
        for start_s in (0.0, 2.0, 4.0):
            part = readings(start_s, start_s + 2.0, intensities=True)
            writer.write(part, drive(start_s, start_s + 2.0))
    return run


@pytest.mark.parametrize("inside", ["", "log", f"log/{MCAP_NAME}"])
def test_our_recording_comes_back_the_same(own_log: Path, inside: str) -> None:
    whole = readings(0.0, 6.0, intensities=True)
    log = read_log(own_log / inside)
    assert log.epoch == "simulation"
    assert log.warnings == ()
    assert len(log.scans) == len(whole.scans)
    for _ in range(2):
        for back, scan in zip(log.scans, whole.scans, strict=True):
            assert (back.stamp_ns, back.geometry.beam_dt_ns) == (scan.stamp_ns, 15_000)
            np.testing.assert_array_equal(back.ranges_m, scan.ranges_m)
            assert back.intensities is not None
            np.testing.assert_array_equal(back.intensities, scan.intensities)
            np.testing.assert_allclose(
                back.geometry.angles_rad(), scan.geometry.angles_rad(), atol=2e-6
            )
            assert back.geometry.frame_id == "laser"
    assert log.imu is not None
    for name in ("stamps_ns", "angular_velocity_rad_s", "linear_acceleration_m_s2"):
        np.testing.assert_array_equal(getattr(log.imu, name), getattr(whole.imu.stream, name))
    assert log.encoders is not None
    for name in ("stamps_ns", "ticks", "ticks_per_revolution", "wheel_radius_m", "track_m"):
        np.testing.assert_array_equal(
            getattr(log.encoders, name), getattr(whole.encoders.stream, name)
        )
    assert log.odometry is not None
    expected = wheel_odometry(whole.encoders.stream)
    np.testing.assert_array_equal(log.odometry.stamps_ns, expected.stamps_ns)
    np.testing.assert_allclose(log.odometry.poses, expected.poses, atol=1e-9)
    np.testing.assert_allclose(log.T_base_laser[:3, 3], [0.1, -0.02, 0.3])
    assert log.T_base_imu is not None
    np.testing.assert_allclose(log.T_base_imu[:2, :2], [[0.0, -1.0], [1.0, 0.0]], atol=1e-12)


def test_truth_comes_back_below_a_millimetre(own_log: Path) -> None:
    truth, exact = read_truth(own_log), drive(0.0, 6.0)
    assert truth is not None
    assert (truth.stamps_ns[0], truth.stamps_ns[-1]) == (0, 6_000_000_000)
    np.testing.assert_allclose(truth.at(exact.stamps_ns).positions_m, exact.positions_m, atol=1e-5)


def test_the_log_is_the_same_without_the_truth(own_log: Path, tmp_path: Path) -> None:
    """Truth topics are never read: a recording that has no other odometry has none."""
    messages = [*ROBOT2.scans(), ROBOT2.mounting()]
    truth = [("/ground_truth/odom", t, ROBOT2.odometry(t, 1.0)) for _, t, _ in messages]
    log = read_log(as_mcap(tmp_path / "a.mcap", [*messages, *truth]))
    assert log.odometry is None
    assert any("without odometry" in warning for warning in log.warnings)


FORMATS: dict[str, Callable[[Path], Path]] = {
    "mcap zstd": lambda folder: as_mcap(folder / "a.mcap", ROBOT2.drive()),
    "mcap lz4": lambda folder: as_mcap(folder / "a.mcap", ROBOT2.drive(), CompressionType.LZ4),
    "mcap plain": lambda folder: as_mcap(folder / "a.mcap", ROBOT2.drive(), CompressionType.NONE),
    "mcap lone messages": lambda folder: as_mcap(
        folder / "a.mcap", ROBOT2.drive(), chunked=False, profile=""
    ),
    "mcap no definitions": lambda folder: as_mcap(
        folder / "a.mcap",
        ROBOT2.drive(),
        definitions=dict.fromkeys(ROS2.fielddefs, ""),
    ),
    "rosbag2 sqlite": lambda folder: as_rosbag2(folder / "a", ROBOT2.drive()),
    "sqlite file": lambda folder: next(as_rosbag2(folder / "a", ROBOT2.drive()).glob("*.db3")),
    "rosbag2 mcap": lambda folder: as_rosbag2(folder / "a", ROBOT2.drive(), StoragePlugin.MCAP),
    "ros 1": lambda folder: as_ros1(folder / "a.bag", ROBOT1.drive()),
    "ros 1 bz2": lambda folder: as_ros1(folder / "a.bag", ROBOT1.drive(), "BZ2"),
    "ros 1 lz4": lambda folder: as_ros1(folder / "a.bag", ROBOT1.drive(), "LZ4"),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_log(name: str, tmp_path: Path) -> None:
    log = read_log(FORMATS[name](tmp_path))
    stamps = [START_NS + 100_000_000 * i for i in range(SCANS)]
    assert log.epoch == "unix"
    assert [scan.stamp_ns for scan in log.scans] == stamps
    assert [scan.stamp_ns for scan in log.scans] == stamps
    assert [float(scan.ranges_m[0]) for scan in log.scans] == [1.0 + i for i in range(SCANS)]
    geometry = next(iter(log.scans)).geometry
    assert (geometry.angle_min_rad, geometry.angle_step_rad) == (-1.0, 0.5)
    assert geometry.beam_dt_ns == 1_000_000
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.poses[:, 0], 0.02 * np.arange(IMUS))
    assert log.imu is not None
    np.testing.assert_allclose(log.imu.angular_velocity_rad_s[:, 2], 0.1 * np.arange(IMUS))
    assert log.encoders is None
    assert read_truth(_only(tmp_path)) is None
    cos, sin = np.cos(0.5), np.sin(0.5)
    np.testing.assert_allclose(log.T_base_laser[:2, [0, 1, 3]], [[cos, -sin, 0.2], [sin, cos, 0.0]])
    assert not [w for w in log.warnings if "cover" not in w]


def _only(folder: Path) -> Path:
    (path,) = folder.iterdir()
    return path


def _read(tmp_path: Path, messages: list[Message], scan_topic: str | None = None) -> Log:
    in_order = sorted(messages, key=lambda message: message[1])
    wanted = Selection((scan_topic,)) if scan_topic else Selection()
    return read_log(as_mcap(tmp_path / "a.mcap", in_order), wanted)


def _told(log: Log, words: str) -> bool:
    return any(words in warning for warning in log.warnings)


def test_odometry_from_transforms_and_the_mounting_too(tmp_path: Path) -> None:
    """No Odometry topic, no /tf_static: everything is on /tf, as in many ROS 1 bags."""
    tf = []
    for i in range(60):
        stamp_ns = START_NS + 20_000_000 * i
        tf += [
            ("/tf", stamp_ns, ROBOT2.tf(ROBOT2.transform(stamp_ns, ("map", "odom"), -0.5 * i))),
            ("/tf", stamp_ns, ROBOT2.tf(ROBOT2.transform(stamp_ns, ("/odom", "base_link"), 0.1 * i),
                                        ROBOT2.transform(stamp_ns, ("base_link", "/laser"), 0.3))),
        ]  # fmt: skip
    log = _read(tmp_path, [*ROBOT2.scans(), *tf])
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.poses[:, 0], 0.1 * np.arange(60), atol=1e-12)
    np.testing.assert_allclose(log.T_base_laser[0, 3], 0.3)


def test_of_several_lidars_the_busiest_or_the_one_asked_for(tmp_path: Path) -> None:
    other = [("/rear/scan", t, ROBOT2.scan(t, [9.0] * 4)) for _, t, _ in ROBOT2.scans()[:5]]
    log = _read(tmp_path, [*ROBOT2.drive(), *other])
    assert len(log.scans) == SCANS
    assert "scans from /front/scan (not /rear/scan)" in log.sources
    assert len(_read(tmp_path, [*ROBOT2.drive(), *other], "rear/scan").scans) == 5
    with pytest.raises(OverrideRefused, match="/front/scan"):
        _read(tmp_path, ROBOT2.drive(), "/nothing")


def test_of_several_echoes_the_first_is_read(tmp_path: Path) -> None:
    """sensor_msgs/MultiEchoLaserScan, in both ROS; what is read so cannot be written back."""
    for robot, make, name in ((ROBOT2, as_mcap, "a.mcap"), (ROBOT1, as_ros1, "a.bag")):
        stamps_ns = START_NS, START_NS + 100_000_000
        scans = [("/echoes", stamp_ns, robot.echoes(stamp_ns)) for stamp_ns in stamps_ns]
        path = make(tmp_path / name, [robot.mounting(), *scans])
        log = read_log(path)
        assert "scans from /echoes (the first echo of each beam)" in log.sources
        np.testing.assert_array_equal(next(iter(log.scans)).ranges_m, [1.0, np.inf, 3.0])
        assert [topic.topic for topic in survey_recording(path).topics] == ["/tf_static", "/echoes"]
        read = read_recording(path)
        other = read.with_streams(RawScans, [replace(read.scans[0])])
        with pytest.raises(SlamsimError, match="/echoes are the first echo of each beam; into"):
            copy_recording(path, read, other, tmp_path / "copy")


def test_ranges_by_our_conventions(tmp_path: Path) -> None:
    ranges = [0.0, 0.4, 0.5, 19.9, 20.0, 25.0, np.inf, np.nan, -np.inf, -1.0]
    scan = ROBOT2.scan(START_NS, ranges)
    (back,) = _read(tmp_path, [("/scan", START_NS, scan), *ROBOT2.drive()], "/scan").scans
    nan, inf = np.nan, np.inf
    expected = np.array([nan, nan, 0.5, 19.9, inf, inf, inf, nan, nan, nan], dtype=np.float32)
    np.testing.assert_array_equal(back.ranges_m, expected)


def test_scans_out_of_order_are_sorted_and_repeated_ones_dropped(tmp_path: Path) -> None:
    order = [3, 0, 1, 1, 2, 5, 4]
    scans = [
        ("/scan", START_NS + i, ROBOT2.scan(START_NS + 10**8 * k, [1.0 + k] * 3))
        for i, k in enumerate(order)
    ]
    log = _read(tmp_path, [*ROBOT2.drive(), *scans], "/scan")
    assert [float(scan.ranges_m[0]) for scan in log.scans] == [1, 2, 3, 4, 5, 6]
    assert len(log.scans) == 6
    assert _told(log, "2 of 7 scans are stamped before")
    assert _told(log, "1 scans carry the stamp of another")


def test_scans_that_describe_no_lidar_are_left_out_and_odd_ones_told(tmp_path: Path) -> None:
    odd = [
        ROBOT2.scan(START_NS + 1, [1.0] * 5, angle_increment=0.0),
        ROBOT2.scan(START_NS + 2, []),
        ROBOT2.scan(START_NS + 3, [1.0] * 5, range_max=0.0),
        ROBOT2.scan(START_NS + 4, [1.0] * 5, angle_min=float("nan")),
        ROBOT2.scan(START_NS + 5, [1.0] * 50),
        ROBOT2.scan(START_NS + 6, [1.0] * 6, time_increment=0.0, angle_max=9.0),
        ROBOT2.scan(START_NS + 7, [1.0, 7.0], time_increment=0.0, range_max=float("inf")),
    ]
    messages = [("/scan", START_NS + i, scan) for i, scan in enumerate(odd)]
    log = _read(tmp_path, [*ROBOT2.drive(), *messages], "/scan")
    assert [scan.geometry.beam_count for scan in log.scans] == [6, 2]
    assert list(log.scans)[1].geometry.range_max_m == pytest.approx(7.0)
    for words in ("5 scans that describe no lidar", "beams changes: 2, 6", "angle_max of 1"):
        assert _told(log, words)
    assert _told(log, "time_increment is 0")


def test_beams_that_fired_before_the_stamp_are_read_and_told(tmp_path: Path) -> None:
    scans = [ROBOT2.scan(START_NS + 10**8 * k, [1.0] * 5, time_increment=-0.01) for k in (2, 3)]
    messages = [("/scan", START_NS + k, scan) for k, scan in enumerate(scans)]
    log = _read(tmp_path, [*ROBOT2.drive(), *messages], "/scan")
    assert [scan.geometry.duration_ns for scan in log.scans] == [-40_000_000] * 2
    assert _told(log, "time_increment is negative")


def test_missing_mounting_is_told(tmp_path: Path) -> None:
    messages = [message for message in ROBOT2.drive() if message[0] != "/tf_static"]
    log = _read(tmp_path, messages)
    np.testing.assert_array_equal(log.T_base_laser, np.eye(4))
    assert _told(log, "no fixed transform from 'base_footprint' to 'laser'")
    assert log.T_base_imu is None


def test_unsound_odometry_is_left_out(tmp_path: Path) -> None:
    bad = ROBOT2.odometry(START_NS + 1, float("nan"))
    worse = ROBOT2.odometry(START_NS + 2, 1.0)
    worse.pose.pose.orientation.w = 0.0
    late = ROBOT2.odometry(START_NS - 5, 3.0)
    extra = [("/wheel_odom", START_NS + 10**7 + i, m) for i, m in enumerate((bad, worse, late))]
    log = _read(tmp_path, [*ROBOT2.drive(), *extra])
    assert log.odometry is not None
    assert len(log.odometry) == IMUS + 1
    assert (np.diff(log.odometry.stamps_ns) > 0).all()
    assert _told(log, "2 messages without sound numbers")
    assert _told(log, "stamps run backwards: sorted")


def test_transforms_give_odometry_where_its_topic_holds_no_pose(tmp_path: Path) -> None:
    """Quaternions of zeros, as some drivers leave them; and a gyroscope that is none."""
    messages = [ROBOT2.mounting(), *ROBOT2.scans()]
    for i in range(60):
        stamp_ns = START_NS + 20_000_000 * i
        empty = ROBOT2.odometry(stamp_ns, 0.0)
        empty.pose.pose.orientation.w = 0.0
        moved = ROBOT2.tf(ROBOT2.transform(stamp_ns, ("odom", "base_footprint"), 0.1 * i))
        messages += [("/odom", stamp_ns, empty), ("/tf", stamp_ns, moved)]
        messages.append(("/imu", stamp_ns, ROBOT2.imu(stamp_ns, 0.0)))
    log = _read(tmp_path, messages)
    assert log.odometry is not None and log.imu is None
    np.testing.assert_allclose(log.odometry.poses[:, 0], 0.1 * np.arange(60), atol=1e-12)
    assert _told(log, "/odom: no usable pose; the transforms give odometry")
    assert _told(log, "/imu: all its turn rates are exactly 0")


def test_frames_of_changing_length_are_read_all_the_same(tmp_path: Path) -> None:
    """Messages whose strings differ cannot be decoded as one array."""
    odometry = [
        ("/odom", START_NS + 10**7 * i, ROBOT2.odometry(START_NS + 10**7 * i, i, "b" * (1 + i % 3)))
        for i in range(90)
    ]
    messages = [m for m in ROBOT2.drive() if m[0] != "/wheel_odom"]
    log = _read(tmp_path, [*messages, *odometry])
    assert log.odometry is not None
    np.testing.assert_array_equal(log.odometry.poses[:, 0], np.arange(90))


def test_a_clock_in_the_recording_means_simulation(tmp_path: Path) -> None:
    stamp = ROS2.types["builtin_interfaces/msg/Time"](1, 0)
    scans = [("/scan", i, ROBOT2.scan(10**9 + i * 10**8)) for i in range(3)]
    clock = ("/clock", 5, ROS2.types["rosgraph_msgs/msg/Clock"](stamp))
    assert _read(tmp_path, scans).epoch == "unknown"
    assert _read(tmp_path, [*scans, clock]).epoch == "simulation"
