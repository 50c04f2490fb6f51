"""Lengths in no metres: found and named on whichever side they are, and repaired."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from calibration_example import Robot
from hypothesis import given
from hypothesis import strategies as st
from scan_recording import healthy

from slamsim.check.calibration.distance_unit import (
    METRES,
    WrongUnit,
    in_metres,
    ratio_of_units,
)
from slamsim.check.calibration.joint import calibrate_inputs
from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport
from slamsim.check.motion.integrated import integrated_wheels
from slamsim.recording import RawOdometry, Recording
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.registry import load_fault


@cache
def damaged(name: str) -> Recording:
    return load_fault(name).inject(healthy(), np.random.default_rng(0))


def named(recording: Recording) -> set[str]:
    return {finding.fault for finding in check_recording(recording).faults if finding.fault}


@cache
def usual() -> set[str]:
    return named(healthy())


@cache
def reported(name: str) -> CheckReport:
    return check_recording(damaged(name))


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "wheels_millimetres",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in (
                "range_feet",
                "range_inches",
                "range_millimetres_throughout",
                "wheels_centimetres",
            )
        ),
    ],
)
def test_a_wrong_unit_is_named_and_its_mend_leaves_the_healthy_recording(name: str) -> None:
    recording, report = damaged(name), reported(name)
    units = [one for one in report.faults if one.fault in ("range_unit", "wheel_unit")]
    assert {one.fault for one in report.faults} - usual() == {load_fault(name).expects}

    repaired = apply_repairs(recording, [repair for one in units for repair in one.repairs])

    assert named(repaired) == usual()
    np.testing.assert_allclose(
        repaired.scans[0].ranges_m, healthy().scans[0].ranges_m, rtol=1e-5, atol=1e-5
    )
    np.testing.assert_allclose(
        repaired.odometries[0].positions_m, healthy().odometries[0].positions_m, atol=1e-6
    )


@pytest.mark.long
def test_ranges_without_any_other_stream_are_judged_by_the_room() -> None:
    alone = replace(
        damaged("range_millimetres_throughout").with_streams(RawOdometry, ()), transforms=()
    )

    assert "range_unit" in named(alone)
    assert "range_unit" not in named(
        replace(healthy().with_streams(RawOdometry, ()), transforms=())
    )


@given(
    ratio=st.sampled_from([*METRES.values(), *(1.0 / one for one in METRES.values())]),
    off=st.floats(-0.05, 0.05),
)
def test_ratios_near_those_of_units_are_meant_to_be_them(ratio: float, off: float) -> None:
    assert ratio_of_units(ratio * np.exp(off)) == pytest.approx(ratio)
    assert ratio_of_units(np.exp(off)) is None


@pytest.mark.long
@pytest.mark.parametrize("radius_alone", [False, True])
def test_the_fit_in_metres_is_that_of_wheels_in_metres(radius_alone: bool) -> None:
    """The slow way round: the counters read anew with the right radius and track."""
    robot = Robot()
    ticks, inputs = robot.ticks(), robot.inputs()
    track = 1.0 if radius_alone else 100.0
    wrong = replace(
        ticks, wheel_radius_m=100.0 * ticks.wheel_radius_m, track_m=track * ticks.track_m
    )
    calibration = calibrate_inputs(replace(inputs, wheels=integrated_wheels(wrong)))
    assert calibration is not None
    unit = WrongUnit("wheels", "/ticks", 0.01, (0.01, 1e-5), radius_alone)

    found = in_metres(calibration, unit, 1.0)

    right = robot.calibrated()
    np.testing.assert_allclose(found.fit.values, right.fit.values, atol=1e-6)
    np.testing.assert_allclose(found.fit.sigmas, right.fit.sigmas, rtol=1e-3, atol=1e-12)


def test_all_proposed_mends_of_a_wrong_unit_can_be_applied() -> None:
    name = "wheels_millimetres"
    assert apply_repairs(damaged(name), reported(name).repairs)
