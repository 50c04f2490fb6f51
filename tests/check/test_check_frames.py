"""Which way transforms lead, in which order quaternions are written, and transforms that repeat an
odometry; each fault with its repair, and healthy recordings of every sort."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_data import ROS1, START_NS, Robot
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from recording_data import edge, recording, scans_at, stamps
from scipy.spatial.transform import Rotation
from test_check_inertial import robot

from slamsim.check.diagnosis import explained
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.frames.directions import check_directions
from slamsim.check.questions.frames.quaternions import check_quaternions
from slamsim.check.questions.frames.repeated_odometry import check_repetitions
from slamsim.check.questions.frames.slashes import check_slashes
from slamsim.check.questions.frames.transforms import check_transforms
from slamsim.core.geometry import matrix_from_rpy, xyzw_from_matrix
from slamsim.core.types import FloatArray
from slamsim.io.bag2.writer import write_recording
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import read_recording
from slamsim.recording import RawImu, RawOdometry, Recording, TransformEdge
from slamsim.recording.edits.base import DRIVEN, ROTATIONS
from slamsim.recording.edits.frames import RollQuaternions, with_odometry_edge
from slamsim.recording.edits.motion import scaled_edge
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.registry import load_fault


def asked(made: Recording) -> list[Finding]:
    evidence = RecordingEvidence(made)
    return [
        *check_directions(evidence),
        *check_quaternions(evidence),
        *check_repetitions(evidence),
        *check_transforms(evidence),
    ]


def named(made: Recording) -> set[str]:
    return {one.fault for one in explained(asked(made)) if one.fault is not None}


def whole() -> Recording:
    """The robot with a tree: odom, base, unit, and a laser without messages."""
    made = robot()
    made = with_odometry_edge(made, made.odometries[0])
    laser = edge("base_link", "laser", made.imus[0].stamps_ns[:1])
    scans = scans_at(stamps(5.0, 60.0))
    return replace(made, transforms=(*made.transforms, laser), streams=(*made.streams, scans))


def turning_edge(made: Recording) -> TransformEdge:
    return next(one for one in made.transforms if not one.is_static)


def with_edge(made: Recording, other: TransformEdge) -> Recording:
    edges = (one if one.is_static else other for one in made.transforms)
    return replace(made, transforms=tuple(edges))


NAMES = ["odometry_wxyz", "scan_in_odom", "odometry_child_unknown", "tf_inverted", "tf_late"]


@pytest.mark.parametrize("name", NAMES)
def test_a_fault_is_named_alone_and_put_right(name: str) -> None:
    fault = load_fault(name)
    assert not named(whole())
    wrong = fault.inject(whole(), np.random.default_rng(0))
    assert named(wrong) == {fault.expects}
    repairs = [one for finding in asked(wrong) for one in finding.repairs]
    assert repairs and not named(apply_repairs(wrong, repairs))


def test_exchanged_names_are_told_from_inverted_poses() -> None:
    for poses, words in ((True, "the inverse of"), (False, "the very poses of")):
        fault = load_fault("tf_inverted").model_copy(update={"poses": poses})
        wrong = fault.inject(whole(), np.random.default_rng(0))
        (found,) = [one for one in asked(wrong) if one.fault == "tf_inverted"]
        assert words in found.words
        repaired = turning_edge(apply_repairs(wrong, found.repairs))
        np.testing.assert_allclose(
            repaired.positions_m, turning_edge(whole()).positions_m, atol=1e-9
        )


def test_a_map_below_the_odometry_is_a_recorded_map_upside_down() -> None:
    made = whole()
    upside_down = replace(turning_edge(made), parent="odom", child="map")
    made = replace(made, transforms=(*made.transforms, upside_down))
    assert named(made) == {"tf_map_recorded"}
    (found,) = [one for one in asked(made) if one.fault == "tf_map_recorded"]
    assert [repair.operation for repair in found.repairs] == ["drop_transform"]


@pytest.mark.long
@given(yaw=st.lists(st.floats(-7.0, 7.0), min_size=2, max_size=6), tilt=st.floats(0.0, 0.15))
def test_a_robot_on_a_floor_never_writes_its_quaternions_the_other_way(
    yaw: list[float], tilt: float
) -> None:
    """Whatever it turns, and on ramps; but written the other way it is found, if it turns."""
    made = whole()
    odometry = made.odometries[0]
    course = np.interp(np.linspace(0.0, 1.0, len(odometry)), np.linspace(0.0, 1.0, len(yaw)), yaw)
    ramps = tilt * np.sin(np.arange(len(odometry)) * 0.05)
    turns = Rotation.from_euler("ZY", np.column_stack([course, ramps]))
    quats = xyzw_from_matrix(turns.as_matrix())
    made = made.with_streams(RawOdometry, (replace(odometry, quats_xyzw=quats),))
    assert "quaternion_order" not in named_by(check_quaternions, made)
    # How far it tilts when it is read the other way.
    tilts = np.pi - np.abs(np.arctan2(np.sin(course), np.cos(course)))
    if np.ptp(np.quantile(tilts, [0.05, 0.95])) > 0.1 and np.quantile(tilts, 0.95) > 0.5:
        other = RollQuaternions(DRIVEN, 1).apply(made)
        assert "quaternion_order" in named_by(check_quaternions, other)


def named_by(ask: Callable[[RecordingEvidence], Iterable[Finding]], made: Recording) -> set[str]:
    return {one.fault for one in ask(RecordingEvidence(made)) if one.fault is not None}


def test_a_unit_on_its_head_is_not_taken_for_another_order() -> None:
    """Its gravity tells: turned by the orientation as it is read it points up."""
    made = robot()
    imu = made.imus[0]
    yaw = np.cumsum(imu.angular_velocity_rad_s[:, 2]) * 0.01
    quats = np.array([xyzw_from_matrix(matrix_from_rpy(0.0, 0.0, one)) for one in yaw])
    healthy = made.with_streams(RawImu, (replace(imu, orientation_xyzw=quats),))
    assert not named_by(check_quaternions, healthy)
    wxyz = RollQuaternions(ROTATIONS.on("/imu"), 1).apply(healthy)
    assert named_by(check_quaternions, wxyz) == {"quaternion_order"}
    rolls = np.pi + 0.1 * np.sin(0.01 * np.arange(len(imu)))
    rocking = np.array([xyzw_from_matrix(matrix_from_rpy(roll, 0.0, 0.0)) for roll in rolls])
    head = replace(
        imu,
        orientation_xyzw=rocking,
        linear_acceleration_m_s2=imu.linear_acceleration_m_s2 * [1.0, -1.0, -1.0],
    )
    assert not named_by(check_quaternions, made.with_streams(RawImu, (head,)))


@settings(max_examples=30)
@given(late_ms=st.floats(-200.0, 200.0), scale=st.floats(0.97, 1.03), seed=st.integers(0, 99))
def test_how_late_and_how_long_a_repeated_odometry_is(
    late_ms: float, scale: float, seed: int
) -> None:
    """Stamps on another clock's ticks, and poses in single precision."""
    made = whole()
    moved = scaled_edge(turning_edge(made), scale, 1.0)
    keep = np.sort(np.random.default_rng(seed).permutation(moved.stamps_ns.size)[:1000])
    other = replace(
        moved,
        stamps_ns=moved.stamps_ns[keep] + round(1e6 * late_ms),
        received_ns=None,
        positions_m=moved.positions_m[keep].astype(np.float32).astype(np.float64),
        quats_xyzw=moved.quats_xyzw[keep],
    )
    time, length = check_repetitions(RecordingEvidence(with_edge(made, other)))
    assert time.estimate is not None and length.estimate is not None
    assert time.estimate.value == pytest.approx(late_ms, abs=0.5)
    assert length.estimate.value == pytest.approx(100.0 * (scale - 1.0), abs=0.1)
    for found, limit in ((time, 5.0), (length, 0.5)):
        assert found.estimate is not None
        if abs(abs(found.estimate.value) - limit) > 0.5:
            assert (found.verdict == "fault") == (abs(found.estimate.value) > limit)


