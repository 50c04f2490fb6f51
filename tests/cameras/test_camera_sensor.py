"""Noise, response, exposure and occlusion of image sensors beside their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from slamsim.cameras.align import DepthAlignment
from slamsim.cameras.auto_exposure import AutoExposure
from slamsim.cameras.lens import pinhole
from slamsim.cameras.response import ImageSensor, response_curve
from slamsim.cameras.settings import ExposureConfig, SensorConfig
from slamsim.core.types import FloatArray
from slamsim.sensors.cameras.imager import hidden_from_right

LENS = pinhole(160, 120, 70.0)
LINEAR = {"response": "linear", "vignetting": 0.0, "electrons_per_s": 1e6, "full_well_e": 1e4}


def exposed(config: SensorConfig, radiance: float, exposure_s: float, gain: float) -> FloatArray:
    light = np.full((160 * 120, 3), radiance, dtype=np.float32)
    values, _ = ImageSensor(config, LENS).exposed(light, exposure_s, gain, np.random.default_rng(1))
    return values.astype(np.float64)


@pytest.mark.parametrize(
    ("radiance", "exposure_s", "gain", "read_e"),
    [(0.5, 0.002, 4.0, 30.0), (0.2, 0.01, 4.0, 3.0), (0.05, 0.002, 60.0, 4.0)],
)
def test_mean_and_variance_are_those_of_emva_1288(
    radiance: float, exposure_s: float, gain: float, read_e: float
) -> None:
    """Grey values: mean K e, variance K^2 (read^2 + e) + 1/12, K the gain over all; within 5 %."""
    config = SensorConfig.model_validate({**LINEAR, "read_noise_e": read_e, "adc_bits": 8})
    values = exposed(config, radiance, exposure_s, gain)
    electrons, per_electron = 1e6 * radiance * exposure_s, gain * 255.0 / 1e4
    assert values.mean() == pytest.approx(per_electron * electrons, rel=0.05)
    expected = per_electron**2 * (read_e**2 + electrons) + 1.0 / 12.0
    assert expected > 0.5
    assert values.var() == pytest.approx(expected, rel=0.05)


def test_without_noise_every_pixel_is_alike() -> None:
    plain = {**LINEAR, "shot_noise": False, "read_noise_e": 0.0}
    assert np.ptp(exposed(SensorConfig.model_validate(plain), 0.5, 0.004, 1.0)) == 0.0


def test_a_full_well_and_the_largest_value_are_ends() -> None:
    config = SensorConfig.model_validate({**LINEAR, "read_noise_e": 0.0})
    assert (exposed(config, 10.0, 0.01, 1.0) == 255.0).all()
    assert (exposed(config, 0.0, 0.01, 1.0) == 0.0).all()


def test_corners_are_darker_by_the_vignetting() -> None:
    plain = {**LINEAR, "vignetting": 0.4, "shot_noise": False, "read_noise_e": 0.0}
    values = exposed(SensorConfig.model_validate(plain), 0.8, 0.01, 1.0).reshape(120, 160, 3)
    assert values[0, 0, 0] / values[60, 80, 0] == pytest.approx(0.6, abs=0.01)
    assert values[0, 80, 0] / values[60, 80, 0] == pytest.approx(1.0 - 0.4 * 0.36, abs=0.01)


def test_the_curve_is_that_of_srgb() -> None:
    """IEC 61966-2-1: the middle grey of 18 % is 118, and 0.0031308 the end of the straight part."""
    curve = response_curve(SensorConfig(adc_bits=16))
    assert (curve[0], curve[-1], curve[round(0.18 * 65535)]) == (0, 255, 118)
    assert curve[round(0.0031308 * 65535)] == 10
    assert (np.diff(curve.astype(int)) >= 0).all()


def test_a_mosaic_keeps_plain_colours() -> None:
    plain = {**LINEAR, "bayer": True, "shot_noise": False, "read_noise_e": 0.0}
    light = np.tile(np.array([0.6, 0.4, 0.2], dtype=np.float32), (160 * 120, 1))
    sensor = ImageSensor(SensorConfig.model_validate(plain), LENS)
    values, _ = sensor.exposed(light, 0.01, 1.0, np.random.default_rng(0))
    inside = values.reshape(120, 160, 3)[2:-2, 2:-2]
    np.testing.assert_array_equal(inside.reshape(-1, 3), np.tile([[153, 102, 51]], (156 * 116, 1)))


@settings(max_examples=60)
@given(st.floats(0.002, 20.0), st.floats(0.0, 1.0), st.floats(5.0, 60.0))
def test_exposure_settles_where_the_target_is_met(light: float, lag_s: float, rate: float) -> None:
    """A linear sensor whose mean is light times exposure times gain, cut off at one."""
    config = ExposureConfig(lag_s=lag_s, target=0.2)
    auto = AutoExposure(config, rate)
    for _ in range(int(12.0 * lag_s * rate) + 30):
        auto.measured(min(50.0 * light * auto.exposure_s * auto.gain, 1.0))
    reached = 50.0 * light * auto.exposure_s * auto.gain
    most = 50.0 * light * config.exposure_max_s * config.gain_max
    least = 50.0 * light * config.exposure_min_s
    assert reached == pytest.approx(min(max(0.2, least), most), rel=0.01)
    assert auto.gain == 1.0 or auto.exposure_s == config.exposure_max_s


def test_exposure_follows_with_its_lag() -> None:
    """After one lag 37 % of the difference is left, counted in stops."""
    auto = AutoExposure(ExposureConfig(lag_s=0.5, exposure_s=0.004), 30.0)
    for _ in range(15):
        auto.measured(0.2 * auto.exposure_s / 0.008)
    left = np.log(0.008 / auto.exposure_s) / np.log(2.0)
    assert left == pytest.approx(np.exp(-1.0), rel=0.01)


def test_exposure_that_is_not_automatic_stays() -> None:
    auto = AutoExposure(ExposureConfig(auto=False, exposure_s=0.003, gain=2.0), 30.0)
    auto.measured(0.9)
    assert (auto.exposure_s, auto.gain) == (0.003, 2.0)


@settings(max_examples=40)
@given(
    st.floats(0.8, 1.5),
    st.floats(1.8, 5.0),
    st.integers(5, 25),
    st.integers(3, 12),
    st.floats(0.03, 0.1),
)
def test_the_right_camera_does_not_see_behind_a_near_edge(
    near_m: float, far_m: float, first: int, width: int, baseline_m: float
) -> None:
    """A board before a wall: each pixel's line to the right camera, met with the board by hand."""
    columns, focal = 40, 30.0
    rays = (np.arange(columns) - 19.5) / focal
    on_board = (np.arange(columns) >= first) & (np.arange(columns) < first + width)
    depths = np.where(on_board, near_m, far_m).astype(np.float32)
    edges_m = (np.array([first - 0.5, first + width - 0.5]) - 19.5) / focal * near_m
    hidden = hidden_from_right(depths[None], focal * baseline_m)[0]
    for column in np.flatnonzero(~on_board):
        at = np.array([rays[column] * far_m, far_m])
        crossing = baseline_m + (at[0] - baseline_m) * near_m / far_m
        # Half a pixel at the edges, where it matters which part of a pixel is looked at.
        inside = edges_m + np.array([1.0, -1.0]) * near_m / focal
        outside = edges_m - np.array([1.0, -1.0]) * near_m / focal
        if inside[0] < crossing < inside[1]:
            assert hidden[column] or at[0] > edges_m[1] * far_m / near_m
        if not outside[0] < crossing < outside[1]:
            assert not hidden[column]
    assert not hidden[on_board].any()


