"""Robots that run elsewhere are mapped, checked, recorded and driven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played_robot import PlayedSource, is_living, mapping, recorded, simulated
from waiting import wait_for

from slamsim.core.geometry import compose
from slamsim.evaluate.trajectory import compare
from slamsim.guard.errors import InputRefused, OverrideRefused, SlamsimError
from slamsim.guard.numbers import BadNumbers
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.open import open_recording
from slamsim.io.ros.message_types import ros2_types
from slamsim.io.selection import Selection
from slamsim.live.hub import Message
from slamsim.live.mapping import MappingProcess
from slamsim.live.published import DIAGNOSTICS, MAP, SLAM_TOPICS
from slamsim.live.remote import received
from slamsim.live.remote import robot as remote
from slamsim.live.remote.checking import CheckingProcess
from slamsim.live.remote.controls import RemoteControls
from slamsim.live.remote.received import FixedTransforms

pytestmark = pytest.mark.usefixtures("drives_here")

TYPES = ros2_types()
TWIST = TopicKind("/cmd_vel", "geometry_msgs/msg/Twist")


@pytest.fixture(autouse=True)
def short_first_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "FIRST_S", 0.5)


@pytest.fixture(scope="module")
def process() -> Iterator[MappingProcess]:
    with MappingProcess() as process:
        yield process


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    folder = tmp_path_factory.mktemp("remote") / "log"
    return simulated(folder, "drive.route.max_duration_s=13")


def decoded(data: bytes, kind: str) -> Any:
    return TYPES.deserialize_cdr(data, kind)


def without(messages: Sequence[Message], *topics: str) -> list[Message]:
    return [message for message in messages if message.topic.name not in topics]


def is_mapped(source: PlayedSource, process: MappingProcess, robot: Any) -> bool:
    return source.is_over and robot.known.placed > 20 and process.behind < 3


def test_a_robot_is_mapped_recorded_and_told_its_map(
    drive: list[Message], process: MappingProcess, tmp_path: Path
) -> None:
    source = PlayedSource(drive)
    with mapping(source, tmp_path, process, record=True) as (robot, _):
        wait_for(lambda: is_mapped(source, process, robot) and robot.known.grid is not None)
        wait_for(lambda: source.of("/map") and source.of("/slamsim/diagnostics"))
    finished = process.finish()
    assert [path.name for path in robot.recordings.folders] == ["drive_1"]
    written = recorded(tmp_path / "drive_1" / "log")
    read = {"/ground_truth/odom", *(kind.name for kind in robot._topics.values())}
    sent = [(m.topic.name, m.data) for m in drive if m.topic.name in read]
    assert [(m.topic.name, m.data) for m in written] == sent
    truth = open_recording(tmp_path / "drive_1").truth()
    assert truth is not None and len(finished.trajectory) > 50
    errors_m = compare(finished.trajectory, truth.planar()).translation_m
    assert np.sqrt(np.mean(errors_m**2)) < 0.01

    grid = decoded(source.of("/map")[-1], "nav_msgs/msg/OccupancyGrid")
    assert grid.header.frame_id == "map" and (np.asarray(grid.data) > 65).sum() > 100
    edge = decoded(source.of("/tf")[-1], "tf2_msgs/msg/TFMessage").transforms[0]
    assert (edge.header.frame_id, edge.child_frame_id) == ("map", "odom")
    T_map_odom = (
        edge.transform.translation.x,
        edge.transform.translation.y,
        2.0 * np.arctan2(edge.transform.rotation.z, edge.transform.rotation.w),
    )
    stamp_ns = edge.header.stamp.sec * 10**9 + edge.header.stamp.nanosec
    odometry = open_recording(tmp_path / "drive_1").log().odometry
    assert odometry is not None
    T_map_base = compose(np.array(T_map_odom), odometry.at(np.array([stamp_ns]))[0])
    believed = finished.trajectory.at(np.array([stamp_ns]))[0]
    assert np.allclose(T_map_base, believed, atol=0.02)


def turned(message: Message, frame: str, yaw_rad: float) -> Message:
    """Fixed transforms that say that a frame is turned."""
    if message.topic.name != "/tf_static":
        return message
    told = decoded(message.data, "tf2_msgs/msg/TFMessage")
    for edge in told.transforms:
        if edge.child_frame_id == frame:
            edge.transform.rotation.z = np.sin(0.5 * yaw_rad)
            edge.transform.rotation.w = np.cos(0.5 * yaw_rad)
    return replace(message, data=bytes(TYPES.serialize_cdr(told, "tf2_msgs/msg/TFMessage")))


def test_a_laser_that_is_turned_is_told(tmp_path: Path, process: MappingProcess) -> None:
    """Half a minute of turns is enough for the laser frame's yaw."""
    messages = simulated(tmp_path / "log", "drive.route.max_duration_s=45")
    scan = next(m for m in messages if m.topic.name == "/scan")
    frame = decoded(scan.data, "sensor_msgs/msg/LaserScan").header.frame_id
    source = PlayedSource([turned(message, frame, np.deg2rad(8.0)) for message in messages])
    with (
        CheckingProcess("ws://played", Selection()) as checker,
        mapping(source, tmp_path, process, checker) as (robot, _),
    ):
        wait_for(lambda: checker.checks)
        told = wait_for(lambda: [words for words in robot.known.events if "yaw" in words])
        wait_for(
            lambda: any(
                "laser" in pair.value
                for data in source.of("/slamsim/diagnostics")
                for pair in decoded(data, "diagnostic_msgs/msg/DiagnosticArray").status[0].values
                if pair.key == "faults"
            )
        )
    assert len(told) == 1


