"""Whose clock is off, and what the joint fit says of wheels, gyroscope and mounting in words."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration_example import T_BASE_LASER, Robot, without
from check_example import motion_findings
from hypothesis import given, settings
from hypothesis import strategies as st
from two_lidars import mounted, scans_of

from slamsim.check.calibration.explanation import explain
from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.diagnosis import explained
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement, decide
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.integrated import integrated_wheels
from slamsim.check.questions.clocks.offsets import check_timing
from slamsim.check.questions.clocks.pairs import LIMITS_S, most_likely
from slamsim.check.questions.inertial.gyroscope import check_gyro
from slamsim.check.questions.laser.mounting import GROUP, check_mounting
from slamsim.check.questions.wheels.direction import check_reversing
from slamsim.check.questions.wheels.sizes import check_wheels
from slamsim.check.questions.wheels.slip import check_slip
from slamsim.check.wording import JSON_VERDICTS, finding_json
from slamsim.core.types import FloatArray
from slamsim.recording import RawImu, RawOdometry, RawScans, RawTicks, Recording


def everything(calibration: Calibration) -> list[Finding]:
    return [
        *check_timing(calibration),
        *check_slip(calibration),
        *check_wheels(calibration, explain(calibration)),
        *check_gyro(calibration, explain(calibration)),
        *check_mounting(calibration, explain(calibration)),
    ]


def named(inputs: Inputs) -> set[str]:
    calibration = calibrate_inputs(inputs)
    assert calibration is not None
    return {one.fault for one in everything(calibration) if one.fault is not None}


FAULTS = [
    (Robot(), set()),
    (Robot(lidar_late_s=0.003), {"time_offset_lidar"}),
    (Robot(lidar_late_s=-0.3), {"time_offset_lidar"}),
    (Robot(gyro_late_s=0.01), {"time_offset_imu"}),
    (Robot(wheels_late_s=0.05), {"time_offset_wheels"}),
    (Robot(lidar_late_s=0.04), {"scan_stamp_end"}),
    (Robot(lidar_late_s=0.02), {"scan_stamp_middle"}),
    (Robot(lidar_late_s=1.7e9), {"epoch_mismatch"}),
    (Robot(lidar_drift=5e-4), {"clock_drift"}),
    (Robot(lidar_drift=-2e-3, lidar_late_s=0.03), {"clock_drift"}),  # they agree on the way
    (Robot(lidar_drift=-2e-3, lidar_late_s=-0.3), {"clock_drift", "time_offset_lidar"}),
    (Robot(lidar_late_s=0.1, wheels_late_s=-0.2), {"clocks_apart"}),
    (Robot(gyro_late_s=0.003, wheels_late_s=0.01), {"clocks_apart"}),
    (Robot(lidar_late_s=0.04, wheels_late_s=-0.2), {"scan_stamp_end", "time_offset_wheels"}),
    (Robot(lidar_late_s=0.02, gyro_late_s=0.1), {"scan_stamp_middle", "time_offset_imu"}),
    (Robot(gyro_scale=1.05), {"gyro_scale"}),
    (Robot(gyro_scale=10.0, gyro_bias=0.02), {"gyro_scale"}),  # 0.115 deg/s of true turns
    (Robot(gyro_scale=0.1, gyro_bias=0.005), {"gyro_scale", "gyro_bias"}),
    (Robot(gyro_scale=-1.0), {"gyro_sign"}),
    (Robot(gyro_scale=57.29578, noise=0.0), {"gyro_degrees"}),
    (Robot(gyro_bias=0.05), {"gyro_bias"}),
    (Robot(radius=1.05), {"wheel_radius"}),
    (Robot(track=0.9), {"wheel_track"}),
    (Robot(T_base_laser=T_BASE_LASER + np.array([0.0, 0.0, 0.05])), {"laser_yaw"}),
    (Robot(T_base_laser=T_BASE_LASER + np.array([0.0, 0.05, 0.0])), {"laser_position"}),
    (Robot(T_base_laser=T_BASE_LASER + np.array([0.0, 0.0, math.pi])), {"laser_yaw"}),
]


@pytest.mark.parametrize(
    ("mast_off_m", "expected"), [(0.0, "laser_frame"), (0.05, "laser_position")]
)
def test_scans_that_name_the_frame_of_another_sensor(mast_off_m: float, expected: str) -> None:
    """Told as a laser that sits elsewhere, the frame was moved, and the inertial unit with it."""
    sits = T_BASE_LASER + np.array([0.1, 0.05, 0.0])
    inputs = replace(Robot(T_base_laser=sits).inputs(), base_frame="base_footprint")
    calibration = calibrate_inputs(inputs)
    assert calibration is not None and inputs.gyro is not None
    name, no_readings = inputs.laser_frame, (np.zeros(0, dtype=np.int64), None)
    unit = RawImu("/imu", (name,), *no_readings, np.zeros((0, 3)), np.zeros((0, 3)))
    placed = (T_BASE_LASER, name), (sits + mast_off_m, "lidar_mast"), (np.zeros(3), "imu_link")
    frames = tuple(mounted(pose, frame) for pose, frame in placed)
    of = Recording("named", "mcap", streams=(scans_of(sits, "any"), unit), transforms=frames)
    (scans,) = of.scans
    of = of.with_streams(RawScans, (replace(scans, topic="/scan", frame_ids=(name,)),))
    evidence = RecordingEvidence(of)
    evidence.once("calibration", lambda: calibration)
    evidence.once("explanation", lambda: explain(calibration))
    found = [one for one in explained(list(GROUP.ask(evidence))) if one.fault]
    assert {one.fault for one in found} == {expected}
    renamed = [repair.parameters.get("frame") for one in found for repair in one.repairs]
    assert renamed == (["lidar_mast"] if expected == "laser_frame" else [])


@pytest.mark.parametrize(
    ("robot", "check"),
    [
        (Robot(wheels_late_s=0.0024), "time.offset.wheels"),
        (Robot(lidar_late_s=0.003), "time.offset.lidar"),
        (Robot(T_base_laser=T_BASE_LASER + np.array([0.0, 0.05, 0.0])), "laser.y"),
        (Robot(), "laser.x"),
    ],
)
def test_a_verdict_follows_from_the_numbers_in_the_json(robot: Robot, check: str) -> None:
    calibration = calibrate_inputs(robot.inputs())
    assert calibration is not None
    finding = next(one for one in everything(calibration) if one.check == check)
    told: dict[str, Any] = finding_json(finding)
    size = Measurement(told["value"], told["sigma"], told["unit"], allowed=told["allowed"])
    assert told["allowed"] > 0.0 or check == "time.offset.lidar"
    assert JSON_VERDICTS[decide(size, told["limit"])] == told["verdict"]


@pytest.mark.parametrize("track_m", [0.25, 0.35, 0.65])
def test_unequal_wheels_of_an_odometry_move_no_laser(track_m: float) -> None:
    """Poses do not tell the track, by which unequal wheels drive forward in turns."""
    inputs = Robot().inputs()
    assert inputs.wheels is not None
    path_m, turn_rad = inputs.wheels.totals.T
    larger = 0.08
    believed = np.column_stack(
        [path_m + 0.25 * larger * track_m * turn_rad, turn_rad + larger * path_m / track_m]
    )
    poses = replace(inputs.wheels, totals=believed, track_m=0.0)
    assert named(replace(inputs, wheels=poses)) == {"wheel_radius"}


@pytest.mark.parametrize(("robot", "expected"), FAULTS)
def test_one_fault_has_one_name(robot: Robot, expected: set[str]) -> None:
    assert named(robot.inputs()) == expected


@pytest.mark.parametrize(
    ("scale", "read", "bias_rad_s"),
    [(0.9, 0.008, 0.008), (-1.1, 0.008, 0.008), (math.degrees(1.0), 1.0, math.radians(1.0))],
)
def test_the_bias_is_what_the_unit_reads_at_rest(
    scale: float, read: float, bias_rad_s: float
) -> None:
    calibration = calibrate_inputs(Robot(gyro_scale=scale, gyro_bias=read).inputs())
    assert calibration is not None
    size = next(one for one in everything(calibration) if one.check == "gyro.bias").estimate
    assert size is not None and size.sigma < 0.02 * bias_rad_s
    assert size.value == pytest.approx(bias_rad_s, abs=4.0 * size.sigma)


def test_three_clocks_that_all_differ_are_brought_to_one() -> None:
    """Each pair is told with its offset, and no stream is blamed: any two may be the late ones."""
    robot = Robot(lidar_late_s=0.013, gyro_late_s=0.003, wheels_late_s=-0.02)
    findings = check_timing(robot.calibrated())
    told = {one.check: one for one in findings if one.fault == "clocks_apart"}
    expected_ms = {"lidar_imu": -10.0, "lidar_wheels": -33.0, "imu_wheels": -23.0}
    assert set(told) == {f"time.offset.{pair}" for pair in expected_ms}
    for pair, size_ms in expected_ms.items():
        estimate = told[f"time.offset.{pair}"].estimate
        assert estimate is not None and estimate.value == pytest.approx(size_ms, abs=1.0)
    shifted = [repair for one in findings for repair in one.repairs]
    offsets_s = [float(repair.parameters["offset_s"]) for repair in shifted]
    assert offsets_s == pytest.approx([-0.01, 0.023], abs=0.001)


@pytest.mark.parametrize("stream", ["lidar", "imu", "wheels"])
def test_a_late_stream_is_told_where_the_others_differ_by_what_is_healthy(stream: str) -> None:
    """However surely: robots that turn by jerks seem to have 0.7 ms between lidar and gyroscope."""
    late_s = {"lidar": 0.0, "imu": 0.0, "wheels": 0.0007, stream: 0.05}
    imu_s, wheels_s = (late_s[one] - late_s["lidar"] for one in ("imu", "wheels"))
    between_s = {"gyro": imu_s, "wheel": wheels_s, "gyro_wheel": wheels_s - imu_s}
    wrong = {pair for pair, apart_s in between_s.items() if abs(apart_s) > LIMITS_S[pair]}
    seen = {pair: (apart_s, 1e-5) for pair, apart_s in between_s.items()}
    told = most_likely(seen, wrong, LIMITS_S)
    assert told == {stream: pytest.approx(0.05, abs=0.001)}
    for lacking in seen:
        fewer = {pair: one for pair, one in seen.items() if pair != lacking}
        told = most_likely(fewer, wrong & set(fewer), LIMITS_S)
        assert told == {stream: pytest.approx(0.05, abs=0.001)}


def test_when_clouds_without_order_were_seen_is_told_no_better_than_it_is_known() -> None:
    for late_s, expected in ((0.005, set()), (0.08, {"time_offset_lidar"})):
        inputs = replace(Robot(lidar_late_s=late_s).inputs(), instant_sigma_s=0.01)
        assert {name for name in named(inputs) if name.startswith("time_offset")} == expected
    late = replace(Robot(wheels_late_s=0.01).inputs(), instant_sigma_s=0.01)
    assert "time_offset_wheels" in named(late)


@pytest.mark.parametrize("lacking", ["lidar_gyro", "lidar_wheels", "gyro_wheels"])
def test_two_late_streams_are_not_told_as_one_where_a_pair_cannot_be_compared(lacking: str) -> None:
    """Offsets that contradict each other are no stream's: each is told by itself."""
    calibration = Robot(lidar_late_s=0.1, wheels_late_s=-0.2).calibrated()
    shift = getattr(calibration.alignment, lacking)
    unclear = replace(calibration.alignment, **{lacking: replace(shift, clear=False)})
    findings = check_timing(replace(calibration, alignment=unclear))
    told = [one for one in findings if one.fault]
    assert [one.fault for one in told] == ["clocks_apart", "clocks_apart"]


