"""All that the joint fit of scans, gyroscope and wheels can say of a recording."""

from __future__ import annotations

from slamsim.check.calibration.joint import calibrate
from slamsim.check.calibration.majority import vote
from slamsim.check.findings import Finding
from slamsim.check.map_quality.agreement import held_against_map
from slamsim.check.map_quality.crispness import crispness
from slamsim.check.questions.clocks.excitation import check_excitation
from slamsim.check.questions.clocks.offsets import check_timing
from slamsim.check.questions.inertial.gyroscope import check_gyro
from slamsim.check.questions.laser.mounting import check_mounting
from slamsim.check.questions.wheels.direction import check_reversing
from slamsim.check.questions.wheels.distance_unit import check_unit, in_metres, of_slip, wrong_unit
from slamsim.check.questions.wheels.odometry import check_odometry, check_slip
from slamsim.check.questions.wheels.sizes import check_wheels
from slamsim.recording import Recording
from slamsim.slam.laser.scan_motion import ScanMotions


def check_calibration(recording: Recording, motions: ScanMotions | None) -> list[Finding]:
    """Clocks against each other, wheels, gyroscope and mounting; motions: of the first lidar."""
    alone = check_odometry(recording)
    calibration = calibrate(recording, motions)
    if calibration is None:
        words = "two of a lidar, an inertial unit and wheels are needed to compare them"
        return [*alone, Finding("calibration", recording.name, "cannot tell", words)]
    unit = wrong_unit(recording, motions, calibration)
    metres_per_unit = motions.metres_per_unit if motions else 1.0
    metric = in_metres(calibration, unit, metres_per_unit)
    placed = calibration if unit is not None and unit.side == "ranges" else metric
    opinion = vote(metric)
    return [
        *alone,
        *check_unit(unit),
        *of_slip(check_slip(metric), unit, metres_per_unit),
        *check_reversing(metric),
        *held_against_map(check_timing(metric), crispness(recording, motions, placed)),
        *check_wheels(metric, opinion),
        *check_gyro(metric, opinion),
        *check_mounting(metric),
        *check_excitation(metric),
    ]
