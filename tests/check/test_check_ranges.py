"""The checker's look at ranges and at the inertial unit's gravity."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.check.diagnosis import explained
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.inertial.gravity import check_inertial
from slamsim.check.questions.inertial.readings import check_readings
from slamsim.check.questions.ranges.ranges import check_ranges
from slamsim.check.questions.streams.scan_times import check_scan_time
from slamsim.check.scan_sample import sample_scans
from slamsim.core.types import Float32Array, FloatArray
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import open_recording
from slamsim.recording import RawImu, RawOdometry, RawScans, Recording, ScanLayout, TransformEdge
from slamsim.recording.edits.messages import select
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.recording.repairs.base import Repair
from slamsim.slam.matching.range_noise import COARSE_STEP_M, rounding_step_m


def range_findings(recording: Recording) -> list[Finding]:
    return check_ranges(RecordingEvidence(recording))


def imu_findings(recording: Recording) -> list[Finding]:
    return check_inertial(RecordingEvidence(recording))


SECOND = 1_000_000_000
SCANS, BEAMS = 200, 541
STEP_RAD = float(np.radians(0.5))
LAYOUT = ScanLayout(-1.5 * np.pi / 2, 1.5 * np.pi / 2, STEP_RAD, 0.0, 0.1, 0.1, 30.0)


def room(seed: int = 0) -> Float32Array:
    """Ranges of a robot that turns in an oblong room, with noise and a few lost beams."""
    draw = np.random.default_rng(seed)
    heading = np.linspace(0.0, 6.0 * np.pi, SCANS)[:, None]
    angles = heading + LAYOUT.angle_min_rad + np.arange(BEAMS) * STEP_RAD
    with np.errstate(divide="ignore"):
        walls = np.minimum(3.0 / np.abs(np.cos(angles)), 1.5 / np.abs(np.sin(angles)))
    noisy = walls + 0.008 * draw.standard_normal(walls.shape)
    noisy[draw.random(walls.shape) < 0.003] = np.inf
    return noisy.astype(np.float32)


def recorded(ranges_m: Float32Array, layout: ScanLayout = LAYOUT) -> Recording:
    stamps_ns = np.arange(len(ranges_m), dtype=np.int64) * SECOND // 10
    layout_of = np.zeros(len(ranges_m), dtype=np.int32)
    scans = RawScans("/scan", ("laser_link",), stamps_ns, None, (layout,), layout_of, ranges_m)
    return Recording(
        "test",
        "mcap",
        streams=(
            scans,
            turning_imu(),
        ),
    )


def turning_imu(up: tuple[float, float, float] = (0.0, 0.0, 9.81)) -> RawImu:
    draw = np.random.default_rng(1)
    stamps_ns = np.arange(2000, dtype=np.int64) * SECOND // 100
    gyro = np.array([0.0, 0.0, 0.9]) + 0.002 * draw.standard_normal((2000, 3))
    accel = np.array(up) + 0.05 * draw.standard_normal((2000, 3))
    return RawImu("/imu", ("imu_link",), stamps_ns, None, gyro, accel)


def bad(findings: list[Finding]) -> list[str | None]:
    return [finding.fault for finding in findings if finding.verdict == "fault"]


def test_a_healthy_lidar_has_nothing_to_say() -> None:
    findings = range_findings(recorded(room()))
    assert {finding.verdict for finding in findings} == {"ok"}


def with_zeros() -> Float32Array:
    ranges = room()
    ranges[np.isinf(ranges)] = 0.0
    return ranges


def with_maximum() -> Float32Array:
    ranges = room()
    ranges[np.isinf(ranges)] = 30.0
    return ranges


def with_own_body() -> Float32Array:
    ranges = room()
    draw = np.random.default_rng(2)
    ranges[:, 100:112] = 0.25 + 0.005 * draw.standard_normal((SCANS, 12))
    return ranges


def with_dead_beams() -> Float32Array:
    ranges = room()
    ranges[:, 300:310] = np.inf
    return ranges


def with_stuck_scans() -> Float32Array:
    ranges = room()
    ranges[50:60] = ranges[50]
    return ranges


def with_lost_beams() -> Float32Array:
    ranges = room()
    ranges[np.random.default_rng(2).random(ranges.shape) < 0.4] = np.inf
    return ranges


def with_strays() -> Float32Array:
    ranges = room()
    draw = np.random.default_rng(3)
    stray = draw.random(ranges.shape) < 0.03
    ranges[stray] *= draw.uniform(0.1, 0.8, int(stray.sum())).astype(np.float32)
    return ranges


@pytest.mark.parametrize(
    ("ranges", "fault"),
    [
        (with_zeros(), "range_zero_no_return"),
        (with_maximum(), "range_max_no_return"),
        (with_own_body(), "beams_constant"),
        (with_dead_beams(), "beams_dead"),
        (with_stuck_scans(), "scan_stuck"),
        (with_lost_beams(), "beams_lost"),
        (with_strays(), "scan_interference"),
        (room() * np.float32(1000.0), "range_unit"),
        (room() * np.float32(0.001), "range_unit"),
    ],
    ids=["zeros", "maximum", "own body", "dead", "stuck", "lost", "strays", "mm", "km"],
)
def test_each_fault_is_named_and_nothing_else(ranges: Float32Array, fault: str) -> None:
    findings = range_findings(recorded(ranges))
    assert bad(findings) == [fault]
    assert all(finding.words for finding in findings)


@pytest.mark.parametrize("period_m", [2.048, 2.5, 3.0])
def test_ranges_of_too_few_bits_are_told_with_where_they_begin_anew(period_m: float) -> None:
    ranges = room()
    seen = np.isfinite(ranges)
    ranges[seen] %= np.float32(period_m)
    finding = wrapped_finding(ranges)
    assert finding.fault == "ranges_wrapped"
    assert finding.plots[0].limits[0] == pytest.approx(period_m, abs=0.01)


def test_a_number_near_zero_for_what_is_too_far_is_no_overflow() -> None:
    """Beside walls that are as far as the lidar sees: both ends of each fit a line by accident."""
    ranges = room()
    assert wrapped_finding(np.where(ranges > 2.5, np.float32(0.001), ranges)).verdict == "ok"


def test_one_place_that_looks_like_an_overflow_in_each_scan_of_a_robot_that_stands_is_none() -> (
    None
):
    row = np.full(360, 3.0, dtype=np.float32)
    row[100:106] = [5.97, 5.98, 5.99, 6.0, 0.01, 0.02]  # a wall that ends at something close
    rng = np.random.default_rng(4)
    ranges = row + rng.normal(0.0, 0.002, (60, 360)).astype(np.float32)
    assert wrapped_finding(np.maximum(ranges, np.float32(1e-3))).verdict == "ok"


def wrapped_finding(ranges_m: Float32Array) -> Finding:
    findings = explained(range_findings(recorded(ranges_m)))
    found = next(one for one in findings if one.check == "ranges.wrapped")
    assert found.verdict == "ok" or bad(list(findings)) == ["ranges_wrapped"]
    return found


@pytest.mark.parametrize(
    ("layout", "fault"),
    [
        (replace(LAYOUT, range_max_m=2.0), "range_limits"),
        (replace(LAYOUT, range_min_m=1.8), "range_limits"),
        (replace(LAYOUT, range_max_m=0.0), "range_limits"),
        (replace(LAYOUT, range_max_m=np.nan), "range_limits"),
        (replace(LAYOUT, angle_max_rad=0.3), "scan_layout"),
        (replace(LAYOUT, angle_step_rad=1.5 * STEP_RAD), "scan_folds"),  # `map` refuses it
        (replace(LAYOUT, beam_dt_s=np.nan), "scan_layout"),
    ],
)
def test_declarations_that_contradict_the_readings(layout: ScanLayout, fault: str) -> None:
    assert bad(range_findings(recorded(room(), layout))) == [fault]


def test_scans_that_fold_by_a_rounded_angle_are_unfolded() -> None:
    beams = 1800
    ranges_m = np.random.default_rng(0).uniform(2.0, 3.0, (20, beams)).astype(np.float32)
    turn = replace(LAYOUT, angle_min_rad=-np.pi, angle_max_rad=np.pi, angle_step_rad=0.0035)
    advice, repairs = folded(ranges_m, turn)
    assert advice == "Declare 0.0034926 rad between beams."
    (repair,) = repairs
    assert repair.number("factor") * 0.0035 == pytest.approx(2.0 * np.pi / (beams - 1))
    advice, repairs = folded(ranges_m, replace(turn, angle_step_rad=0.007))
    assert "or declare 0.0034926 rad" in advice and not repairs
    two_turns = replace(turn, angle_max_rad=3.0 * np.pi, angle_step_rad=0.007)
    advice, repairs = folded(ranges_m, two_turns)
    assert advice == "Publish each turn as a scan of its own." and not repairs


def folded(ranges_m: Float32Array, layout: ScanLayout) -> tuple[str, tuple[Repair, ...]]:
    """What is advised of scans of more than a turn."""
    found = range_findings(recorded(ranges_m, layout))
    (told,) = [one for one in found if one.fault == "scan_folds"]
    return told.advice, told.repairs


@pytest.mark.parametrize(
    ("wrong", "fault"),
    [
        (replace(LAYOUT, beam_dt_s=np.nan), "scan_layout"),
        (replace(LAYOUT, range_max_m=0.0), "range_limits"),
        (replace(LAYOUT, range_min_m=np.nan), "range_limits"),
    ],
)
def test_a_tenth_of_the_scans_that_no_consumer_can_use_is_told(
    wrong: ScanLayout, fault: str
) -> None:
    of = recorded(room())
    some = (np.arange(len(of.scans[0])) % 10 == 3).astype(np.int32)
    scans = replace(of.scans[0], layouts=(LAYOUT, wrong), layout_of=some)
    found = range_findings(of.with_streams(RawScans, [scans]))
    assert bad(found) == [fault]
    assert any(f"{some.sum()} of {len(some)} scans" in each.words for each in found)


def test_a_full_turn_may_count_its_first_beam_twice() -> None:
    one_more = replace(LAYOUT, angle_max_rad=LAYOUT.angle_max_rad + STEP_RAD)
    assert not bad(range_findings(recorded(room(), one_more)))


def test_a_robot_that_stands_may_see_the_same() -> None:
    still = np.repeat(room()[:1], SCANS, axis=0)
    gyro = turning_imu()
    resting = replace(gyro, angular_velocity_rad_s=np.zeros((len(gyro), 3)))
    assert not bad(range_findings(recorded(still).with_streams(RawImu, (resting,))))


def test_a_wall_along_a_straight_corridor_is_not_the_robot_itself() -> None:
    angles = LAYOUT.angle_min_rad + np.arange(BEAMS) * STEP_RAD
    draw = np.random.default_rng(4)
    ahead = np.linspace(12.0, 2.0, SCANS)[:, None]
    with np.errstate(divide="ignore"):
        side = 0.75 / np.abs(np.sin(angles))
        end = np.where(np.cos(angles) > 0.0, ahead / np.cos(angles), np.inf)
    ranges = np.minimum(side, end) + 0.008 * draw.standard_normal((SCANS, BEAMS))
    assert "beams_constant" not in bad(range_findings(recorded(ranges.astype(np.float32))))


@given(
    st.sampled_from([0, 1, 2, 3]),
    st.integers(0, 8),
    st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30, 1.0]),
)
def test_hopeless_scans_never_break_it(scans: int, beams: int, value: float) -> None:
    findings = range_findings(recorded(np.full((scans, beams), value, dtype=np.float32)))
    assert findings
    for finding in findings:
        assert finding.estimate is None or np.isfinite(finding.estimate.value)


def test_scans_of_changing_length_are_sampled_by_the_commonest() -> None:
    rows = [row[: 300 + 10 * (i % 3 == 0)] for i, row in enumerate(room())]
    recording = recorded(room())
    scans = replace(recording.scans[0], ranges_m=rows)
    sample = sample_scans(scans)
    assert sample is not None
    assert sample.ranges_m.shape[1] == 300
    assert sample.repeats.shape == (SCANS,)


def mounted(quat_xyzw: tuple[float, float, float, float]) -> tuple[TransformEdge, ...]:
    quats: FloatArray = np.array([quat_xyzw])
    at = np.zeros(1, dtype=np.int64)
    edge = TransformEdge("/tf_static", "base_link", "imu_link", True, at, None, np.zeros((1, 3)),
                         quats)  # fmt: skip
    return (edge,)


UPRIGHT, ROLLED = (0.0, 0.0, 0.0, 1.0), (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


def felt(imu: RawImu, quat_xyzw: tuple[float, float, float, float] = UPRIGHT) -> list[Finding]:
    return check_inertial(
        RecordingEvidence(Recording("t", "mcap", streams=(imu,), transforms=mounted(quat_xyzw)))
    )


def test_a_healthy_unit() -> None:
    assert [finding.verdict for finding in felt(turning_imu())] == ["ok"] * 7


def test_a_unit_on_its_side_that_says_so_is_healthy() -> None:
    assert not bad(felt(turning_imu((0.0, 9.81, 0.0)), ROLLED))


@pytest.mark.parametrize(
    ("up", "fault"),
    [
        ((0.0, 9.81, 0.0), "imu_axis"),
        ((0.0, 0.0, -9.81), "imu_axis"),
        ((0.0, 0.0, 0.0), "gravity_missing"),
        ((0.0, 0.0, 1.0), "gravity_units"),
    ],
)
def test_gravity_tells_what_is_wrong(up: tuple[float, float, float], fault: str) -> None:
    assert bad(felt(turning_imu(up))) == [fault]


def test_a_few_spikes_hide_no_gravity() -> None:
    """Twenty of up to 788 m/s^2, of a bad bus, were "gravity missing" beside what they are."""
    imu = turning_imu()
    spiky = imu.linear_acceleration_m_s2.copy()
    spiky[:: len(imu) // 20] *= np.random.default_rng(1).uniform(-80.0, 20.0, (1, 3))
    assert bad(felt(replace(imu, linear_acceleration_m_s2=spiky))) == ["imu_spikes"]


def test_a_unit_that_repeats_its_samples() -> None:
    imu = turning_imu()
    twice = np.repeat(np.arange(0, 2000, 2), 2)
    stuck = replace(
        imu,
        angular_velocity_rad_s=imu.angular_velocity_rad_s[twice],
        linear_acceleration_m_s2=imu.linear_acceleration_m_s2[twice],
    )
    assert bad(felt(stuck)) == ["imu_stuck"]


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
@pytest.mark.parametrize("samples", [0, 1, 30])
def test_a_hopeless_unit_never_breaks_it(samples: int, value: float) -> None:
    rows = np.full((samples, 3), value)
    imu = RawImu("/imu", ("imu_link",), np.arange(samples, dtype=np.int64), None, rows, rows)
    findings = felt(imu)
    assert findings
    for finding in findings:
        assert finding.estimate is None or np.isfinite(finding.estimate.value)


def test_a_unit_that_hangs_while_the_odometry_goes_on() -> None:
    imu = turning_imu()
    rows = np.repeat([[0.0, 0.0, 0.0]], len(imu), axis=0)
    frozen = replace(imu, angular_velocity_rad_s=rows, linear_acceleration_m_s2=rows + 9.8)
    driven = np.column_stack([np.linspace(0.0, 5.0, len(imu)), rows[:, :2]])
    upright = np.repeat([UPRIGHT], len(imu), axis=0)
    odometry = RawOdometry("/odom", ("odom",), imu.stamps_ns, None, ("base_link",), driven, upright,
                           rows * np.nan, rows * np.nan)  # fmt: skip
    recording = Recording("t", "mcap", streams=(frozen,), transforms=mounted(UPRIGHT))
    assert "imu_stuck" not in bad(imu_findings(recording))
    assert "imu_stuck" in bad(imu_findings(recording.with_streams(RawOdometry, (odometry,))))


@pytest.mark.parametrize(("per_metre", "factor"), [(1000.0, 1e-3), (100.0, 1e-2)])
def test_of_two_units_that_fit_the_limits_the_way_driven_chooses(
    per_metre: float, factor: float
) -> None:
    angles = LAYOUT.angle_min_rad + np.arange(BEAMS) * STEP_RAD
    ahead = np.linspace(2.8, 0.8, SCANS)[:, None]
    with np.errstate(divide="ignore"):
        side = 0.9 / np.abs(np.sin(angles))
        ends = np.where(np.cos(angles) > 0.0, ahead, 3.4 - ahead) / np.abs(np.cos(angles))
    ranges = np.minimum(side, ends) + 0.005 * np.random.default_rng(5).standard_normal(
        (SCANS, BEAMS)
    )
    recording = recorded((ranges * per_metre).astype(np.float32))
    stamps_ns = recording.scans[0].stamps_ns
    driven = np.column_stack([np.linspace(0.0, 2.0, SCANS), np.zeros((SCANS, 2))])
    upright = np.repeat([UPRIGHT], SCANS, axis=0)
    odometry = RawOdometry("/odom", ("odom",), stamps_ns, None, ("base_link",), driven, upright,
                           driven * np.nan, driven * np.nan)  # fmt: skip
    findings = range_findings(recording.with_streams(RawOdometry, (odometry,)))
    units = [finding for finding in findings if finding.fault == "range_unit"]
    assert [unit.repairs[0].parameters["factor"] for unit in units] == [factor]


@pytest.mark.parametrize("clipped", [True, False])
def test_noise_about_no_return_is_told_and_left_out_whole(clipped: bool) -> None:
    """The walls of the room are up to 3.35 m away, of which the lidar sees 2.5 m."""
    whole, layout = room(), replace(LAYOUT, range_max_m=2.5)
    nothing = whole > 2.5
    noise = 0.02 * np.random.default_rng(1).standard_normal(whole.shape)
    ranges = np.where(nothing, 2.5 + noise, whole).astype(np.float32)
    if clipped:
        ranges = np.minimum(ranges, np.float32(2.5))
    made = recorded(ranges, layout)
    told = [one for one in range_findings(made) if one.verdict == "fault"]
    assert [one.fault for one in told] == ["range_max_no_return"]
    fixed = np.asarray(apply_repairs(made, told[0].repairs).scans[0].ranges_m)
    assert np.isinf(fixed[nothing]).mean() > 0.999
    assert np.isfinite(fixed[whole < 2.35]).all()


@pytest.mark.parametrize("value_m", [30.0, 29.99])
def test_beams_that_stand_alone_at_one_value_are_a_code_and_not_stray(value_m: float) -> None:
    """Too few in a scan for a code to be told from surfaces by how often it comes."""
    ranges = room()[:, ::3]
    layout = replace(LAYOUT, angle_step_rad=3.0 * STEP_RAD / 2.0)
    rare = np.random.default_rng(1).random(ranges.shape) < 0.01
    findings = range_findings(recorded(np.where(rare, np.float32(value_m), ranges), layout))
    told = {one.fault for one in findings}
    assert "range_max_no_return" in told and "scan_interference" not in told


def test_a_code_with_surfaces_just_above_it_is_none_of_them() -> None:
    """Noise carries a wall near the maximum beyond the code: the commonest reading is the code."""
    ranges, rng = room(), np.random.default_rng(2)
    ranges[rng.random(ranges.shape) < 0.02] = np.float32(29.99)
    ranges[::2, 200:230] = np.float32(29.99)
    beside = rng.random(ranges.shape) < 2e-4
    ranges[beside] = rng.uniform(29.98, 30.0, beside.sum()).astype(np.float32)
    told = {one.fault: one for one in range_findings(recorded(ranges)) if one.fault}
    assert set(told) == {"range_max_no_return"}
    assert told["range_max_no_return"].repairs[0].parameters["value_m"] == np.float32(29.99)


@pytest.mark.parametrize("count", [BEAMS - 1, BEAMS // 2, BEAMS + 9])
def test_another_number_of_intensities_than_of_ranges(count: int, tmp_path: Path) -> None:
    """In memory, and read from a file, where SLAM goes on without them."""
    made = recorded(room())
    assert not _named_layout(made)
    strengths = np.ones((SCANS, count), dtype=np.float32)
    wrong = made.changed(RawScans, lambda one: replace(one, intensities=strengths))
    assert _named_layout(wrong)
    write_recording(wrong, tmp_path / "bag")
    read = open_recording(tmp_path / "bag").recording
    assert _named_layout(read) and read.scans[0].other_intensities == SCANS
    right = np.ones((SCANS, BEAMS), dtype=np.float32)
    assert not _named_layout(made.changed(RawScans, lambda one: replace(one, intensities=right)))


def _named_layout(made: Recording) -> bool:
    return any(one.check == "ranges.intensities" for one in range_findings(made))


@pytest.mark.parametrize(
    ("scan_time_s", "beam_dt_s", "wrong"),
    [
        (0.1, 0.0, False),
        (0.0, 1e-4, False),
        (0.05, 0.0, False),  # every second scan recorded
        (0.11, 1e-4, False),
        (0.054, 1e-4, False),  # the sweep alone
        (0.2, 1e-4, True),
        (100.0, 1e-4, True),
        (0.01, 1e-4, True),
        (-0.1, 0.0, True),
        (float("nan"), 0.0, True),
        (100.0, 0.1, False),  # then the time from beam to beam is what is wrong
    ],
)
def test_scan_time_fits_stamps_and_sweep(scan_time_s: float, beam_dt_s: float, wrong: bool) -> None:
    layout = replace(LAYOUT, scan_time_s=scan_time_s, beam_dt_s=beam_dt_s)
    made = recorded(room(), layout)
    findings = list(check_scan_time(RecordingEvidence(made)))
    assert [one.fault for one in findings if one.fault] == ["scan_time"] * wrong
    if wrong:
        repaired = apply_repairs(made, findings[0].repairs)
        (found,) = check_scan_time(RecordingEvidence(repaired))
        assert found.verdict == "ok"


@given(step_m=st.floats(0.002, 0.4), begin_m=st.floats(0.0, 0.3), seed=st.integers(0, 99))
def test_the_step_of_rounded_ranges_is_found(step_m: float, begin_m: float, seed: int) -> None:
    true_m = np.random.default_rng(seed).uniform(0.5, 8.0, 60_000)
    rounded = begin_m + np.round(true_m / step_m) * step_m
    found = rounding_step_m(rounded.astype(np.float32).astype(np.float64))
    # Ten readings of each value and steps that rounding to 0.1 mm leaves whole.
    assert found == pytest.approx(step_m, abs=2e-4) or (found == 0.0 and step_m < 0.01)


@given(
    step_m=st.floats(0.012, 0.25),
    noise_steps=st.floats(0.0, 0.15),
    far_m=st.floats(15.0, 60.0),
    seed=st.integers(0, 99),
)
def test_the_step_of_ranges_that_noise_came_upon_is_found(
    step_m: float, noise_steps: float, far_m: float, seed: int
) -> None:
    """Of places at all distances, however often each was read."""
    rng = np.random.default_rng(seed)
    places_m = rng.uniform(0.5, far_m, 8000)
    true_m = np.concatenate([places_m, np.full(8000, places_m[0])])
    read_m = np.round(true_m / step_m) * step_m + rng.normal(0.0, noise_steps * step_m, 16_000)
    assert rounding_step_m(read_m) == pytest.approx(step_m, rel=0.01)


@given(
    places=st.integers(8, 3000),
    far_m=st.floats(1.0, 60.0),
    noise_m=st.sampled_from([0.0, 0.003, 0.01, 0.03]),
    seed=st.integers(0, 2**32 - 1),
)
def test_few_places_read_again_and_again_keep_no_step(
    places: int, far_m: float, noise_m: float, seed: int
) -> None:
    """A robot at rest, by chance at multiples of anything."""
    rng = np.random.default_rng(seed)
    read_m = np.repeat(rng.uniform(0.3, far_m, places), 16_000 // places)
    assert not rounding_step_m(read_m + rng.normal(0.0, noise_m, read_m.size))


@pytest.mark.parametrize(
    ("readings", "found"),
    [
        (np.zeros(0), None),
        (np.full(500, 2.0), None),
        (np.tile([1.0, 1.25, 1.5], 400), None),
        (np.arange(1.0, 8.0, 0.25), None),
        (np.linspace(1.0, 8.0, 900), 0.0),
        (np.linspace(1.0, 8.0, 90_000), 0.0),
    ],
    ids=["none", "one value", "three values", "few, once each", "each once", "without gaps"],
)
def test_what_does_not_repeat_steps_is_not_called_rounded(
    readings: FloatArray, found: float | None
) -> None:
    assert rounding_step_m(readings) == found


def test_steps_as_long_as_a_cell_are_no_fault() -> None:
    """To the last bit, wherever the steps begin."""
    for begin_m in np.arange(0.5, 4.0, 0.05):
        steps_m = (begin_m + 0.05 * np.arange(20)).astype(np.float32)
        assert rounding_step_m(np.repeat(steps_m, 20).astype(np.float64)) == COARSE_STEP_M


def test_readings_too_few_to_show_a_step_are_not_called_fine() -> None:
    for ranges_m in (np.full_like(room(), np.inf), np.full_like(room(), 2.0)):
        found = range_findings(recorded(ranges_m.astype(np.float32)))
        assert [one.verdict for one in found if one.check == "ranges.rounding"] == ["inconclusive"]


def test_a_room_without_noise_keeps_no_step() -> None:
    """A robot at rest reads few values again and again, at any distance from each other."""
    readings = np.random.default_rng(3).uniform(0.4, 7.0, 300)
    assert rounding_step_m(np.tile(readings, 200)) == 0.0


@pytest.mark.parametrize(("step_m", "told"), [(0.25, True), (0.1, True), (0.04, False)])
def test_ranges_in_steps_longer_than_a_cell_are_told(step_m: float, told: bool) -> None:
    ranges_m = (np.round(room() / step_m) * step_m).astype(np.float32)
    found = {one.fault for one in range_findings(recorded(ranges_m))}
    assert ("ranges_coarse" in found) is told


def test_millimetres_are_no_coarse_metres() -> None:
    ranges = np.round(1e3 * room()).astype(np.float32)
    told = {one.fault for one in explained(range_findings(recorded(ranges))) if one.fault}
    assert "range_unit" in told
    assert "ranges_coarse" not in told


@pytest.mark.parametrize(("sigma_m", "told"), [(0.15, True), (0.03, False)])
def test_ranges_that_scatter_more_than_a_lidar_are_told(sigma_m: float, told: bool) -> None:
    noise_m = sigma_m * np.random.default_rng(4).standard_normal(room().shape)
    found = {one.fault for one in range_findings(recorded((room() + noise_m).astype(np.float32)))}
    assert ("range_noise" in found) is told


@pytest.mark.parametrize(
    ("every", "lasts", "felt_m_s2", "fault"),
    [
        (33, 6, 1.0, False),  # a trot: 60 ms in the air
        (1999, 25, 0.5, False),  # down a step
        (200, 1, 0.0, True),  # a bus that reads nothing now and then
        (200, 3, 0.0, True),  # exactly 0 on all axes is no fall, however short
        (1999, 60, 0.1, True),
        (200, 1, 45.0, True),
    ],
)
def test_a_robot_that_falls_or_trots_feels_little_and_no_spikes(
    every: int, lasts: int, felt_m_s2: float, fault: bool
) -> None:
    imu = turning_imu()
    accelerations = imu.linear_acceleration_m_s2.copy()
    for begin in range(20, len(accelerations) - lasts, every):
        accelerations[begin : begin + lasts] *= felt_m_s2 / 9.81
    found = bad(felt(replace(imu, linear_acceleration_m_s2=accelerations)))
    assert found == (["imu_spikes"] if fault else [])


def test_single_spikes_at_fifty_a_second_are_told_by_a_clock_that_is_slow_too() -> None:
    imu = turning_imu()
    accelerations = imu.linear_acceleration_m_s2.copy()
    accelerations[20::200] *= 0.1
    stamps_ns = np.arange(len(imu), dtype=np.int64) * 20_000_200
    imu = replace(imu, stamps_ns=stamps_ns, linear_acceleration_m_s2=accelerations)
    assert bad(felt(imu)) == ["imu_spikes"]


def test_what_is_usual_is_sought_once_however_many_spikes_there_are() -> None:
    imu = turning_imu()
    accelerations = imu.linear_acceleration_m_s2.copy()
    accelerations[5::50] *= 4.6
    accelerations[1000] *= 8.0
    imu = replace(imu, linear_acceleration_m_s2=accelerations)
    with mock.patch.object(np, "median", wraps=np.median) as median:
        found = list(check_readings(Recording("t", "mcap", streams=(imu,)), imu))
    words = [one.words for one in found if one.fault == "imu_spikes"]
    assert words[0].endswith(f"the farthest is {np.linalg.norm(accelerations[1000]):.3g}")
    assert median.call_count < 10


@pytest.mark.parametrize(
    ("every", "lasts", "share", "fault"),
    [
        (10, 1, 0.0, True),  # a bus that reads nothing now and then
        (25, 1, 5.0, True),
        (400, 1, 0.0, False),  # now and then
        (50, 4, 2.0, False),  # shaken for some readings
        (10, 1, 0.9, False),
    ],
)
def test_single_turn_rates_that_leap(every: int, lasts: int, share: float, fault: bool) -> None:
    imu = turning_imu()
    rates = imu.angular_velocity_rad_s * np.sin(imu.stamps_ns * 2e-9)[:, None]
    for begin in range(20, len(rates) - lasts, every):
        rates[begin : begin + lasts] *= share
    rates += np.random.default_rng(2).normal(0.0, 2e-3, rates.shape)
    made = replace(imu, angular_velocity_rad_s=rates)
    found = check_readings(Recording("t", "mcap", streams=(made,)), made)
    assert ("imu.leaps" in {one.check for one in found if one.fault == "imu_spikes"}) == fault


def test_noise_beside_stamps_that_repeat_is_no_turn_rate_that_leaps() -> None:
    """Of which the usual period is none."""
    imu = turning_imu()
    stands = np.arange(len(imu)) % 500 < 300
    noise = np.random.default_rng(4).laplace(0.0, 1.0, (len(imu), 3))
    rates = imu.angular_velocity_rad_s.mean(axis=0) + noise * np.where(stands, 3e-4, 4e-3)[:, None]
    stamps_ns = imu.stamps_ns // (SECOND // 10) * (SECOND // 10)
    made = replace(imu, stamps_ns=stamps_ns, angular_velocity_rad_s=rates)
    found = check_readings(Recording("t", "mcap", streams=(made,)), made)
    assert "imu_spikes" not in {one.fault for one in found}


def test_messages_in_the_wrong_order_are_no_turn_rates_that_leap() -> None:
    imu = turning_imu()
    rates = imu.angular_velocity_rad_s * np.sin(imu.stamps_ns * 2e-9)[:, None]
    order = np.arange(len(imu))
    some = np.arange(10, len(order) // 2, 10)
    order[some] = order[some[::-1] + len(order) // 2]
    order[some[::-1] + len(order) // 2] = some
    made = select(replace(imu, angular_velocity_rad_s=rates), order)
    found = check_readings(Recording("t", "mcap", streams=(made,)), made)
    assert "imu_spikes" not in {one.fault for one in found}
