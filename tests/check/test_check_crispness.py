"""Offsets held against the map: entropy by its definition, and fits that are fooled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_example import BEGIN_NS, T_BASE_LASER, Robot, without
from check_example import motion_findings
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_recording import healthy
from scipy.stats import multivariate_normal

from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.calibration.model import GYRO_DELAY, UNKNOWNS, WHEEL_DELAY
from slamsim.check.map_quality.crispness import Crispness, Stream, along
from slamsim.check.map_quality.entropy import ACROSS_M, ALONG_M, map_entropy, placed
from slamsim.check.map_quality.views import WindowView
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.integrated import integrated_wheels
from slamsim.check.questions.clocks.map_agreement import with_map
from slamsim.check.questions.clocks.offsets import check_timing
from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawScans

ROOM_M, BEAMS, SWEEP_S = 3.5, 150, 0.04
STREAMS: tuple[Stream, ...] = ("gyro", "wheel")


def by_definition(pieces: FloatArray, scan: IntArray) -> float:
    """Pair by pair, with the density of a normal distribution from SciPy."""
    shares = []
    for i in range(len(pieces)):
        for j in range(i):
            if scan[i] != scan[j]:
                spread = covariance(pieces[i]) + covariance(pieces[j])
                apart = pieces[i, :2] - pieces[j, :2]
                shares.append(multivariate_normal.pdf(apart, np.zeros(2), spread))
    return float(-np.log(np.sum(shares) / (0.5 * len(pieces) * (len(pieces) - 1))))


def covariance(piece: FloatArray) -> FloatArray:
    normal = piece[2:4]
    tangent = np.array([-normal[1], normal[0]])
    across = (ACROSS_M**2 + piece[4]) * np.outer(normal, normal)
    return np.asarray(across + ALONG_M**2 * np.outer(tangent, tangent))


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), count=st.integers(2, 20), size_m=st.floats(0.05, 2.0))
def test_entropy_is_that_of_all_pairs_of_different_scans(
    seed: int, count: int, size_m: float
) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, count)
    spots = rng.uniform(-size_m, size_m, (count, 2))
    variance = rng.uniform(0.0, 1e-4, count)
    pieces = np.column_stack([spots, np.cos(angle), np.sin(angle), variance])
    pieces[1, :2] = pieces[0, :2] + 0.01  # some pair is near
    scan = rng.integers(0, 4, count)
    scan[:2] = [0, 1]

    # Beyond the reach of a piece hardly anything is left: thousandths of what two near ones share.
    assert map_entropy(pieces, scan) == pytest.approx(by_definition(pieces, scan), abs=0.03)


def test_entropy_does_not_depend_on_where_the_map_lies() -> None:
    rng = np.random.default_rng(0)
    angle = rng.uniform(-np.pi, np.pi, 60)
    spots = rng.uniform(-1.0, 1.0, (60, 2))
    pieces = np.column_stack([spots, np.cos(angle), np.sin(angle), np.zeros(60)])
    scan = np.arange(60) % 5
    elsewhere = np.tile(np.array([30.0, -7.0, 2.1]), (60, 1))

    assert map_entropy(placed(pieces, elsewhere), scan) == pytest.approx(
        map_entropy(pieces, scan), abs=0.02
    )


def test_nothing_seen_twice_has_no_finite_entropy() -> None:
    pieces = np.array([[0.0, 0.0, 1.0, 0.0, 0.0], [5.0, 0.0, 1.0, 0.0, 0.0]])

    assert map_entropy(pieces, np.array([0, 1])) == np.inf


def views(robot: Robot, calibration: Calibration) -> list[WindowView]:
    """What the robot's laser sees without noise, by geometry alone, a room for each window."""
    return [_view(robot, calibration, int(w)) for w in np.unique(calibration.model.steps.window)]


def _view(robot: Robot, calibration: Calibration, window: int) -> WindowView:
    model = calibration.model
    mine = model.steps.window == window
    stamps = np.union1d(model.steps.first_ns[mine], model.steps.second_ns[mine])[::8]
    true_s = (stamps - BEGIN_NS) * 1e-9 - robot.lidar_late_s
    bearing = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    after_s = SWEEP_S * bearing / (2.0 * np.pi)
    seen_s = (true_s[:, None] + after_s).ravel()
    room = true_poses(robot, true_s[:1])[0]
    T_room_laser = between(room, true_poses(robot, seen_s))
    scan_s = (stamps - model.middle_ns) * 1e-9
    return WindowView(
        wall_pieces(T_room_laser, np.tile(bearing, true_s.size)),
        (scan_s[:, None] + after_s).ravel(),
        np.repeat(np.arange(true_s.size), BEAMS),
        scan_s,
        between(room, true_poses(robot, true_s)),
    )


