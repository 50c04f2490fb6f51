"""All that the joint fit of scans, gyroscope and wheels can say of a recording."""

from __future__ import annotations

from slamsim.check.calibration import calibrate
from slamsim.check.crispness import crispness
from slamsim.check.excitation import check_excitation
from slamsim.check.findings import Finding
from slamsim.check.map_agreement import held_against_map
from slamsim.check.mounting import check_mounting
from slamsim.check.odometry import check_odometry, check_slip
from slamsim.check.reversing import check_reversing
from slamsim.check.rolling import check_wheels
from slamsim.check.scan_motion import ScanMotions
from slamsim.check.timing import check_timing
from slamsim.check.turning import check_gyro
from slamsim.check.votes import vote
from slamsim.recording import Recording


def check_calibration(recording: Recording, motions: ScanMotions | None) -> list[Finding]:
    """Clocks against each other, wheels, gyroscope and mounting; motions: of the first lidar."""
    alone = check_odometry(recording)
    calibration = calibrate(recording, motions)
    if calibration is None:
        words = "two of a lidar, an inertial unit and wheels are needed to compare them"
        return [*alone, Finding("calibration", recording.name, "cannot tell", words)]
    opinion = vote(calibration)
    return [
        *alone,
        *check_slip(calibration),
        *check_reversing(calibration),
        *held_against_map(check_timing(calibration), crispness(recording, motions, calibration)),
        *check_wheels(calibration, opinion),
        *check_gyro(calibration, opinion),
        *check_mounting(calibration),
        *check_excitation(calibration),
    ]
