"""The rig: the same bytes for any windows, each stream free of the others, bad input refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensing_example import (
    Robot,
    drive_along,
    figure_eight,
    joined_meshes,
    prism,
    rectangle,
    room,
    standing,
    windows,
)

from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import Drive
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig

WORLD = joined_meshes(
    [room(), prism(rectangle(1.9, -0.3, 2.1, 0.4)), prism(rectangle(-3, 1, -2, 2))]
)
CLOCK = {
    "offset_s": 0.1,
    "drift_ppm": 80.0,
    "jitter_s": 0.002,
    "latency_s": 0.01,
    "latency_jitter_s": 0.03,
    "drop_probability": 0.2,
}
EVERYTHING_ON = SensorsConfig.model_validate(
    {
        "lidar": {
            "rate_hz": 31.0,
            "phase_s": 0.004,
            "angle_step_deg": 2.0,
            "angle_min_deg": -180.0,
            "beam_count": 179,
            "intensities": True,
            "noise": {"constant_m": 0.01, "proportional": 0.01, "spot_mrad": 2.0},
            "dropout": {"probability": 0.05, "at_max_range": 0.1, "at_grazing": 0.1},
            "mixed": {"divergence_mrad": 30.0, "probability": 0.5},
            "clock": CLOCK,
        },
        "imu": {
            "rate_hz": 173.0,
            "gyro": {"scale_error": [0.01, 0.0, 0.02], "resolution": 0.001},
            "clock": CLOCK,
        },
        "encoders": {
            "rate_hz": 57.0,
            "phase_s": 0.001,
            "tick_noise": 0.7,
            "missed_tick_probability": 0.05,
            "clock": CLOCK,
        },
    }
)
DRIVE = figure_eight(0.7)


def all_of(parts: Sequence[Readings]) -> dict[str, np.ndarray[Any, Any]]:
    """Every array of the readings, end to end."""
    columns = [_arrays(part) for part in parts]
    return {name: np.concatenate([column[name] for column in columns]) for name in columns[0]}


def _arrays(readings: Readings) -> dict[str, np.ndarray[Any, Any]]:
    scans, imu, encoders = readings.scans, readings.imu, readings.encoders
    assert scans.intensities is not None
    return {
        "scan stamps": scans.stamps_ns,
        "scan truth": scans.true_stamps_ns,
        "scan arrival": scans.arrival_ns,
        "ranges": scans.ranges_m,
        "intensities": scans.intensities,
        "imu stamps": imu.stream.stamps_ns,
        "imu truth": imu.true_stamps_ns,
        "imu arrival": imu.arrival_ns,
        "gyro": imu.stream.angular_velocity_rad_s,
        "accelerometer": imu.stream.linear_acceleration_m_s2,
        "encoder stamps": encoders.stream.stamps_ns,
        "encoder truth": encoders.true_stamps_ns,
        "encoder arrival": encoders.arrival_ns,
        "ticks": encoders.stream.ticks,
    }


def sensed(drive: Drive, cuts: Sequence[int] = (), threads: int = 1) -> list[Readings]:
    rig = SensorRig(WORLD, Robot(), EVERYTHING_ON, seed=3, threads=threads)
    return [rig.sense(window) for window in windows(drive, cuts)]


@cache
def whole() -> dict[str, np.ndarray[Any, Any]]:
    return all_of(sensed(DRIVE))


@settings(max_examples=40)
@given(st.lists(st.integers(2, len(DRIVE) - 1), max_size=60))
def test_the_same_bytes_however_the_drive_is_cut(cuts: list[int]) -> None:
    pieces = all_of(sensed(DRIVE, cuts))
    for name, values in whole().items():
        assert pieces[name].tobytes() == values.tobytes(), name


def test_the_same_bytes_step_by_step_and_on_two_threads() -> None:
    for pieces in (all_of(sensed(DRIVE, range(2, len(DRIVE)))), all_of(sensed(DRIVE, threads=2))):
        for name, values in whole().items():
            assert pieces[name].tobytes() == values.tobytes(), name


def test_batches_of_many_scans_are_the_same_bytes_as_scan_by_scan() -> None:
    """The default lidar: a long window is cast in several batches, short ones in their own."""
    drive = figure_eight(4.0)
    whole = SensorRig(WORLD, Robot(), SensorsConfig(), seed=1).sense(drive).scans.ranges_m
    rig = SensorRig(WORLD, Robot(), SensorsConfig(), seed=1)
    parts = [rig.sense(w).scans.ranges_m for w in windows(drive, range(5, len(drive), 7))]
    assert len(whole) == 160
    assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_every_sample_is_covered_and_none_is_left_out() -> None:
    quiet = SensorsConfig()
    rig = SensorRig(WORLD, Robot(), quiet, seed=0)
    covered = 0
    counts = np.zeros(3, dtype=int)
    for window in windows(figure_eight(2.0), range(30, 480, 30)):
        readings = rig.sense(window)
        before, covered = covered, int(window.stamps_ns[-1])
        scans, imu, encoders = readings.scans, readings.imu, readings.encoders
        ends = scans.true_stamps_ns + scans.geometry.duration_ns
        for done in (ends, imu.true_stamps_ns + 2_500_000, encoders.true_stamps_ns):
            assert ((done <= covered) & ((done > before) | (before == 0))).all()
        assert (scans.arrival_ns >= ends).all()
        counts += [len(scans), len(imu), len(encoders)]
    # 2 s: scans at 0, 25, ... 1975 ms; inertial samples at 5, ... 1995 ms; ticks at 0, ... 2000 ms
    assert counts.tolist() == [80, 399, 101]


def test_a_stream_depends_on_itself_only() -> None:
    base = SensorRig(WORLD, Robot(), EVERYTHING_ON, seed=3).sense(DRIVE)
    without = EVERYTHING_ON.model_copy(
        update={"imu": EVERYTHING_ON.imu.model_copy(update={"enabled": False, "rate_hz": 9.0})}
    )
    readings = SensorRig(WORLD, Robot(), without, seed=3).sense(DRIVE)
    assert len(readings.imu) == 0
    assert readings.imu.stream.angular_velocity_rad_s.shape == (0, 3)
    np.testing.assert_array_equal(readings.scans.ranges_m, base.scans.ranges_m)
    np.testing.assert_array_equal(readings.encoders.stream.ticks, base.encoders.stream.ticks)


def test_a_late_sensor_does_not_keep_the_drive_in_memory() -> None:
    off = {"enabled": False}
    config = SensorsConfig.model_validate({"lidar": off, "imu": off, "encoders": off})
    rig = SensorRig(WORLD, Robot(), config, seed=0)
    for window in windows(standing(4.0), range(100, 960, 100)):
        readings = rig.sense(window)
        assert (len(readings.scans), len(readings.imu), len(readings.encoders)) == (0, 0, 0)
        assert rig._motion is not None
        assert len(rig._motion.drive) == 2


def test_streams_start_with_the_drive_whatever_its_epoch() -> None:
    drive = drive_along(0.5, 240.0, yaw_rate_rad_s=1.0)
    later = replace(drive, stamps_ns=drive.stamps_ns + 1_700_000_000_000_000_000)
    here = SensorRig(WORLD, Robot(), SensorsConfig(), seed=0).sense(drive)
    there = SensorRig(WORLD, Robot(), SensorsConfig(), seed=0).sense(later)
    np.testing.assert_array_equal(
        there.scans.stamps_ns - here.scans.stamps_ns, 1_700_000_000_000_000_000
    )
    np.testing.assert_allclose(
        here.scans.ranges_m, there.scans.ranges_m, atol=0.0015, equal_nan=True
    )


def test_iterating_a_batch_gives_its_scans() -> None:
    scans = SensorRig(WORLD, Robot(), EVERYTHING_ON, seed=3).sense(DRIVE).scans
    listed = list(scans)
    assert len(listed) == len(scans) > 5
    assert listed[2].stamp_ns == scans.stamps_ns[2]
    np.testing.assert_array_equal(listed[2].ranges_m, scans.ranges_m[2])
    assert scans.intensities is not None
    np.testing.assert_array_equal(listed[2].intensities, scans.intensities[2])


@pytest.mark.parametrize("name", ["positions_m", "quats_xyzw", "angular_velocity_rad_s"])
def test_a_motion_that_is_not_finite_is_refused_with_its_place(name: str) -> None:
    drive = standing(0.1)
    values = getattr(drive, name).copy()
    values[7, 1] = np.nan
    rig = SensorRig(WORLD, Robot(), SensorsConfig(), seed=0)
    with pytest.raises(ValueError, match=f"{name} of a drive: 1 of .* not finite.* number 7"):
        rig.sense(replace(drive, **{name: values}))


def test_windows_that_do_not_follow_on_are_refused() -> None:
    rig = SensorRig(WORLD, Robot(), SensorsConfig(), seed=0)
    first, second = windows(standing(0.2), [20])
    rig.sense(first)
    with pytest.raises(ValueError, match="stamp must be later"):
        rig.sense(first)
    assert len(rig.sense(second).encoders) > 0  # the refused window left no trace
    one_step = next(windows(standing(0.2), [1]))
    with pytest.raises(ValueError, match="at least two steps"):
        SensorRig(WORLD, Robot(), SensorsConfig(), seed=0).sense(one_step)
