"""Each of several lidars is asked about its place, its clock and its beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from two_lidars import REAR, front_and_rear

from slamsim.check.check import check_recording
from slamsim.recording import RawScans, Recording


def faults(recording: Recording) -> set[tuple[str, str]]:
    """(name, subject) of each fault that is found."""
    report = check_recording(recording)
    return {(one.fault, one.subject) for one in report.findings if one.fault is not None}


def test_two_lidars_that_are_right_raise_no_alarm() -> None:
    assert faults(front_and_rear()) == set()


@pytest.mark.long
@pytest.mark.parametrize(
    ("off", "name"),
    [
        ((0.0, 0.0, np.deg2rad(2.0)), "laser_yaw"),
        pytest.param((0.05, 0.0, 0.0), "laser_position", marks=pytest.mark.slow),
    ],
)
def test_the_second_lidar_sits_elsewhere_than_declared(
    off: tuple[float, float, float], name: str
) -> None:
    assert faults(front_and_rear(rear=REAR + np.array(off))) == {(name, "rear_laser")}


@pytest.mark.long
def test_the_second_lidar_is_late() -> None:
    recording = front_and_rear()
    front, rear = recording.scans
    # The one turn of twenty seconds tells a time to some 10 ms.
    late = replace(rear, stamps_ns=rear.stamps_ns + 100_000_000)
    found = faults(recording.with_streams(RawScans, (front, late)))
    assert found == {("time_offset_lidar", "/rear/scan")}


def test_a_quick_check_does_not_compare_the_scans_of_either() -> None:
    quick = check_recording(front_and_rear(), quick=True)
    assert not any(one.check.startswith("laser.yaw") for one in quick.findings)
