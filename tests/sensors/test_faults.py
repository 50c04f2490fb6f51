"""Faults: what each does to a recording and, as important, what it leaves alone."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from recording_data import leaves

from slamsim.cameras.frames import CameraClaim
from slamsim.cameras.survey import CameraSurvey
from slamsim.check.registry import CHECKER_ERROR, registry
from slamsim.config.bundled import bundled_names
from slamsim.core.geometry import xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import EncoderStream
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.models.differential_drive import wheel_odometry
from slamsim.recording import (
    RawImu,
    RawJoints,
    RawOdometry,
    RawScans,
    RawTicks,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.recording.edits.base import CannotEdit
from slamsim.recording.edits.messages import with_sequence_numbers
from slamsim.sensors.faults.registry import bundled_faults, injected, kinds, load_fault

NAMES = bundled_names("configs/faults")
BEAMS, PERIOD_NS = 181, 100_000_000
STEP_RAD = np.radians(1.0)
URDF = """<robot name="r"><link name="base_link"/><link name="laser_link"/>
<link name="camera_link"><inertial><mass value="0.1"/>
<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
<link name="caster_front_link"/>
<joint name="a" type="fixed"><origin xyz="0.1 0 0.2" rpy="0 0 0"/>
<parent link="base_link"/><child link="laser_link"/></joint>
<joint name="b" type="fixed"><parent link="base_link"/><child link="camera_link"/></joint>
<joint name="c" type="continuous"><origin xyz="0.1 0 -0.02" rpy="0 0 0"/>
<parent link="base_link"/><child link="caster_front_link"/><axis xyz="0 1 0"/></joint></robot>"""


def wheels(seconds: float = 20.0) -> EncoderStream:
    """A robot that drives a slow curve, now left, now right."""
    stamps = np.arange(0, round(seconds * 1e9), 20_000_000, dtype=np.int64)
    t = stamps * 1e-9
    forward, turned = 0.3 * t, 0.1 * np.sin(t)
    angles = np.column_stack([forward - turned, forward + turned]) / 0.035
    ticks = np.rint(angles * 2578 / (2.0 * np.pi)).astype(np.int64)
    return EncoderStream(stamps, ticks, 2578, 0.035, 0.23)


def example() -> Recording:
    """A small healthy recording with everything in it; scans of random ranges, some without."""
    rng = np.random.default_rng(1)
    stream = wheels()
    stamps, poses = stream.stamps_ns, wheel_odometry(stream).poses
    quats, zero = xyzw_from_yaw(poses[:, 2]), np.zeros(stamps.size)
    positions = np.column_stack([poses[:, :2], zero])
    scan_ns = np.arange(0, int(stamps[-1]), PERIOD_NS, dtype=np.int64)
    ranges = rng.uniform(0.5, 8.0, (scan_ns.size, BEAMS)).astype(np.float32)
    ranges[:, ::17] = np.inf
    layout = ScanLayout(-0.5 * np.pi, 0.5 * np.pi, STEP_RAD, 2e-4, 0.1, 0.1, 10.0)
    imu_ns = np.arange(0, int(stamps[-1]), 7_300_000, dtype=np.int64)
    still = np.tile([0.0, 0.0, 9.80665], (imu_ns.size, 1))

    def fixed(parent: str, child: str, x: float, z: float) -> TransformEdge:
        at, xyz, identity = np.array([0]), np.array([[x, 0.0, z]]), np.array([[0.0, 0.0, 0.0, 1.0]])
        return TransformEdge("/tf_static", parent, child, True, at, at, xyz, identity)

    joints = np.asarray(stream.ticks * (2.0 * np.pi / 2578), dtype=np.float64)
    return Recording(
        "example",
        "memory",
        streams=(
            RawScans(
                "/scan",
                ("laser_link",),
                scan_ns,
                scan_ns + 50_000_000,
                (layout,),
                np.zeros(scan_ns.size, dtype=np.int32),
                ranges,
            ),
            RawImu(
                "/imu",
                ("imu_link",),
                imu_ns,
                imu_ns + 1_000_000,
                rng.normal(0.0, 0.3, still.shape),
                still + rng.normal(0.0, 0.01, still.shape),
            ),
            RawOdometry(
                "/odom",
                ("odom",),
                stamps,
                stamps + 1,
                ("base_footprint",),
                positions,
                quats,
                np.column_stack([np.full(stamps.size, 0.3), zero, zero]),
                np.column_stack([zero, zero, np.gradient(np.unwrap(poses[:, 2]), 0.02)]),
            ),
            RawTicks(
                "/ticks", ("base_footprint",), stamps, stamps + 1, stream.ticks, 2578, 0.035, 0.23
            ),
            RawJoints(
                "/joints", ("",), stamps, stamps + 1, ("l", "r"), joints, np.ones(joints.shape)
            ),
        ),
        transforms=(
            TransformEdge(
                "/tf", "odom", "base_footprint", False, stamps, stamps + 1, positions, quats
            ),
            fixed("base_footprint", "base_link", 0.0, 0.035),
            fixed("base_link", "laser_link", 0.1, 0.2),
            fixed("base_link", "imu_link", 0.0, 0.1),
            fixed("base_link", "camera_link", 0.2, 0.3),
        ),
        cameras=tuple(_images(*each) for each in CAMERAS),
        robot_description=URDF,
        epoch="simulation",
    )


CAMERAS: tuple[tuple[str, Literal["colour", "grey", "depth"]], ...] = (
    ("/cam/left/image_raw", "colour"),
    ("/cam/right/image_raw", "grey"),
    ("/cam/depth/image_raw", "depth"),
)
IMAGES = 90


def _images(topic: str, kind: Literal["colour", "grey", "depth"]) -> CameraSurvey:
    """What is looked at of images of 40 x 30 pixels, all of them decoded."""
    rng = np.random.default_rng(len(topic))
    K = np.array([[40.0, 0.0, 19.5], [0.0, 40.0, 14.5], [0.0, 0.0, 1.0]])
    about = f"topic {topic}", "camera_link", 40, 30, "plumb_bob", np.zeros(5), K
    claim = CameraClaim(*about, readout_s=0.01)
    numbers = np.arange(IMAGES)
    stamps_ns = 200_000_000 * numbers
    return CameraSurvey(
        *(topic, kind, "camera_link", (40, 30), claim, stamps_ns, stamps_ns + 1),
        *(numbers.astype(np.uint32), numbers, rng.uniform(50.0, 150.0, IMAGES)),
        *(rng.uniform(1.0, 3.0, (IMAGES, 3)), np.zeros((IMAGES, 30, 40), np.uint8)),
        damaged=np.zeros(0, np.int64),
        grids_m=rng.uniform(1.0, 3.0, (IMAGES, 30, 40)).astype(np.float32),
        grid_px=1,
        colours=rng.uniform(0.0, 255.0, (IMAGES, 6, 8, 3)),
        read_topic=topic,
        numbers=numbers,
    )


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def differences(one: Recording, other: Recording) -> set[str]:
    """The names of fields that differ, without indices."""
    ours, theirs = dict(leaves(one)), dict(leaves(other))
    found = set(ours) ^ set(theirs)
    for place in set(ours) & set(theirs):
        a, b = ours[place], theirs[place]
        arrays = isinstance(a, np.ndarray), isinstance(b, np.ndarray)
        same = _alike(np.asarray(a), np.asarray(b)) if all(arrays) else not any(arrays) and a == b
        if not same:
            found.add(place)
    return {re.sub(r"\[\d+\]", "", place).lstrip(".") for place in found}


def damaged(name: str, size: float | None = None) -> Recording:
    fault = load_fault(name)
    return injected(example(), [fault if size is None else fault.with_size(size)], seed=3)


STAMPS = {
    "lidar": {"scans.stamps_ns"},
    "imu": {"imus.stamps_ns"},
    "wheels": {f"{s}.stamps_ns" for s in ("odometries", "ticks", "joints", "transforms")},
}


@pytest.mark.parametrize("name", NAMES)
def test_a_bundled_fault_is_complete_and_named_as_its_file(name: str) -> None:
    fault = load_fault(name)

    assert fault.name == name
    assert {fault.expects, *fault.also, *fault.hides} <= registry().faults.keys()
    assert fault.expects not in fault.also
    for size in fault.sizes:
        assert fault.with_size(size).size == pytest.approx(size)
    assert fault.SIZE is None or fault.size is not None


def test_the_faults_cover_every_kind_and_nearly_every_name() -> None:
    faults = bundled_faults()

    assert {fault.kind for fault in faults} == set(kinds())
    assert len({fault.kind for fault in faults}) >= 30
    untried = registry().faults.keys() - {fault.expects for fault in faults}
    # Tried in test_check_timing.py, for it takes robots that back up, in test_check_ranges.py, in
    # test_check_odometry.py, and in tests/independent, for it takes two drives.
    elsewhere = {"odometry_unsigned", "ranges_coarse", "range_noise", "odometry_coarse"}
    elsewhere |= {"does_not_fit"}
    # Tried in test_check_timing.py, for it takes two faults, in test_check_frames.py, for
    # recordings hold names without their slash, and in test_camera_place.py, with made-up images.
    elsewhere |= {"clocks_apart", "frame_slash", "camera_flipped"}
    # Tried in tests/independent, for it takes the frame of another sensor, and in
    # test_check_ranges.py, for no lidar of ours looks along a direction twice.
    elsewhere |= {"laser_frame", "scan_folds"}
    assert untried <= {"urdf_balance", CHECKER_ERROR.name} | elsewhere, (
        "a name that no fault tries cannot be relied on"
    )


THREAD = r"https://github\.com/[\w.-]+/[\w.-]+/(issues|pull)/\d+"
WORK = r"\(\d{4}\)|IR-SIM|MVSim|the project's own"


def test_a_source_is_a_thread_or_a_work_that_can_be_found() -> None:
    for fault in bundled_faults():
        assert re.search(f"{THREAD}|{WORK}", fault.source), fault.name


@pytest.mark.parametrize("name", NAMES)
def test_a_fault_changes_the_recording_and_not_the_one_it_was_given(name: str) -> None:
    recording, before = example(), example()
    fault = load_fault(name)

    changed = injected(recording, [fault], seed=3)

    assert differences(recording, before) == set(), "the recording that was given"
    assert differences(before, changed), "the fault does nothing"
    assert differences(changed, injected(before, [fault], seed=3)) == set(), "not the same twice"


@pytest.mark.parametrize("name", NAMES)
def test_every_message_of_a_numbered_recording_keeps_its_number(name: str) -> None:
    changed = injected(with_sequence_numbers(example()), [load_fault(name)], seed=3)

    kinds = (changed.scans, changed.imus, changed.odometries, changed.ticks, changed.joints)
    streams = [stream for streams in kinds for stream in streams]
    assert len(streams) >= 3
    for stream in streams:
        assert stream.samples is not None
        assert stream.samples.shape == stream.stamps_ns.shape


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("lidar_late", STAMPS["lidar"]),
        ("imu_late", STAMPS["imu"]),
        ("wheels_late", STAMPS["wheels"]),
        ("stamps_late", {"scans.received_ns"}),
        ("mvsim_times_zero", {"scans.layouts.beam_dt_s"}),
        ("laser_yaw", {"transforms.quats_xyzw", "robot_description"}),
        ("laser_forward", {"transforms.positions_m", "robot_description"}),
        ("gyro_scale", {"imus.angular_velocity_rad_s"}),
        ("gravity_units", {"imus.linear_acceleration_m_s2"}),
        ("ticks_wrap", {"ticks.ticks"}),
        ("range_offset", {"scans.ranges_m"}),
        ("scan_layout", {"scans.layouts.angle_max_rad"}),
        ("urdf_inertia", {"robot_description"}),
        ("camera_late", {"cameras.stamps_ns"}),
        ("camera_info_focal", {"cameras.claim.K"}),
        ("camera_readout", {"cameras.claim.readout_s"}),
        ("camera_turned", {"transforms.quats_xyzw", "transforms.positions_m"}),
        ("camera_tilted", {"transforms.quats_xyzw"}),
        ("depth_scale", {"cameras.depths_m", "cameras.grids_m", "cameras.changes.factor"}),
        ("tf_unknown_frame", {"scans.frame_ids"}),
    ],
)
def test_a_fault_changes_nothing_else(name: str, places: set[str]) -> None:
    assert differences(example(), damaged(name)) == places


@pytest.mark.parametrize("offset_s", [-0.05, 0.0005, 1.7e9])
def test_an_offset_moves_every_stamp_by_that_much(offset_s: float) -> None:
    moved = damaged("lidar_late", offset_s).scans[0].stamps_ns - example().scans[0].stamps_ns

    assert_array_equal(moved, round(offset_s * 1e9))


def test_a_drifting_clock_gains_so_many_microseconds_a_second() -> None:
    gained = damaged("lidar_clock_drift", 100.0).scans[0].stamps_ns - example().scans[0].stamps_ns

    elapsed = example().scans[0].stamps_ns * 1e-9
    assert_allclose(gained, elapsed * 100e-6 * 1e9, atol=1.0)


def test_a_clock_that_ticks_with_the_stamps_rounds_nothing() -> None:
    """Scans at 10 Hz have nothing to lose to a clock of 100 Hz but a common part."""
    with pytest.raises(CannotEdit, match="tick with that clock"):
        damaged("lidar_stamps_coarse", 0.01)


def test_the_stamp_of_the_last_beam_is_a_sweep_later() -> None:
    moved = damaged("scan_stamp_end").scans[0].stamps_ns - example().scans[0].stamps_ns

    assert_array_equal(moved, round((BEAMS - 1) * 2e-4 * 1e9))


def test_a_mount_error_says_less_than_the_truth() -> None:
    """The laser is turned by 3 degrees to the left of what its frame says."""
    edge = damaged("laser_yaw", 3.0).transforms[2]

    assert edge.child == "laser_link"
    assert_allclose(np.degrees(yaw_from_xyzw(edge.quats_xyzw)), [-3.0], atol=1e-9)


def test_the_description_says_the_same_as_the_transforms() -> None:
    recording = damaged("laser_forward", 0.05)

    assert_allclose(recording.transforms[2].positions_m, [[0.05, 0.0, 0.2]], atol=1e-12)
    assert 'xyz="0.05 0 0.2"' in (recording.robot_description or "")


def test_mirrored_scans_show_the_left_on_the_right() -> None:
    instantaneous = injected(example(), [load_fault("mvsim_times_zero")], seed=0)

    mirrored = injected(instantaneous, [load_fault("laser_mirrored")], seed=0)

    clean = np.asarray(instantaneous.scans[0].ranges_m)
    assert_array_equal(np.asarray(mirrored.scans[0].ranges_m), clean[:, ::-1])


def test_rays_fixed_to_the_world_turn_against_the_robot() -> None:
    """Beam j of the faulty scan sees what lies in that direction of the odometry's frame."""
    recording, fixed = example(), damaged("laser_world_fixed").scans[0].ranges_m
    scans, odometry = recording.scans[0], recording.odometries[0]
    headings = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
    for scan in (0, 20, 111):
        heading = np.interp(scans.stamps_ns[scan], odometry.stamps_ns, headings)
        shift = round(heading / STEP_RAD)
        for beam in (60, 90, 120):
            assert fixed[scan][beam] == scans.ranges_m[scan][beam - shift]