def rewired(ticks: RawTicks, by: list[list[int]]) -> RawTicks:
    return replace(ticks, ticks=ticks.ticks @ np.array(by))


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        ([[0, 1], [1, 0]], {"wheels_swapped"}),
        ([[-1, 0], [0, 1]], {"wheel_reversed"}),
        ([[1, 0], [0, -1]], {"wheel_reversed"}),
        ([[-1, 0], [0, -1]], {"wheel_reversed"}),
    ],
)
def test_wiring(by: list[list[int]], expected: set[str]) -> None:
    robot = Robot()
    wheels = integrated_wheels(rewired(robot.ticks(), by))
    assert named(replace(robot.inputs(), wheels=wheels)) == expected


def test_mirrored_scans_are_no_fault_of_gyroscope_or_wheels() -> None:
    inputs = Robot().inputs()
    turned = np.array([1.0, -1.0, -1.0])
    steps = replace(inputs.steps, T_first_second=inputs.steps.T_first_second * turned)
    assert named(replace(inputs, steps=steps)) == set()


@pytest.mark.parametrize("factor", [0.9, 1.05, 1.2])
def test_ranges_that_are_too_long_move_no_laser(factor: float) -> None:
    """Scans measure the lever arm of a turn by their own ranges."""
    inputs = Robot().inputs()
    moved = inputs.steps.T_first_second * np.array([factor, factor, 1.0])
    inputs = replace(inputs, steps=replace(inputs.steps, T_first_second=moved))
    calibration = calibrate_inputs(inputs)
    assert calibration is not None
    found = explain(calibration)
    assert found.wrong == {"ranges"}
    assert not [one for one in check_mounting(calibration, found) if one.fault]


