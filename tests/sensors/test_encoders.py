"""Wheel encoders: whole ticks of the true angle, and every error as stated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensing_example import drive_along, figure_eight

from slamsim.config.sensors import EncoderConfig
from slamsim.core.types import Drive
from slamsim.models.differential_drive import wheel_odometry
from slamsim.sensors.motion import joined
from slamsim.sensors.readings import EncoderBatch
from slamsim.sensors.rig import Encoders

PERFECT = {"wheel_scale_error": [0.0, 0.0], "wheel_radius_error": 0.0, "track_error": 0.0}


def sensed(drive: Drive, seed: int = 0, **settings: Any) -> EncoderBatch:
    """What encoders on perfect wheels read, but for the given settings."""
    config = EncoderConfig.model_validate({**PERFECT, **settings})
    encoders = Encoders(config, 0.0352, 0.230, seed, 0)
    return encoders.sense(joined(None, drive))


@settings(max_examples=30)
@given(
    ticks=st.integers(1, 5000),
    rate_hz=st.floats(1.0, 500.0),
    speed=st.floats(-1.0, 1.0),
    turning=st.floats(-3.0, 3.0),
)
def test_a_count_is_the_true_angle_rounded_down(
    ticks: int, rate_hz: float, speed: float, turning: float
) -> None:
    drive = drive_along(2.0, 240.0, speed_m_s=speed, yaw_rate_rad_s=turning)
    batch = sensed(drive, ticks_per_revolution=ticks, rate_hz=rate_hz)
    t = batch.true_stamps_ns * 1e-9
    wheel = np.array([speed - 0.115 * turning, speed + 0.115 * turning]) / 0.0352
    exact = wheel * t[:, None] * ticks / (2 * np.pi)
    assert len(batch) == int(2.0 * rate_hz + 1e-9) + 1 or abs(2.0 * rate_hz % 1.0) < 1e-6
    assert ((batch.stream.ticks <= exact + 1e-6) & (batch.stream.ticks > exact - 1 - 1e-6)).all()


def test_noiseless_ticks_give_the_true_path_back() -> None:
    drive = drive_along(4.0, 240.0, speed_m_s=0.4, yaw_rate_rad_s=0.7)
    path = wheel_odometry(sensed(drive).stream)
    end = drive.trajectory().planar().at(path.stamps_ns[-1:])[0]
    np.testing.assert_allclose(path.poses[-1], end, atol=2e-3)


def test_what_the_driver_believes_of_the_wheels() -> None:
    drive = drive_along(1.0, 240.0, speed_m_s=0.5)
    plain = sensed(drive).stream
    assert (plain.wheel_radius_m, plain.track_m) == (0.0352, 0.230)
    wrong = sensed(drive, wheel_radius_error=0.05, track_error=-0.1).stream
    assert wrong.wheel_radius_m == pytest.approx(0.0352 * 1.05)
    assert wrong.track_m == pytest.approx(0.230 * 0.9)
    np.testing.assert_array_equal(wrong.ticks, plain.ticks)
    assert wheel_odometry(wrong).path_length_m() == pytest.approx(
        1.05 * wheel_odometry(plain).path_length_m()
    )


def test_unequal_wheels_bend_a_straight_path() -> None:
    drive = drive_along(4.0, 240.0, speed_m_s=0.5)
    path = wheel_odometry(sensed(drive, wheel_scale_error=[0.0, 0.02]).stream)
    assert path.poses[-1, 2] == pytest.approx(0.02 * 2.0 / 0.230, rel=0.02)


def test_tick_noise_spreads_readings_without_adding_up() -> None:
    drive = drive_along(40.0, 240.0, speed_m_s=0.5)
    error = sensed(drive, tick_noise=5.0).stream.ticks - sensed(drive).stream.ticks
    assert error.std() == pytest.approx(5.0, rel=0.05)
    assert abs(error[-100:].mean()) < 2.0


@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_missed_ticks_add_up_to_their_share_in_either_direction(speed: float) -> None:
    drive = drive_along(20.0, 240.0, speed_m_s=speed)
    all_of_them = sensed(drive).stream.ticks
    counted = sensed(drive, missed_tick_probability=0.1).stream.ticks
    np.testing.assert_array_equal(counted[0], all_of_them[0])
    assert counted[-1] / all_of_them[-1] == pytest.approx(0.9, abs=0.005)
    assert (np.diff(np.abs(counted), axis=0) >= 0).all()
    none = sensed(drive, missed_tick_probability=1.0).stream.ticks
    np.testing.assert_array_equal(none, np.tile(all_of_them[0], (len(none), 1)))


def test_the_errors_draw_from_streams_of_their_own() -> None:
    drive = figure_eight(4.0)
    plain = sensed(drive).stream.ticks
    noise = sensed(drive, tick_noise=3.0).stream.ticks - plain
    missed = sensed(drive, missed_tick_probability=0.2).stream.ticks - plain
    both = sensed(drive, tick_noise=3.0, missed_tick_probability=0.2).stream.ticks - plain
    np.testing.assert_array_equal(both, noise + missed)
    assert (sensed(drive, seed=1, tick_noise=3.0).stream.ticks - plain != noise).any()
