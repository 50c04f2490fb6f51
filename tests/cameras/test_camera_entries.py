"""Entries of cameras: presets, topics, messages as others read them, and what is refused."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from camera_example import (
    decoded,
    frames,
    pixels,
    recorded,
    sensors,
    small,
    the_camera,
    true_images,
)
from numpy.typing import NDArray
from sensing_example import standing

from slamsim.cameras.codecs.depth import decode_compressed_depth
from slamsim.cameras.presets import PRESETS
from slamsim.config.loading import load_run_config
from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import mount_transform
from slamsim.guard.errors import SlamsimError
from slamsim.io.ros.reader import is_truth
from slamsim.sensors.base import static_frames
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header

STANDING = standing(0.35)
INFO, IMAGE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
PACKED = "sensor_msgs/msg/CompressedImage"


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_a_preset_survives_being_written_and_read(preset: str) -> None:
    config = sensors(preset=preset)
    entry = the_camera(config)
    assert entry.imagers.keys() == PRESETS[preset]["imagers"].keys()
    written = SensorsConfig.model_validate(config.model_dump(mode="json"))
    assert written == config


def test_what_is_said_counts_before_the_preset() -> None:
    imagers = {"color": {"readout_s": 0.01}, "infra2": {"enabled": False}}
    entry = the_camera(sensors(preset="realsense_d435", imagers=imagers))
    assert entry.imagers["color"].readout_s == 0.01
    assert entry.imagers["color"].lens.width == 848
    assert "infra2" not in entry.enabled_imagers
    assert not any("infra2" in topic for topic in entry.topics)
    again = SensorsConfig.model_validate({"additional": [entry.model_dump(mode="json")]})
    assert again.additional[0] == entry


def test_pairs_are_as_far_apart_as_their_data_sheets_say() -> None:
    for preset, left, right, apart_m in [
        ("realsense_d435", "infra1", "infra2", 0.05),
        ("realsense_d455", "infra1", "infra2", 0.095),
        ("oak_d", "left", "right", 0.075),
        ("fisheye_stereo", "fisheye1", "fisheye2", 0.064),
    ]:
        entry = the_camera(sensors(preset=preset))
        T = [entry.T_base_imager(entry.imagers[name]) for name in (left, right)]
        beside_m = T[0][:3, :3].T @ (T[1][:3, 3] - T[0][:3, 3])
        np.testing.assert_allclose(beside_m, [apart_m, 0.0, 0.0], atol=1e-9)
        assert entry.right_of_m(right, is_claimed=True) == pytest.approx(apart_m)
        assert entry.right_of_m(left, is_claimed=True) == 0.0
        if "depth" in entry.imagers:
            assert entry.imagers["depth"].depth.baseline_m == apart_m


def test_images_are_what_others_read() -> None:
    imagers = {
        "color": small(encoding="png"),
        "photo": small(encoding="jpeg", jpeg_quality=95),
        "raw": small(),
        "grey": small(kind="grey"),
        "depth": small(kind="depth", encoding="png", depth={"is_exact": True}),
        "plain": small(kind="depth", encoding="raw", depth={"is_exact": True}),
    }
    quiet = {"shot_noise": False, "read_noise_e": 0.0}
    for name in ("color", "photo", "raw"):
        imagers[name]["sensor"] = quiet
    messages = recorded(sensors(imagers=imagers), STANDING)
    raw = pixels(decoded(messages, "/cam/raw/image_raw", IMAGE)[0], "u1", 3)
    packed = decoded(messages, "/cam/color/image_raw/compressed", PACKED)[0]
    assert packed.format == "rgb8; png compressed bgr8"
    shown = unpacked(packed)
    np.testing.assert_array_equal(shown[:, :, ::-1], raw)
    photo = decoded(messages, "/cam/photo/image_raw/compressed", PACKED)[0]
    shown = unpacked(photo)
    assert np.abs(shown[:, :, ::-1].astype(int) - raw).mean() < 3.0
    grey = decoded(messages, "/cam/grey/image_raw", IMAGE)[0]
    assert (grey.encoding, grey.step, grey.width, grey.height) == ("mono8", 32, 32, 24)
    plain = pixels(decoded(messages, "/cam/plain/image_raw", IMAGE)[0], "<u2")
    depth = decoded(messages, "/cam/depth/image_raw/compressedDepth", PACKED)[0]
    np.testing.assert_array_equal(decode_compressed_depth(depth.format, bytes(depth.data)), plain)


def unpacked(message: Any) -> NDArray[np.uint8]:
    """(h, w, 3) of a CompressedImage, blue first."""
    data = np.frombuffer(bytes(message.data), np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def test_the_truth_is_beside_what_is_claimed() -> None:
    claimed = {"width": 32, "height": 24, "focal_px": [30.0, 31.0], "distortion": [0.1]}
    imager = small(
        **{"truth": ["depth"], "claimed_lens": claimed, "claimed_offset": {"y_m": 0.02}},
        lens={"distortion_model": "rational_polynomial", "distortion": [0.05] * 8},
    )
    config = sensors(imagers={"color": imager}, mount_error={"yaw_deg": 2.0})
    messages = recorded(config, STANDING)
    told = decoded(messages, "/cam/color/camera_info", INFO)[0]
    true = decoded(messages, "/ground_truth/cam/color/camera_info", INFO)[0]
    assert (told.k[0], told.k[4], told.d.tolist()) == (30.0, 31.0, [0.1, 0.0, 0.0, 0.0, 0.0])
    assert (told.distortion_model, true.distortion_model) == ("plumb_bob", "rational_polynomial")
    assert (len(true.d), true.d[0]) == (8, 0.05)
    assert told.header.stamp == true.header.stamp
    entry = the_camera(config)
    tree = {edge.child: edge.T_parent_child for edge in static_frames([entry])}
    claimed_T = tree["cam_link"] @ tree["cam_color_optical_frame"]
    true_T = entry.T_base_imager(entry.imagers["color"])
    turn = mount_transform(entry.mount_error)[:3, :3]
    between = np.linalg.inv(mount_transform(entry.mount)) @ true_T
    np.testing.assert_allclose(between[:3, :3], turn @ tree["cam_color_optical_frame"][:3, :3])
    assert np.linalg.norm(claimed_T[:3, 3] - true_T[:3, 3]) == pytest.approx(0.02)
    place = np.array(frames(messages, "color")[0].positions_m)
    np.testing.assert_allclose(place, true_T[:3, 3], atol=1e-9)


def test_the_right_one_of_a_pair_tells_the_distance() -> None:
    """P of sensor_msgs/CameraInfo: Tx = -fx times the baseline, of the second camera."""
    right = small(
        **{"kind": "grey", "stereo_left": "left", "offset": {"y_m": -0.06}},
        claimed_offset={"y_m": -0.05},
    )
    messages = recorded(sensors(imagers={"left": small(kind="grey"), "right": right}), STANDING)
    left, told = (decoded(messages, f"/cam/{n}/camera_info", INFO)[0] for n in ("left", "right"))
    true = decoded(messages, "/ground_truth/cam/right/camera_info", INFO)[0]
    assert (left.p[3], told.p[3]) == (0.0, pytest.approx(-told.k[0] * 0.05))
    assert true.p[3] == pytest.approx(-true.k[0] * 0.06)


def test_no_reader_takes_the_truth_for_a_measurement() -> None:
    class Channel:
        def __init__(self, topic: str) -> None:
            self.topic = topic

    everything = ["depth", "normals", "instances", "materials", "flow"]
    topics = the_camera(sensors(imagers={"color": small(truth=everything)})).topics
    true = [t for t in topics if is_truth(Channel(t))]  # type: ignore[arg-type]
    assert len(true) == 7
    assert set(topics) - set(true) == {"/cam/color/image_raw", "/cam/color/camera_info"}


def test_stamps_are_those_of_the_camera_s_clock() -> None:
    """Late by the offset, alike for all imagers, and received after exposure, readout, latency."""
    exposure = {"auto": False, "exposure_s": 0.01}
    clock = {"offset_s": 0.5, "jitter_s": 0.002, "latency_s": 0.05}
    two = {"a": small(exposure=exposure), "b": small(exposure=exposure, kind="grey")}
    messages = recorded(sensors(imagers=two, clock=clock), STANDING)
    stamps = {
        name: [m.header.stamp for m in decoded(messages, f"/cam/{name}/image_raw", IMAGE)]
        for name in two
    }
    assert stamps["a"] == stamps["b"]
    truth = frames(messages, "a")
    late = [
        s.sec + s.nanosec * 1e-9 - t.instant_ns * 1e-9
        for s, t in zip(stamps["a"], truth, strict=True)
    ]
    assert np.mean(late) == pytest.approx(0.5, abs=0.01)
    assert np.ptp(late) > 1e-4


def test_lost_images_are_lost_with_their_truth() -> None:
    config = sensors(
        imagers={"color": small(truth=["depth"])}, clock={"drop_probability": 0.5}, rate_hz=100.0
    )
    messages = recorded(config, STANDING)
    kept = len(messages["/cam/color/image_raw"])
    assert 5 < kept < 30
    assert len(messages["/ground_truth/cam/color/depth"]) == kept
    assert len(frames(messages, "color")) == kept


def test_exact_depth_is_the_truth_in_millimetres() -> None:
    limits = {"is_exact": True, "depth_min_m": 0.5, "depth_max_m": 3.5}
    imager = small(kind="depth", depth=limits, truth=["depth"])
    messages = recorded(sensors(imagers={"depth": imager}), STANDING)
    told = pixels(decoded(messages, "/cam/depth/image_raw", IMAGE)[0], "<u2")
    true = true_images(messages, "depth", "depth")[0]
    inside = (true >= 0.5) & (true <= 3.5)
    assert (told > 0).tolist() == inside.tolist()
    assert 50 < inside.sum() < inside.size
    assert np.abs(told[inside] * 1e-3 - true[inside]).max() < 5.1e-4


def test_infrared_sees_the_dots_of_the_projector() -> None:
    lens = {"width": 160, "height": 120}
    quiet = {"response": "linear", "shot_noise": False, "read_noise_e": 0.0}
    imager = small(
        kind="infrared", lens=lens, sensor=quiet, exposure={"auto": False, "exposure_s": 0.002}
    )
    dark, lit = (
        pixels(
            decoded(
                recorded(sensors(imagers={"ir": imager}, projector=projector), STANDING),
                "/cam/ir/image_raw",
                IMAGE,
            )[0],
            "u1",
        ).astype(int)
        for projector in (None, {"radiance": 20.0})
    )
    brighter = lit - dark
    assert brighter.min() >= 0
    assert 0.01 < (brighter > 10).mean() < 0.5


REFUSED = [
    ("{imagers: {a: {lens: {distortion: [-0.9]}}}}", "folds inside the image"),
    ("{imagers: {a: {lens: {focal_px: [0.0, 300.0]}}}}", "singular"),
    ("{imagers: {a: {lens: {distortion: [0,0,0,0,0,0]}}}}", "has 5 coefficients, not 6"),
    ("{imagers: {a: {lens: {width: 0}}}}", "must be at least 1"),
    ("{imagers: {a: {lens: {horizontal_fov_deg: 200.0}}}}", "equidistant"),
    ("{imagers: {a: {lens: {distortion_model: brown}}}}", "'plumb_bob', 'rational_polynomial'"),
    ("{imagers: {a: {kind: depth, encoding: jpeg}}}", "known are png, rvl, raw"),
    ("{imagers: {a: {kind: color, encoding: rvl}}}", "known are jpeg, png, raw"),
    ("{imagers: {a: {kind: depth, encoding: png, readout_s: 0.01}}}", "of one instant"),
    ("{imagers: {a: {exposure: {blur_rays: 4}}}}", "must be odd"),
    ("{imagers: {a: {exposure: {exposure_min_s: 0.1}}}}", "is beyond exposure_max_s"),
    ("{imagers: {a: {kind: grey, stereo_left: b}}}", "cannot be a pair with 'b'"),
    ("{imagers: {a: {readout_s: 0.5}}}", "must be shorter than a period"),
    ("{imagers: {a: {enabled: false}}}", "all imagers are switched off"),
    ("{imagers: {}}", "at least 1"),
    ("{imagers: {A: {}}}", "match"),
    ("{imagers: {a: {truth: [dept]}}}", "'depth', 'normals'"),
    ("{imagers: {a: {lense: {}}}}", "did you mean 'lens'"),
    ("{preset: realsense_d436}", "'realsense_d435'"),
    (
        "{imagers: {a: {kind: depth, encoding: png, depth: {aligned_to: color}}}}",
        "cannot be aligned to 'color'; imagers are a",
    ),
    (
        "{imagers: {a: {kind: depth, encoding: png, depth: {aligned_to: color}}, color: {}, "
        "aligned_depth_to_color: {}}}",
        "'aligned_depth_to_color' is where the depth of 'a' goes",
    ),
]


@pytest.mark.parametrize(("settings", "told"), REFUSED)
def test_wrong_settings_are_refused(settings: str, told: str) -> None:
    entry = settings[1:-1]
    with pytest.raises(SlamsimError, match=told):
        option = f"sensors.additional=[{{type: camera, name: c, mount: {{}}, {entry}}}]"
        load_run_config(None, None, [option])


def test_two_cameras_whose_frames_and_tables_would_be_one_are_refused() -> None:
    def both(first: str, second: str) -> str:
        told = ", ".join(
            f"{{type: camera, name: {name}, mount: {{}}, imagers: {{{imager}: {{}}}}}}"
            for name, imager in (first.split(), second.split())
        )
        return f"sensors.additional=[{told}]"

    with pytest.raises(SlamsimError, match="'front' and 'front_left' both have what is called"):
        load_run_config(None, None, [both("front left_color", "front_left color")])
    load_run_config(None, None, [both("front left_color", "front_right color")])


def test_the_bundled_configuration_is_a_realsense() -> None:
    config = load_run_config(None, "realsense_d435", [])
    assert the_camera(config.sensors).preset == "realsense_d435"
    header = log_header(build_robot(config.robot), config)
    assert "/front/color/image_raw/compressed" in header.topics
