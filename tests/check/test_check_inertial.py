"""How an inertial unit sits, and spells for which it hangs, by its readings and the odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_data import edge, stamps

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.inertial.frozen import check_frozen
from slamsim.check.questions.inertial.gravity import check_inertial
from slamsim.check.questions.inertial.heading import check_heading
from slamsim.check.questions.inertial.readings import check_readings
from slamsim.check.questions.inertial.saturated import check_saturation
from slamsim.core.geometry import matrix_from_rpy, xyzw_from_yaw
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.recording.edits.base import IMUS
from slamsim.recording.edits.imu import Quantity, RotateReadings, ScaleReadings
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.registry import load_fault

SECONDS = 60.0


def motion(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) speed, m/s, and turn rate, rad/s: curves to both sides, with stops."""
    pace = 0.4 - 0.4 * np.cos(0.7 * t)
    return pace, 0.9 * np.sin(0.9 * t) + 0.4 * np.sin(0.31 * t + 1.0)


def robot(
    seed: int = 0, lever_m: tuple[float, float] = (0.1, -0.05), noise: float = 1.0
) -> Recording:
    """Wheels at 20 Hz and a unit at 100 Hz beside the axle, with the accelerations of the drive."""
    rng = np.random.default_rng(seed)
    odometry_ns, imu_ns = stamps(20.0, SECONDS), stamps(100.0, SECONDS)
    fine = np.arange(0.0, SECONDS + 1.0, 1e-3)
    speed, rate = motion(fine)
    yaw = np.cumsum(rate) * 1e-3
    x, y = (np.cumsum(speed * heading(yaw)) * 1e-3 for heading in (np.cos, np.sin))

    def at(stamps_ns: IntArray, values: FloatArray) -> FloatArray:
        return np.asarray(np.interp((stamps_ns - odometry_ns[0]) * 1e-9, fine, values))

    zero = np.zeros(odometry_ns.size)
    odometry = RawOdometry(
        *("/odom", ("odom",), odometry_ns, None, ("base_link",)),
        np.column_stack([at(odometry_ns, x), at(odometry_ns, y), zero]),
        xyzw_from_yaw(at(odometry_ns, yaw)),
        np.column_stack([at(odometry_ns, speed), zero, zero]),
        np.column_stack([zero, zero, at(odometry_ns, rate)]),
    )
    gained, turned = np.gradient(speed, 1e-3), np.gradient(rate, 1e-3)
    ahead = gained - rate**2 * lever_m[0] - turned * lever_m[1]
    left = speed * rate - rate**2 * lever_m[1] + turned * lever_m[0]
    felt = np.column_stack([at(imu_ns, ahead), at(imu_ns, left), np.full(imu_ns.size, 9.81)])
    felt += noise * rng.normal(0.0, 0.05, felt.shape)
    rates = np.column_stack([np.zeros((imu_ns.size, 2)), at(imu_ns, rate)])
    rates += noise * rng.normal(0.0, 0.003, rates.shape)
    imu = RawImu("/imu", ("imu_link",), imu_ns, None, rates, felt)
    sits = edge("base_link", "imu_link", imu_ns[:1])
    return Recording("robot", "memory", (imu, odometry), (sits,))


def turned(yaw_deg: float, made: Recording) -> Recording:
    return RotateReadings(IMUS, matrix_from_rpy(0.0, 0.0, np.radians(yaw_deg))).apply(made)


def heading_of(made: Recording) -> Finding:
    (found,) = check_heading(RecordingEvidence(made))
    return found


@settings(max_examples=40)
@given(
    yaw_deg=st.floats(-180.0, 180.0),
    lever_m=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    seed=st.integers(0, 1000),
)
def test_the_yaw_of_the_unit_is_measured_wherever_it_sits(
    yaw_deg: float, lever_m: tuple[float, float], seed: int
) -> None:
    found = heading_of(turned(yaw_deg, robot(seed, lever_m)))
    assert found.estimate is not None
    off_deg = (found.estimate.value - yaw_deg + 180.0) % 360.0 - 180.0
    assert abs(off_deg) < 5.0 * found.estimate.sigma + 0.3
    assert found.estimate.sigma < 1.0
    if abs(yaw_deg) < 4.0:
        assert found.verdict == "ok"
    elif abs(yaw_deg) > 8.0:
        assert found.fault == "imu_axis"