def test_scans_that_do_not_turn_leave_the_others_comparable() -> None:
    robot = Robot(wheels_late_s=0.05)
    inputs = robot.inputs()
    moved = inputs.steps.T_first_second.copy()
    moved[:, 2] = 1e-4 * np.random.default_rng(0).standard_normal(len(moved))
    steps = replace(inputs.steps, T_first_second=moved)
    assert named(replace(inputs, steps=steps)) == {"time_offset_wheels"}


def test_readings_that_queue_up_before_they_are_stamped_lose_no_path() -> None:
    """Twenty a second, each stamped when it is published, up to a tenth of a second late."""
    ticks, rng = Robot().ticks(), np.random.default_rng(0)
    every = max(round(0.05e9 / float(np.median(np.diff(ticks.stamps_ns)))), 1)
    stamps_ns, counts = ticks.stamps_ns[::every], ticks.ticks[::every]
    delays_ns = (0.033e9 * np.abs(rng.standard_normal(len(stamps_ns)))).astype(np.int64)
    in_turn_ns = 100_000 * np.arange(len(stamps_ns))
    published_ns = np.maximum.accumulate(stamps_ns + delays_ns - in_turn_ns) + in_turn_ns
    assert (np.diff(published_ns) < 1_000_000).mean() > 0.05
    late = integrated_wheels(replace(ticks, stamps_ns=published_ns, ticks=counts))
    true = integrated_wheels(replace(ticks, stamps_ns=stamps_ns, ticks=counts))
    assert late is not None and true is not None
    np.testing.assert_allclose(late.totals[-1], true.totals[-1], atol=0.1)


