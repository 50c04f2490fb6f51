"""Questions about the laser: each fault is named, and a healthy recording has none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from calibration_example import Robot
from scan_recording import (
    LIDAR,
    healthy,
    raw_scans,
    recording,
    truth,
    with_layout,
    with_ranges,
    with_scans,
    world,
    world_fixed,
)
from simulated import drive, sense_scans

from slamsim.check.diagnosis import explained
from slamsim.check.findings import Finding, Measurement, decide
from slamsim.check.motion.inputs import gather_inputs
from slamsim.check.motion.laser_steps import ANGLE_LIMIT, _evened, laser_motions, laser_steps
from slamsim.check.questions.laser.laser import check_laser
from slamsim.check.questions.laser.rotation import check_rotation
from slamsim.check.questions.laser.shape import check_angles
from slamsim.core.types import FloatArray, ScanGeometry
from slamsim.recording import (
    RawImu,
    RawOdometry,
    RawScans,
    RawStream,
    Recording,
    RecordingFormat,
)
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.slam.laser.calibration import SHAPE, LaserCalibration
from slamsim.slam.laser.scan_bundle import WindowFit
from slamsim.slam.laser.scan_motion import ShapeEstimate
from slamsim.slam.laser.scan_scale import _Try, rough_angle_scale
from slamsim.slam.laser.scan_track import LaserTrack

STEP = LIDAR.angle_step_rad
BEAM_DT_S = LIDAR.beam_dt_ns * 1e-9
SWEEP_ALONE = np.array([False, False, True])


def findings(of: Recording) -> dict[str, Finding]:
    motions = laser_motions(of)
    assert motions is not None
    alone = check_laser(motions, gather_inputs(of, motions), of)
    angles = check_angles(motions, None) if motions.windows else []
    found = [*alone, *angles]
    assert len({finding.check for finding in found}) == len(found)
    return {finding.check: finding for finding in found}


def named(of: Recording) -> set[str | None]:
    return {finding.fault for finding in findings(of).values() if finding.verdict == "fault"}


def ranges(of: Recording) -> FloatArray:
    return np.asarray(of.scans[0].ranges_m, dtype=np.float64)


def test_healthy_recording_is_told_so() -> None:
    found = findings(healthy())
    assert {finding.verdict for finding in found.values()} == {"ok"}
    gain = found["laser.rotation"].estimate
    assert gain is not None and gain.value == pytest.approx(1.0, abs=0.02)
    assert found["laser.rotation"].plots and found["laser.sweep"].plots


@pytest.mark.long
@pytest.mark.parametrize("share", [0.4, 0.43, 0.46])
def test_a_clock_that_is_set_within_a_window_leaves_the_others_as_they_are(share: float) -> None:
    """The mean step of all windows would be seconds with one of an hour among them, and the scans
    be put on that beat, on which they do not turn as the robot does."""
    stamps = healthy().scans[0].stamps_ns
    at_ns = int(stamps[round(share * len(stamps))])

    def later(stream: RawStream) -> RawStream:
        put_ns = np.where(stream.stamps_ns >= at_ns, 3_600_000_000_000, 0)
        return replace(stream, stamps_ns=stream.stamps_ns + put_ns)

    made = healthy().changed(RawStream, later)
    found = findings(made)["laser.rotation"]
    assert found.verdict == "ok", found.words


@pytest.mark.parametrize("count", [2, 3])
def test_few_windows_keep_their_stamps_where_a_clock_is_set(count: int) -> None:
    """Half of their mean step is an hour's share, which is no usual step."""
    windows = [100_000_000 * np.arange(32) + 10_000_000_000 * k for k in range(count)]
    windows[0] = windows[0] + np.where(np.arange(32) >= 16, 3_600_000_000_000, 0)
    for found, given in zip(_evened(windows)[1:], windows[1:], strict=True):
        np.testing.assert_array_equal(found, given)


@pytest.mark.parametrize(("of_another_drive", "verdict"), [(False, "ok"), (True, "inconclusive")])
def test_turns_that_noise_hides_in_each_step_are_known_from_all(
    of_another_drive: bool, verdict: str
) -> None:
    """As of a fast lidar of few beams: what one step turns too far the next turns back."""
    inputs = Robot(seconds=240.0).inputs()
    steps = Robot(seconds=240.0, seed=7).inputs().steps if of_another_drive else inputs.steps
    noise = np.random.default_rng(3).normal(0.0, 0.03, len(steps) + 1)
    moved = steps.T_first_second + np.diff(noise)[:, None] * [0.0, 0.0, 1.0]
    found = check_rotation(replace(inputs, steps=replace(steps, T_first_second=moved)))
    assert found.verdict == verdict, found.words


