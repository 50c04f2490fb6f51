"""Odometry by itself and beside others: its twists, and a heading that stays the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_data import odometry_at, recording, stamps
from scan_recording import healthy
from test_check_inertial import robot

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.wheels.heading import check_heading
from slamsim.check.questions.wheels.odometry import check_odometry
from slamsim.check.questions.wheels.rounding import check_rounding
from slamsim.check.questions.wheels.turning import check_turning
from slamsim.check.questions.wheels.twist import check_twist
from slamsim.core.geometry import wrap_angle, xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import FloatArray
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.recording.edits.motion import rotated
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.registry import load_fault
from slamsim.sensors.faults.wheels import OdometryNoTurn, TwistWrong

RNG = np.random.default_rng(0)


def twist_of(made: Recording) -> Finding:
    (found,) = check_twist(RecordingEvidence(made))
    return found


def wrong(**changes: float | bool) -> Recording:
    fault = load_fault("odometry_twist_world").model_copy(update={"of_world": False, **changes})
    assert isinstance(fault, TwistWrong)
    return fault.inject(robot(), RNG)


@settings(max_examples=30)
@given(speed=st.floats(0.1, 100.0), turn=st.floats(-60.0, 60.0))
def test_a_twist_in_other_units_is_measured(speed: float, turn: float) -> None:
    made = wrong(speed_factor=speed, turn_factor=turn)
    found = twist_of(made)
    assert found.estimate is not None
    off = 100.0 * max(abs(speed - 1.0), abs(turn - 1.0))
    assert abs(found.estimate.value) == pytest.approx(off, abs=1.0 + 0.02 * off)
    if off > 22.0:
        assert found.fault == "odometry_twist"
        assert twist_of(apply_repairs(made, found.repairs)).verdict == "ok"
    elif off < 18.0:
        assert found.verdict == "ok"


def test_speeds_along_the_axes_of_the_world_are_named() -> None:
    found = twist_of(wrong(of_world=True))
    assert found.fault == "odometry_twist" and "in the frame of the odometry" in found.words


@pytest.mark.parametrize(("every", "is_fault"), [(10, True), (400, False)])
@pytest.mark.parametrize("axis", ["linear_m_s", "angular_rad_s"])
def test_twists_that_leap_in_single_messages(axis: str, every: int, is_fault: bool) -> None:
    """Right on average, and not for who integrates them."""

    def leaping(odometry: RawOdometry) -> RawOdometry:
        twists = getattr(odometry, axis).copy()
        twists[::every, 0 if axis == "linear_m_s" else 2] -= 0.7
        return replace(odometry, **{axis: twists})

    made = robot().changed(RawOdometry, leaping)
    found = twist_of(made)
    assert (found.fault == "odometry_twist") == is_fault
    if is_fault:
        assert "% of its messages leap" in found.words
        assert twist_of(apply_repairs(made, found.repairs)).verdict == "ok"


@pytest.mark.parametrize("stands", [0.0, 0.3, 0.6])
def test_twists_of_a_robot_that_shakes_and_often_stands(stands: float) -> None:
    """Its yaw rate scatters by 0.3 rad/s within 20 ms where it drives, and not where it stands."""
    at_s = np.arange(0.0, 300.0, 1e-3)
    drives = (at_s % 50.0) >= 50.0 * stands
    shaken = np.random.default_rng(0).standard_normal(at_s.size)
    shaken = 0.3 * np.convolve(shaken, np.full(20, 20**-0.5), "same")
    speed, turn = 0.4 * drives, (0.2 * np.sin(0.5 * at_s) + shaken) * drives
    yaw = np.cumsum(turn) * 1e-3
    x_m, y_m = (np.cumsum(speed * along(yaw)) * 1e-3 for along in (np.cos, np.sin))
    rows = np.arange(0, at_s.size, 50)
    none = np.zeros(rows.size)
    made = replace(
        odometry_at(100 * 10**9 + rows * 1_000_000),
        positions_m=np.column_stack([x_m[rows], y_m[rows], none]),
        quats_xyzw=xyzw_from_yaw(yaw[rows]),
        linear_m_s=np.column_stack([speed[rows], none, none]),
        angular_rad_s=np.column_stack([none, none, turn[rows]]),
    )
    assert twist_of(robot().with_streams(RawOdometry, (made,))).verdict == "ok"


@pytest.mark.parametrize(("too_large", "is_fault"), [(0.0, False), (-0.4, True)])
def test_twists_of_a_jerky_drive_that_come_late(too_large: float, is_fault: bool) -> None:
    """Another turn rate twice a second, 0.3 s late: -32 % in most seconds, and 0 in all."""
    rate_hz, count, rng = 50, 3000, np.random.default_rng(29)
    changes = np.cumsum(rng.exponential(25.0, count).astype(int) + 2)
    turn = rng.choice([0.0, 0.0, 0.5, -0.5, 1.2, -1.2], count)
    turn = followed(turn[np.searchsorted(changes, np.arange(count))], 11.0 / rate_hz)
    late = (1.0 + too_large) * np.concatenate([np.zeros(15), turn[:-15]])
    yaw, none = np.cumsum(turn) / rate_hz, np.zeros(count)
    made = replace(
        odometry_at(100 * 10**9 + np.arange(count) * (10**9 // rate_hz)),
        positions_m=np.zeros((count, 3)),
        quats_xyzw=xyzw_from_yaw(yaw),
        linear_m_s=np.zeros((count, 3)),
        angular_rad_s=np.column_stack([none, none, late]),
    )
    found = twist_of(robot().with_streams(RawOdometry, (made,)))
    assert (found.fault == "odometry_twist") == is_fault


@pytest.mark.parametrize(("sideways", "is_fault"), [(1.0, False), (0.5, True), (-1.0, True)])
def test_twists_of_a_robot_that_mostly_drives_sideways(sideways: float, is_fault: bool) -> None:
    """What it goes ahead is said rightly, which of the usual second is a little."""
    at_s = np.arange(0.0, 120.0, 0.02)
    ahead, left = 0.1 * np.sin(0.3 * at_s), 0.4 * np.sin(0.17 * at_s + 1.0)
    turn, none = 0.2 * np.sin(0.23 * at_s), np.zeros(at_s.size)
    yaw = np.cumsum(turn) * 0.02
    places_m = np.cumsum(rotated(np.column_stack([ahead, left]), yaw), axis=0) * 0.02
    made = replace(
        odometry_at(100 * 10**9 + np.arange(at_s.size) * 20_000_000),
        positions_m=np.column_stack([places_m, none]),
        quats_xyzw=xyzw_from_yaw(yaw),
        linear_m_s=np.column_stack([ahead, sideways * left, none]),
        angular_rad_s=np.column_stack([none, none, turn]),
    )
    found = twist_of(robot().with_streams(RawOdometry, (made,)))
    assert (found.fault == "odometry_twist") == is_fault


def test_twists_of_coarse_counters_leap_as_their_poses_do() -> None:
    """A centimetre of path a step, a hundred messages a second: 0 or 1 m/s of a robot with 0.3."""
    stamps_ns = stamps(100.0, 30.0)
    rolled_m = np.floor(30.0 * np.arange(stamps_ns.size) / 100.0) * 0.01
    made = replace(
        odometry_at(stamps_ns),
        positions_m=np.column_stack([rolled_m, np.zeros((stamps_ns.size, 2))]),
        quats_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (stamps_ns.size, 1)),
        linear_m_s=np.column_stack(
            [np.diff(rolled_m, prepend=0.0) * 100.0, np.zeros((stamps_ns.size, 2))]
        ),
        angular_rad_s=np.zeros((stamps_ns.size, 3)),
    )
    assert twist_of(robot().with_streams(RawOdometry, (made,))).verdict == "ok"


@pytest.mark.parametrize(("factor", "is_fault"), [(1.9, True), (0.6, True), (1.1, False)])
@pytest.mark.parametrize(
    ("axis", "what"), [("linear_m_s", "speed"), ("angular_rad_s", "turn rate")]
)
def test_twists_that_are_wrong_for_a_fifth_of_the_drive(
    axis: str, what: str, factor: float, is_fault: bool
) -> None:
    """By most seconds they are right."""

    def wrong_for_a_while(odometry: RawOdometry) -> RawOdometry:
        share = np.arange(len(odometry)) / len(odometry)
        factors = np.where((share > 0.3) & (share < 0.5), factor, 1.0)
        return replace(odometry, **{axis: getattr(odometry, axis) * factors[:, None]})

    made = robot().changed(RawOdometry, wrong_for_a_while)
    found = twist_of(made)
    assert (found.fault == "odometry_twist") == is_fault
    if is_fault:
        assert f"its {what} is" in found.words.partition("but for 10 s")[2]
        assert found.estimate is not None
        assert found.estimate.value == pytest.approx(100.0 * (factor - 1.0), abs=2.0)
        assert twist_of(apply_repairs(made, found.repairs)).verdict == "ok"


@pytest.mark.parametrize(("turn_rad", "by_m"), [(1.0, 0.0), (2.0, 0.0), (0.0, 2.0)])
def test_poses_that_jump_are_no_twist_that_is_wrong(turn_rad: float, by_m: float) -> None:
    """As of a counter that overflows: all at once the robot is elsewhere, or turned."""

    def jumping(odometry: RawOdometry) -> RawOdometry:
        after = np.arange(len(odometry)) > len(odometry) // 2
        places, corner = odometry.positions_m.copy(), odometry.positions_m[len(odometry) // 2]
        yaw, turned = yaw_from_xyzw(odometry.quats_xyzw), np.where(after, turn_rad, 0.0)
        places[:, :2] = corner[:2] + rotated(places[:, :2] - corner[:2], turned)
        ahead = yaw[len(yaw) // 2]
        places[after, :2] += by_m * np.array([np.cos(ahead), np.sin(ahead)])
        return replace(odometry, positions_m=places, quats_xyzw=xyzw_from_yaw(yaw + turned))

    assert twist_of(robot().changed(RawOdometry, jumping)).verdict == "ok"


@pytest.mark.parametrize(
    ("aside_m", "missing", "is_fault"), [(0.05, 0, True), (0.03, 0, False), (0.0, 20, False)]
)
def test_a_step_to_the_side_is_no_step_of_wheels(
    aside_m: float, missing: int, is_fault: bool
) -> None:
    """A SLAM in the place of an odometry, 1 m/s at 20 Hz: longer steps ahead are usual there. In a
    curve, what a robot turned by while messages were missing leads aside as well."""
    stamps_ns = stamps(20.0, 30.0)
    turned = 1.5 * (stamps_ns - stamps_ns[0]) * 1e-9
    places = np.column_stack([np.sin(turned), 1.0 - np.cos(turned), np.zeros(turned.size)]) / 1.5
    later = np.arange(turned.size) > turned.size // 2
    places[later, :2] += aside_m * np.array([-np.sin(turned[later][0]), np.cos(turned[later][0])])
    kept = ~later | (np.cumsum(later) > missing)
    made = replace(
        odometry_at(stamps_ns[kept]),
        positions_m=places[kept],
        quats_xyzw=xyzw_from_yaw(turned[kept]),
    )
    of = robot().with_streams(RawOdometry, (made,))

    def jump_of(recording: Recording) -> Finding:
        findings = check_odometry(RecordingEvidence(recording))
        return next(one for one in findings if one.check == "odometry.jump")

    found = jump_of(of)
    assert (found.fault == "odometry_jump") == is_fault
    if is_fault:
        smooth = apply_repairs(of, found.repairs)
        assert jump_of(smooth).verdict == "ok"
        ends = [one.odometries[0].positions_m[-1] for one in (of, smooth)]
        assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(aside_m, abs=2e-3)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_messages_without_twists_are_no_fault(value: float) -> None:
    none = np.full_like(robot().odometries[0].linear_m_s, value)
    empty = replace(robot().odometries[0], linear_m_s=none, angular_rad_s=none)
    found = twist_of(robot().with_streams(RawOdometry, (empty,)))
    assert found.verdict == "inconclusive"


def test_a_twist_that_is_filtered_or_the_command_is_none() -> None:
    """Half a second behind, and with noise."""
    odometry = robot().odometries[0]

    def behind(values: FloatArray) -> FloatArray:
        kernel = np.exp(-np.arange(40) / 10.0) / np.exp(-np.arange(40) / 10.0).sum()
        smooth = np.column_stack([np.convolve(one, kernel)[: len(one)] for one in values.T])
        return smooth + RNG.normal(0.0, 0.03, smooth.shape)

    slow = replace(
        odometry,
        linear_m_s=behind(odometry.linear_m_s),
        angular_rad_s=behind(odometry.angular_rad_s),
    )
    assert twist_of(robot().with_streams(RawOdometry, (slow,))).verdict == "ok"


@pytest.mark.parametrize("begin_rad", [0.0, 2.0])
@pytest.mark.parametrize(
    ("factor", "anew", "words"),
    [
        (180.0 / np.pi, False, "it is in degrees"),
        (180.0 / np.pi, True, "it is in degrees"),
        (np.pi / 180.0, False, "taken for degrees"),
        (-1.0, False, "clockwise"),
    ],
)
def test_a_heading_in_another_unit_than_its_path_is_named_and_repaired(
    factor: float, anew: bool, words: str, begin_rad: float
) -> None:
    """anew: it begins anew at 180 degrees before it is taken for radians."""
    odometry = robot().odometries[0]
    yaw = np.unwrap(yaw_from_xyzw(odometry.quats_xyzw)) + begin_rad
    places = odometry.positions_m.copy()
    places[:, :2] = rotated(places[:, :2], np.full(len(places), begin_rad))
    said = factor * (wrap_angle(yaw) if anew else yaw)
    wrong = replace(odometry, positions_m=places, quats_xyzw=xyzw_from_yaw(said))
    made = robot().with_streams(RawOdometry, (wrong,))
    (found,) = check_heading(RecordingEvidence(made))
    assert found.fault == "odometry_heading" and words in found.words
    (fixed,) = apply_repairs(made, found.repairs).odometries
    np.testing.assert_allclose(wrap_angle(yaw_from_xyzw(fixed.quats_xyzw) - yaw), 0.0, atol=1e-6)
    np.testing.assert_array_equal(fixed.positions_m, places)


@pytest.mark.parametrize("factor", [1.0, 1.5, 0.4, 0.0, -0.6])
def test_a_heading_that_turns_about_as_its_path_does_is_fine(factor: float) -> None:
    """More where robots turn on the spot between straight pieces, anyhow where they slide."""
    odometry = robot().odometries[0]
    yaw = factor * np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
    made = robot().with_streams(RawOdometry, (replace(odometry, quats_xyzw=xyzw_from_yaw(yaw)),))
    (found,) = check_heading(RecordingEvidence(made))
    assert found.verdict == "ok"


def test_a_heading_in_degrees_is_told_where_robots_turn_between_straight_pieces() -> None:
    odometry = robot().odometries[0]
    yaw = 1.3 * 180.0 / np.pi * np.unwrap(yaw_from_xyzw(odometry.quats_xyzw))
    made = robot().with_streams(RawOdometry, (replace(odometry, quats_xyzw=xyzw_from_yaw(yaw)),))
    (found,) = check_heading(RecordingEvidence(made))
    assert found.fault == "odometry_heading"


def turning_of(made: Recording) -> Finding:
    (found,) = check_turning(RecordingEvidence(made))
    return found


def no_turn(made: Recording) -> Recording:
    fault = load_fault("odometry_no_turn")
    assert isinstance(fault, OdometryNoTurn)
    return fault.inject(made, RNG)


@pytest.mark.long
@pytest.mark.parametrize("with_imu", [True, False], ids=["gyroscope", "scans alone"])
def test_an_odometry_that_never_turns_is_named_by_any_other(with_imu: bool) -> None:
    made = healthy() if with_imu else healthy().with_streams(RawImu, ())
    assert turning_of(made).verdict == "ok"
    assert turning_of(no_turn(made)).fault == "odometry_no_turn"


def test_an_odometry_whose_stamps_go_backward_is_not_accused() -> None:
    """As in a log of 2003: between messages in the wrong order there is no course of a heading."""
    made = no_turn(robot())
    back = made.odometries[0].stamps_ns.copy()
    back[500] -= 200_000_000
    wrong = made.with_streams(RawOdometry, (replace(made.odometries[0], stamps_ns=back),))
    assert turning_of(wrong).verdict == "inconclusive"


def test_a_heading_that_hangs_for_some_seconds_is_named() -> None:
    made = robot()
    odometry = made.odometries[0]
    source = np.arange(len(odometry))
    source[400:600] = 400
    hung = replace(odometry, quats_xyzw=odometry.quats_xyzw[source])
    found = turning_of(made.with_streams(RawOdometry, (hung,)))
    assert found.fault == "odometry_no_turn" and found.plots[0].spans


def test_an_odometry_that_never_moves_stands_still() -> None:
    made = robot()
    odometry = made.odometries[0]
    still = replace(
        odometry,
        positions_m=np.zeros_like(odometry.positions_m),
        quats_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(odometry), 1)),
    )
    assert turning_of(made.with_streams(RawOdometry, (still,))).fault == "odometry_frozen"


@given(bias=st.floats(-0.5, 0.5))
def test_a_robot_that_drives_straight_on_need_not_turn_with_a_biased_gyroscope(bias: float) -> None:
    made = robot()
    odometry, imu = made.odometries[0], made.imus[0]
    ahead = np.column_stack([0.02 * np.arange(len(odometry)), *np.zeros((2, len(odometry)))])
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (len(odometry), 1))
    straight = replace(odometry, positions_m=ahead, quats_xyzw=quats)
    rates = np.random.default_rng(1).normal([0.0, 0.0, bias], 0.01, (len(imu), 3))
    made = replace(made, streams=(replace(imu, angular_velocity_rad_s=rates), straight))
    assert turning_of(made).verdict == "ok"


def written(place_m: float, turn_rad: float) -> Finding:
    """Of a robot that turns to and fro, its poses rounded to these steps, 0 for none."""
    odometry = odometry_at(stamps(20.0, 60.0))
    since_s = 1e-9 * (odometry.stamps_ns - odometry.stamps_ns[0])
    yaw = 3.0 + 1.3 * np.sin(0.4 * since_s) + 0.7 * np.sin(0.17 * since_s)
    places = np.cumsum(0.02 * np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw]), axis=0)
    places = np.round(places / place_m) * place_m if place_m else places
    yaw = np.round(yaw / turn_rad) * turn_rad if turn_rad else yaw
    made = replace(odometry, positions_m=places, quats_xyzw=xyzw_from_yaw(yaw))
    (found,) = check_rounding(RecordingEvidence(recording().with_streams(RawOdometry, (made,))))
    return found


@pytest.mark.parametrize(
    ("place_m", "turn_rad", "step_mm"),
    [
        (0.0, 0.0, 0.0),
        (0.001, 0.001, 10.0),
        (0.01, 0.0, 10.0),
        (0.01, 0.01, 100.0),
        (0.1, 0.0, 100.0),
        (0.0, np.radians(1.0), 10e3 * np.radians(1.0)),
        (0.0, np.radians(0.1), 10e3 * np.radians(0.1)),
        (0.0, 0.0123, 0.0),  # of counters, not of writing
    ],
)
def test_poses_that_are_written_with_few_digits(
    place_m: float, turn_rad: float, step_mm: float
) -> None:
    found = written(place_m, turn_rad)
    assert found.estimate is not None and found.estimate.value == pytest.approx(step_mm, abs=0.01)
    assert found.fault == ("odometry_coarse" if step_mm > 50.0 else None)


def test_a_robot_that_turns_at_one_rate_is_no_rounded_one() -> None:
    odometry = odometry_at(stamps(10.0, 12.0))  # 0.02 rad from message to message
    made = recording().with_streams(RawOdometry, (odometry,))
    (found,) = check_rounding(RecordingEvidence(made))
    assert found.verdict == "ok"


@pytest.mark.parametrize(
    ("seed", "most_m_s2", "most_rad_s2", "stopped_s"),
    [(0, 0.3, 0.5, 0.0), (10, 0.3, 0.5, 0.0), (0, 1.0, 2.0, 4.0), (1, 1.0, 2.0, 4.0)],
)
def test_a_twist_that_is_the_command_is_none(
    seed: int, most_m_s2: float, most_rad_s2: float, stopped_s: float
) -> None:
    """Of a robot that is slow to do as it is told, or was stopped once."""
    rng, rate_hz = np.random.default_rng(seed), 50
    count = 300 * rate_hz
    speed, turn = np.zeros(count), np.zeros(count)
    begin = 0
    while begin < count:
        end = begin + int(rate_hz * rng.uniform(1.0, 6.0))
        is_straight = rng.random() < 0.4
        speed[begin:end] = rng.choice([0.0, 0.2, 0.4, 0.5])
        turn[begin:end] = 0.0 if is_straight else rng.uniform(-1.0, 1.0)
        begin = end
    moved, turned = followed(speed, most_m_s2 / rate_hz), followed(turn, most_rad_s2 / rate_hz)
    if stopped_s:
        driving = np.flatnonzero(speed[50 * rate_hz : 250 * rate_hz] >= 0.4) + 50 * rate_hz
        first = int(rng.choice(driving))
        for does in (moved, turned):
            does[first : first + int(stopped_s * rate_hz)] = 0.0
    yaw = np.cumsum(turned) / rate_hz
    x_m, y_m = (np.cumsum(moved * along(yaw)) / rate_hz for along in (np.cos, np.sin))
    none = np.zeros(count)
    made = replace(
        odometry_at(100 * 10**9 + np.arange(count) * (10**9 // rate_hz)),
        positions_m=np.column_stack([x_m, y_m, none]),
        quats_xyzw=xyzw_from_yaw(yaw),
        linear_m_s=np.column_stack([speed, none, none]),
        angular_rad_s=np.column_stack([none, none, turn]),
    )
    assert twist_of(robot().with_streams(RawOdometry, (made,))).fault is None


def followed(wanted: FloatArray, most: float) -> FloatArray:
    """(n,) what changes by so much in each step at the most."""
    found, now = np.zeros_like(wanted), 0.0
    for number, one in enumerate(wanted):
        now += float(np.clip(one - now, -most, most))
        found[number] = now
    return found
