"""The joint fit: against motions known in closed form and slow ways to the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_example import TRACK_M, Robot, without
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from scan_recording import healthy
from scipy.optimize import least_squares

from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.calibration.model import LASER, UNKNOWNS, Model
from slamsim.check.calibration.noise import blocks, shared_scans, whitened, whitening
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.questions.clocks.excitation import check_sensors
from slamsim.core.geometry import wrap_angle
from slamsim.core.types import FloatArray, ScanGeometry
from slamsim.models.jackknife import jackknife
from slamsim.recording import RawImu

SMALL = st.floats(-1.0, 1.0)


def errors(found: Calibration, robot: Robot) -> dict[str, tuple[float, float]]:
    """Estimate less truth, and sigma."""
    truth = {
        "gyro_gain": 1.0 / robot.gyro_scale,
        "gyro_bias_rad_s": robot.gyro_bias / robot.gyro_scale,
        "path_gain": 1.0 / robot.radius,
        "turn_gain": robot.track / robot.radius,
        "curvature_rad_m": 0.0,
        "laser_x_m": robot.T_base_laser[0],
        "laser_y_m": robot.T_base_laser[1],
        "laser_yaw_rad": robot.T_base_laser[2],
    }
    return {name: (found.value(name) - value, found.sigma(name)) for name, value in truth.items()}


@settings(max_examples=8, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    seed=st.integers(0, 999), off=st.tuples(*[SMALL] * 9), lidar_late=st.sampled_from([0.0, 3.0])
)
def test_what_is_off_is_found(seed: int, off: tuple[float, ...], lidar_late: float) -> None:
    robot = Robot(
        seed=seed,
        lidar_late_s=lidar_late + 0.2 * off[0],
        gyro_late_s=0.1 * off[1],
        wheels_late_s=0.1 * off[2],
        gyro_scale=1.0 + 0.1 * off[3],
        radius=1.0 + 0.1 * off[4],
        track=1.0 + 0.1 * off[5],
        T_base_laser=np.array([0.08 + 0.1 * off[6], -0.02 + 0.1 * off[7], 0.3 + 0.2 * off[8]]),
    )
    found = robot.calibrated()
    assume(found.follows("gyro"))  # the turns of one drive in a hundred repeat, mirrored
    for name, (error, sigma) in errors(found, robot).items():
        assert abs(error) < 6.0 * sigma + 1e-4, name
        assert sigma < {"laser_yaw_rad": 1e-3}.get(name, 3e-3), name
    for pair, late in (
        ("gyro", robot.gyro_late_s - robot.lidar_late_s),
        ("wheel", robot.wheels_late_s - robot.lidar_late_s),
        ("gyro_wheel", robot.wheels_late_s - robot.gyro_late_s),
    ):
        offset, sigma, bound = found.offset(pair)
        assert abs(offset - late) < 6.0 * sigma
        assert bound < sigma * 2.0
        assert sigma < 1e-3


@pytest.mark.parametrize("drift", [2e-4, -3e-3])
def test_a_clock_that_runs_away(drift: float) -> None:
    robot = Robot(lidar_drift=drift)
    found = robot.calibrated()
    for pair in ("gyro", "wheel"):
        growth, sigma, _ = found.drift(pair)
        assert abs(growth + drift / (1.0 + drift)) < 6.0 * sigma + 1e-6


@pytest.mark.parametrize(("missing", "pair"), [("steps", "gyro_wheel"), ("gyro", "wheel")])
def test_two_streams_are_enough_for_their_offset(missing: str, pair: str) -> None:
    robot = Robot(wheels_late_s=0.05)
    found = calibrate_inputs(without(robot.inputs(), missing))
    assert found is not None
    offset, sigma, _ = found.offset(pair)
    assert abs(offset - 0.05) < 6.0 * sigma


@pytest.mark.parametrize("seed", range(4))
def test_without_scans_turns_that_differ_by_slip_leave_an_honest_offset(seed: int) -> None:
    """Wheels that slip at random in each step: the turns tell what they are good for."""
    robot = Robot(seed=seed)
    inputs = without(robot.inputs(), "steps")
    assert inputs.wheels is not None
    totals = inputs.wheels.totals.copy()
    rng = np.random.default_rng(seed)
    totals[:, 1] += np.cumsum(rng.normal(0.0, 3e-3, len(totals)))
    found = calibrate_inputs(replace(inputs, wheels=replace(inputs.wheels, totals=totals)))
    assert found is not None
    offset, sigma, bound = found.offset("gyro_wheel")
    assert abs(offset) < 3.0 * sigma and bound > 3e-4


def test_noise_of_the_wheels_draws_no_gain_toward_nothing() -> None:
    """Noise a tenth as large as their turns makes a plain regression 0.4 % too small."""
    found = []
    for seed in range(6):
        robot = Robot(seed=seed, track=1.05)
        inputs = robot.inputs()
        assert inputs.wheels is not None
        totals = inputs.wheels.totals.copy()
        slip_rad = 0.1 * float(np.std(np.diff(totals[:, 1])))
        totals[:, 1] += np.cumsum(np.random.default_rng(seed).normal(0.0, slip_rad, len(totals)))
        calibration = calibrate_inputs(
            replace(inputs, wheels=replace(inputs.wheels, totals=totals))
        )
        assert calibration is not None
        found.append(calibration.value("turn_gain"))
    error, scatter = np.mean(found) / 1.05 - 1.0, np.std(found) / np.sqrt(len(found))
    assert abs(error) < 3.0 * scatter < 3e-3


def test_noise_of_scans_draws_no_gain_of_the_wheels_away() -> None:
    """Whose noise it is nothing tells without a gyroscope: as of logs whose stamps scatter."""
    robot = Robot(seed=1)
    inputs = without(robot.inputs(), "gyro")
    steps = inputs.steps
    moved = steps.T_first_second.copy()
    moved[:, 2] += np.random.default_rng(1).normal(0.0, 0.3 * np.std(moved[:, 2]), len(moved))
    noisy = replace(inputs, steps=replace(steps, T_first_second=moved))
    calibration = calibrate_inputs(noisy)
    assert calibration is not None
    error = calibration.value("turn_gain") - 1.0
    assert abs(error) < 3.0 * calibration.sigma("turn_gain") < 0.05


def test_no_sigma_is_smaller_than_noise_makes_it() -> None:
    """A jackknife over the few blocks of a short drive finds less by chance."""
    for seed in range(4):
        found = Robot(seed=seed, seconds=24.0).calibrated()
        assert (found.fit.sigmas >= found.fit.bounds * (1.0 - 1e-9)).all()
        for pair in ("gyro", "wheel", "gyro_wheel"):
            _, sigma, bound = found.drift(pair)
            assert sigma >= bound


def test_one_stream_alone_has_nothing_to_be_compared_with() -> None:
    inputs = Robot(seconds=8.0).inputs()
    assert calibrate_inputs(without(without(inputs, "gyro"), "wheels")) is None
    assert calibrate_inputs(without(without(inputs, "gyro"), "steps")) is None


def slow_prediction(robot: Robot, model: Model, values: FloatArray, pair: int) -> FloatArray:
    """(4,) laser's motion by wheels and turn by gyroscope, walked along in tiny steps."""
    named = dict(zip(UNKNOWNS, values, strict=True))
    ticks, imu, steps = robot.ticks(), robot.imu(), model.steps
    middle_ns = int(steps.first_ns[0] + (steps.second_ns[-1] - steps.first_ns[0]) // 2)
    begin, end = (
        (int(stamps[pair]) - middle_ns) * 1e-9 for stamps in (steps.first_ns, steps.second_ns)
    )

    def times(delay: float, drift: float) -> FloatArray:
        first, last = (one + delay + drift * one for one in (begin, end))
        return np.asarray(np.linspace(first, last, 400))

    assert model.wheels is not None
    wheel_s = (ticks.stamps_ns - middle_ns) * 1e-9
    totals = np.column_stack(
        [
            np.interp(times(named["wheel_delay_s"], named["wheel_drift"]), wheel_s, column)
            for column in model.wheels.totals.T
        ]
    )
    x = y = yaw = 0.0
    for path, turn in np.diff(totals, axis=0):
        lever = 0.25 * TRACK_M**2 * named["curvature_rad_m"]
        forward = named["path_gain"] * path + lever * turn
        bend = named["turn_gain"] * turn + named["curvature_rad_m"] * path
        x += forward * np.cos(yaw + 0.5 * bend)
        y += forward * np.sin(yaw + 0.5 * bend)
        yaw += bend
    tx, ty, tyaw = values[LASER]
    moved = np.array(
        [x + np.cos(yaw) * tx - np.sin(yaw) * ty - tx, y + np.sin(yaw) * tx + np.cos(yaw) * ty - ty]
    )
    cos, sin = np.cos(tyaw), np.sin(tyaw)
    seen = np.array([cos * moved[0] + sin * moved[1], -sin * moved[0] + cos * moved[1], yaw])

    at = times(named["gyro_delay_s"], named["gyro_drift"])
    nearest = np.abs((imu.stamps_ns - middle_ns)[:, None] * 1e-9 - 0.5 * (at[1:] + at[:-1]))
    rates = imu.angular_velocity_rad_s[nearest.argmin(axis=0), 2]
    turned = float((named["gyro_gain"] * rates - named["gyro_bias_rad_s"]) @ np.diff(at))
    return np.append(seen, turned)


@settings(max_examples=6)
@given(seed=st.integers(0, 99), off=st.tuples(*[SMALL] * 12))
def test_predictions_against_tiny_steps(seed: int, off: tuple[float, ...]) -> None:
    robot = Robot(seed=seed, seconds=12.0, noise=0.0)
    inputs = robot.inputs()
    steps = inputs.steps
    middle_ns = int(steps.first_ns[0] + (steps.second_ns[-1] - steps.first_ns[0]) // 2)
    model = Model(steps, inputs.gyro, inputs.wheels, middle_ns, (0, 0))
    sizes = [0.1, 0.01, 0.02, 1e-3, 0.1, 0.1, 0.05, 0.02, 1e-3, 0.2, 0.2, 0.5]
    healthy = [1, 0, 0, 0, 1, 1, 0, 0, 0, 0.08, -0.02, 0.3]
    values = np.array(healthy) + np.array(sizes) * np.array(off)
    T_wheels, turned = model.predicted(values)
    for pair in (20, 77, 150):
        slow = slow_prediction(robot, model, values, pair)
        # Readings are rounded to a tenth of a millimetre, and joined by curves or by lines.
        assert np.abs(T_wheels[pair] - slow[:3]).max() < 4e-4
        assert abs(float(wrap_angle(turned[pair] - slow[3]))) < 4e-4


def test_the_fit_against_a_slow_dense_one() -> None:
    robot = Robot(seed=3, seconds=24.0, gyro_late_s=0.01)
    found = robot.calibrated()
    model = found.model
    variances = np.append(2.09 * np.array([5e-4, 5e-4, 1.2e-4]) ** 2, 1e-10)
    spread = np.vstack([np.eye(3), [0.0, 0.0, 1.0]])
    own = np.diag([2e-9, 2e-9, 2e-7, 1e-9])
    covariance = spread @ np.diag(variances[:3]) @ spread.T + own
    root = np.linalg.cholesky(np.linalg.inv(covariance))
    scales = found.fit.sigmas

    def weighed(moved: FloatArray) -> FloatArray:
        return (model.residual(found.fit.values + moved * scales) @ root).ravel()

    slow = least_squares(weighed, np.zeros(len(UNKNOWNS)), method="lm")
    # Other weights, other errors: but both are estimates of the same numbers.
    assert np.abs(slow.x).max() < 3.0


def test_whitening_against_a_dense_covariance() -> None:
    robot = Robot(seconds=8.5)
    steps, share = robot.steps(), np.array([0.3, 0.45])
    rng = np.random.default_rng(0)
    parts = list(blocks(steps))
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(steps)))
    part = parts[1]
    column = rng.standard_normal((len(steps), 2))
    white = whitened(whitening(part, steps, share), column[part])
    scans = np.unique([steps.first[part], steps.second[part]])
    incidence = (steps.second[part][:, None] == scans).astype(float) - (
        steps.first[part][:, None] == scans
    )
    for k, mine in enumerate(share):
        dense = (1.0 - 2.0 * mine) * np.eye(part.size) + mine * incidence @ incidence.T
        assert np.allclose(
            dense,
            (1 - 2 * mine) * np.eye(part.size)
            + mine * shared_scans(steps.first[part], steps.second[part]),
        )
        expected = column[part, k] @ np.linalg.solve(dense, column[part, k])
        assert white[:, k] @ white[:, k] == pytest.approx(expected)