@pytest.mark.parametrize("seed", [0, 3])
def test_scans_that_are_lost_in_turns_are_not_fixed_to_the_world(seed: int) -> None:
    """What is left turns by too little to tell an offset of the clocks: one of half a minute, as
    likely as any, compared it with what was driven then."""
    inputs = Robot(seconds=240.0, seed=seed).inputs()
    straight = inputs.steps.select(np.abs(inputs.steps.T_first_second[:, 2]) < 0.01)
    found = check_rotation(replace(inputs, steps=straight, gyro=None))
    assert found.verdict == "ok", found.words


@cache
def of_world_fixed() -> dict[str, Finding]:
    return findings(world_fixed())


def test_rays_fixed_to_the_world_are_named() -> None:
    found = explained(list(of_world_fixed().values()))
    assert {finding.fault for finding in found} == {None, "laser_world_fixed"}


def test_rays_fixed_to_the_world_are_turned_back() -> None:
    repair = of_world_fixed()["laser.rotation"].repairs[0]
    drift, offset = (float(repair.parameters[name]) for name in ("drift_rad_s", "offset_rad"))
    yaw = np.unwrap(truth().poses[:, 2])
    gyro_bias_rad_s = 0.01
    assert drift == pytest.approx(gyro_bias_rad_s, abs=1e-3)
    assert np.sin(0.5 * (offset - yaw[0])) == pytest.approx(0.0, abs=0.01)
    assert named(apply_repairs(world_fixed(), [repair])) == set()


def test_mirrored_scans_are_named() -> None:
    of = healthy()
    mirrored = with_layout(of, angle_min_rad=-LIDAR.angle_min_rad, angle_step_rad=-STEP)
    assert named(mirrored) == {"laser_mirrored"}


def test_an_array_that_is_turned_round_is_mirrored_and_runs_backward() -> None:
    of = healthy()
    assert named(with_ranges(of, ranges(of)[:, ::-1])) == {"laser_mirrored", "beam_time_reversed"}


@pytest.mark.long
@pytest.mark.parametrize("error", [-0.02, pytest.param(0.01, marks=pytest.mark.slow)])
def test_a_wrong_angle_between_beams_is_measured(error: float) -> None:
    half = 0.5 * (1.0 + error) * STEP * (LIDAR.beam_count - 1)
    wrong = with_layout(
        healthy(),
        angle_step_rad=(1.0 + error) * STEP,
        angle_min_rad=-half,
        angle_max_rad=half,
    )
    found = findings(wrong)["laser.angle_step"]
    assert found.fault == "laser_angle_step" and found.estimate is not None
    assert found.estimate.value == pytest.approx(100.0 * error, abs=0.2)
    assert found.repairs[0].parameters["factor"] == pytest.approx(1.0 / (1.0 + error), abs=2e-3)


@pytest.mark.long
@pytest.mark.parametrize("every", [2, 3])
def test_angles_of_a_scan_that_was_thinned_are_those_of_the_beams_that_are_left(every: int) -> None:
    """With a third of the right angles scans turned a third as far, and where they were laid so no
    other angle fitted better."""
    thinned = with_ranges(healthy(), ranges(healthy())[:, ::every])
    beams = len(thinned.scans[0].ranges_m[0])
    last_rad = LIDAR.angle_min_rad + STEP * (beams - 1)
    motions = laser_motions(with_layout(thinned, angle_max_rad=last_rad))
    assert motions is not None
    assert abs(motions.angle_step.value - every) < 4.0 * motions.angle_step.sigma < 0.02


@pytest.mark.long
def test_noise_that_bends_the_scans_of_few_beams_is_no_wrong_angle() -> None:
    """181 beams over half a turn with 3 cm of noise: -0.98 +- 0.14 %, a fault, where none is."""
    beams = ScanGeometry(-0.5 * np.pi, np.pi / 180.0, 181, 0, 0.1, 30.0)
    walls, tour = world()
    scans = raw_scans(sense_scans(walls, drive(tour, max_s=45.0), beams, 0.03, 0))
    motions = laser_motions(Recording("noisy", "mcap", streams=(scans,)))
    assert motions is not None
    angle = motions.angle_step
    assert decide(Measurement(angle.value, angle.sigma, ""), ANGLE_LIMIT, 1.0) != "fault"
    assert abs(angle.value - 1.0) < 2.0 * angle.sigma < 0.02