@pytest.mark.parametrize("name", ["imu_turned", "imu_tilted"])
def test_a_unit_that_sits_otherwise_is_named_and_put_right(name: str) -> None:
    fault = load_fault(name)
    rng = np.random.default_rng(0)

    def told(made: Recording) -> list[Finding]:
        evidence = RecordingEvidence(made)
        asked = [*check_inertial(evidence), *check_heading(evidence)]
        return [one for one in asked if one.verdict == "fault"]

    assert not told(robot())
    (found,) = told(fault.inject(robot(), rng))
    assert found.fault == "imu_axis"
    assert not told(apply_repairs(fault.inject(robot(), rng), found.repairs))


@pytest.mark.parametrize(
    ("quantity", "factor"),
    [
        ("angular_velocity_rad_s", -1.0),
        ("linear_acceleration_m_s2", 1000.0),
        ("linear_acceleration_m_s2", 0.0),
    ],
)
def test_readings_that_do_not_follow_the_odometry_tell_no_yaw(
    quantity: Quantity, factor: float
) -> None:
    """Of a gyroscope that turns the other way, of other units, of none."""
    other = ScaleReadings(IMUS, quantity, factor).apply(robot())
    assert heading_of(other).verdict == "inconclusive"


def test_a_robot_that_never_drives_curves_tells_no_yaw() -> None:
    made = robot()
    straight = replace(
        made.odometries[0], quats_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(made.odometries[0]), 1))
    )
    still = replace(straight, positions_m=np.zeros_like(straight.positions_m))
    assert heading_of(made.with_streams(RawOdometry, (still,))).verdict == "inconclusive"


@pytest.mark.parametrize(
    ("unit", "metres"), [("thousandths of gravity", 9.80665e-3), ("cm/s^2", 1e-2), ("mm/s^2", 1e-3)]
)
def test_accelerations_in_another_unit_are_named_with_it(unit: str, metres: float) -> None:
    made = robot()
    other = ScaleReadings(IMUS, "linear_acceleration_m_s2", 1.0 / metres).apply(made)
    (found,) = [
        one for one in check_inertial(RecordingEvidence(other)) if one.check == "imu.gravity"
    ]
    assert found.fault == "gravity_units" and unit in found.words
    repaired = apply_repairs(other, found.repairs).imus[0].linear_acceleration_m_s2
    np.testing.assert_allclose(repaired, made.imus[0].linear_acceleration_m_s2)


def test_vibration_that_falls_for_longer_than_it_pushes_is_no_lack_of_gravity() -> None:
    """Its median reading is 9.3, its mean 9.8. A unit that does not feel gravity is still told."""
    made = robot()
    imu = made.imus[0]
    shakes = np.random.default_rng(0).exponential(2.0, len(imu)) - 2.0
    for lift, fault in ((0.0, None), (-9.81, "gravity_missing"), (-1.0, "gravity_missing")):
        felt = imu.linear_acceleration_m_s2 + np.outer(shakes + lift, [0.0, 0.0, 1.0])
        shaken = made.with_streams(RawImu, (replace(imu, linear_acceleration_m_s2=felt),))
        (found,) = [
            one for one in check_inertial(RecordingEvidence(shaken)) if one.check == "imu.gravity"
        ]
        assert found.fault == fault


def test_a_unit_in_a_robot_that_circles_all_the_time_is_not_called_tilted() -> None:
    """1 m/s at 1 rad/s: the mean acceleration stands 6 degrees off, and that is the circle."""
    made = robot()
    imu = made.imus[0]
    felt = imu.linear_acceleration_m_s2 * [0.0, 0.0, 1.0] + [0.0, 1.1, 0.0]
    circling = replace(
        imu,
        linear_acceleration_m_s2=felt,
        angular_velocity_rad_s=np.tile([0.0, 0.0, 1.0], (len(felt), 1)),
    )
    findings = check_inertial(RecordingEvidence(made.with_streams(RawImu, (circling,))))
    assert {one.check: one.verdict for one in findings}["imu.axis"] == "ok"


