"""Edits of recordings: each with its inverse, and each repairable fault with its repair."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_data import leaves
from test_faults import CAMERAS, differences, example

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.recording import RawOdometry, RawTicks, Recording
from slamsim.recording.edits import base, beams, frames, imu, messages, odometry, ranges, wheels
from slamsim.recording.edits import stamps as clocks
from slamsim.recording.edits.base import CannotEdit, Edit, Edits
from slamsim.recording.edits.messages import select, with_sequence_numbers
from slamsim.recording.repairs.apply import OPERATIONS, apply_repairs
from slamsim.recording.repairs.base import Repair
from slamsim.sensors import faults
from slamsim.sensors.faults.registry import injected, kinds, load_fault

MADE = example()
SECOND_NS = 1_000_000_000
ATOL = 1e-9
"""Of float64; ranges are float32 and lose 1e-7 of themselves by each operation."""

TARGETS = st.sampled_from(
    [base.SCANS, base.IMUS, base.WHEELS, base.STAMPED.on("/scan", "/tf odom -> base_footprint")]
)
SCANS, IMUS = st.just(base.SCANS), st.just(base.IMUS)
FACTORS = st.floats(0.01, 100.0)
SIGNED = st.one_of(FACTORS, FACTORS.map(lambda factor: -factor))
LENGTHS = st.floats(-5.0, 5.0)
SIGNS = st.sampled_from([(1, 1), (-1, 1), (1, -1), (-1, -1)])


@st.composite
def rotations(draw: st.DrawFn) -> FloatArray:
    return matrix_from_rpy(*(draw(st.floats(-3.0, 3.0)) for _ in range(3)))


@st.composite
def transforms(draw: st.DrawFn) -> FloatArray:
    return se3_from_parts(draw(rotations()), np.array([draw(LENGTHS) for _ in range(3)]))


QUANTITIES = st.sampled_from(["angular_velocity_rad_s", "linear_acceleration_m_s2"])
SCALED_WHEELS = st.builds(wheels.ScaleWheelNumbers, st.just(base.TICKS), FACTORS, FACTORS)
SCALED_RATES = st.builds(imu.ScaleReadings, IMUS, QUANTITIES, SIGNED, FACTORS)
OFFSET_RATES = st.builds(imu.OffsetReadings, IMUS, QUANTITIES, st.tuples(LENGTHS, LENGTHS, LENGTHS))
SHIFTED = st.builds(
    clocks.ShiftStamps, TARGETS, st.integers(-(10**18), 10**18), receipt_follows=st.booleans()
)
INVERTIBLE: dict[type[Edit], st.SearchStrategy[Any]] = {
    clocks.ShiftStamps: SHIFTED,
    clocks.ScaleStamps: st.builds(
        clocks.ScaleStamps,
        TARGETS,
        st.floats(-0.1, 0.1),
        st.one_of(st.none(), st.integers(-(10**10), 10**10)),
    ),
    clocks.ShiftWithinScan: st.builds(clocks.ShiftWithinScan, SCANS, st.floats(-1.0, 2.0)),
    clocks.ShiftReceipt: st.builds(clocks.ShiftReceipt, TARGETS, st.integers(-(10**15), 10**15)),
    ranges.ScaleRanges: st.builds(ranges.ScaleRanges, SCANS, FACTORS),
    ranges.OffsetRanges: st.builds(
        ranges.OffsetRanges, SCANS, st.floats(-0.4, 0.4), only_returns=st.booleans()
    ),
    ranges.CodeNoReturn: st.builds(ranges.CodeNoReturn, SCANS, st.sampled_from([0.0, 12.5, -1.0])),
    beams.ScaleRangeLimits: st.builds(beams.ScaleRangeLimits, SCANS, FACTORS),
    beams.ScaleAngles: st.builds(
        beams.ScaleAngles, SCANS, st.floats(0.5, 2.0), by_beams=st.booleans()
    ),
    beams.ConvertAngles: st.builds(
        beams.ConvertAngles,
        SCANS,
        st.sampled_from(["degrees", "radians"]),
        ends=st.booleans(),
    ),
    beams.MirrorAngles: st.builds(beams.MirrorAngles, SCANS),
    beams.ExtendAngleMax: st.builds(beams.ExtendAngleMax, SCANS, st.integers(-50, 50)),
    beams.ScaleBeamTimes: st.builds(beams.ScaleBeamTimes, SCANS, SIGNED),
    beams.ReverseBeams: st.builds(beams.ReverseBeams, SCANS),
    imu.ScaleReadings: SCALED_RATES,
    imu.OffsetReadings: OFFSET_RATES,
    imu.RotateReadings: st.builds(imu.RotateReadings, IMUS, rotations()),
    wheels.ScaleWheelNumbers: SCALED_WHEELS,
    wheels.RewireWheels: st.builds(
        wheels.RewireWheels, st.just(base.COUNTS), st.sampled_from([(0, 1), (1, 0)]), SIGNS
    ),
    wheels.WrapTicks: st.builds(
        wheels.WrapTicks, st.just(base.TICKS), st.sampled_from([2**10, 2**16, 1000])
    ),
    odometry.ScaleMotion: st.builds(
        odometry.ScaleMotion, st.just(base.DRIVEN), FACTORS, st.floats(0.5, 2.0)
    ),
    odometry.WithOdometry: st.builds(odometry.WithOdometry, st.just("/ticks"), SCALED_WHEELS),
    frames.MoveMount: st.builds(
        frames.MoveMount,
        st.just(frozenset({"laser_link"})),
        transforms(),
        st.sampled_from(["parent", "sensor"]),
    ),
    frames.InvertTransform: st.builds(
        frames.InvertTransform, st.just("odom -> base_footprint"), st.booleans()
    ),
    frames.RollQuaternions: st.builds(
        frames.RollQuaternions, st.just(base.ROTATIONS), st.integers(-3, 3)
    ),
    frames.TurnFrame: st.builds(frames.TurnFrame, st.just("laser_link"), rotations()),
    frames.AddTransform: st.just(
        frames.AddTransform(replace(MADE.transforms[0], parent="map", child="odom"))
    ),
    messages.AddStream: st.just(messages.AddStream(replace(MADE.imus[0], topic="/imu_2"))),
    Edits: st.lists(st.one_of(SHIFTED, SCALED_RATES, OFFSET_RATES), max_size=4).map(
        lambda edits: Edits(tuple(edits))
    ),
}
"""Edits of every class that has an inverse."""
ROUNDED_NS: dict[type[Edit], int] = {clocks.ScaleStamps: 1}
"""What the inverse leaves of integers; nothing for all others."""


def assert_alike(one: Recording, other: Recording, within_ns: int = 0, atol: float = ATOL) -> None:
    """Integers and texts equal (but for within_ns), floats to rounding; q and -q are one turn."""
    ours, theirs = dict(leaves(one)), dict(leaves(other))
    assert ours.keys() == theirs.keys()
    for place, value in ours.items():
        if "quats_xyzw" in place:
            cosines = np.abs((np.asarray(value) * np.asarray(theirs[place])).sum(axis=1))
            np.testing.assert_allclose(cosines, 1.0, atol=1e-9, err_msg=place)
        elif isinstance(value, np.ndarray) and value.dtype.kind == "i":
            apart = np.abs(value - np.asarray(theirs[place]))
            assert apart.max(initial=0) <= within_ns, place
        elif isinstance(value, np.ndarray | float):
            theirs_here: Any = theirs[place]
            if np.array_equal(value, theirs_here):
                continue  # most are, and to find out takes a tenth of the time
            single = 2e-6 if "ranges_m" in place else 1e-9
            np.testing.assert_allclose(
                theirs_here, value, rtol=single, atol=max(atol, single), err_msg=place
            )
        elif place != ".robot_description":
            assert theirs[place] == value, place


def _subclasses(parent: Any) -> set[type[Edit]]:
    return {parent}.union(*map(_subclasses, parent.__subclasses__()))


def test_every_edit_with_an_inverse_is_tried() -> None:
    own = {one for one in _subclasses(Edit) if one.__module__.startswith("slamsim.")}
    invertible = {one.__name__ for one in own - {Edit} if "inverse" in vars(one)}
    assert invertible == {one.__name__ for one in INVERTIBLE}


@pytest.mark.parametrize("kind", INVERTIBLE, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=10)
def test_an_edit_and_its_inverse_give_the_recording_back(kind: type[Edit], data: Any) -> None:
    """Exactly where integers are changed, to rounding where floats are; counts but for turns of
    the counter before the first message."""
    edit = data.draw(INVERTIBLE[kind])
    before = example()
    changed = edit.apply(before)
    assert differences(before, MADE) == set(), "the recording that was given"
    again = edit.inverse().apply(changed)
    if kind is wheels.WrapTicks:
        ticks = again.ticks[0]
        missing = MADE.ticks[0].ticks[0] - ticks.ticks[0]
        assert not (missing % edit.modulus).any()
        again = again.with_streams(RawTicks, (replace(ticks, ticks=ticks.ticks + missing),))
    if kind is odometry.WithOdometry:
        again = _comparable(again)
    assert_alike(MADE, again, ROUNDED_NS.get(kind, 0))


@pytest.mark.parametrize(
    "edit",
    [
        messages.SelectMessages(base.SCANS, lambda one: np.arange(len(one)) % 2 == 0),
        ranges.BlankBeams(base.SCANS, 3, 5),
        ranges.CodeNoReturn(base.SCANS, None),
        beams.ScaleAngles(base.SCANS, 0.0),
        wheels.RewireWheels(base.COUNTS, signs=(0, 1)),
        odometry.ScaleMotion(base.DRIVEN, 0.0, 1.0),
        Edits((clocks.ShiftStamps(base.SCANS, 1), beams.SetSweep(base.SCANS, 0.0))),
    ],
)
def test_what_is_lost_cannot_be_undone(edit: Edit) -> None:
    assert differences(MADE, edit.apply(MADE))
    with pytest.raises(CannotEdit):
        edit.inverse()


def test_of_several_edits_the_last_is_undone_first() -> None:
    """An offset and a scale, which do not commute."""
    edits = Edits(
        (
            imu.OffsetReadings(base.IMUS, "angular_velocity_rad_s", (1.0, 2.0, 3.0)),
            imu.ScaleReadings(base.IMUS, "angular_velocity_rad_s", 2.0),
        )
    )
    assert_alike(MADE, edits.inverse().apply(edits.apply(MADE)))


def test_selected_messages_keep_all_that_they_carry() -> None:
    """Every array with a row for each message, whichever class of stream has it."""
    yaws_rad = np.arange(len(MADE.odometries[0]), dtype=np.float64)
    made = with_sequence_numbers(
        MADE.changed(RawOdometry, lambda one: replace(one, yaws_rad=yaws_rad))
    )
    tried = set()
    everything: list[Any] = [*made.streams, *made.transforms]
    for messages_of in everything:
        count = messages_of.stamps_ns.size
        rows = np.arange(count)[::-3]
        chosen = select(messages_of, rows)
        for field in fields(messages_of):
            value = getattr(messages_of, field.name)
            if isinstance(value, np.ndarray) and len(value) == count:
                np.testing.assert_array_equal(getattr(chosen, field.name), value[rows])
                tried.add(field.name)
    assert {"stamps_ns", "received_ns", "samples", "layout_of", "ranges_m", "yaws_rad"} <= tried


def test_a_target_that_is_not_there_is_named() -> None:
    with pytest.raises(CannotEdit, match=r"example has no scans on '/nowhere'"):
        ranges.ScaleRanges(base.SCANS.on("/nowhere"), 2.0).apply(MADE)


Pairs = list[tuple[str, float | None, list[Repair]]]
ORIGIN_NS = str(int(MADE.scans[0].stamps_ns[0]))
PAIRS: Pairs = [
    ("lidar_late", 0.03, [Repair("shift_stamps", "/scan", {"offset_s": -0.03})]),
    ("wheels_late", -1.5, [Repair("shift_stamps", "/odom", {"offset_s": 1.5})]),
    (
        "lidar_clock_drift",
        500.0,
        [Repair("rescale_stamps", "/scan", {"drift_ppm": 500.0, "origin_ns": ORIGIN_NS})],
    ),
    (
        "lidar_clock_step",
        0.3,
        [
            Repair(
                "undo_clock_step",
                "/scan",
                {"after_ns": str(10 * SECOND_NS - SECOND_NS // 10), "jump_s": 0.3},
            )
        ],
    ),
    ("stamps_late", 1.0, [Repair("shift_receipt", "/scan", {"offset_s": -1.0})]),
    ("range_inches", None, [Repair("scale_ranges", "/scan", {"factor": 0.0254})]),
    ("range_millimetres_throughout", None, [Repair("scale_ranges", "/scan", {"factor": 1e-3})]),
    ("range_offset", 0.1, [Repair("add_to_ranges", "/scan", {"offset_m": -0.1})]),
    ("range_zero_no_return", None, [Repair("zero_to_inf", "/scan")]),
    ("range_max_no_return", None, [Repair("value_to_inf", "/scan", {"value_m": 10.0})]),
    (
        "range_limits",
        None,
        [Repair("set_range_limits", "/scan", {"range_min_m": 0.1, "range_max_m": 10.0})],
    ),
    ("angle_step_wide", 0.02, [Repair("scale_angles", "/scan", {"factor": 1.0 / 1.02})]),
    ("laser_degrees", None, [Repair("angles_to_radians", "/scan")]),
    ("laser_step_degrees", None, [Repair("angles_to_radians", "/scan")]),
    ("scan_time", None, [Repair("set_scan_time", "/scan", {"scan_time_s": 0.1})]),
    ("scan_layout", None, [Repair("set_angle_max", "/scan")]),
    ("lds_time_tiny", 0.05, [Repair("scale_beam_times", "/scan", {"factor": 20.0})]),
    ("mvsim_times_zero", None, [Repair("set_sweep", "/scan", {"sweep_s": 180 * 2e-4})]),
    (
        "laser_yaw",
        3.0,
        [
            Repair(
                "set_mounting",
                "laser_link",
                {"parent": "base_link", "x_m": 0.1, "y_m": 0.0, "yaw_rad": 0.0},
            )
        ],
    ),
    (
        "laser_upside_down",
        None,
        [Repair("turn_frame", "laser_link", {"roll_rad": np.pi, "pitch_rad": 0.0, "yaw_rad": 0.0})],
    ),
    ("gyro_scale", 1.1, [Repair("scale_gyro", "/imu", {"factor": 1.0 / 1.1})]),
    ("gyro_sign", None, [Repair("scale_gyro", "/imu", {"factor": -1.0})]),
    ("gyro_bias", 0.2, [Repair("subtract_gyro_bias", "/imu", {"bias_rad_s": 0.2})]),
    ("gravity_units", None, [Repair("scale_acceleration", "/imu", {"factor": 9.80665})]),
    (
        "imu_sideways",
        None,
        [Repair("rotate_imu", "/imu", {"up_x": 0.0, "up_y": 1.0, "up_z": 0.0})],
    ),
    ("imu_turned", None, [Repair("turn_imu", "/imu", {"yaw_rad": np.radians(30.0)})]),
    ("imu_orientation_identity", None, [Repair("drop_orientation", "/imu")]),
    (
        "wheel_radius",
        0.1,
        [Repair("scale_wheels", "/ticks", {"radius_factor": 1 / 1.1, "track_factor": 1.0})],
    ),
    (
        "wheel_track",
        0.1,
        [Repair("scale_wheels", "/ticks", {"radius_factor": 1.0, "track_factor": 1 / 1.1})],
    ),
    (
        "wheels_millimetres",
        None,
        [Repair("scale_lengths", "/ticks", {"radius_factor": 1e-3, "track_factor": 1e-3})],
    ),
    (
        "odometry_millimetres",
        None,
        [Repair("scale_odometry", "/odom", {"path_factor": 1e-3, "turn_factor": 1.0})],
    ),
    ("odometry_contradicts_wheels", None, [Repair("odometry_from_ticks", "/odom")]),
    ("wheels_swapped", None, [Repair("swap_wheels", "/ticks")]),
    ("wheel_reversed", None, [Repair("reverse_wheel", "/ticks", {"wheel": "left"})]),
    ("ticks_wrap", None, [Repair("unwrap_ticks", "/ticks", {"modulus": 65536.0})]),
    ("tf_missing_odometry", None, [Repair("add_odometry_transform", "/odom")]),
    ("tf_two_parents", None, [Repair("drop_transform", "odom -> base_link")]),
    ("tf_map_recorded", None, [Repair("drop_transform", "map -> odom")]),
    ("tf_inverted", None, [Repair("invert_transform", "base_footprint -> odom")]),
    ("tf_late", 0.5, [Repair("add_odometry_transform", "/odom")]),
    (
        "odometry_wxyz",
        None,
        [
            Repair("reorder_quaternions", "/odom"),
            Repair("reorder_quaternions", "/tf odom -> base_footprint"),
        ],
    ),
    (
        "odometry_heading_degrees",
        None,
        [Repair("scale_heading", "/odom", {"factor": np.pi / 180.0})],
    ),
    ("camera_higher", 0.1, [Repair("set_height", "camera_link", {"z_m": 0.335})]),
    (
        "camera_tilted",
        3.0,
        [
            Repair(
                "turn_frame",
                "camera_link",
                {"roll_rad": np.radians(3.0), "pitch_rad": 0.0, "yaw_rad": 0.0},
            )
        ],
    ),
    (
        "camera_late",
        0.1,
        [Repair("shift_stamps", "/cam/depth/image_raw", {"offset_s": -0.1})],
    ),
    (
        "camera_info_focal",
        0.1,
        [Repair("scale_focal", topic, {"factor": 1.0 / 1.1}) for topic, _ in CAMERAS],
    ),
    (
        "camera_readout",
        0.03,
        [
            Repair("set_readout", topic, {"readout_s": 0.01})
            for topic, kind in CAMERAS
            if kind != "depth"
        ],
    ),
    (
        "camera_info_size",
        2.0,
        [Repair("set_camera_size", topic) for topic, _ in CAMERAS],
    ),
    (
        "stereo_swapped",
        None,
        [Repair("exchange_images", CAMERAS[0][0], {"other": CAMERAS[1][0]})],
    ),
    ("scan_in_odom", None, [Repair("rename_frame", "/scan", {"frame": "laser_link"})]),
    (
        "odometry_child_unknown",
        None,
        [Repair("rename_child_frame", "/odom", {"frame": "base_footprint"})],
    ),
    ("tf_unknown_frame", None, [Repair("rename_frame", "/scan", {"frame": "laser_link"})]),
]
"""Faults with a size, and the repair with the right one."""
LOSSY = {
    *("reorder", "restamp_evenly", "stamp_by_receipt", "drop_beams", "drop_stray_beams"),
    *("drop_repeated_scans", "drop_broken_readings", "drop_broken_poses", "drop_repeated_images"),
    *("drop_damaged_images", "drop_copies"),
}
"""Repairs that leave out, or approximate, what a fault has destroyed."""
APPROXIMATE = {
    *("negate_angles", "turn_with_robot", "normalise_rotations", "freeze_static_transform"),
    *("remove_odometry_jumps", "twist_from_poses", "scale_depths"),
}
"""Of faults of the sensing, and of what no message says any more; tried in test_repairs.py; and
of pixels, which change as a copy is written (test_camera_faults.py)."""


def test_every_repair_is_tried() -> None:
    tried = {repair.operation for _, _, repairs in PAIRS for repair in repairs}
    assert tried | LOSSY | APPROXIMATE == set(OPERATIONS)


@pytest.mark.parametrize(("name", "size", "repairs"), PAIRS, ids=[pair[0] for pair in PAIRS])
def test_a_fault_and_its_repair_give_the_healthy_recording(
    name: str, size: float | None, repairs: list[Repair]
) -> None:
    fault = load_fault(name)
    faulty = injected(MADE, [fault if size is None else fault.with_size(size)], seed=2)
    assert differences(MADE, faulty)
    assert_alike(MADE, _comparable(apply_repairs(faulty, repairs)), within_ns=1, atol=2e-4)


EXAMPLE = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text().split("### Add a fault")[1]


def test_a_new_fault_is_one_module_and_one_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worked example of CONTRIBUTING.md, put where faults are looked for."""
    module, description = (
        EXAMPLE.split(f"```{language}\n", 1)[1].split("```", 1)[0]
        for language in ("python", "yaml")
    )
    (tmp_path / "warming.py").write_text(module)
    (tmp_path / "gyro_drift.yaml").write_text(description)
    before = set(kinds())
    monkeypatch.setattr(faults, "__path__", [*faults.__path__, str(tmp_path)])

    kinds.cache_clear()
    try:
        assert set(kinds()) - before == {"gyro_drift"}
        fault = load_fault(str(tmp_path / "gyro_drift.yaml"))
    finally:
        kinds.cache_clear()

    drifting = injected(MADE, [fault.with_size(0.01)], seed=0)
    assert differences(MADE, drifting) == {"imus.angular_velocity_rad_s"}
    gained = drifting.imus[0].angular_velocity_rad_s - MADE.imus[0].angular_velocity_rad_s
    since_s = (MADE.imus[0].stamps_ns - MADE.imus[0].stamps_ns[0]) * 1e-9
    np.testing.assert_allclose(gained[:, 2], 0.01 * since_s, atol=1e-12)


def _comparable(fixed: Recording) -> Recording:
    """Without what repairs do not reach: joints, and the speeds that odometry made anew has."""
    linear, angular = MADE.odometries[0].linear_m_s, MADE.odometries[0].angular_rad_s
    streams: list[Any] = [*fixed.scans, *fixed.imus]
    streams += [replace(one, linear_m_s=linear, angular_rad_s=angular) for one in fixed.odometries]
    order = [edge.name for edge in MADE.transforms]
    edges = sorted(fixed.transforms, key=lambda edge: order.index(edge.name))
    return replace(fixed, streams=(*streams, *fixed.ticks, *MADE.joints), transforms=tuple(edges))