def test_odometry_of_transforms_alone_is_used_and_topics_of_the_robot_are_left_to_it(
    drive: list[Message], process: MappingProcess, tmp_path: Path
) -> None:
    own = [kind for kind in SLAM_TOPICS if kind.name in (MAP, DIAGNOSTICS)]
    source = PlayedSource(without(drive, "/odom", "/encoder_ticks", "/joint_states"), own)
    with mapping(source, tmp_path, process) as (robot, _):
        wait_for(lambda: is_mapped(source, process, robot))
        wait_for(lambda: source.of("/tf") and source.of("/slamsim/map"))
        assert not source.of(MAP) and not source.of(DIAGNOSTICS)
        assert robot.inputs is not None and robot.inputs.odom_frame == "odom"
        assert robot.known.twist() != (0.0, 0.0) or robot.known.pose() is not None


def test_time_that_goes_back_begins_a_new_map(
    drive: list[Message], process: MappingProcess, tmp_path: Path
) -> None:
    source = PlayedSource(drive)
    with mapping(source, tmp_path, process) as (robot, _):
        wait_for(lambda: is_mapped(source, process, robot) and robot.known.grid is not None)
        source.play(drive)
        wait_for(lambda: (tmp_path / "map_1").is_dir() and is_mapped(source, process, robot))
    assert sum("time went back" in note for note in robot.notes) == 1
    assert (tmp_path / "map_1" / "map.yaml").is_file()
    assert robot.known.tracking == "tracking"


def test_each_publisher_of_fixed_transforms_is_heard_by_late_clients(
    drive: list[Message],
) -> None:
    said = next(m for m in drive if m.topic.name == "/tf_static")
    fixed = FixedTransforms()
    first = decoded(fixed.with_all(said).data, "tf2_msgs/msg/TFMessage").transforms
    one = decoded(said.data, "tf2_msgs/msg/TFMessage")
    one.transforms = one.transforms[:1]
    one.transforms[0].child_frame_id = "camera"
    other = replace(said, data=bytes(TYPES.serialize_cdr(one, "tf2_msgs/msg/TFMessage")))
    both = decoded(fixed.with_all(other).data, "tf2_msgs/msg/TFMessage").transforms
    frames = {edge.child_frame_id for edge in first} | {"camera"}
    assert [edge.child_frame_id for edge in both] == [
        *(edge.child_frame_id for edge in first),
        "camera",
    ]
    assert len(frames) == len(both)
    damaged = replace(said, data=said.data[:7])
    assert fixed.with_all(damaged) is damaged
    again = decoded(fixed.with_all(said).data, "tf2_msgs/msg/TFMessage").transforms
    assert len(again) == len(both)