def test_no_block_is_empty_where_scans_are_missing() -> None:
    """Means of nothing made a clock's drift unsure by nan."""
    steps = Robot(seconds=8.5).steps()
    begun_s = (steps.first_ns - steps.first_ns[0]) * 1e-9
    window = replace(steps, window=np.zeros_like(steps.window))
    parts = list(blocks(window.select((begun_s < 1.0) | (begun_s > 7.0))))
    assert len(parts) > 1
    assert min(part.size for part in parts) > 0


def test_the_jackknife_against_leaving_out_and_fitting_again() -> None:
    rng = np.random.default_rng(1)
    design, noise = rng.standard_normal((20, 5, 3)), rng.standard_normal((20, 5))
    gained = np.einsum("bni,bnj->bij", design, design)
    whole = np.linalg.lstsq(design.reshape(-1, 3), noise.ravel(), rcond=None)[0]
    pushes = -np.einsum("bni,bn->bi", design, noise - design @ whole)
    left_out = []
    for block in range(20):
        kept = np.arange(20) != block
        fitted = np.linalg.lstsq(design[kept].reshape(-1, 3), noise[kept].ravel(), rcond=None)[0]
        left_out.append(fitted)
    apart = np.array(left_out) - np.mean(left_out, axis=0)
    slow = 19.0 / 20.0 * apart.T @ apart
    assert np.allclose(jackknife(gained.sum(axis=0), gained, pushes)[0], slow)


def test_a_lidar_that_tells_no_motion_is_not_called_missing() -> None:
    few = ScanGeometry(np.deg2rad(-150.0), np.deg2rad(60.0), 6, 0, 0.1, 30.0)
    recording = healthy(geometry=few)
    alone = recording.with_streams(RawImu, ())
    (found,) = check_sensors(RecordingEvidence(alone))
    assert found.verdict == "inconclusive"
    assert found.words.endswith("; the lidar tells no motion: scans do not fit one another")
