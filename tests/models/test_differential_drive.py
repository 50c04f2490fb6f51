"""Wheel odometry against fine Euler integration, and its random streams."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamsim.core.geometry import wrap_angle
from slamsim.core.randomness import random_stream
from slamsim.core.types import EncoderStream
from slamsim.models.differential_drive import wheel_odometry


@given(st.integers(-5000, 5000), st.integers(-5000, 5000), st.floats(-3.0, 3.0))
def test_an_arc_equals_many_tiny_steps(left: int, right: int, start_yaw: float) -> None:
    encoders = EncoderStream(
        np.array([0, 10], dtype=np.int64),
        np.array([[7, 3], [7 + left, 3 + right]]),
        1000,
        0.03,
        0.2,
    )
    end = wheel_odometry(encoders, np.array([1.0, 2.0, start_yaw])).poses[-1]

    steps = 20_000
    turn = (right - left) / 1000 * 2 * np.pi * 0.03 / 0.2
    forward = (right + left) / 2 / 1000 * 2 * np.pi * 0.03
    yaw = start_yaw + (np.arange(steps) + 0.5) / steps * turn
    expected = [
        1.0 + forward * np.cos(yaw).mean(),
        2.0 + forward * np.sin(yaw).mean(),
        start_yaw + turn,
    ]
    assert end[:2] == pytest.approx(expected[:2], abs=1e-5)
    assert wrap_angle(end[2] - np.array(expected[2])) == pytest.approx(0.0, abs=1e-9)


def test_a_drive_may_be_integrated_in_pieces() -> None:
    rng = np.random.default_rng(3)
    ticks = np.cumsum(rng.integers(-20, 60, size=(50, 2)), axis=0)
    stamps = np.arange(50, dtype=np.int64)
    whole = wheel_odometry(EncoderStream(stamps, ticks, 1000, 0.03, 0.2))
    head = wheel_odometry(EncoderStream(stamps[:20], ticks[:20], 1000, 0.03, 0.2))
    tail = wheel_odometry(EncoderStream(stamps[19:], ticks[19:], 1000, 0.03, 0.2), head.poses[-1])
    np.testing.assert_allclose(tail.poses[-1], whole.poses[-1], atol=1e-12)


def test_streams_differ_by_name_and_seed_only() -> None:
    draw = random_stream(1, "lidar", "noise").standard_normal(4)
    np.testing.assert_array_equal(draw, random_stream(1, "lidar", "noise").standard_normal(4))
    assert not np.any(draw == random_stream(1, "lidar", "dropout").standard_normal(4))
    assert not np.any(draw == random_stream(2, "lidar", "noise").standard_normal(4))
