"""Slip is not told where single beams fit the wheels' motion: people ahead are no slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_example import T_BASE_LASER, Robot

from slamsim.check.calibration.joint import Calibration, calibrate_inputs
from slamsim.check.calibration.model import PATH_GAIN, TURN_GAIN
from slamsim.check.calibration.slip_beams import _plainly_fewer, mistaken_scans
from slamsim.check.calibration.slipping import find_spells
from slamsim.check.motion.inputs import from_above
from slamsim.check.motion.integrated import integrated_wheels
from slamsim.check.questions.wheels.slip import check_slip
from slamsim.core.geometry import compose
from slamsim.core.types import FloatArray
from slamsim.recording import RawScans, ScanLayout

ROOM_M, NOISE_M = 12.0, 0.02
ANGLES = np.deg2rad(np.arange(-135.0, 136.0, 3.0))
SLOWED = slice(300, 340)
"""Steps of two seconds."""


def scans_of(robot: Robot, sign: float = 1.0, angles: FloatArray = ANGLES) -> RawScans:
    """From where the laser truly was at each scan of ``Robot.steps``, in a square room. sign: -1 as
    a lidar that hangs upside down counts its angles."""
    t = np.arange(0.05, robot.seconds - 0.05, 0.05)
    poses = robot.totals()[2]
    at = np.column_stack([np.interp(t, robot.times_s(), poses[:, k]) for k in range(3)])
    laser = compose(at, T_BASE_LASER)
    middle = 0.5 * (laser[:, :2].min(axis=0) + laser[:, :2].max(axis=0))
    heading = laser[:, 2:] + sign * angles
    way = np.stack([np.cos(heading), np.sin(heading)], axis=2)
    ahead = np.sign(way) * ROOM_M - (laser[:, None, :2] - middle)
    ranges = np.min(ahead / way, axis=2)
    ranges += np.random.default_rng(0).normal(0.0, NOISE_M, ranges.shape)
    step = float(angles[1] - angles[0])
    layout = ScanLayout(float(angles[0]), float(angles[-1]), step, 0.0, 0.05, 0.1, 40.0)
    stamps = np.round(1e9 * t).astype(np.int64)
    layouts = (layout,), np.zeros(len(t), dtype=np.int32), ranges.astype(np.float32)
    return RawScans("/scan", ("laser",), stamps, None, *layouts)


def told(calibration: Calibration | None, scans: RawScans) -> tuple[set[str], set[str]]:
    """The faults by the motions alone, and by the beams as well."""
    assert calibration is not None
    mistaken = mistaken_scans(calibration, scans, NOISE_M)
    alone, beside = check_slip(calibration), check_slip(calibration, mistaken)
    first, second = ({one.fault for one in found} - {None} for found in (alone, beside))
    return {str(name) for name in first}, {str(name) for name in second}


def slowed(T_steps: FloatArray) -> FloatArray:
    """As scans tell that follow somebody who walks ahead."""
    found = T_steps.copy()
    found[SLOWED, :2] *= 0.5
    return found


@pytest.mark.parametrize("upside_down", [False, True])
def test_scans_that_follow_somebody_who_walks_ahead_tell_no_slip(upside_down: bool) -> None:
    robot = Robot(seed=3)
    inputs = robot.inputs()
    steps = replace(inputs.steps, T_first_second=slowed(inputs.steps.T_first_second))
    inputs = replace(inputs, steps=steps, upside_down=upside_down)
    scans = scans_of(robot, -1.0 if upside_down else 1.0)
    assert told(calibrate_inputs(inputs), scans) == ({"wheel_slip"}, set())


@pytest.mark.parametrize(("upside_down", "every"), [(False, 1), (True, 1), (False, 10)])
def test_wheels_that_slip_are_told_by_beams_too(upside_down: bool, every: int) -> None:
    """every: of the beams; ten of them are too few to say anything."""
    robot = Robot(seed=3)
    ticks = robot.ticks()
    gain = np.ones(len(ticks) - 1)
    gain[700:800] = 1.4
    turned = np.diff(ticks.ticks, axis=0) * gain[:, None]
    slipped = np.vstack([ticks.ticks[:1], ticks.ticks[0] + np.cumsum(turned, axis=0)])
    wheels = integrated_wheels(replace(ticks, ticks=slipped.astype(np.int64)))
    inputs = replace(robot.inputs(), wheels=wheels)
    if upside_down:  # not declared: found by the turns
        inputs = replace(inputs, steps=from_above(inputs.steps))
    scans = scans_of(robot, -1.0 if upside_down else 1.0, ANGLES[::every])
    assert told(calibrate_inputs(inputs), scans) == ({"wheel_slip"}, {"wheel_slip"})


@pytest.mark.parametrize(
    ("for_scans", "for_wheels", "fewer"),
    [(20, 19, True), (0, 84, True), (0, 3, True), (0, 0, False), (7, 2, False), (8, 6, False)],
)
def test_few_beams_that_mostly_fit_the_scans_leave_a_slip_told(
    for_scans: int, for_wheels: int, fewer: bool
) -> None:
    """The first are of people ahead, the last two of a corridor with 120 beams."""
    assert _plainly_fewer(for_scans, for_wheels) is fewer


def test_wheels_that_are_fitted_with_no_size_do_not_stand() -> None:
    """As where most scans of a corridor see no motion, and some do."""
    inputs = Robot(seed=3).inputs()
    moved = inputs.steps.T_first_second.copy()
    moved[:300] *= 1e-4
    moved[340:] *= 1e-4
    fitted = calibrate_inputs(inputs)
    assert fitted is not None
    values = fitted.fit.values.copy()
    values[PATH_GAIN], values[TURN_GAIN] = 1e-4, 1e-4
    fitted.model.steps = replace(inputs.steps, T_first_second=moved)
    assert not find_spells(fitted.model, values).frozen.any()


def test_wheels_stand_where_they_report_no_motion() -> None:
    robot = Robot(seed=3)
    ticks = robot.ticks()
    turned = np.diff(ticks.ticks, axis=0)
    turned[700:900] = 0
    counted = np.vstack([ticks.ticks[:1], ticks.ticks[0] + np.cumsum(turned, axis=0)])
    wheels = integrated_wheels(replace(ticks, ticks=counted.astype(np.int64)))
    fitted = calibrate_inputs(replace(robot.inputs(), wheels=wheels))
    assert fitted is not None and fitted.spells is not None
    assert fitted.spells.frozen.any()