@pytest.mark.parametrize(("radius", "track"), [(0.05, 0.0), (0.0, 0.1), (-0.3, 0.5)])
def test_a_driver_with_wrong_wheels_publishes_what_its_counters_give(
    radius: float, track: float
) -> None:
    """The odometry under wrong numbers against dead reckoning from the counters with them."""
    faults = [
        load_fault("wheel_radius").with_size(radius),
        load_fault("wheel_track").with_size(track),
    ]

    recording = injected(example(), faults, seed=0)

    ticks = recording.ticks[0]
    assert ticks.wheel_radius_m == pytest.approx(0.035 * (1.0 + radius))
    assert ticks.track_m == pytest.approx(0.23 * (1.0 + track))
    expected = wheel_odometry(
        EncoderStream(ticks.stamps_ns, ticks.ticks, 2578, ticks.wheel_radius_m, ticks.track_m)
    )
    for stream in (recording.odometries[0], recording.transforms[0]):
        assert_allclose(stream.positions_m[:, :2], expected.poses[:, :2], atol=2e-4)
        assert_allclose(yaw_from_xyzw(stream.quats_xyzw), expected.poses[:, 2], atol=1e-9)


@pytest.mark.parametrize("name", ["wheel_reversed", "wheels_swapped"])
def test_wrongly_wired_wheels_give_the_odometry_of_their_counters(name: str) -> None:
    recording = damaged(name)

    ticks, odometry = recording.ticks[0], recording.odometries[0]
    expected = wheel_odometry(EncoderStream(ticks.stamps_ns, ticks.ticks, 2578, 0.035, 0.23))
    assert_allclose(odometry.positions_m[:, :2], expected.poses[:, :2], atol=1e-9)
    assert_allclose(recording.joints[0].positions_rad, ticks.ticks * 2 * np.pi / 2578, atol=1e-9)


