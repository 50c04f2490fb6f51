"""Which sizes are wrong when several gains are, and which change during the drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from calibration_example import Robot
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.check.calibration import explanation
from slamsim.check.calibration.explanation import (
    EFFECTS,
    HEALTHY_SHARE,
    LIMITS,
    OF_ROBOTS,
    Size,
    explain,
)
from slamsim.check.calibration.joint import calibrate_inputs
from slamsim.check.calibration.noise import Pieces, pieces_of
from slamsim.check.findings import SURE_SIGMAS, decide
from slamsim.check.motion.inputs import Inputs
from slamsim.check.questions import changes
from slamsim.check.questions.changes import check_changes
from slamsim.check.questions.laser.mounting import check_mounting
from slamsim.check.questions.ranges.scale import check_range_scale
from slamsim.core.types import BoolArray, FloatArray

Change = Callable[[FloatArray], FloatArray]

FORWARD = np.array([0.25, -0.02, 0.3])
"""A laser so far from the axle that its lever arm tells ranges of another length."""


def seen(inputs: Inputs, change: Change) -> Inputs:
    """With the motion of the scans, (n, 3), changed."""
    moved = change(inputs.steps.T_first_second.copy())
    return replace(inputs, steps=replace(inputs.steps, T_first_second=moved))


def scaled(*factors: float) -> Change:
    return lambda steps: steps * np.array(factors)


CASES: list[tuple[Robot, Change, dict[Size, float]]] = [
    (Robot(), scaled(1, 1, 1), {}),
    (Robot(radius=1.005), scaled(1, 1, 1), {"radius": 0.5}),
    (Robot(radius=0.99), scaled(1, 1, 1), {"radius": -1.0}),
    (Robot(track=1.01), scaled(1, 1, 1), {"track": 1.0}),
    (Robot(gyro_scale=1.02), scaled(1, 1, 1), {"gyro": 2.0}),
    (Robot(), scaled(1.006, 1.006, 1), {"ranges": 0.6}),
    (Robot(), scaled(1, 1, 1.005), {"scan_turns": 0.5}),
    (Robot(radius=1.02, track=1.03), scaled(1, 1, 1), {"radius": 2.0, "track": 3.0}),
    (Robot(track=1.02, gyro_scale=0.97), scaled(1, 1, 1), {"track": 2.0, "gyro": -3.0}),
    (Robot(gyro_scale=1.03), scaled(0.99, 0.99, 1), {"ranges": -1.0, "gyro": 3.0}),
]


@pytest.mark.parametrize(("robot", "change", "wrong"), CASES)
def test_the_fewest_wrong_sizes_explain_all_gains(
    robot: Robot, change: Change, wrong: dict[Size, float]
) -> None:
    calibration = calibrate_inputs(seen(robot.inputs(), change))
    assert calibration is not None
    found = explain(calibration)
    assert found.wrong == set(wrong)
    for size, percent in wrong.items():
        measured = found.too_large[size]
        assert measured is not None and measured.value == pytest.approx(percent, abs=0.12)
    for size in set(EFFECTS) - set(wrong):
        measured = found.too_large[size]
        assert measured is None or abs(measured.value) < 100.0 * LIMITS[size] + 0.1
    scale = check_range_scale(calibration, found)
    assert [one.fault for one in scale] == ["range_scale" if "ranges" in wrong else None]


@pytest.mark.parametrize(
    ("robot", "length", "wrong"),
    [
        (Robot(T_base_laser=FORWARD), 0.95, {"ranges"}),
        (Robot(T_base_laser=FORWARD, radius=1.05, track=1.05), 1.0, {"radius", "track"}),
    ],
)
def test_the_lever_arm_of_turns_tells_ranges_from_an_odometry_whose_path_is_scaled(
    robot: Robot, length: float, wrong: set[Size]
) -> None:
    inputs = replace(seen(robot.inputs(), scaled(length, length, 1.0)), T_base_laser=FORWARD)
    calibration = calibrate_inputs(inputs)
    assert calibration is not None
    found = explain(calibration)
    assert found.wrong == wrong
    assert not any(one.fault for one in check_mounting(calibration, found))


def test_without_a_gyroscope_the_scans_are_believed_and_wheels_blamed() -> None:
    inputs = replace(seen(Robot().inputs(), scaled(1, 1, 1.02)), gyro=None)
    calibration = calibrate_inputs(inputs)
    assert calibration is not None
    assert explain(calibration).wrong == {"track"}


def test_wheels_alone_say_nothing_of_how_far_scans_turn() -> None:
    """Their track may be off by ten times what is asked of the angle between beams."""
    rng, sigmas = np.random.default_rng(5), np.array([1e-3, 2e-4])
    known = np.array([True, True, False, False])
    for _ in range(100):
        off = {size: HEALTHY_SHARE * LIMITS[size] * rng.standard_normal() for size in OF_ROBOTS}
        gain = sum(off[size] * EFFECTS[size] for size in OF_ROBOTS)
        seen = np.asarray(gain)[known] + sigmas * rng.normal(size=2)
        gains = explanation._Gains(seen, np.diag(np.square(sigmas)), known)
        assert "scan_turns" not in explanation._fewest(gains)
        assert explanation._told(gains, "scan_turns", ()) is None


@pytest.mark.long
@pytest.mark.parametrize(("wrong", "by"), [("radius", 0.0), ("radius", 0.01), ("track", 0.02)])
def test_intervals_of_a_size_hold_what_the_others_of_a_healthy_robot_add(
    wrong: Size, by: float
) -> None:
    """Paths are known ten times less well than turns, which tell a radius by the track."""
    rng, sigmas, draws = np.random.default_rng(7), np.array([2e-3, 2e-4, 2e-4, 1e-4]), 400
    held: dict[Size, int] = dict.fromkeys((*OF_ROBOTS, "ranges"), 0)
    for _ in range(draws):
        off = {size: HEALTHY_SHARE * LIMITS[size] * rng.standard_normal() for size in OF_ROBOTS}
        off["ranges"] = 0.0
        off[wrong] = by or off[wrong]
        gain = sum(off[size] * EFFECTS[size] for size in OF_ROBOTS) + sigmas * rng.normal(size=4)
        known = np.ones(4, dtype=np.bool_)
        gains = explanation._Gains(np.asarray(gain), np.diag(np.square(sigmas)), known)
        found = explanation._fewest(gains)
        for size in held:
            measured = explanation._told(gains, size, found)
            if measured is None:
                assert size == "ranges" and {"radius", "track"} <= set(found)
                continue
            low, high = measured.interval
            held[size] += low <= 100.0 * np.expm1(off[size]) <= high
    assert all(0.9 * draws < count < 0.985 * draws for count in held.values()), held


CREEPS = np.array([-0.002, 0.0031, 0.0, 0.0])
"""Gains of the simulator's robot: it rolls less and turns more than its wheels count."""