def true_poses(robot: Robot, at_s: FloatArray) -> FloatArray:
    poses = robot.totals()[2]
    base = [np.interp(at_s, robot.times_s(), poses[:, k]) for k in range(3)]
    return compose(np.column_stack(base), T_BASE_LASER)


def wall_pieces(T_room_laser: FloatArray, bearing: FloatArray) -> FloatArray:
    """(k, 5) where each beam meets one of four walls, in the frame of the laser."""
    yaw = T_room_laser[:, 2] + bearing
    heading = np.column_stack([np.cos(yaw), np.sin(yaw)])
    ranges = (np.copysign(ROOM_M, heading) - T_room_laser[:, :2]) / heading
    reach, wall = ranges.min(axis=1), ranges.argmin(axis=1)
    normal = np.where(wall == 0, 0.0, 0.5 * np.pi) - T_room_laser[:, 2]
    spots = (reach * np.cos(bearing), reach * np.sin(bearing))
    return np.column_stack([*spots, np.cos(normal), np.sin(normal), np.full(bearing.size, 1e-6)])


def calibrated(inputs: Inputs) -> Calibration:
    found = calibrate_inputs(inputs)
    assert found is not None
    return found


def told(robot: Robot, calibration: Calibration, stream: Stream) -> Crispness:
    found = along(calibration, views(robot, calibration), stream)
    assert found is not None
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("robot", "missing", "stream", "true_s"),
    [
        (Robot(), "", "gyro", 0.0),
        (Robot(gyro_late_s=0.02), "wheels", "gyro", 0.02),
        (Robot(lidar_late_s=-0.02), "", "wheel", 0.02),
        pytest.param(Robot(lidar_late_s=0.03), "", "gyro", -0.03, marks=pytest.mark.slow),
        pytest.param(Robot(wheels_late_s=0.05), "gyro", "wheel", 0.05, marks=pytest.mark.slow),
    ],
)
def test_a_true_offset_is_where_the_map_is_crispest(
    robot: Robot, missing: str, stream: Stream, true_s: float
) -> None:
    inputs = without(robot.inputs(), missing) if missing else robot.inputs()

    found = told(robot, calibrated(inputs), stream)

    assert found.objection == ""
    assert found.crispest_s is not None
    assert found.crispest_s[0] == pytest.approx(true_s, abs=0.002)
    if true_s != 0.0:
        assert found.gained is not None
        assert found.gained[0] > 0.0


@pytest.mark.long
@pytest.mark.parametrize(("unknown", "stream"), [(GYRO_DELAY, "gyro"), (WHEEL_DELAY, "wheel")])
def test_a_fit_that_is_fooled_is_contradicted(unknown: int, stream: Stream) -> None:
    """Whatever has fooled it: the offset is moved behind its back."""
    robot = Robot()
    calibration = calibrated(robot.inputs())
    values = calibration.fit.values + 0.03 * (np.arange(len(UNKNOWNS)) == unknown)

    found = told(robot, replace(calibration, fit=replace(calibration.fit, values=values)), stream)

    assert "crisp" in found.objection


def test_wheels_that_turn_before_the_robot_does_are_not_named_early() -> None:
    """Tyres and castors give: the turn of the wheels leads, their way does not."""
    robot = Robot()
    ticks = robot.ticks()
    times_s = ticks.stamps_ns * 1e-9
    mean, apart = ticks.ticks.mean(axis=1), np.diff(ticks.ticks, axis=1)[:, 0]
    leading = 0.5 * np.interp(times_s + 0.03, times_s, apart)
    counts = np.rint(np.column_stack([mean - leading, mean + leading])).astype(np.int64)
    inputs = replace(robot.inputs(), wheels=integrated_wheels(replace(ticks, ticks=counts)))
    calibration = calibrated(inputs)
    misled = check_timing(calibration)
    assert "time_offset_wheels" in {finding.fault for finding in misled}

    crispness = {stream: told(robot, calibration, stream) for stream in STREAMS}
    findings = with_map(misled, crispness)

    assert not any(finding.fault for finding in findings)
    doubted = next(one for one in findings if one.check == "time.offset.wheels")
    assert doubted.verdict == "inconclusive"
    assert "crisp" in doubted.words
    assert doubted.plots[0].spans
    assert not doubted.repairs


def test_recorded_scans_tell_that_the_lidar_is_late() -> None:
    """From ranges to words."""
    recording = healthy()
    late = tuple(
        replace(scans, stamps_ns=scans.stamps_ns + 25_000_000) for scans in recording.scans
    )

    findings = {one.check: one for one in motion_findings(recording.with_streams(RawScans, late))}

    offset = findings["time.offset.lidar_imu"]
    assert "the map is crispest" in offset.words
    assert "less than as stamped" in offset.words
    assert offset.plots
