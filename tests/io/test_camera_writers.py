"""TUM RGB-D and EuRoC folders: read back by us, and by evo and OpenCV, which know nothing of us."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from bag_data import ROS2, START_NS, Robot, as_mcap
from evo.tools import file_interface

from slamsim.cameras.codecs.pictures import encode_jpeg
from slamsim.guard.errors import SlamsimError
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.converting import convert_images

ROBOT, TYPES = Robot(ROS2), ROS2.types
RANDOM = np.random.default_rng(11)
K = np.array([30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1])
D = np.array([0.01, -0.02, 0.001, 0.0005, 0.0])
COLOURS = RANDOM.integers(0, 255, (4, 24, 32, 3), dtype=np.uint8)
DEPTHS = RANDOM.integers(300, 9000, (4, 24, 32), dtype=np.uint16)
JPEG = encode_jpeg(COLOURS[0])


def image(at_ns: int, pixels: Any, encoding: str, frame: str = "camera") -> Any:
    data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
    header = ROBOT.header(START_NS + at_ns, frame)
    return TYPES["sensor_msgs/msg/Image"](header, 24, 32, encoding, 0, data.size // 24, data)


def info(model: str = "plumb_bob", D: Any = D) -> Any:
    roi = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    header, P = ROBOT.header(START_NS, "camera"), np.zeros(12)
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header, 24, 32, model, D, K, np.eye(3).ravel(), P, 0, 0, roi
    )


def recording(path: Path, *more: tuple[str, int, Any], claim: Any = None) -> Path:
    """A drive straight on at 1 m/s with truth, colour and depth at 10 Hz, a camera at x = 0.3 m."""
    edge = ROBOT.transform(START_NS, ("base_link", "camera"), 0.3)
    messages = [*ROBOT.drive(), ("/tf_static", START_NS, ROBOT.tf(edge))]
    messages.append(("/cam/color/camera_info", START_NS, claim or info()))
    messages.append(("/cam/depth/camera_info", START_NS, info()))
    for k in range(4):
        at_ns = 100_000_000 * k
        colour, depth = image(at_ns, COLOURS[k], "rgb8"), image(at_ns + 7, DEPTHS[k], "16UC1")
        messages.append(("/cam/color/image_raw", START_NS + at_ns, colour))
        messages.append(("/cam/depth/image_raw", START_NS + at_ns, depth))
        truth = ROBOT.odometry(START_NS + at_ns, 1e-9 * at_ns)
        messages.append(("/ground_truth/odom", START_NS + at_ns, truth))
    return as_mcap(path, sorted([*messages, *more], key=lambda message: message[1]))


def test_tum_is_what_other_programs_read(tmp_path: Path) -> None:
    folder = tmp_path / "tum"
    written = convert_images(recording(tmp_path / "a.mcap"), folder, "tum")
    assert {name: one.images for name, one in written.items()} == {"rgb": 4, "depth": 4}
    for name, stored in (("rgb", COLOURS), ("depth", 5 * DEPTHS.astype(int))):
        lines = [
            x.split() for x in (folder / f"{name}.txt").read_text().splitlines() if x[0] != "#"
        ]
        assert [float(seconds) for seconds, _ in lines] == pytest.approx(
            [1e-9 * START_NS + 0.1 * k for k in range(4)]
        )
        for (_, file), expected in zip(lines, stored, strict=True):
            seen = cv2.imread(str(folder / file), cv2.IMREAD_UNCHANGED)
            assert seen is not None
            np.testing.assert_array_equal(seen if name == "depth" else seen[:, :, ::-1], expected)
    truth = file_interface.read_tum_trajectory_file(folder / "groundtruth.txt")
    np.testing.assert_allclose(truth.positions_xyz[:, 0], [0.3, 0.4, 0.5, 0.6], atol=1e-9)
    told = yaml.safe_load((folder / "rgb.yaml").read_text())
    np.testing.assert_array_equal(told["camera_matrix"]["data"], K)
    np.testing.assert_array_equal(told["distortion_coefficients"]["data"], D)


def test_tum_is_read_back(tmp_path: Path) -> None:
    path = recording(tmp_path / "a.mcap")
    convert_images(path, tmp_path / "tum", "tum")
    with open_cameras(path) as before, open_cameras(tmp_path / "tum") as after:
        for old, new in (("/cam/color/image_raw", "rgb"), ("/cam/depth/image_raw", "depth")):
            assert after.model(new) is not None
            np.testing.assert_array_equal(before.model(old).K, after.model(new).K)
            pairs = zip(before.frames({old}), after.frames({new}), strict=True)
            for one, other in pairs:
                assert one.stamp_ns == other.stamp_ns
                np.testing.assert_allclose(one.pixels, other.pixels, rtol=1e-6)
    convert_images(tmp_path / "tum", tmp_path / "again", "tum")
    for name in ("rgb.txt", "depth.txt", "rgb.yaml"):
        assert (tmp_path / "again" / name).read_text() == (tmp_path / "tum" / name).read_text()


def test_euroc_is_what_other_programs_read(tmp_path: Path) -> None:
    root = tmp_path / "euroc" / "mav0"
    written = convert_images(recording(tmp_path / "a.mcap"), tmp_path / "euroc", "euroc")
    assert list(written) == ["cam0"] and written["cam0"].rate_hz == pytest.approx(10.0)
    with (root / "cam0" / "data.csv").open() as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert [int(row[0]) - START_NS for row in rows] == [100_000_000 * k for k in range(4)]
    for (_, name), expected in zip(rows, COLOURS, strict=True):
        seen = cv2.imread(str(root / "cam0" / "data" / name))
        assert seen is not None
        np.testing.assert_array_equal(seen[:, :, ::-1], expected)
    sensor = yaml.safe_load((root / "cam0" / "sensor.yaml").read_text())
    assert sensor["intrinsics"] == [30.0, 31.0, 15.5, 11.5]
    assert sensor["distortion_model"] == "radial-tangential"
    # The IMU is the body; it sits at x = -0.1 m, and the camera looks along with the base.
    T_body_camera = np.array(sensor["T_BS"]["data"]).reshape(4, 4)
    np.testing.assert_allclose(T_body_camera[:3, 3], [0.4, 0.0, 0.0], atol=1e-12)
    truth = file_interface.read_euroc_csv_trajectory(
        root / "state_groundtruth_estimate0" / "data.csv"
    )
    np.testing.assert_allclose(truth.positions_xyz[:, 0], [-0.1, 0.0, 0.1, 0.2], atol=1e-8)
    np.testing.assert_allclose(truth.orientations_quat_wxyz[:, 0], 1.0)
    imu = np.loadtxt(root / "imu0" / "data.csv", delimiter=",")
    assert imu.shape == (60, 7)
    np.testing.assert_allclose(imu[:, 3], 0.1 * np.arange(60), rtol=1e-8)
    np.testing.assert_allclose(imu[:, 6], 9.8)
    with open_cameras(tmp_path / "euroc") as cameras:
        frames = list(cameras.frames())
        np.testing.assert_array_equal(frames[3].pixels, COLOURS[3])
        assert list(cameras.model("cam0").focal_px) == [30.0, 31.0]


def test_packed_images_stay_as_they_are_and_wrong_ones_are_left_out(tmp_path: Path) -> None:
    def packed(at_ns: int, data: bytes) -> tuple[str, int, Any]:
        header = ROBOT.header(START_NS + at_ns, "camera")
        kind = TYPES["sensor_msgs/msg/CompressedImage"]
        return (
            "/web/compressed",
            START_NS + at_ns,
            kind(header, "jpeg", np.frombuffer(data, np.uint8)),
        )

    path = as_mcap(
        tmp_path / "a.mcap",
        [*ROBOT.drive(), packed(0, JPEG), packed(1, JPEG[:-9]), packed(2, JPEG), packed(2, JPEG)],
    )
    written = convert_images(path, tmp_path / "tum", "tum")
    assert (written["rgb"].images, written["rgb"].left_out) == (2, 2)
    assert "image 2: the JPEG is cut off" in written["rgb"].first_reason
    files = sorted((tmp_path / "tum" / "rgb").iterdir())
    assert [file.suffix for file in files] == [".jpg", ".jpg"] and files[0].read_bytes() == JPEG


@pytest.mark.parametrize("layout", ["tum", "euroc"])
def test_without_images_nothing_is_written(layout: Any, tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", ROBOT.drive())
    with pytest.raises(SlamsimError, match="there are no"):
        convert_images(path, tmp_path / "out", layout)
    assert not (tmp_path / "out").exists()


def test_a_distortion_that_euroc_cannot_say_is_told(tmp_path: Path) -> None:
    claim = info("rational_polynomial", np.full(8, 1e-3))
    with pytest.raises(SlamsimError, match="four coefficients of plumb_bob or equidistant"):
        convert_images(recording(tmp_path / "a.mcap", claim=claim), tmp_path / "out", "euroc")