def test_an_odometry_that_is_frozen_stays_put_and_does_not_catch_up() -> None:
    clean, frozen = example().odometries[0], damaged("odometry_frozen", 2.0).odometries[0]

    still = np.all(np.diff(frozen.positions_m, axis=0) == 0.0, axis=1)
    assert still.sum() == pytest.approx(2 * 2.0 * 50, abs=3)
    driven = [np.linalg.norm(np.diff(o.positions_m, axis=0), axis=1).sum() for o in (clean, frozen)]
    assert driven[0] - driven[1] == pytest.approx(4.0 * 0.3, rel=0.1)


def test_counters_that_wrap_differ_by_whole_turns_of_the_counter() -> None:
    clean, wrapped = example().ticks[0].ticks, damaged("ticks_wrap", 12).ticks[0].ticks

    assert_array_equal((clean - wrapped) % (1 << 12), 0)
    assert np.abs(wrapped).max() <= 1 << 11


def test_a_unit_on_its_side_feels_gravity_along_y() -> None:
    felt = damaged("imu_sideways").imus[0].linear_acceleration_m_s2.mean(axis=0)

    assert_allclose(felt, [0.0, 9.80665, 0.0], atol=0.01)


def test_lost_messages_lose_their_ranges_too() -> None:
    """What is left of each row belongs together."""
    clean, kept = example().scans[0], damaged("lidar_gaps", 2.0).scans[0]

    assert len(kept) == pytest.approx(len(clean) - 60, abs=3)
    rows = np.searchsorted(clean.stamps_ns, kept.stamps_ns)
    assert_array_equal(np.asarray(kept.ranges_m), np.asarray(clean.ranges_m)[rows])