def frozen(made: Recording, begin_s: float, seconds: float) -> Recording:
    imu = made.imus[0]
    source = np.arange(len(imu))
    first, count = round(100 * begin_s), round(100 * seconds)
    source[first : first + count] = first
    return made.with_streams(
        RawImu,
        (
            replace(
                imu,
                angular_velocity_rad_s=imu.angular_velocity_rad_s[source],
                linear_acceleration_m_s2=imu.linear_acceleration_m_s2[source],
            ),
        ),
    )


@given(begin_s=st.floats(0.0, 50.0), seconds=st.floats(0.2, 9.0), noise=st.sampled_from([0.0, 1.0]))
def test_a_unit_that_hangs_is_named_with_its_spell(
    begin_s: float, seconds: float, noise: float
) -> None:
    (found,) = check_frozen(RecordingEvidence(frozen(robot(noise=noise), begin_s, seconds)))
    assert found.estimate is not None
    if seconds > (0.6 if noise else 4.0):  # without noise, from the turns that it misses
        assert found.fault == "imu_stuck"
        assert found.estimate.value == pytest.approx(seconds, abs=0.03)
    elif seconds < 0.4:
        assert found.verdict == "ok"


def test_a_unit_without_noise_may_stand_still_and_drive_straight() -> None:
    """As of a simulator: nothing changes, and nothing should."""
    made = robot(noise=0.0)
    imu, odometry = made.imus[0], made.odometries[0]
    even = np.zeros_like(imu.angular_velocity_rad_s)
    steady = replace(
        imu,
        angular_velocity_rad_s=even,
        linear_acceleration_m_s2=np.tile([0.0, 0.0, 9.81], (len(even), 1)),
    )
    ahead = np.column_stack([0.02 * np.arange(len(odometry)), *np.zeros((2, len(odometry)))])
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (len(odometry), 1))
    straight = replace(odometry, positions_m=ahead, quats_xyzw=quats)
    made = replace(made, streams=(steady, straight))
    (found,) = check_frozen(RecordingEvidence(made))
    assert found.verdict == "ok"


@given(
    range_rad_s=st.floats(0.3, 5.0),
    noise=st.sampled_from([0.0, 1.0]),
    step_rad_s=st.sampled_from([0.0, 1e-3, 0.02]),
)
@settings(max_examples=30)
def test_a_gyroscope_that_is_cut_off_is_told_from_one_that_is_rounded(
    range_rad_s: float, noise: float, step_rad_s: float
) -> None:
    made = robot(noise=noise)
    imu = made.imus[0]
    rates = imu.angular_velocity_rad_s
    if step_rad_s:
        rates = step_rad_s * np.round(rates / step_rad_s)
    cut = np.clip(rates, -range_rad_s, range_rad_s)
    made = made.with_streams(RawImu, (replace(imu, angular_velocity_rad_s=cut),))
    (found,) = check_saturation(RecordingEvidence(made))
    beyond = int((np.abs(rates) > range_rad_s).sum())
    if beyond > 300 and noise and step_rad_s < 0.02:  # else as many are rounded to each step
        assert found.fault == "gyro_saturated"
    if beyond == 0 or not noise:
        assert found.verdict == "ok"


@pytest.mark.parametrize(
    ("turns", "verdict"), [(1.0, "ok"), (1.1, "ok"), (-1.0, "fault"), (0.5, "fault")]
)
def test_an_orientation_turns_as_the_gyroscope_does(turns: float, verdict: str) -> None:
    made = robot()
    imu = made.imus[0]
    seconds = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    yaw = np.concatenate([[0.0], np.cumsum(imu.angular_velocity_rad_s[1:, 2] * np.diff(seconds))])
    imu = replace(imu, orientation_xyzw=xyzw_from_yaw(1.0 + turns * yaw))
    (found,) = [one for one in check_readings(made, imu) if one.check == "imu.orientation"]
    assert found.verdict == verdict