GOOD_LIDAR = np.array([7e-4, 1.2e-4, 7e-5, 1.1e-4])
"""Sigmas of the gains by a drive through the labyrinth."""


def _gains(seen: FloatArray, sigmas: FloatArray) -> explanation._Gains:
    return explanation._Gains(seen, np.diag(np.square(sigmas)), np.ones(4, dtype=np.bool_))


def _faults(gains: explanation._Gains) -> dict[Size, float]:
    """Those told as faults, with their size in per cent."""
    wrong = explanation._fewest(gains)
    told = {size: explanation._told(gains, size, wrong) for size in EFFECTS}
    return {
        size: found.value
        for size, found in told.items()
        if found is not None and decide(found, 100.0 * LIMITS[size]) == "fault"
    }


def test_ranges_are_no_surer_than_the_wheels_that_measure_them() -> None:
    """With noise as the only doubt 36 of 2000 such drives with a noisy lidar had a fault."""
    rng, sigmas = np.random.default_rng(11), np.array([1.25e-3, 5.5e-4, 4.9e-4, 1.4e-4])
    told = [_faults(_gains(CREEPS + sigmas * rng.normal(size=4), sigmas)) for _ in range(500)]
    assert sum(map(bool, told)) <= 1


@pytest.mark.parametrize(
    ("size", "by"),
    [("ranges", 0.01), ("ranges", -0.01), ("ranges", 0.02), ("radius", 0.01), ("radius", -0.01)],
)
def test_a_path_is_told_by_its_name_of_a_robot_whose_wheels_creep(size: Size, by: float) -> None:
    """Ranges 1 % too short were called wheels of another radius and track."""
    told = _faults(_gains(CREEPS + by * EFFECTS[size], GOOD_LIDAR))
    assert told.keys() == {size} and told[size] == pytest.approx(100.0 * by, abs=0.3)