@pytest.mark.parametrize(
    ("name", "mark"), [("range_zero_no_return", 0.0), ("range_max_no_return", 10.0)]
)
def test_no_return_reads_as_a_number(name: str, mark: float) -> None:
    clean, marked = np.asarray(example().scans[0].ranges_m), damaged(name).scans[0].ranges_m

    assert_array_equal(np.asarray(marked)[np.isinf(clean)], np.float32(mark))
    assert_array_equal(np.asarray(marked)[np.isfinite(clean)], clean[np.isfinite(clean)])


def bare() -> Recording:
    """A recording with nothing in it."""
    return Recording("bare", "memory")


@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_there_cannot_be_damaged(name: str) -> None:
    with pytest.raises(CannotEdit, match="bare"):
        injected(bare(), [load_fault(name)], seed=0)


def test_faults_add_up() -> None:
    both = injected(example(), [load_fault("lidar_late"), load_fault("gyro_sign")], seed=0)

    assert differences(example(), both) == {"scans.stamps_ns", "imus.angular_velocity_rad_s"}


def test_a_fault_without_a_size_has_none_to_change() -> None:
    with pytest.raises(SlamsimError, match="has no size"):
        load_fault("laser_mirrored").with_size(2.0)


def test_a_size_out_of_bounds_is_told() -> None:
    with pytest.raises(SlamsimError, match="angle_deg = 999"):
        load_fault("laser_yaw").with_size(999.0)
    with pytest.raises(SlamsimError, match="bits = inf"):
        load_fault("ticks_wrap").with_size(math.inf)


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(NotFound, match="did you mean the bundled 'laser_yaw'"):
        load_fault("laser_yw")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name: a", "the key 'kind' is missing"),
        ("kind: laser_mirored", "did you mean 'laser_mirrored'"),
        (
            "{name: a, title: b, kind: laser_mirrored, expects: Not a name, source: c}",
            "expects",
        ),
        (
            "{name: a, title: b, kind: gyro_bias, expects: gyro_bias, source: c, bias_rad: 1.0}",
            "unknown key 'bias_rad'; did you mean 'bias_rad_s'",
        ),
        (
            "{name: a, title: b, kind: gyro_bias, expects: gyro_bias, source: c}",
            "the key 'bias_rad_s' is missing",
        ),
        ("[]", "the key 'kind' is missing"),
    ],
)
def test_a_file_that_describes_no_fault_is_refused_with_what_would_be_right(
    tmp_path: Path, text: str, told: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)

    with pytest.raises(InputRefused, match=told):
        load_fault(str(path))
