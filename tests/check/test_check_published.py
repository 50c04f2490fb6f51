"""Numbers that are no measurement, publishers that share a topic, counters that stand still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recording_data import recording as healthy

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.motion.inputs import gather_inputs
from slamsim.check.questions.frames.transforms import check_transforms
from slamsim.check.questions.inertial.gravity import check_inertial
from slamsim.check.questions.streams.publishers import check_publishers
from slamsim.check.questions.wheels.odometry import check_odometry
from slamsim.check.questions.wheels.published import check_published
from slamsim.recording import RawImu, RawOdometry, RawScans, RawTicks
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import injected, load_fault

ASKED: dict[str, Callable[[RecordingEvidence], list[Finding]]] = {
    "odometry_not_a_number": check_published,
    "odometry_no_rotation": check_published,
    "second_odometry": check_published,
    "two_odometries_one_topic": check_publishers,
    "two_lidars_one_topic": check_publishers,
    "two_lidars_one_frame": check_publishers,
    "imu_not_a_number": check_inertial,
    "imu_spikes": check_inertial,
    "gyro_axis_dead": check_inertial,
    "imu_orientation_identity": check_inertial,
    "imu_orientation_zero": check_inertial,
    "ticks_frozen": check_odometry,
    "wheel_dead": check_odometry,
    "odometry_still": check_odometry,
    "tf_map_recorded": check_transforms,
}


def harmful(name: str) -> Fault:
    """The made-up room is square: a lidar that looks a quarter turn aside sees the same."""
    fault = load_fault(name)
    return fault.model_copy(update={"yaw_deg": 40.0}) if "lidars" in name else fault


def named(findings: list[Finding]) -> set[str]:
    return {finding.fault for finding in findings if finding.fault is not None}


@pytest.mark.parametrize("name", ASKED)
def test_a_fault_is_named_and_a_healthy_recording_has_none(name: str) -> None:
    fault, ask = harmful(name), ASKED[name]
    recording = healthy()
    assert fault.expects not in named(ask(RecordingEvidence(recording)))
    assert fault.expects in named(ask(RecordingEvidence(injected(recording, [fault], seed=2))))


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("odometry_not_a_number", 0.01),
        ("odometry_no_rotation", 2.0),
        ("imu_not_a_number", 0.01),
        ("imu_orientation_zero", None),
        ("tf_map_recorded", None),
    ],
)
def test_what_is_proposed_mends_it(name: str, size: float | None) -> None:
    fault = load_fault(name) if size is None else load_fault(name).with_size(size)
    broken = injected(healthy(), [fault], seed=2)
    findings = [one for one in ASKED[name](RecordingEvidence(broken)) if one.fault == fault.expects]
    repaired = apply_repairs(broken, [repair for one in findings for repair in one.repairs])
    assert fault.expects not in named(ASKED[name](RecordingEvidence(repaired)))


def test_a_filtered_copy_of_a_lidar_or_a_unit_is_the_same_sensor() -> None:
    recording = healthy()
    scans, imu = recording.scans[0], recording.imus[0]
    thinned = np.array(scans.ranges_m)
    thinned[:, ::3] = np.inf
    copies = recording.with_streams(
        RawScans, (scans, replace(scans, topic="/scan_filtered", ranges_m=thinned))
    ).with_streams(RawImu, (imu, replace(imu, topic="/imu/data_raw")))
    assert not named(check_publishers(RecordingEvidence(copies)))


def test_a_topic_that_names_two_frames_has_two_publishers() -> None:
    recording = healthy()
    two = replace(recording.scans[0], frame_ids=("left", "right"))
    findings = check_publishers(RecordingEvidence(recording.with_streams(RawScans, (two,))))
    assert named(findings) == {"topic_shared"}


def test_a_transform_that_a_driver_and_a_filter_publish_has_two_publishers() -> None:
    recording = healthy()
    edge = next(one for one in recording.transforms if not one.is_static)
    second = np.arange(edge.stamps_ns.size) % 2 == 1
    longer = edge.positions_m * np.where(second, 1.5, 1.0)[:, None]
    both = tuple(
        replace(one, positions_m=longer) if one is edge else one for one in recording.transforms
    )
    findings = check_publishers(RecordingEvidence(replace(recording, transforms=both)))
    assert [one.subject for one in findings if one.fault == "topic_shared"] == [
        f"{edge.topic} {edge.name}"
    ]


def test_an_orientation_that_follows_the_turns_is_one() -> None:
    recording = healthy()
    imu = recording.imus[0]
    yaw = 0.2 * (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    still = np.zeros_like(yaw)
    quats = np.column_stack([still, still, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    turning = recording.with_streams(RawImu, (replace(imu, orientation_xyzw=quats),))
    verdicts = {one.check: one.verdict for one in check_inertial(RecordingEvidence(turning))}
    assert verdicts["imu.orientation"] == "ok"


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_few_messages_are_no_fault(count: int) -> None:
    recording = healthy()
    few = recording.changed(
        RawScans,
        lambda one: replace(
            one,
            stamps_ns=one.stamps_ns[:count],
            received_ns=None,
            layout_of=one.layout_of[:count],
            ranges_m=np.asarray(one.ranges_m)[:count],
        ),
    )
    assert not named(check_publishers(RecordingEvidence(few)))


def test_a_format_without_twists_has_sound_poses() -> None:
    recording = healthy()
    none = np.full_like(recording.odometries[0].linear_m_s, np.nan)
    odometry = replace(recording.odometries[0], linear_m_s=none, angular_rad_s=none)
    (values,) = check_published(RecordingEvidence(recording.with_streams(RawOdometry, (odometry,))))
    assert values.verdict == "ok"


def test_odometry_that_is_only_a_transform_is_compared_with_the_scans() -> None:
    recording = healthy().with_streams(RawOdometry, ()).with_streams(RawTicks, ())
    edge = next(one for one in recording.transforms if not one.is_static)

    wheels = gather_inputs(recording, None).wheels
    assert wheels is not None
    assert wheels.topic == f"{edge.topic} {edge.name}"
    assert gather_inputs(replace(recording, transforms=()), None).wheels is None
