"""Every fault of a stream shows what it rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_recording import healthy
from two_lidars import FRONT, REAR, front_and_rear

from slamsim.check.check import check_recording
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Plot
from slamsim.check.recorded import recorded_plot
from slamsim.recording import RawImu, RawOdometry, Recording
from slamsim.report.pages.check import check_page


def fault(recording: Recording, name: str) -> Finding:
    return next(one for one in check_recording(recording).faults if one.fault == name)


def lowest(plot: Plot) -> float:
    curve = plot.curves[0]
    return float(curve.x[np.argmin(curve.y)])


@pytest.fixture(scope="module")
def scaled() -> Finding:
    """A gyroscope that reads 1.3 times the turn."""
    wrong = healthy().changed(
        RawImu, lambda imu: replace(imu, angular_velocity_rad_s=1.3 * imu.angular_velocity_rad_s)
    )
    return fault(wrong, "gyro_scale")


def test_a_scale_is_the_slope_of_what_both_streams_turn(scaled: Finding) -> None:
    points, declared, found = scaled.plots[0].curves
    slope = np.polyfit(points.x, points.y, 1)[0]
    assert slope == pytest.approx(1.0 / 1.3, abs=0.02)
    assert np.ptp(declared.y) == pytest.approx(np.ptp(declared.x))
    assert np.ptp(found.y) / np.ptp(found.x) == pytest.approx(slope, abs=0.02)


def test_the_misfit_is_least_at_what_was_found_and_larger_as_declared() -> None:
    late = healthy().changed(RawImu, lambda imu: replace(imu, stamps_ns=imu.stamps_ns + 60_000_000))
    evidence = RecordingEvidence(late)
    assert evidence.calibration is not None
    plot = evidence.plot_of("time.offset.imu")
    assert plot is not None and lowest(plot) == pytest.approx(60.0, abs=6.0)
    as_declared = plot.curves[1]
    assert as_declared.x.tolist() == [0.0, 0.0] and plot.curves[0].y.max() > 1.5
    assert RecordingEvidence(late).plot_of("time.offset.imu") is None  # nothing was calibrated


@pytest.mark.long
def test_a_laser_that_is_turned_shows_where_the_streams_fit_best() -> None:
    declared = FRONT + np.array([0.0, 0.0, np.deg2rad(3.0)])
    whole = front_and_rear(rear=REAR)
    edges = tuple(
        replace(edge, quats_xyzw=_turned(edge.quats_xyzw, 3.0)) if edge.child == "front_laser"
        else edge
        for edge in whole.transforms
    )  # fmt: skip
    found = fault(replace(whole, transforms=edges), "laser_yaw")
    assert lowest(found.plots[0]) == pytest.approx(np.degrees(declared[2]) - 3.0, abs=0.5)


def _turned(quats_xyzw: np.ndarray, degrees: float) -> np.ndarray:
    half = np.deg2rad(degrees) / 2.0
    z, w = quats_xyzw[:, 2], quats_xyzw[:, 3]
    turned = quats_xyzw.copy()
    turned[:, 2] = z * np.cos(half) + w * np.sin(half)
    turned[:, 3] = w * np.cos(half) - z * np.sin(half)
    return turned


def test_what_is_recorded_keeps_its_spikes_however_many_rows_there_are() -> None:
    imu = healthy().imus[0]
    rates = imu.angular_velocity_rad_s.copy()
    rates[1777, 2], rates[2345, 1] = 40.0, -30.0
    spiked = healthy().changed(RawImu, lambda each: replace(each, angular_velocity_rad_s=rates))
    plot = recorded_plot(spiked, imu.topic)
    assert plot is not None
    about = {curve.label: curve for curve in plot.curves}
    assert about["about z"].y.max() == 40.0 and about["about y"].y.min() == -30.0
    assert len(about["about x"].x) <= 1200
    assert recorded_plot(spiked, "nowhere") is None


def test_a_fault_without_a_plot_of_its_own_shows_the_stream() -> None:
    jumping = healthy().changed(
        RawOdometry,
        lambda each: replace(
            each, positions_m=each.positions_m + 5.0 * (np.arange(len(each)) > 600)[:, None]
        ),
    )
    found = fault(jumping, "odometry_jump")
    (plot,) = found.plots
    steps = max(np.abs(np.diff(curve.y)).max() for curve in plot.curves[:2])
    assert steps == pytest.approx(5.0, abs=0.1)


def test_the_page_draws_the_transform_tree_and_marks_what_a_fault_names() -> None:
    report = check_recording(front_and_rear(), quick=True)
    page = check_page(report)
    assert "Transform tree" in page and "rear_laser" in page
    named = replace(report, findings=(Finding("tf.links", "base_footprint -> rear_laser", "fault",
                                              "no link", "tf_missing_link"),))  # fmt: skip
    assert "named by a fault" in check_page(named) and "named by a fault" not in page
