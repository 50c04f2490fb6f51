"""Faults of the sensing itself: a drive sensed with them, against what each beam must then see."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sensing_example import PERFECT_LIDAR, Robot, drive_along, room

from slamsim.config.lidar import LidarConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.recording import RawScans, Recording
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.faults.registry import declared, faulty_sensors, kinds, load_fault
from slamsim.sensors.motion import Motion
from slamsim.sensors.rig import SensorRig
from slamsim.simulation.header import LogHeader
from slamsim.simulation.recorder import DriveRecorder

HALF_X_M, HALF_Y_M = 4.0, 3.0
HEADER = LogHeader(robot_description="<robot name='r'/>", static_transforms=(), scan_rate_hz=10.0)
SENSORS = SensorsConfig(lidar=PERFECT_LIDAR.model_copy(update={"rate_hz": 10.0}))
HALF_TURN = LidarConfig.model_validate(
    {
        **SENSORS.lidar.model_dump(),
        "angle_min_deg": -30.0,
        "beam_count": 361,
        "angle_step_deg": 0.5,
    }
)
DRIVE = drive_along(3.0, 240.0, yaw_rate_rad_s=0.9, speed_m_s=0.5)


def sensed(faults: list[Fault], config: SensorsConfig = SENSORS) -> Recording:
    sensors, override = faulty_sensors(faults, config)
    rig = SensorRig(room(HALF_X_M, HALF_Y_M), Robot(), sensors, seed=2, override=override)
    recording = DriveRecorder("room", HEADER).take([rig.sense(DRIVE)], [DRIVE]).recording
    return declared(recording, faults, config, seed=2)


def scans_of(recording: Recording) -> tuple[RawScans, Float32Array]:
    scans = recording.scans[0]
    assert isinstance(scans.ranges_m, np.ndarray)
    return scans, scans.ranges_m


def seen(stamps_ns: IntArray, directions_map: FloatArray) -> FloatArray:
    """(n,) ranges in the room from the laser at these instants along (n, 2) directions.

    By hand: the nearest of the four walls ahead.
    """
    motion = Motion(DRIVE)
    rotations = matrix_from_xyzw(motion.quats_xyzw_at(stamps_ns))
    laser = motion.positions_at(stamps_ns) + rotations @ Robot().T_base_laser[:3, 3]
    half = np.array([HALF_X_M, HALF_Y_M])
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = (np.sign(directions_map) * half - laser[:, :2]) / directions_map
    return np.asarray(np.where(directions_map == 0.0, np.inf, ahead).min(axis=1))


def beam_instants(config: LidarConfig, stamps_ns: IntArray, firing: IntArray) -> IntArray:
    """(n * beams,) when each beam fires; firing: (beams,) the number in the order of firing."""
    return np.asarray((stamps_ns[:, None] + firing * config.beam_dt_ns).ravel())


def angles_of(config: LidarConfig) -> FloatArray:
    beams = np.arange(config.beam_count)
    return np.asarray(np.radians(config.angle_min_deg + beams * config.angle_step_deg))


def test_rays_fixed_to_the_world_start_at_the_laser_and_never_turn() -> None:
    scans, ranges = scans_of(sensed([load_fault("laser_world_fixed")]))
    lidar, angles = SENSORS.lidar, angles_of(SENSORS.lidar)
    instants = beam_instants(lidar, scans.stamps_ns, np.arange(angles.size))
    directions = np.tile(np.column_stack([np.cos(angles), np.sin(angles)]), (len(scans), 1))

    assert_allclose(ranges.ravel(), seen(instants, directions), atol=5e-5)


@pytest.mark.parametrize("lidar", [SENSORS.lidar, HALF_TURN])
def test_a_lidar_that_turns_clockwise_sees_the_right_places_in_the_wrong_order(
    lidar: LidarConfig,
) -> None:
    """Readings stand at their angles, but the last beam of the message was the first to fire."""
    config = SENSORS.model_copy(update={"lidar": lidar})

    scans, ranges = scans_of(sensed([load_fault("rplidar_time_reversed")], config))

    level = level_directions(lidar, scans.stamps_ns, np.arange(lidar.beam_count)[::-1])
    assert_allclose(ranges.ravel(), level, atol=5e-5)
    wrong_order = level_directions(lidar, scans.stamps_ns, np.arange(lidar.beam_count))
    assert np.abs(ranges.ravel() - wrong_order).max() > 0.1


def test_a_mirrored_scan_sees_the_right_side_on_its_left() -> None:
    lidar = SENSORS.lidar
    scans, ranges = scans_of(sensed([load_fault("laser_mirrored")]))

    expected = level_directions(lidar, scans.stamps_ns, np.arange(lidar.beam_count), mirror=-1.0)
    assert_allclose(ranges.ravel(), expected, atol=5e-5)


def level_directions(
    lidar: LidarConfig, stamps_ns: IntArray, firing: IntArray, mirror: float = 1.0
) -> FloatArray:
    """Ranges of a scan whose beams fire in this order."""
    instants = beam_instants(lidar, stamps_ns, firing)
    rotations = matrix_from_xyzw(Motion(DRIVE).quats_xyzw_at(instants))
    angles = np.tile(mirror * angles_of(lidar), stamps_ns.size)
    x, y = rotations[:, :2, 0], rotations[:, :2, 1]
    directions = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * y
    return seen(instants, directions)


def test_a_flash_scan_sees_one_instant_and_declares_a_sweep() -> None:
    lidar = SENSORS.lidar
    healthy, _ = scans_of(sensed([]))

    scans, ranges = scans_of(sensed([load_fault("irsim_flash_timed")]))

    assert scans.layouts == healthy.layouts
    expected = level_directions(
        lidar.model_copy(update={"rolling": False}),
        scans.stamps_ns,
        np.arange(lidar.beam_count),
    )
    assert_allclose(ranges.ravel(), expected, atol=5e-5)


@pytest.mark.parametrize(
    "name", ["laser_world_fixed", "laser_mirrored", "rplidar_time_reversed", "irsim_flash_timed"]
)
def test_a_faulty_twin_shares_all_but_the_scans(name: str) -> None:
    healthy, faulty = sensed([]), sensed([load_fault(name)])

    for kind in ("imus", "odometries", "ticks"):
        for one, other in zip(getattr(healthy, kind), getattr(faulty, kind), strict=True):
            assert_array_equal(one.stamps_ns, other.stamps_ns)
    assert_array_equal(
        healthy.imus[0].angular_velocity_rad_s, faulty.imus[0].angular_velocity_rad_s
    )
    assert_array_equal(healthy.ticks[0].ticks, faulty.ticks[0].ticks)
    together = min(len(healthy.scans[0]), len(faulty.scans[0]))
    assert_array_equal(healthy.scans[0].stamps_ns[:together], faulty.scans[0].stamps_ns[:together])
    assert not np.array_equal(healthy.scans[0].ranges_m[0], faulty.scans[0].ranges_m[0])


def test_what_is_injected_into_a_finished_recording_is_near_to_what_is_sensed() -> None:
    """Of foreign recordings: most beams within the width of a few beams of the truth."""
    recording = sensed([])
    for kind in ("beam_time_reversed", "flash_scan_timed", "laser_mirrored"):
        assert issubclass(kinds()[kind], SensedFault)
    for name in ("rplidar_time_reversed", "irsim_flash_timed", "laser_mirrored"):
        fault = load_fault(name)
        _, truly = scans_of(sensed([fault]))
        _, nearly = scans_of(fault.inject(recording, np.random.default_rng(0)))
        count = min(len(truly), len(nearly))
        apart = np.abs(truly[:count] - nearly[:count])
        near = apart[np.isfinite(apart)] < 0.05
        assert near.mean() > 0.7, name
