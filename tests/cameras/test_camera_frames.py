"""Frames of cameras beside what is worked out by hand: rows, blur, flow, truth, determinism."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from camera_example import (
    decoded,
    frames,
    pixels,
    recorded,
    room_depth,
    sensors,
    small,
    the_camera,
    true_images,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from sensing_example import drive_along, figure_eight, room, standing

from slamsim.cameras.appearance import PlainGrey
from slamsim.cameras.lens import pinhole
from slamsim.core.types import Float32Array, FloatArray
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.motion import Motion
from slamsim.sensors.scene import Scene

YAW_RATE, SPEED = 0.9, 0.4
TURNING = drive_along(0.6, 240.0, 0.3, YAW_RATE, SPEED)
T_LINK_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def optical_pose(seconds: float) -> tuple[FloatArray, FloatArray]:
    """Origin and axes of the optical frame on the circle of ``TURNING``, by its formula."""
    yaw = 0.3 + YAW_RATE * seconds
    chord, middle = SPEED * seconds * np.sinc(YAW_RATE * seconds / (2 * np.pi)), (0.3 + yaw) / 2
    base = np.array([chord * np.cos(middle), chord * np.sin(middle), 0.0])
    R = Rotation.from_euler("z", yaw).as_matrix()
    origin = base + R @ np.array([0.1, 0.05, 0.4])
    turned = Rotation.from_euler("z", yaw + np.radians(20.0)).as_matrix()
    return origin, turned @ T_LINK_OPTICAL


def test_poses_of_rows_are_those_of_the_drive() -> None:
    """Below 0.1 mm and 0.01 degrees, at the instant of each row."""
    config = sensors(imagers={"color": small(readout_s=0.03)})
    messages = frames(recorded(config, TURNING), "color")
    assert len(messages) > 1
    for message in messages:
        seconds = np.array(message.row_instants_ns) * 1e-9
        expected_s = message.instant_ns * 1e-9 + np.linspace(0, 0.03, 24)
        np.testing.assert_allclose(seconds, expected_s, atol=1e-9)
        places = np.array(message.positions_m).reshape(-1, 3)
        turns = Rotation.from_quat(np.array(message.quats_xyzw).reshape(-1, 4))
        for row, at_s in enumerate(seconds):
            origin, axes = optical_pose(float(at_s))
            assert np.linalg.norm(places[row] - origin) < 1e-4
            off = (turns[row].inv() * Rotation.from_matrix(axes)).magnitude()
            assert np.degrees(off) < 0.01


@pytest.mark.parametrize("readout_s", [0.0, 0.04])
def test_each_row_sees_from_where_the_camera_is_at_its_instant(readout_s: float) -> None:
    """Each pixel's ray by hand, met with the planes of the room; within 0.1 mm."""
    config = sensors(imagers={"color": small(readout_s=readout_s, truth=["depth", "normals"])})
    messages = recorded(config, TURNING)
    focal = 16.0 / np.tan(np.radians(35.0))
    depth, normals = (true_images(messages, "color", what)[3] for what in ("depth", "normals"))
    truth = frames(messages, "color")[3]
    for row in range(24):
        at_s = truth.instant_ns * 1e-9 + readout_s * row / 23.0
        origin, axes = optical_pose(at_s)
        for column in range(0, 32, 3):
            ray = np.array([(column - 15.5) / focal, (row - 11.5) / focal, 1.0])
            expected = room_depth(origin, axes @ ray)
            if np.isfinite(expected):
                assert depth[row, column] == pytest.approx(expected, abs=1e-4)
                normal = axes @ normals[row, column]
                assert np.abs(normal).max() == pytest.approx(1.0, abs=1e-5)
                assert normals[row, column] @ ray < 0.0
            else:
                assert np.isnan(depth[row, column])


def moved_by_hand(
    pixel: tuple[int, int], depth_m: float, at_s: float, next_s: float, readout_s: float
) -> FloatArray:
    """Where a pixel's point is in the next image: the row whose instant sees it there."""
    focal = 16.0 / np.tan(np.radians(35.0))
    column, row = pixel
    origin, axes = optical_pose(at_s + readout_s * row / 23.0)
    ray = np.array([(column - 15.5) / focal, (row - 11.5) / focal, 1.0])
    point = origin + axes @ ray * depth_m

    def seen(from_row: float) -> FloatArray:
        origin, axes = optical_pose(next_s + readout_s * np.clip(from_row, 0.0, 23.0) / 23.0)
        x, y, z = axes.T @ (point - origin)
        return np.array([focal * x / z + 15.5, focal * y / z + 11.5])

    found = brentq(lambda from_row: seen(from_row)[1] - from_row, -200.0, 200.0, xtol=1e-9)
    return np.asarray(seen(float(found)) - np.array(pixel))