def test_a_filter_of_wheels_and_gyroscope_is_no_repetition() -> None:
    """Its turns are others, by a few per cent, and its stamps are its own affair."""
    made = whole()
    rng = np.random.default_rng(3)
    filtered = turning_edge(made)
    gains: FloatArray = 1.0 + 0.1 * rng.standard_normal(filtered.stamps_ns.size - 1)
    other = scaled_edge(filtered, 1.0, gains)
    late = replace(other, stamps_ns=other.stamps_ns + 20_000_000)
    assert not list(check_repetitions(RecordingEvidence(with_edge(made, late))))


def test_a_robot_that_only_drives_straight_on_has_no_turn_to_compare() -> None:
    made = whole()
    odometry = made.odometries[0]
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (len(odometry), 1))
    ahead = np.column_stack([0.02 * np.arange(len(odometry)), *np.zeros((2, len(odometry)))])
    straight = replace(odometry, positions_m=ahead, quats_xyzw=quats)
    made = with_odometry_edge(made.with_streams(RawOdometry, (straight,)), straight)
    findings = list(check_repetitions(RecordingEvidence(made)))
    assert [one.verdict for one in findings] == ["ok", "ok"]


def test_names_with_a_leading_slash_are_told_of_ros_2_and_lose_it(tmp_path: Path) -> None:
    """tf2 refuses to look them up; in ROS 1 the slash meant nothing."""
    scans = scans_at(stamps(10.0, 2.0))
    frames = ("/laser", "/odom", "/base_link")
    made = recording(2.0).changed(RawOdometry, lambda one: replace(one, frame_ids=frames[1:2]))
    made = made.changed(RawOdometry, lambda one: replace(one, child_frame_ids=frames[2:]))
    made = made.with_streams(type(scans), (replace(scans, frame_ids=frames[:1]),))
    write_recording(made, tmp_path / "slashed")
    read = read_recording(tmp_path / "slashed")
    told = list(check_slashes(RecordingEvidence(read)))
    assert [(one.fault, one.subject) for one in told] == [
        ("frame_slash", "/scan"),
        ("frame_slash", "/odom"),
    ]
    fixed = apply_repairs(read, [repair for one in told for repair in one.repairs])
    assert not list(check_slashes(RecordingEvidence(fixed)))
    copy_recording(tmp_path / "slashed", read, fixed, tmp_path / "fixed")
    again = read_recording(tmp_path / "fixed")
    assert not list(check_slashes(RecordingEvidence(again)))
    named = [*again.scans[0].frame_ids, *again.odometries[0].frame_ids]
    assert [*named, *again.odometries[0].child_frame_ids] == ["laser", "odom", "base_link"]


def test_a_slash_in_messages_of_ros_1_means_nothing_whatever_holds_them(tmp_path: Path) -> None:
    message, kind = Robot(ROS1).scan(START_NS, frame="/laser"), "sensor_msgs/msg/LaserScan"
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        definition = ROS1.generate_msgdef(kind)[0].encode()
        schema = writer.register_schema("sensor_msgs/LaserScan", "ros1msg", definition)
        channel = writer.register_channel("/scan", "ros1", schema)
        writer.add_message(channel, START_NS, bytes(ROS1.serialize_ros1(message, kind)), START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    read = read_recording(tmp_path / "a.mcap")
    assert read.scans[0].frame_ids == ("laser",)
    assert not list(check_slashes(RecordingEvidence(read)))


def test_a_slash_alone_is_told_and_leaves_no_name_to_have(tmp_path: Path) -> None:
    scans = replace(scans_at(stamps(10.0, 2.0)), frame_ids=("/",))
    write_recording(recording(2.0).with_streams(type(scans), (scans,)), tmp_path / "slash")
    read = read_recording(tmp_path / "slash")
    (told,) = check_slashes(RecordingEvidence(read))
    assert told.fault == "frame_slash" and not told.repairs
