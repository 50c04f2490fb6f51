"""Scans of which every n-th beam was kept: one fault with one repair, and no other beside it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from calibration_example import T_BASE_LASER, Robot
from scan_recording import healthy, with_ranges

from slamsim.check.calibration.explanation import explain
from slamsim.check.calibration.joint import calibrate_inputs
from slamsim.check.calibration.thinned import thinned
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.laser_steps import (
    laser_motions,
    laser_steps,
    middle_sigma_s,
    thinned_by,
    times_of_all,
)
from slamsim.check.questions.laser import laser, mounting
from slamsim.recording.edits.base import SCANS
from slamsim.recording.edits.beams import CloseAngles
from slamsim.slam.laser.scan_motion import ScanMotions, ShapeEstimate

SPAN_RAD = np.deg2rad(270.0)
HALF_RAD = 0.25 * SPAN_RAD
"""Between the directions of the middle beam with and without the angle between those left."""


def motions(factor: float, sigma: float = 2e-4) -> ScanMotions:
    step = ShapeEstimate(factor, sigma, 1.0)
    return cast(ScanMotions, cast(Any, SimpleNamespace(angle_step=step, span_rad=SPAN_RAD)))


@pytest.mark.parametrize(
    ("factor", "sigma", "every"),
    [
        (2.0003, 2e-4, 2),
        (2.9990, 4e-4, 3),
        (1.0, 2e-4, 1),
        (0.5, 2e-4, 1),
        (2.01, 2e-4, 1),
        (2.0, 0.1, 1),
        (2.0, np.inf, 1),
        (1.0, np.inf, 1),
    ],
)
def test_a_whole_multiple_of_the_declared_angle_that_is_known_as_one_is_of_beams_left_out(
    factor: float, sigma: float, every: int
) -> None:
    assert thinned_by(motions(factor, sigma)) == every


@pytest.mark.parametrize(
    ("found_s", "sigma_s", "lasts_s"),
    [
        (0.0395, 2e-4, 0.04),  # told
        (0.033, 5e-3, 0.04),  # rather than 20 ms
        (0.05, np.inf, 0.04),
        (0.0202, 2e-4, 0.02),  # as declared
        (0.0265, 5e-3, 0.02),
        (0.03, 2e-4, 0.03),  # another sweep
    ],
)
def test_the_time_between_beams_goes_with_the_angle_unless_scans_say_otherwise(
    found_s: float, sigma_s: float, lasts_s: float
) -> None:
    """Scans of 40 Hz, of which no sweep is told, made the lidar 4.9 ms early: half of what is
    missing."""
    whole = laser_motions(healthy())
    assert whole is not None
    given_up = np.array([lasts_s == 0.03, True, False])
    sweep, step = ShapeEstimate(found_s, sigma_s, 0.02), ShapeEstimate(2.0, 2e-4, 1.0)
    of_half = replace(whole, sweep_s=sweep, angle_step=step, contradicted=given_up)
    assert times_of_all(of_half) == (lasts_s == 0.04)
    steps = laser_steps(of_half)
    assert steps.sweep_s == lasts_s
    later_ns = (
        steps.first_ns - laser_steps(replace(whole, sweep_s=replace(sweep, sigma=0.0))).first_ns
    )
    np.testing.assert_array_equal(later_ns, round(0.5e9 * (lasts_s - 0.02)))
    assert (middle_sigma_s(of_half) > 0.0) == (lasts_s == 0.03)


def looking(off_rad: float, upside_down: bool) -> Inputs:
    """A laser that looks further to the left, seen from above, than it is declared to."""
    robot = Robot(T_base_laser=T_BASE_LASER + np.array([0.0, 0.0, off_rad]))
    return replace(robot.inputs(), upside_down=upside_down)


@pytest.mark.parametrize(
    ("off_rad", "upside_down", "pivot", "is_fault"),
    [
        (HALF_RAD, False, "first", False),
        (-HALF_RAD, False, "last", False),
        (0.0, False, "middle", False),
        (HALF_RAD, True, "last", False),
        (HALF_RAD + 0.02, False, "first", True),
        (-0.02, False, "middle", True),
    ],
)
def test_the_beam_that_kept_its_direction_turns_no_laser(
    off_rad: float, upside_down: bool, pivot: str, is_fault: bool
) -> None:
    calibration = calibrate_inputs(looking(off_rad, upside_down))
    assert calibration is not None
    found = thinned(motions(2.0), calibration)
    assert found is not None and (found.every, found.pivot) == (2, pivot)
    answers = mounting.check_mounting(calibration, explain(calibration), found)
    (yaw,) = (one for one in answers if one.check == mounting.YAW.id)
    assert (yaw.fault is not None) == is_fault
    assert yaw.estimate is not None
    left_rad = off_rad - found.turned_rad
    assert yaw.estimate.value == pytest.approx(np.degrees(left_rad), abs=0.15)
    if is_fault:
        declared_rad = float(T_BASE_LASER[2]) + left_rad
        assert yaw.repairs[0].parameters["yaw_rad"] == pytest.approx(declared_rad, abs=0.003)


@pytest.mark.long
def test_angle_time_and_direction_of_a_thinned_scan_are_told_and_mended_once() -> None:
    """Here the laser sits at the base, and looks where it does as of the first beam."""
    scans = np.asarray(healthy().scans[0].ranges_m, dtype=np.float64)[:, ::2]
    of = CloseAngles(SCANS).apply(with_ranges(healthy(), scans))
    evidence = RecordingEvidence(of)
    found = {one.check: one for one in [*laser._asked(evidence), *laser._angles(evidence)]}
    assert {one.fault for one in found.values()} == {None, "laser_angle_step"}
    sweep, step = found["laser.sweep"], found["laser.angle_step"]
    assert sweep.verdict == "inconclusive" and "of every 2 beams" in sweep.words
    assert [(one.operation, one.parameters["factor"]) for one in step.repairs] == [
        ("scale_angles", 2.0),
        ("scale_beam_times", 2.0),
    ]