@pytest.mark.parametrize("readout_s", [0.0, 0.04])
def test_flow_is_that_of_points_followed_by_hand(readout_s: float) -> None:
    """Within 0.01 pixels, the poses being those of the drive's formula."""
    truth = ["depth", "flow"]
    config = sensors(imagers={"color": small(readout_s=readout_s, truth=truth)})
    messages = recorded(config, TURNING)
    flows, depths = (true_images(messages, "color", what) for what in ("flow", "depth"))
    stamps = [frame.instant_ns * 1e-9 for frame in frames(messages, "color")]
    assert len(flows) == len(depths) - 1
    worst = 0.0
    for number in (0, 2):
        assert (np.isfinite(flows[number]).all(axis=2) == np.isfinite(depths[number])).all()
        for column, row in [(0, 23), (5, 14), (16, 12), (31, 20), (27, 9)]:
            depth_m = float(depths[number][row, column])
            assert np.isfinite(depth_m)
            at_s, next_s = stamps[number : number + 2]
            expected = moved_by_hand((column, row), depth_m, at_s, next_s, readout_s)
            worst = max(worst, float(np.abs(flows[number][row, column] - expected).max()))
            assert np.abs(expected).max() > 0.5
    assert worst < 0.01


def test_flow_on_the_floor_is_a_homography() -> None:
    """The plane z = 0 between two images of a global shutter: H = K (R - t n' / d) K^-1."""
    config = sensors(imagers={"color": small(truth=["flow", "normals"])})
    messages = recorded(config, TURNING)
    flow, normals = (true_images(messages, "color", what)[1] for what in ("flow", "normals"))
    first, second = (optical_pose(f.instant_ns * 1e-9) for f in frames(messages, "color")[1:3])
    K = np.array([[16 / np.tan(np.radians(35)), 0, 15.5], [0, 16 / np.tan(np.radians(35)), 11.5]])
    K = np.vstack([K, [0.0, 0.0, 1.0]])
    R = second[1].T @ first[1]
    t = second[1].T @ (first[0] - second[0])
    up = first[1].T @ np.array([0.0, 0.0, 1.0])
    H = K @ (R - np.outer(t, up) / first[0][2]) @ np.linalg.inv(K)
    rows, columns = np.nonzero(normals @ up > 0.99)
    assert rows.size > 100
    moved = np.column_stack([columns, rows, np.ones(rows.size)]) @ H.T
    expected = moved[:, :2] / moved[:, 2:] - np.column_stack([columns, rows])
    assert np.abs(flow[rows, columns] - expected).max() < 0.01


def test_blur_is_the_mean_of_sharp_images_in_the_exposure() -> None:
    """Linear response, no noise: a blurred image beside five sharp ones taken at its instants."""
    plain: dict[str, Any] = {
        "shot_noise": False,
        "read_noise_e": 0.0,
        "response": "linear",
        "adc_bits": 16,
    }
    plain |= {"electrons_per_s": 2e5, "adc_bits": 16}
    exposure = {"auto": False, "exposure_s": 0.05, "blur_rays": 5}
    lens = {"width": 48, "height": 36}
    blurred = small(lens=lens, sensor=plain, exposure=exposure)
    sharp = small(lens=lens, sensor=plain, exposure={**exposure, "blur_rays": 1})
    config = sensors(imagers={"color": blurred}, phase_s=0.1)
    image = colour(recorded(config, TURNING))[2]
    parts = []
    for look in range(5):
        phase_s = 0.1 + 0.05 * ((look + 0.5) / 5 - 0.5)
        config = sensors(imagers={"color": sharp}, phase_s=phase_s)
        parts.append(colour(recorded(config, TURNING))[2])
    mean = np.mean(parts, axis=0)
    assert np.abs(parts[0] - parts[4]).max() > 20.0
    assert np.abs(image - mean).max() <= 1.01


def colour(messages: dict[str, list[bytes]]) -> list[Any]:
    images = decoded(messages, "/cam/color/image_raw", "sensor_msgs/msg/Image")
    return [pixels(message, "u1", 3).astype(np.float64) for message in images]


