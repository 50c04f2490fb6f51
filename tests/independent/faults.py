"""All faults by name."""

from __future__ import annotations

from independent.fault import Fault
from independent.faults_drivers import DRIVER_FAULTS
from independent.faults_frames import FRAME_FAULTS
from independent.faults_inertial import INERTIAL_FAULTS
from independent.faults_laser import LASER_FAULTS
from independent.faults_messages import MESSAGE_FAULTS
from independent.faults_odometry import ODOMETRY_FAULTS
from independent.faults_scans import SCAN_FAULTS
from independent.faults_sized import SIZED
from independent.faults_stamps import STAMP_FAULTS
from independent.faults_wheels import WHEEL_FAULTS

EVERY = (
    *SIZED,
    *LASER_FAULTS,
    *SCAN_FAULTS,
    *STAMP_FAULTS,
    *MESSAGE_FAULTS,
    *WHEEL_FAULTS,
    *ODOMETRY_FAULTS,
    *FRAME_FAULTS,
    *INERTIAL_FAULTS,
    *DRIVER_FAULTS,
)

FAULTS: dict[str, Fault] = {each.name: each for each in EVERY}