def test_it_is_driven_and_stops_when_no_twist_follows(
    drive: list[Message], process: MappingProcess, tmp_path: Path
) -> None:
    source = PlayedSource(without(drive, "/cmd_vel"), [TWIST])
    with mapping(source, tmp_path, process) as (robot, _):
        controls = RemoteControls(robot)
        controls.drive(0.25, -0.5, 0.05)
        wait_for(lambda: len(source.of("/cmd_vel")) == 2)
        with pytest.raises(SlamsimError, match="no topic for goals"):
            controls.go_to(1.0, 2.0)
        simulated_only: dict[str, Any] = {"pause": True, "step": 1.0, "set_rate": 2.0}
        for name, value in {**simulated_only, "set_mode": "tour"}.items():
            with pytest.raises(SlamsimError, match="not simulated here"):
                getattr(controls, name)(value)
        with pytest.raises(BadNumbers):
            controls.drive(float("nan"), 0.0)
    twists = [decoded(data, TWIST.type_name) for data in source.of("/cmd_vel")]
    assert [(t.linear.x, t.angular.z) for t in twists] == [(0.25, -0.5), (0.0, 0.0)]


@pytest.mark.long
def test_goals_and_stamped_twists(
    drive: list[Message], process: MappingProcess, tmp_path: Path
) -> None:
    stamped = TopicKind("/cmd_vel", "geometry_msgs/msg/TwistStamped")
    goals = TopicKind("/goal_pose", "geometry_msgs/msg/PoseStamped")
    source = PlayedSource(without(drive, "/cmd_vel"), [stamped, goals])
    with mapping(source, tmp_path, process) as (robot, _):
        controls = RemoteControls(robot)
        controls.drive(0.1, 0.2)
        controls.go_to(1.0, 2.0, np.pi / 2)
    twist = decoded(source.of("/cmd_vel")[0], stamped.type_name).twist
    assert (twist.linear.x, twist.angular.z) == (0.1, 0.2)
    assert len(source.of("/cmd_vel")) == 2, "it is told to stop in the end"
    goal = decoded(source.of("/goal_pose")[0], goals.type_name)
    assert goal.header.frame_id == "map" and goal.pose.position.y == 2.0
    assert goal.pose.orientation.z == pytest.approx(np.sqrt(0.5))


@pytest.mark.long
def test_what_cannot_be_mapped_is_refused(
    drive: list[Message], process: MappingProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "PATIENCE_S", 2.0)
    monkeypatch.setattr(received, "PATIENCE_S", 2.0)
    with pytest.raises(InputRefused, match="no topic of sensor_msgs/msg/LaserScan in 2 s"):
        received.read_topics(PlayedSource(without(drive, "/scan")))
    silent = TopicKind("/scan", "sensor_msgs/msg/LaserScan")
    with (
        pytest.raises(InputRefused, match="a log without scans"),
        mapping(PlayedSource(without(drive, "/scan"), [silent]), tmp_path, process) as (_, _),
    ):
        wait_for(lambda: not is_living())
    with (
        pytest.raises(OverrideRefused, match="the nearest of sensor_msgs/msg/LaserScan is /scan"),
        mapping(PlayedSource(drive), tmp_path, process, wanted=Selection(("/scna",))) as (_, _),
    ):
        wait_for(lambda: not is_living())
