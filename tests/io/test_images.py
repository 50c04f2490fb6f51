"""Camera images of a recording: pixels as they were, whatever order and padding they came in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_data import ROS2, START_NS, Robot, as_mcap

from slamsim.core.types import CameraImage
from slamsim.io.open import open_recording
from slamsim.io.ros.images import camera_images
from slamsim.report.viewer.run import write_recording
from slamsim.report.viewer.unmapped import unmapped

ROBOT = Robot(ROS2)
RANDOM = np.random.default_rng(5)
TYPES = {"rgb8": np.uint8, "mono8": np.uint8, "16UC1": np.uint16, "32FC1": np.float32}


def pixels_of(encoding: str) -> Any:
    shape = (4, 6, 3) if encoding == "rgb8" else (4, 6)
    return (200.0 * RANDOM.random(shape)).astype(TYPES[encoding])


def raw(at: int, pixels: Any, encoding: str, padding: int = 0, big: bool = False) -> Any:
    dtype = pixels.dtype.newbyteorder(">" if big else "<")
    plain = np.ascontiguousarray(pixels.astype(dtype)).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(plain, ((0, 0), (0, padding)))
    kind = ROS2.types["sensor_msgs/msg/Image"]
    header = ROBOT.header(START_NS + at, "camera")
    return kind(header, *pixels.shape[:2], encoding, int(big), rows.shape[1], rows.ravel())


def packed(at: int, data: bytes, about: str = "jpeg") -> Any:
    kind = ROS2.types["sensor_msgs/msg/CompressedImage"]
    header = ROBOT.header(START_NS + at, "camera")
    return kind(header, about, np.frombuffer(data, dtype=np.uint8))


def bag(path: Path, *messages: Any, topic: str = "/camera/image") -> Path:
    timed = [(topic, START_NS + i, message) for i, message in enumerate(messages)]
    return as_mcap(path, [*ROBOT.drive(), *timed])


@pytest.mark.parametrize("encoding", TYPES)
@pytest.mark.parametrize(("padding", "big"), [(0, False), (5, False), (3, True)])
def test_pixels_are_those_that_were_written(
    encoding: str, padding: int, big: bool, tmp_path: Path
) -> None:
    pixels = pixels_of(encoding)
    path = bag(tmp_path / "a.mcap", raw(7, pixels, encoding, padding, big))
    (image,) = camera_images(path, 10)
    assert image.stamp_ns == START_NS + 7 and image.encoding == encoding
    np.testing.assert_array_equal(image.pixels, pixels)


def test_so_many_are_given_and_what_is_no_image_is_left_out(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", pixels_of("mono8"))[1].tobytes()
    broken = raw(3, pixels_of("mono8"), "mono8")
    broken.data = broken.data[:5]
    many = [packed(10 + i, jpeg) for i in range(20)]
    odd = [packed(4, b"text"), broken, raw(5, pixels_of("mono8"), "yuv422")]
    images = list(camera_images(bag(tmp_path / "a.mcap", *many), 7))
    assert [one.stamp_ns - START_NS for one in images] == [10 + 3 * i for i in range(7)]
    assert {one.packed for one in images} == {jpeg}
    assert {one.media_type for one in images} == {"image/jpeg"}
    assert list(camera_images(bag(tmp_path / "b.mcap", *odd[1:]), 7)) == []
    assert list(camera_images(bag(tmp_path / "c.mcap", odd[0]), 7)) == []


def test_a_recording_is_shown_with_its_cameras(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", pixels_of("mono8"))[1].tobytes()
    images = [CameraImage("/a", START_NS + 1, jpeg, "image/jpeg")]
    images += [CameraImage("/b", START_NS + 2, b"", "", pixels_of(one), one) for one in TYPES]
    log = open_recording(bag(tmp_path / "a.mcap")).log()
    write_recording(tmp_path / "with.rrd", unmapped(log), images)
    write_recording(tmp_path / "without.rrd", unmapped(log))
    written = (tmp_path / "with.rrd").read_bytes()
    assert len(written) > (tmp_path / "without.rrd").stat().st_size
    assert b"cameras/a" in written or b"/cameras/a" in written