def test_readings_that_are_stamped_late_lose_no_path_of_a_robot_that_mostly_stands() -> None:
    ticks = Robot().ticks()
    counts = np.vstack([np.repeat(ticks.ticks[:1], 19 * len(ticks), axis=0), ticks.ticks])
    stamps_ns = np.arange(len(counts), dtype=np.int64) * 20_000_000
    late_ns = stamps_ns.copy()
    late_ns[1:-1:4] = stamps_ns[2::4] - 20_000
    late = integrated_wheels(replace(ticks, stamps_ns=late_ns, ticks=counts))
    true = integrated_wheels(replace(ticks, stamps_ns=stamps_ns, ticks=counts))
    assert late is not None and true is not None
    np.testing.assert_allclose(late.totals[-1], true.totals[-1], atol=0.1)


def test_slip_is_found_and_kept_out_of_the_fit() -> None:
    robot = Robot()
    ticks = robot.ticks()
    gain = np.ones(len(ticks) - 1)
    gain[600:800] = 1.4
    steps = np.diff(ticks.ticks, axis=0) * gain[:, None]
    slipped = np.vstack([ticks.ticks[:1], ticks.ticks[0] + np.cumsum(steps, axis=0)])
    wheels = integrated_wheels(replace(ticks, ticks=slipped.astype(np.int64)))
    assert named(replace(robot.inputs(), wheels=wheels)) == {"wheel_slip"}


def test_nothing_is_said_of_what_cannot_be_told() -> None:
    """No turning: no offset, no track, no gyroscope; all inconclusive, with what would tell."""
    findings = {one.check: one for one in everything(Robot(turning=0.0).calibrated())}
    for check in ("time.offset.lidar_imu", "time.offset.imu_wheels", "gyro.scale"):
        assert findings[check].verdict == "inconclusive"
    assert not any(one.verdict == "fault" for one in findings.values())
    told = {one.check for one in everything(calibrated_without("gyro"))}
    assert "time.offset.lidar_imu" not in told


def calibrated_without(name: str) -> Calibration:
    found = calibrate_inputs(without(Robot().inputs(), name))
    assert found is not None
    return found