@pytest.mark.long
def test_what_noise_makes_of_wrong_angles_is_seen_about_the_angles_that_were_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Noise upon every second beam of a scanner hid that scans fit with angles twice as wide, and
    this was taken for what noise shifts them by: 3.8 +- 0.9 for 2."""
    looks = list[float]()

    def hidden_by_noise(*args: Any) -> float:
        looks.append(1.0 if looks else rough_angle_scale(*args))
        return looks[-1]

    monkeypatch.setattr("slamsim.slam.laser.scan_motion.rough_angle_scale", hidden_by_noise)
    half = 0.4 * STEP * (LIDAR.beam_count - 1)
    motions = laser_motions(
        with_layout(healthy(), angle_step_rad=0.8 * STEP, angle_min_rad=-half, angle_max_rad=half)
    )
    assert motions is not None and abs(looks[0] - 1.25) < 0.1
    angle = motions.angle_step
    assert abs(angle.value - 1.25) < 3.0 * angle.sigma < 0.01


@pytest.mark.parametrize(("step", "is_believed"), [(0.0, True), (0.1, False)])
def test_fans_that_steps_make_wider_than_a_turn_are_not_believed(
    step: float, is_believed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They fold up and fit anything: from 364 degrees on, steps led to 485."""

    def the_wider_the_sharper(*of: Any) -> _Try:
        scale = float(of[3]) if len(of) > 3 else 0.0
        return _Try(misfit=1.0, sharpness=scale, step=step, sigma=1.0)

    monkeypatch.setattr("slamsim.slam.laser.scan_scale._of", the_wider_the_sharper)
    track = cast(LaserTrack, SimpleNamespace(poses=np.zeros((3, 3)), scans=np.arange(3)))
    scale = rough_angle_scale([track], [cast(WindowFit, None)], np.pi, lambda *_: [])
    assert (scale != 1.0) == is_believed


def test_where_the_sweep_is_by_the_scans_their_instant_is_half_as_unsure() -> None:
    """A sweep of 2.5 +- 0.24 of the declared 25 ms made stamps 6.0 +- 0.15 ms late."""
    motions = laser_motions(healthy())
    assert motions is not None
    unsure = replace(motions, sweep_s=replace(motions.sweep_s, sigma=0.006))
    by_scans = replace(unsure, contradicted=np.array([True, False, False]))
    assert gather_inputs(healthy(), unsure).instant_sigma_s == 0.0
    assert gather_inputs(healthy(), by_scans).instant_sigma_s == pytest.approx(0.003)


@pytest.mark.parametrize(
    ("declared_s", "found_s", "later_s"),
    [
        *((0.04, 0.02, -0.01), (0.04, -0.04, 0.0), (0.0, -0.04, 0.02)),
        *((0.1, 0.02, -0.04), (0.1, -0.02, -0.04), (0.04, -1e-3, -0.02), (0.0, -1e-4, 0.0)),
        *((-0.04, -0.02, 0.01), (-0.04, 0.04, 0.04), (-0.04, 1e-3, 0.02)),
    ],
)
def test_the_instant_of_a_scan_goes_with_its_sweep(
    declared_s: float, found_s: float, later_s: float
) -> None:
    """From the stamp on, before it only where beams are declared to fire before it: a sweep of 20
    ms before the stamp, declared as 40, was seen 20 ms earlier than it was. As SLAM has it, which
    put beams of one instant a little before the stamp."""
    motions = laser_motions(healthy())
    assert motions is not None
    sweep = ShapeEstimate(found_s, 1e-4, declared_s)
    contradicted = np.array([True, False, False])
    steps = laser_steps(replace(motions, sweep_s=sweep, contradicted=contradicted), even=False)
    declared = LaserCalibration.unknown(np.eye(4), declared_s)
    told = declared.told(SHAPE, np.array([1.0, 0.0, found_s]), np.full(3, 1e-4), SWEEP_ALONE)
    assert told.later_ns == round(1e9 * later_s)
    as_declared_ns = np.concatenate([window.middle_ns[:-1] for window in motions.windows])
    np.testing.assert_array_equal(steps.first_ns - as_declared_ns, round(1e9 * later_s))
    assert steps.sweep_s == (0.0 if abs(found_s) <= 1e-3 else abs(found_s))


@pytest.mark.parametrize(("noise_m", "sigma_mm"), [(0.0, 1.0), (0.025, 3.0)])
def test_the_range_offset_is_as_unsure_as_noise_makes_it(noise_m: float, sigma_mm: float) -> None:
    """What noise adds to it, 2 mm as a rule, is none of a lidar without noise."""
    walls, tour = world()
    scans = raw_scans(sense_scans(walls, drive(tour, max_s=20.0), LIDAR, noise_m, 0))
    motions = laser_motions(Recording("noisy", "mcap", streams=(scans,)))
    assert motions is not None
    offset_mm, sigma = 1e3 * motions.range_offset_m.value, 1e3 * motions.range_offset_m.sigma
    assert abs(offset_mm) < 2.0 * sigma < 2.0 * sigma_mm