EVERYTHING: dict[str, Any] = {
    "clock": {"jitter_s": 0.001, "latency_s": 0.01, "drop_probability": 0.2},
    "projector": {},
    "imagers": {
        "color": small(
            readout_s=0.03,
            encoding="jpeg",
            truth=["depth", "normals", "instances", "materials", "flow"],
            exposure={"blur_rays": 3},
            sensor={"bayer": True},
        ),
        "depth": small(kind="depth", encoding="png", depth={"aligned_to": "color"}),
        "infra": small(kind="infrared", encoding="png", truth=["flow"]),
    },
}
EIGHT = figure_eight(0.5)


@cache
def uncut() -> dict[str, list[bytes]]:
    return recorded(sensors(**EVERYTHING), EIGHT)


@settings(max_examples=3)
@example([2, 5, 5, len(EIGHT) // 2], 2)
@given(st.lists(st.integers(2, len(EIGHT) - 1), max_size=12), st.integers(1, 3))
def test_the_same_bytes_however_the_drive_is_cut(cuts: list[int], threads: int) -> None:
    config = sensors(**EVERYTHING)
    assert uncut().keys() == the_camera(config).topics.keys()
    assert recorded(config, EIGHT, cuts, threads) == uncut()


def test_another_seed_is_another_noise() -> None:
    one, other = uncut(), recorded(sensors(**EVERYTHING), EIGHT, seed=4)
    assert (
        one["/cam/depth/image_raw/compressedDepth"] != other["/cam/depth/image_raw/compressedDepth"]
    )


def test_turning_blur_noise_and_truth_off_changes_no_other_imager() -> None:
    imagers = {**EVERYTHING["imagers"], "color": small(readout_s=0.03)}
    without = recorded(sensors(**{**EVERYTHING, "imagers": imagers}), EIGHT)
    for topic in ("/cam/depth/image_raw/compressedDepth", "/cam/infra/image_raw/compressed"):
        assert without[topic] == uncut()[topic]


class Mirrored(PlainGrey):
    """Every wall of x = -4 m is a mirror; elsewhere the radiance is the place itself."""

    def shade(self, points_m: FloatArray, normals: Any, *_: Any) -> Float32Array:
        there = np.where(self._is_mirror(points_m)[:, None], 0.0, points_m + 10.0)
        return np.where(np.abs(normals).any(axis=1)[:, None], there, 0.0).astype(np.float32)

    def materials(self, triangles: NDArray[Any], points_m: FloatArray) -> NDArray[np.uint8]:
        return np.where(self._is_mirror(points_m), 1, 0).astype(np.uint8)

    @property
    def mirroring(self) -> Float32Array:
        return np.array([0.0, 0.5], dtype=np.float32)

    @staticmethod
    def _is_mirror(points_m: FloatArray) -> Any:
        return np.abs(points_m[:, 0] + 4.0) < 1e-4


def test_a_mirror_shows_what_is_before_it() -> None:
    """Each ray thrown back by hand at the wall, and met with the planes of the room again."""
    T_base_view = np.eye(4)
    T_base_view[:3, :3] = Rotation.from_euler("z", 160.0, degrees=True).as_matrix() @ T_LINK_OPTICAL
    T_base_view[:3, 3] = [0.0, 0.0, 0.5]
    camera = pinhole(32, 24, 70.0)
    view = View(Scene(room(), floor_reach_m=10.0), camera, T_base_view, 0.0)
    sight = view.sight(view.poses(Motion(standing(0.1)), 0, 0))
    radiance = view.radiance(sight, Mirrored(0))
    mirrored = 0
    for pixel, ray in enumerate(camera.rays() @ T_base_view[:3, :3].T):
        origin = T_base_view[:3, 3]
        hit = origin + room_depth(origin, ray) * ray
        expected = hit + 10.0
        if abs(hit[0] + 4.0) < 1e-6:
            back = ray * [-1.0, 1.0, 1.0]
            again = hit + room_depth(hit + 1e-3 * back, back) * back
            expected = 0.5 * (again + 10.0) if np.isfinite(again).all() else np.zeros(3)
            mirrored += 1
        if np.isfinite(hit).all():
            np.testing.assert_allclose(radiance[pixel], expected, atol=2e-2)
    assert 50 < mirrored < 700