def odd_recordings() -> st.SearchStrategy[Recording]:
    numbers = st.sampled_from([0.0, 1.0, -1.0, math.nan, math.inf, 1e300, 1e-300])
    stamps = st.lists(st.sampled_from([0, 1, 10**9, 2 * 10**9, -(10**9), 2**62]), max_size=12)

    def built(
        imu_ns: list[int], ticks_ns: list[int], odometry_ns: list[int], fill: float, step: float
    ) -> Recording:
        def many(count: int, width: int) -> FloatArray:
            with np.errstate(all="ignore"):
                return np.asarray(np.full((count, width), fill) + step * np.arange(count)[:, None])

        at = [np.array(one, dtype=np.int64) for one in (imu_ns, ticks_ns, odometry_ns)]
        counts = np.arange(2 * len(ticks_ns), dtype=np.int64).reshape(-1, 2) * 10**15
        quats = many(len(odometry_ns), 4)
        plain = [many(len(odometry_ns), 3) for _ in range(3)]
        imu = RawImu("/imu", (), at[0], None, many(len(imu_ns), 3), many(len(imu_ns), 3))
        ticks = RawTicks("/ticks", ("b",), at[1], None, counts, 100, fill, step)
        odometry = RawOdometry(
            "/odom", ("o",), at[2], None, ("b",), plain[0], quats, plain[1], plain[2]
        )
        return Recording(
            "odd",
            "memory",
            streams=(
                imu,
                odometry,
                ticks,
            ),
        )

    return st.builds(built, stamps, stamps, stamps, numbers, numbers)


@settings(max_examples=60)
@given(recording=odd_recordings())
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_odd_streams_are_answered_without_a_crash_or_nan(recording: Recording) -> None:
    findings = motion_findings(recording)
    assert findings
    for finding in findings:
        assert "nan" not in finding.words
        if finding.estimate is not None:
            assert math.isfinite(finding.estimate.value)
            assert math.isfinite(finding.estimate.sigma)


@pytest.mark.parametrize("damage", ["nan", "reversed", "constant", "jumping"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_damaged_streams_beside_good_ones(damage: str) -> None:
    robot = Robot(seconds=12.0)
    imu, ticks = robot.imu(), robot.ticks()
    if damage == "nan":
        rates = imu.angular_velocity_rad_s.copy()
        rates[::3] = math.nan
        imu = replace(imu, angular_velocity_rad_s=rates)
    elif damage == "reversed":
        imu = replace(imu, stamps_ns=imu.stamps_ns[::-1].copy())
        ticks = replace(ticks, stamps_ns=ticks.stamps_ns[::-1].copy())
    elif damage == "constant":
        ticks = replace(ticks, ticks=np.zeros_like(ticks.ticks))
        imu = replace(imu, angular_velocity_rad_s=np.zeros_like(imu.angular_velocity_rad_s))
    else:
        counts = ticks.ticks.copy()
        counts[300:] += 10**9
        ticks = replace(ticks, ticks=counts)
    recording = Recording(
        "damaged",
        "memory",
        streams=(
            imu,
            ticks,
        ),
    )
    findings = motion_findings(recording)
    assert findings
    for finding in findings:
        assert "nan" not in finding.words


class ToAndFro(Robot):
    """Backward now and then."""

    def rates(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 0.2 + 0.4 * np.sin(0.4 * t), super().rates(t)[1]


@pytest.mark.parametrize("signed", [True, False])
def test_wheels_that_do_not_know_backward_are_told_from_slip(signed: bool) -> None:
    robot = ToAndFro()
    inputs = robot.inputs()
    assert inputs.wheels is not None
    path = np.diff(inputs.wheels.totals[:, 0])
    totals = inputs.wheels.totals.copy()
    totals[1:, 0] = totals[0, 0] + np.cumsum(path if signed else np.abs(path))
    poses = replace(inputs.wheels, totals=totals, track_m=0.0)
    calibration = calibrate_inputs(replace(inputs, wheels=poses))
    assert calibration is not None
    told = {
        one.check: one
        for one in explained([*check_slip(calibration), *check_reversing(calibration)])
    }
    assert told["odometry.direction"].verdict == ("ok" if signed else "fault")
    assert told["wheels.slip"].verdict != "fault"
    assert {one.fault for one in told.values()} - {None} <= {"odometry_unsigned"}


def test_a_robot_that_never_backs_up_tells_nothing_of_the_sign() -> None:
    (finding,) = check_reversing(Robot().calibrated())
    assert finding.verdict == "inconclusive"
    assert "backward" in finding.words


def test_turns_that_repeat_are_told_to_be_alike_at_several_offsets() -> None:
    found = {one.check: one for one in check_timing(Robot(seed=412, lidar_late_s=3.0).calibrated())}
    pair = found["time.offset.lidar_imu"]
    assert pair.verdict == "inconclusive"
    assert "nearly as alike at other offsets as at 3 s (correlation 0.999)" in pair.words
