"""Repairs: each takes back what was done to a recording, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_data import edge, recording, stamps

from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.recording import RawImu, RawOdometry, RawScans, RawTicks, Recording
from slamsim.recording.edits.stamps import clock_of
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.apply import OPERATIONS, apply_repairs, chosen, next_repairs
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.stamps import even_stamps

MADE = recording(20.0)


def _repaired(
    made: Recording, operation: str, subject: str, **parameters: float | str
) -> Recording:
    return apply_repairs(made, [Repair(operation, subject, dict(parameters))])


def _scans(made: Recording, **changes: Any) -> Recording:
    return made.with_streams(RawScans, (replace(made.scans[0], **changes),))


def _ranges(made: Recording) -> FloatArray:
    return np.asarray(made.scans[0].ranges_m, dtype=np.float64)


def _angles(scans: RawScans, scan: int = 0) -> FloatArray:
    layout = scans.layout(scan)
    steps = np.arange(len(scans.ranges_m[scan]))
    return np.asarray(layout.angle_min_rad + steps * layout.angle_step_rad)


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    repairs = [Repair("shift_stamps", "/scan", {"offset_s": 0.1}), Repair("reorder", "/scan")]
    assert chosen(repairs, "all") == tuple(repairs)
    assert chosen(repairs, "reorder") == (repairs[1],)
    with pytest.raises(SlamsimError, match="did you mean 'shift_stamps'"):
        chosen(repairs, "reorder,shift_stamp")
    for name, subject in (("nonsense", "/scan"), ("reorder", "/nowhere")):
        with pytest.raises(SlamsimError):
            apply_repairs(MADE, [Repair(name, subject)])


def test_what_is_evident_is_repaired_first() -> None:
    late = Repair("shift_stamps", "/scan", {"offset_s": 0.1})
    epoch = Repair("shift_stamps", "/imu", {"offset_s": -1.7e9})
    even, receipt = Repair("restamp_evenly", "/scan"), Repair("shift_receipt", "/scan")
    assert next_repairs([late, receipt, even, epoch]) == (even, epoch)
    assert next_repairs([late, receipt]) == (late,)
    assert next_repairs([receipt]) == (receipt,)
    assert next_repairs([]) == ()


def test_of_rivals_the_last_counts_and_a_clock_is_set_once() -> None:
    repairs = [
        Repair("shift_stamps", "/odom", {"offset_s": 5.0}),
        Repair("shift_stamps", "/ticks", {"offset_s": 1.0}),
        Repair("shift_stamps", "/imu", {"offset_s": -1.0}),
    ]
    found = apply_repairs(MADE, repairs)
    second = 1_000_000_000
    together = frozenset({"/odom", "/ticks", "/tf odom -> base_link"})
    assert clock_of(MADE, "/odom").subjects == together
    for kind, by_ns in (("odometries", second), ("ticks", second), ("imus", -second)):
        (before,), (after,) = getattr(MADE, kind), getattr(found, kind)
        np.testing.assert_array_equal(after.stamps_ns - before.stamps_ns, by_ns)
    np.testing.assert_array_equal(
        found.transforms[2].stamps_ns - MADE.transforms[2].stamps_ns, second
    )
    np.testing.assert_array_equal(found.transforms[0].stamps_ns, MADE.transforms[0].stamps_ns)


@given(ppm=st.floats(-5000.0, 5000.0))
def test_a_drift_is_taken_back(ppm: float) -> None:
    right = MADE.scans[0].stamps_ns
    origin = int(right[0])
    fast = right + np.rint((right - origin) * ppm * 1e-6).astype(np.int64)
    made = _scans(MADE, stamps_ns=fast)
    found = _repaired(made, "rescale_stamps", "/scan", drift_ppm=ppm, origin_ns=str(origin))
    assert np.abs(found.scans[0].stamps_ns - right).max() < 20


def test_stamps_since_1970_keep_their_nanoseconds() -> None:
    """Against integers without bound: a float64 of such a stamp is a multiple of 256 ns."""
    origin_ns, ppm = 1_700_000_000_123_456_789, 500
    right = MADE.scans[0].stamps_ns + origin_ns
    fast = [origin_ns + (int(ns) - origin_ns) * (1_000_000 + ppm) // 1_000_000 for ns in right]
    made = _scans(MADE, stamps_ns=np.array(fast, dtype=np.int64))
    found = _repaired(
        made, "rescale_stamps", "/scan", drift_ppm=float(ppm), origin_ns=str(origin_ns)
    )
    assert np.abs(found.scans[0].stamps_ns - right).max() <= 1


@pytest.mark.parametrize(
    "corrupt",
    [
        lambda t, rng: t + rng.normal(0.0, 5e6, t.size).astype(np.int64),
        lambda t, rng: np.where(rng.random(t.size) < 0.03, t - 150_000_000, t),
        lambda t, rng: t // 15_625_000 * 15_625_000,
        lambda t, rng: t // 1_000_000_000 * 1_000_000_000,
        lambda t, rng: np.repeat(t[::2], 2),
    ],
)
def test_stamps_are_put_back_on_their_beat(corrupt: Any) -> None:
    """Up to a common offset, and though some messages are missing."""
    rng = np.random.default_rng(3)
    right = stamps(10.0, 120.0)
    right = right[(np.arange(right.size) < 500) | (np.arange(right.size) >= 540)]
    found = even_stamps(corrupt(right, rng))
    off_s = (found - right) * 1e-9
    typical = np.abs(off_s - np.median(off_s))
    assert np.median(typical) < 0.003
    away = (np.arange(right.size) < 430) | (np.arange(right.size) > 570)
    assert typical[away].max() < 0.02
    assert (np.diff(found) >= 0).all()


def test_times_of_receipt_that_copy_the_stamps_go_along_and_no_others() -> None:
    copied = _scans(MADE, received_ns=MADE.scans[0].stamps_ns)
    found = _repaired(copied, "shift_stamps", "/scan", offset_s=0.5).scans[0]
    np.testing.assert_array_equal(found.received_ns, found.stamps_ns)
    measured = _repaired(MADE, "shift_stamps", "/scan", offset_s=0.5).scans[0]
    np.testing.assert_array_equal(measured.received_ns, MADE.scans[0].received_ns)


def test_reordering_sorts_messages_with_all_they_carry() -> None:
    shuffle = np.random.default_rng(1).permutation(len(MADE.scans[0]))
    scans = MADE.scans[0]
    made = _scans(MADE, stamps_ns=scans.stamps_ns[shuffle], ranges_m=_ranges(MADE)[shuffle])
    found = _repaired(made, "reorder", "/scan").scans[0]
    np.testing.assert_array_equal(found.stamps_ns, scans.stamps_ns)
    np.testing.assert_array_equal(np.asarray(found.ranges_m), _ranges(MADE))
    assert found.received_ns is not None and (np.diff(found.received_ns) >= 0).all()


@pytest.mark.parametrize(
    ("operation", "parameters", "corrupt"),
    [
        ("scale_ranges", {"factor": 1e-3}, lambda r: r * 1000.0),
        ("add_to_ranges", {"offset_m": -0.2}, lambda r: r + 0.2),
    ],
)
def test_ranges_are_put_back(operation: str, parameters: dict[str, float], corrupt: Any) -> None:
    made = _scans(MADE, ranges_m=corrupt(_ranges(MADE)).astype(np.float32))
    found = _repaired(made, operation, "/scan", **parameters)
    np.testing.assert_allclose(_ranges(found), _ranges(MADE), rtol=1e-5)
    assert found.scans[0].layouts == MADE.scans[0].layouts


def test_codes_for_nothing_become_infinite() -> None:
    ranges_m = _ranges(MADE).astype(np.float32)
    ranges_m[:, 3], ranges_m[:, 5], ranges_m[0, 5] = 0.0, 29.5, 29.1
    made = _scans(MADE, ranges_m=ranges_m)
    made = _repaired(made, "zero_to_inf", "/scan")
    made = _repaired(made, "value_to_inf", "/scan", value_m=29.5, from_m=29.0)
    found = _ranges(_repaired(made, "drop_beams", "/scan", first=10.0, last=12.0))
    assert np.isinf(found[:, [3, 5]]).all() and np.isnan(found[:, 10:13]).all()
    np.testing.assert_array_equal(found[:, 20:], ranges_m[:, 20:])


def test_directions_of_beams_are_put_back() -> None:
    right = _angles(MADE.scans[0])
    layout = MADE.scans[0].layouts[0]
    middle = 0.5 * (right[0] + right[-1])
    wide = replace(
        layout, angle_min_rad=middle + (right[0] - middle) * 1.02, angle_step_rad=0.05 * 1.02
    )
    mirrored = replace(layout, angle_min_rad=-right[0], angle_step_rad=-0.05)
    degrees = replace(layout, angle_step_rad=float(np.degrees(0.05)))
    for faulty, operation, parameters in (
        (wide, "scale_angles", {"factor": 1.0 / 1.02}),
        (mirrored, "negate_angles", {}),
        (degrees, "angles_to_radians", {}),
    ):
        found = _repaired(_scans(MADE, layouts=(faulty,)), operation, "/scan", **parameters)
        np.testing.assert_allclose(_angles(found.scans[0]), right, atol=1e-9)
        assert found.scans[0].layouts[0].angle_max_rad == pytest.approx(right[-1])


def test_beams_that_fire_the_other_way_keep_their_directions_and_swap_their_times() -> None:
    """Contract: the reading of each direction stays; the last direction now fires first."""
    found = _repaired(MADE, "scale_beam_times", "/scan", factor=-1.0).scans[0]
    np.testing.assert_allclose(_angles(found)[::-1], _angles(MADE.scans[0]), atol=1e-9)
    np.testing.assert_array_equal(np.asarray(found.ranges_m)[:, ::-1], _ranges(MADE))
    assert found.layouts[0].beam_dt_s == MADE.scans[0].layouts[0].beam_dt_s
    timed = _repaired(MADE, "set_sweep", "/scan", sweep_s=0.059).scans[0]
    assert timed.layouts[0].beam_dt_s == pytest.approx(0.001)


def test_times_that_are_wrongly_negative_keep_their_stamp() -> None:
    """The beams were turned round as well, and the first one of them had the stamp of the last."""
    layout = MADE.scans[0].layouts[0]
    before = replace(layout, beam_dt_s=-layout.beam_dt_s)
    made = _scans(MADE, layouts=(before,))
    found = _repaired(made, "scale_beam_times", "/scan", factor=-1.0).scans[0]
    assert found.layouts == (layout,)
    np.testing.assert_array_equal(found.ranges_m, MADE.scans[0].ranges_m)


@pytest.mark.parametrize("heading_from", ["/imu", "/odom", "/ticks"])
def test_rays_fixed_to_the_world_are_turned_with_the_robot(heading_from: str) -> None:
    ticks = replace(MADE.ticks[0], track_m=0.07854)  # turns at 0.2 rad/s, as the others say
    made = MADE.with_streams(RawTicks, (ticks,))
    found = _repaired(made, "turn_with_robot", "/scan", heading_from=heading_from).scans[0]
    since_s = (found.stamps_ns - found.stamps_ns[0]) * 1e-9
    for i in (0, 50, 199):
        beams = np.arange(60)
        turned = 0.2 * (since_s[i] + 1e-3 * beams)
        np.testing.assert_allclose(_angles(found, i), _angles(MADE.scans[0]) - turned, atol=0.01)


def test_imu_numbers_are_put_back() -> None:
    imu = MADE.imus[0]
    faulty = replace(
        imu,
        angular_velocity_rad_s=np.degrees(imu.angular_velocity_rad_s) + np.array([0.0, 0.0, 3.0]),
        linear_acceleration_m_s2=imu.linear_acceleration_m_s2 / 9.80665,
    )
    made = MADE.with_streams(RawImu, (faulty,))
    made = _repaired(made, "subtract_gyro_bias", "/imu", bias_rad_s=3.0)
    made = _repaired(made, "scale_gyro", "/imu", factor=float(np.pi / 180.0))
    made = _repaired(made, "scale_acceleration", "/imu", factor=9.80665)
    np.testing.assert_allclose(
        made.imus[0].angular_velocity_rad_s, imu.angular_velocity_rad_s, atol=1e-12
    )
    np.testing.assert_allclose(
        made.imus[0].linear_acceleration_m_s2, imu.linear_acceleration_m_s2, rtol=1e-9
    )


@pytest.mark.parametrize("up", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -0.6, 0.8)])
def test_a_unit_is_turned_upright(up: tuple[float, float, float]) -> None:
    found = _repaired(MADE, "rotate_imu", "/imu", up_x=up[0], up_y=up[1], up_z=up[2]).imus[0]
    before = MADE.imus[0].linear_acceleration_m_s2
    after = found.linear_acceleration_m_s2
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
    tilted = replace(MADE.imus[0], linear_acceleration_m_s2=np.tile(up, (len(before), 1)))
    turned = _repaired(
        MADE.with_streams(RawImu, (tilted,)),
        "rotate_imu",
        "/imu",
        up_x=up[0],
        up_y=up[1],
        up_z=up[2],
    )
    np.testing.assert_allclose(
        turned.imus[0].linear_acceleration_m_s2[0], [0.0, 0.0, 1.0], atol=1e-12
    )


def test_wheels_are_put_back_and_their_odometry_with_them() -> None:
    """An odometry that says what the counters say is made anew from the repaired ones."""
    right = _repaired(MADE, "odometry_from_ticks", "/odom")
    ticks = right.ticks[0]
    wirings: list[tuple[str, dict[str, float | str], IntArray]] = [
        ("swap_wheels", {}, ticks.ticks[:, ::-1].copy()),
        ("reverse_wheel", {"wheel": "left"}, ticks.ticks * np.array([-1, 1])),
        ("unwrap_ticks", {"modulus": 4096.0}, (ticks.ticks + 2048) % 4096 - 2048),
    ]
    for operation, parameters, wrong in wirings:
        faulty = right.with_streams(RawTicks, (replace(ticks, ticks=wrong),))
        faulty = _repaired(faulty, "odometry_from_ticks", "/odom")
        found = _repaired(faulty, operation, "/ticks", **parameters)
        np.testing.assert_array_equal(
            np.diff(found.ticks[0].ticks, axis=0), np.diff(ticks.ticks, axis=0)
        )
        np.testing.assert_allclose(
            found.odometries[0].positions_m, right.odometries[0].positions_m, atol=1e-9
        )
        moving = next(e for e in found.transforms if not e.is_static)
        np.testing.assert_allclose(moving.positions_m, right.odometries[0].positions_m, atol=1e-9)


def test_odometry_is_scaled_and_freed_of_jumps() -> None:
    odometry = MADE.odometries[0]
    found = _repaired(MADE, "scale_odometry", "/odom", path_factor=2.0, turn_factor=0.5)
    yaw = np.unwrap(yaw_from_xyzw(found.odometries[0].quats_xyzw))
    assert yaw[-1] == pytest.approx(
        0.5 * np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))[-1], abs=1e-6
    )
    path = np.linalg.norm(np.diff(found.odometries[0].positions_m, axis=0), axis=1).sum()
    assert path == pytest.approx(2.0 * 0.4 * (len(odometry) - 1) / 50.0, rel=1e-3)
    jumped = odometry.positions_m.copy()
    jumped[400:] += [3.0, 1.0, 0.0]
    faulty = MADE.with_streams(RawOdometry, (replace(odometry, positions_m=jumped),))
    smooth = _repaired(faulty, "remove_odometry_jumps", "/odom", longest_m=1.0).odometries[0]
    np.testing.assert_allclose(smooth.positions_m, odometry.positions_m, atol=1e-3)


def test_frames_and_mountings() -> None:
    found = _repaired(
        MADE, "set_mounting", "laser", parent="base_link", x_m=0.3, y_m=-0.1, yaw_rad=0.5
    )
    T_base_laser = FrameGraph(found.transforms).between("base_link", "laser")
    assert T_base_laser is not None
    np.testing.assert_allclose(T_base_laser[:2, 3], [0.3, -0.1])
    assert np.arctan2(T_base_laser[1, 0], T_base_laser[0, 0]) == pytest.approx(0.5)
    over = {"roll_rad": float(np.pi), "pitch_rad": 0.0, "yaw_rad": 0.0}
    rolled = _repaired(found, "turn_frame", "laser", **over)
    T_base_laser = FrameGraph(rolled.transforms).between("base_link", "laser")
    assert T_base_laser is not None and T_base_laser[2, 2] == pytest.approx(-1.0)
    without = _repaired(MADE, "drop_transform", "odom -> base_link")
    assert [edge.name for edge in without.transforms] == [
        "base_link -> laser",
        "base_link -> imu_link",
    ]
    again = _repaired(without, "add_odometry_transform", "/odom")
    np.testing.assert_array_equal(again.transforms[-1].positions_m, MADE.odometries[0].positions_m)
    assert _repaired(MADE, "rename_frame", "/scan", frame="lidar").scans[0].frame_ids == ("lidar",)
    restless = edge("base_link", "laser", stamps(1.0, 5.0), x_m=0.1)
    restless.positions_m[3] = 9.0
    frozen = _repaired(
        replace(MADE, transforms=(restless,)), "freeze_static_transform", "base_link -> laser"
    )
    assert frozen.transforms[0].positions_m.tolist() == [[0.1, 0.0, 0.0]]


def test_every_operation_says_what_it_does() -> None:
    assert all(operation.__doc__ for operation in OPERATIONS.values())
