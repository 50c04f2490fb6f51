"""A drive as a recording in memory, against the same drive written to a file and read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from recording_data import leaves
from sensing_example import PERFECT_LIDAR, Robot, drive_along, room, windows

from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import StaticTransform, matrix_from_rpy, se3_from_parts
from slamsim.io.open import read_recording
from slamsim.recording import Recording
from slamsim.sensors.rig import SensorRig
from slamsim.simulation.header import LogHeader
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.recorder import DriveRecorder

T = se3_from_parts(matrix_from_rpy(0.1, 0.0, 2.0), np.array([0.1, -0.2, 0.3]))
FIXED = (
    StaticTransform("base_footprint", "base_link", np.eye(4)),
    StaticTransform("base_link", "laser_link", T),
)
FILE_ALONE = (".unread", ".anomalies", ".topics")
"""What only a file can say."""
HEADER = LogHeader("<robot name='r'/>", FIXED, scan_rate_hz=10.0)


def both(config: SensorsConfig, folder: Path) -> tuple[Recording, Recording]:
    """The recording in memory and the one from the file."""
    drive = list(windows(drive_along(2.0, 240.0, yaw_rate_rad_s=0.5, speed_m_s=0.4), [100, 300]))
    rig = SensorRig(room(), Robot(), config, seed=4)
    readings = [rig.sense(window) for window in drive]
    with LogWriter(folder, HEADER) as log:
        for sensed, window in zip(readings, drive, strict=True):
            log.write(sensed, window)
    written = read_recording(folder)
    return DriveRecorder(written.name, HEADER).take(readings, drive).recording, written


def test_memory_and_file_say_the_same(tmp_path: Path) -> None:
    """Every stamp, number, frame and topic; only the format and what nobody reads may differ."""
    lidar = PERFECT_LIDAR.model_copy(update={"rate_hz": 10.0, "intensities": True})

    memory, written = both(SensorsConfig(lidar=lidar), tmp_path / "log")

    ours, theirs = dict(leaves(memory)), dict(leaves(written))
    for place, value in ours.items():
        if place in (".format",) or place.startswith(FILE_ALONE):
            continue
        other = theirs[place]
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, np.asarray(other), err_msg=place)
        else:
            assert value == other, place
    assert {p for p in theirs if not p.startswith(FILE_ALONE)} <= set(ours)


def test_a_stream_that_is_switched_off_is_in_neither(tmp_path: Path) -> None:
    config = SensorsConfig.model_validate(
        {"imu": {"enabled": False}, "encoders": {"enabled": False}, "lidar": {"rate_hz": 10.0}}
    )

    memory, written = both(config, tmp_path / "log")

    for recording in (memory, written):
        assert not recording.imus
        assert not recording.odometries
        assert not recording.ticks
        assert len(recording.scans) == 1