def test_ranges_one_per_cent_too_long_are_told_whatever_the_noise() -> None:
    """By a wheel's name where noise has it so: lengths alone do not say whose is wrong."""
    rng, seen = np.random.default_rng(12), CREEPS + 0.01 * EFFECTS["ranges"]
    told = [_faults(_gains(seen + GOOD_LIDAR * rng.normal(size=4), GOOD_LIDAR)) for _ in range(100)]
    assert all(told) and {size for one in told for size in one} <= {"ranges", "radius"}
    assert sum("ranges" in one for one in told) > 60


def test_ranges_half_a_per_cent_too_long_may_as_well_be_wheels() -> None:
    """Four standard deviations of a healthy radius: nothing is told, and no wheel is blamed."""
    gains = _gains(0.005 * EFFECTS["ranges"], GOOD_LIDAR)
    assert explanation._fewest(gains) == ("ranges",) and not _faults(gains)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), blocks=st.integers(6, 40))
def test_a_piece_is_what_its_blocks_alone_say(seed: int, blocks: int) -> None:
    """Of a linear problem, against least squares of the rows of each piece."""
    rng = np.random.default_rng(seed)
    design, noise = rng.standard_normal((blocks, 6, 3)), rng.standard_normal((blocks, 6))
    whole = np.linalg.lstsq(design.reshape(-1, 3), noise.ravel(), rcond=None)[0]
    at_s = rng.permutation(blocks).astype(float)
    gained = np.einsum("bni,bnj->bij", design, design)
    gradients = -np.einsum("bni,bn->bi", design, noise - design @ whole)
    found = pieces_of(at_s, gained, gradients, 1e-12 * np.eye(3), 1.0)
    assert found is not None
    parts = np.array_split(np.argsort(at_s), min(blocks // 3, 8))
    for part, moved, at in zip(parts, found.moved, found.middle_s, strict=True):
        alone = np.linalg.lstsq(design[part].reshape(-1, 3), noise[part].ravel(), rcond=None)[0]
        assert np.allclose(whole + moved, alone) and at == pytest.approx(at_s[part].mean())


def test_intervals_grow_with_errors_that_last_longer_than_a_block() -> None:
    """A constant that wanders from piece to piece: noise alone claims a sixth of its error."""
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(60):
        wander = np.repeat(rng.normal(0.0, 0.1, 8), 4)
        means = wander + rng.normal(0.0, 0.03, 32)
        gained = np.full((32, 1, 1), 0.03**-2)
        value = float(means.mean())
        gradients = -gained[:, 0] * (means - value)[:, None]
        pieces = pieces_of(np.arange(32.0), gained, gradients, np.array([[1e-9]]), 1.0)
        assert pieces is not None
        sigma = float(np.sqrt(pieces.widened(np.array([[0.03**2 / 32]]))[0, 0]))
        held += abs(value) < 1.96 * sigma
    assert held >= 50


def test_a_piece_that_tells_next_to_nothing_makes_nothing_unsure() -> None:
    """Gain of a stream with noise of its own, seven pieces with turns and one without."""
    rng = np.random.default_rng(6)
    turns = np.where(np.arange(32) < 28, 1.0, 0.0)[:, None] * rng.normal(0.0, 1.0, (32, 100))
    read = turns + rng.normal(0.0, 0.02, turns.shape)
    gain = float((read * turns).sum() / np.square(read).sum())
    left = turns - gain * read
    noise = float(np.std(left))
    gained = np.square(read).sum(axis=1)[:, None, None] / noise**2
    gradients = -(read * left).sum(axis=1)[:, None] / noise**2
    pieces = pieces_of(np.arange(32.0), gained, gradients, np.array([[1e-9]]), 1.0)
    assert pieces is not None
    assert pieces.moved[-1] < -5.0 * pieces.sigmas[-1]
    by_noise = 1.0 / gained.sum(axis=0)
    assert pieces.widened(by_noise) < 1.3**2 * by_noise


class StandingOften(Robot):
    """It stands two thirds of the time, and its wheels slip while they roll."""

    def rates(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        forward, turn = super().rates(t)
        moving = np.clip(4.0 * np.sin(0.9 * t) - 1.5, 0.0, 1.0)
        return forward * moving, turn * moving

    def inputs(self) -> Inputs:
        rolling = super().inputs()
        assert rolling.wheels is not None
        rng = np.random.default_rng(self.seed + 3)
        path_m = np.abs(np.diff(rolling.wheels.totals[:, 0], prepend=0.0))
        slipped_rad = np.cumsum(0.01 * np.sqrt(path_m) * rng.standard_normal(len(path_m)))
        totals = rolling.wheels.totals + slipped_rad[:, None] * [0.0, 1.0]
        return replace(rolling, wheels=replace(rolling.wheels, totals=totals))


@pytest.mark.long
def test_wheels_that_stand_tell_nothing_of_how_much_they_slip() -> None:
    """Where they did, their turns were too short by six standard deviations."""
    pulls = []
    for seed in range(8):
        calibration = calibrate_inputs(StandingOften(seed=seed, seconds=60.0).inputs())
        assert calibration is not None
        pulls.append((calibration.value("turn_gain") - 1.0) / calibration.sigma("turn_gain"))
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_wheels_that_stopped_while_the_robot_drove_on_make_no_gyroscope_unsure() -> None:
    """What they say that they rolled is nothing, and their error is all of it."""
    inputs = Robot(seed=1, noise=3.0).inputs()
    assert inputs.wheels is not None
    totals = inputs.wheels.totals.copy()
    dead = len(totals) // 5
    totals[dead:] = totals[dead]
    calibration = calibrate_inputs(replace(inputs, wheels=replace(inputs.wheels, totals=totals)))
    assert calibration is not None
    assert calibration.sigma("gyro_gain") < 1e-3
    assert abs(calibration.value("gyro_gain") - 1.0) < 3.0 * calibration.sigma("gyro_gain")


@pytest.mark.parametrize("seed", [0, 1])
def test_few_blocks_tell_how_unsure_sizes_are_but_not_what_they_have_in_common(seed: int) -> None:
    """Of two drifts that seem 0.7 correlated in some turns the difference would be too sure."""
    calibration = calibrate_inputs(Robot(seed=seed).inputs())
    assert calibration is not None
    told, least = calibration.fit.covariance, calibration.fit.bound_covariance
    assert (calibration.fit.sigmas > 1.05 * calibration.fit.bounds).any()
    assert np.all(calibration.fit.sigmas > 0.999 * calibration.fit.bounds)
    np.testing.assert_allclose(_correlations(told), _correlations(least), atol=1e-9)


def _correlations(covariance: FloatArray) -> FloatArray:
    sigmas = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sigmas, sigmas))


def test_a_drift_is_as_unsure_as_the_offset_wanders() -> None:
    """The slope through pieces whose offsets scatter far beyond their noise, against its error."""
    rng, at_s = np.random.default_rng(4), np.arange(8.0)
    held, by_noise = 0, np.diag([1.0 / 8.0, 1.0 / np.square(at_s - at_s.mean()).sum()])
    for _ in range(60):
        wander = rng.normal(0.0, 10.0, 8)
        slope, mean = np.polyfit(at_s - at_s.mean(), wander, 1)
        moved = np.column_stack([wander - mean - slope * (at_s - at_s.mean()), np.zeros(8)])
        pieces = Pieces(at_s, moved, np.tile(np.diag([1.0, 1e-18]), (8, 1, 1)))
        sigma = float(np.sqrt(pieces.widened(by_noise, ((0, 1),))[1, 1]))
        held += abs(slope) < 1.96 * sigma
        assert pieces.widened(by_noise)[1, 1] == pytest.approx(by_noise[1, 1])
    assert 50 <= held < 60


def test_a_step_shows_in_pieces_that_tell_two_unknowns_only_together() -> None:
    """Gain and bias of rates that are the same all through a piece; the bias changes half-way."""
    rng, rate, noise = np.random.default_rng(2), np.array([0.9, 0.3, 0.5, 0.5, 0.5, 0.4]), 0.01
    gained, gradients = np.zeros((18, 2, 2)), np.zeros((18, 2))
    for block in range(18):
        turning = rate[block // 3] + rng.normal(0.0, 1e-3, 200)
        left = np.where(block < 9, -0.02, 0.02) + rng.normal(0.0, noise, 200)
        slopes = np.column_stack([turning, np.ones(200)]) / noise
        gained[block], gradients[block] = slopes.T @ slopes, -slopes.T @ left / noise
    pieces = pieces_of(np.arange(18.0), gained, gradients, 1e-6 * np.eye(2), 1.0)
    assert pieces is not None
    assert pieces.sigmas[:, 1].min() > 0.1
    bias = pieces.each_alone(np.array([0.02, np.inf]))
    assert bias.sigmas[:, 1].max() < 0.02
    assert (np.abs(bias.moved[:, 1] - np.repeat([-0.02, 0.02], 3)) < 3.0 * bias.sigmas[:, 1]).all()
    free = pieces.each_alone(np.array([np.inf, np.inf]))
    np.testing.assert_allclose(free.moved, pieces.moved)
    np.testing.assert_allclose(free.sigmas, pieces.sigmas)


def _late(steps: FloatArray, share: float) -> BoolArray:
    return np.asarray(np.arange(len(steps)) > share * len(steps))


def knocked(degrees: float, share: float) -> Change:
    def change(steps: FloatArray) -> FloatArray:
        angle, late = np.deg2rad(degrees), _late(steps, share)
        cos, sin = np.cos(angle), np.sin(angle)
        steps[late, :2] = steps[late, :2] @ np.array([[cos, -sin], [sin, cos]])
        return steps

    return change


@pytest.mark.long
@pytest.mark.parametrize(("degrees", "share"), [(1.9, 0.5), (-1.0, 0.35), (5.0, 0.65)])
def test_a_laser_that_is_knocked_during_the_drive_is_told_with_the_instant(
    degrees: float, share: float
) -> None:
    robot = Robot(seconds=80.0)
    calibration = calibrate_inputs(seen(robot.inputs(), knocked(degrees, share)))
    assert calibration is not None
    found = {one.check: one for one in check_changes(calibration)}
    told = found["laser.steady"]
    assert told.fault == "laser_moved" and told.estimate is not None and told.plots
    assert abs(told.estimate.value) == pytest.approx(abs(degrees), rel=0.15)
    begin_s, end_s = (float(word) for word in told.words.split(" s after")[0].split()[-3::2])
    assert begin_s - 6.0 < share * robot.seconds < end_s + 6.0
    assert {one.fault for one in found.values()} == {"laser_moved", None}


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))]
)
def test_healthy_sizes_do_not_change(seed: int) -> None:
    """Not even by as much as their standard deviations make a fault of, whatever the limits."""
    calibration = Robot(seconds=60.0, seed=seed).calibrated()
    assert {one.verdict for one in check_changes(calibration)} == {"ok"}
    pieces = calibration.fit.pieces
    assert pieces is not None
    for quantity in (one for each in changes.QUANTITIES.values() for one in each):
        steps = list(changes._steps(pieces.each_alone(changes._others_change()), quantity))
        assert steps
        assert all(abs(one.size.value) < SURE_SIGMAS * one.size.sigma for one in steps)