@settings(max_examples=25)
@given(st.floats(0.5, 4.0), st.floats(-0.1, 0.1), st.floats(-4.0, 4.0))
def test_aligned_depth_is_that_of_the_plane(depth_m: float, right_m: float, yaw_deg: float) -> None:
    """A wall across the depth camera's axis, as the other camera's rays meet it by hand."""
    camera, other = pinhole(80, 60, 70.0), pinhole(64, 48, 55.0)
    assume(abs(yaw_deg) > 0.1)
    turn = np.radians(yaw_deg)
    R = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, [-right_m, 0.0, 0.0]
    depths = np.full((60, 80), round(1e3 * depth_m), dtype=np.uint16)
    aligned = DepthAlignment(camera, other, T).aligned(depths)
    normal, plane = R[:, 2], 1e-3 * depths[0, 0] + R[:, 2] @ T[:3, 3]
    rays = other.rays() / other.rays()[:, 2:]
    expected = (plane / (rays @ normal)).reshape(48, 64)
    points = (rays * expected.reshape(-1, 1) - T[:3, 3]) @ R
    pixels, seen = camera.project(points)
    well_inside = seen & ((pixels > 2.0) & (pixels < [77.0, 57.0])).all(axis=1)
    inside = well_inside.reshape(48, 64)
    assert inside.mean() > 0.2
    assert (aligned[inside] > 0).all()
    slope = 1.5 * depth_m * abs(np.tan(turn)) / 40.0 + 1e-3
    assert np.abs(1e-3 * aligned[inside] - expected[inside]).max() < 3.0 * slope