def test_degrees_are_named() -> None:
    first, last = np.degrees([LIDAR.angle_min_rad, -LIDAR.angle_min_rad])
    step = float(np.degrees(STEP))
    assert named(
        with_layout(healthy(), angle_min_rad=first, angle_max_rad=last, angle_step_rad=step)
    ) == {"laser_degrees"}
    assert named(with_layout(healthy(), angle_step_rad=step)) == {"laser_degrees"}


@pytest.mark.parametrize(
    ("declared", "fault"),
    [
        (-1.0, "beam_time_reversed"),
        (0.5, "beam_time_scale"),
        pytest.param(0.05, "beam_time_scale", marks=pytest.mark.slow),
        (0.0, "rolling_scan_untimed"),
    ],
)
def test_wrong_beam_times_are_named(declared: float, fault: str) -> None:
    of = with_layout(healthy(), beam_dt_s=declared * BEAM_DT_S)
    found = findings(of)
    assert {finding.fault for finding in found.values()} == {None, fault}
    estimate = found["laser.sweep"].estimate
    assert estimate is not None
    true_ms = 1e3 * BEAM_DT_S * (LIDAR.beam_count - 1)
    wanted = true_ms if declared == 0.0 else 1.0 / declared
    assert estimate.value == pytest.approx(wanted, rel=0.05)


def test_beams_whose_order_is_lost_do_not_tell_how_long_a_sweep_lasts() -> None:
    of = with_layout(healthy(), beam_dt_s=0.0)
    found = findings(with_scans(of, replace(of.scans[0], in_order=False)))
    assert found["laser.sweep"].verdict == "inconclusive"
    assert not found["laser.sweep"].repairs


def test_a_flash_scan_with_beam_times_is_named() -> None:
    at_once = healthy(0, replace(LIDAR, beam_dt_ns=0))
    assert named(at_once) == set()
    assert named(with_layout(at_once, beam_dt_s=BEAM_DT_S)) == {"flash_scan_timed"}


def test_a_format_without_beam_times_is_not_blamed_for_them() -> None:
    no_field: RecordingFormat = "carmen"
    of = replace(with_layout(healthy(), beam_dt_s=0.0), format=no_field)
    found = findings(of)
    assert {one.verdict for one in found.values()} == {"ok"}
    assert "ms" in found["laser.sweep"].words


def test_ranges_that_are_too_long_are_measured() -> None:
    found = findings(with_ranges(healthy(), ranges(healthy()) + 0.06))["ranges.offset"]
    assert found.fault == "range_offset" and found.estimate is not None
    assert found.estimate.value == pytest.approx(60.0, abs=5.0)


@pytest.mark.long
def test_a_robot_that_stands_cannot_tell() -> None:
    of = healthy()
    scans = of.scans[0]
    still = np.array(scans.ranges_m)[:10].repeat(20, axis=0)[:180]
    still += np.random.default_rng(0).normal(0.0, 0.005, still.shape).astype(np.float32)
    first = replace(
        scans, ranges_m=still, stamps_ns=scans.stamps_ns[:180], layout_of=scans.layout_of[:180]
    )
    quiet = with_scans(of, first)
    quiet = quiet.changed(
        RawImu, lambda i: replace(i, angular_velocity_rad_s=0.0 * i.angular_velocity_rad_s)
    ).with_streams(RawOdometry, ())
    found = findings(quiet)
    assert found["laser.rotation"].verdict == "inconclusive"
    assert found["laser.sweep"].verdict == "inconclusive"
    assert "turn" in found["laser.rotation"].words


def test_without_other_sensors_rotation_cannot_be_told() -> None:
    alone = healthy().with_streams(RawImu, ()).with_streams(RawOdometry, ())
    found = findings(alone)
    assert found["laser.rotation"].verdict == "inconclusive"
    assert found["laser.angle_step"].verdict == "ok"


def test_a_gyroscope_that_turns_the_wrong_way_is_outvoted() -> None:
    of = healthy()
    wrong = tuple(replace(i, angular_velocity_rad_s=-i.angular_velocity_rad_s) for i in of.imus)
    assert findings(of.with_streams(RawImu, wrong))["laser.rotation"].verdict == "ok"


def test_no_scan_fits_anything() -> None:
    of = healthy()
    noise = np.random.default_rng(2).uniform(0.2, 20.0, ranges(of)[:60].shape)
    scans = replace(
        of.scans[0],
        ranges_m=noise.astype(np.float32),
        stamps_ns=of.scans[0].stamps_ns[:60],
        layout_of=of.scans[0].layout_of[:60],
    )
    found = findings(recording(scans, 0))
    assert set(found) == {"laser.rotation"} and found["laser.rotation"].verdict == "inconclusive"


def test_a_recording_without_lidar_has_no_motion() -> None:
    assert laser_motions(healthy().with_streams(RawScans, ())) is None
