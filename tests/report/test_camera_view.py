"""What `slamsim view` makes of cameras: pinholes at their places, with or without scans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from bag_data import ROS2, START_NS, Robot, as_mcap

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.guard.errors import InputRefused
from slamsim.io.cameras import open_cameras
from slamsim.io.open import open_recording
from slamsim.io.selection import EVERYTHING
from slamsim.perception.layers.labels import boxes_of
from slamsim.report.viewer.images import log_images
from slamsim.report.viewer.run import write_recording
from slamsim.report.viewer.show import check_recording
from slamsim.report.viewer.unmapped import unmapped
from slamsim.run.cameras.viewing import AHEAD, shown_cameras, write_unmapped

ROBOT = Robot(ROS2)
DEPTH = np.full((24, 32), 1500, np.uint16)


def camera(frame: str = "camera", focal_px: float = 30.0) -> list[tuple[str, int, Any]]:
    """Depth images and CameraInfo."""
    header = ROBOT.header(START_NS + 1, frame)
    image = ROS2.types["sensor_msgs/msg/Image"](
        header, 24, 32, "16UC1", 0, 64, DEPTH.view(np.uint8).ravel()
    )
    roi = ROS2.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    K = np.array([focal_px, 0, 15.5, 0, focal_px, 11.5, 0, 0, 1])
    info = ROS2.types["sensor_msgs/msg/CameraInfo"](
        header, 24, 32, "plumb_bob", np.zeros(5), K, np.eye(3).ravel(), np.zeros(12), 0, 0, roi
    )
    return [("/cam/camera_info", START_NS, info), ("/cam/image", START_NS, image)]


def mounted() -> list[tuple[str, int, Any]]:
    edge = ROBOT.transform(START_NS, ("base_link", "camera"), 0.3, 0.2)
    return [("/tf_static", START_NS, ROBOT.tf(edge))]


def test_a_camera_is_shown_where_the_transforms_put_it(tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", [*ROBOT.drive(), *mounted(), *camera()])
    with open_cameras(path) as cameras:
        (shown,) = shown_cameras(cameras, open_recording(path).recording)
        (alone,) = shown_cameras(cameras, None)
    assert shown.T_base_camera[0, 3] == pytest.approx(0.3)
    assert shown.T_base_camera[1, 0] == pytest.approx(np.sin(0.2))
    np.testing.assert_array_equal(alone.T_base_camera, AHEAD)
    assert shown.model.width == 32


@pytest.mark.slow
def test_a_recording_with_a_camera_is_drawn_without_errors(tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", [*ROBOT.drive(), *mounted(), *camera()])
    write_unmapped(path, EVERYTHING, tmp_path / "a.rrd")
    found = check_recording(tmp_path / "a.rrd")
    assert found.errors == ()
    assert found.parents["cameras/cam/image/optical"] == "base_footprint"
    assert "cam/image" in found.views


def test_boxes_are_drawn_without_errors_and_lie_about_the_pixels_of_things(tmp_path: Path) -> None:
    image = np.zeros((6, 9), np.int32)
    image[0], image[2:5, 3:7], image[5, 8] = 2, 4, 11
    labels, boxes_px = boxes_of(image)
    assert labels.tolist() == [4, 11]
    assert boxes_px.tolist() == [[3, 2, 6, 4], [8, 5, 8, 5]]
    assert boxes_of(image[:1])[1].shape == (0, 4)

    path = as_mcap(tmp_path / "a.mcap", [*ROBOT.drive(), *mounted(), *camera()])
    with open_cameras(path) as cameras:
        opened = open_recording(path)
        shown = shown_cameras(cameras, opened.recording)
        topic, view = shown[0].topic, unmapped(opened.log())
        stamp_ns = int(view.result.trajectory.stamps_ns[0])
        boxes = {topic: [(stamp_ns, labels, boxes_px), (stamp_ns + 1, labels[:0], boxes_px[:0])]}
        write_recording(tmp_path / "a.rrd", view, cameras.encoded(), shown, boxes)
    found = check_recording(tmp_path / "a.rrd")
    assert found.errors == ()
    assert found.parents["cameras/cam/image/optical"] == "base_footprint"
    assert "cam/image" in found.views
    assert b"Boxes2D" in (tmp_path / "a.rrd").read_bytes()  # labels are packed


def test_colour_is_shown_before_depth_and_grey(tmp_path: Path) -> None:
    grey = np.full((24, 32), 90, np.uint8)
    for name, image in (("depth", DEPTH), ("color", np.dstack([grey] * 3))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.png").write_bytes(encode_png(image))
    recording = rr.RecordingStream("test")
    recording.memory_recording()
    with open_cameras(tmp_path) as cameras:
        frames = sorted(cameras.encoded(), key=lambda frame: frame.topic, reverse=True)
        view = unmapped(open_recording(as_mcap(tmp_path / "a.mcap", ROBOT.drive())).log())
        assert [frame.topic for frame in frames] == ["depth", "color"]
        assert log_images(recording, view, frames) == ["cameras/color", "cameras/depth"]


def test_cameras_are_shown_without_scans(tmp_path: Path) -> None:
    write_unmapped(as_mcap(tmp_path / "a.mcap", camera()), EVERYTHING, tmp_path / "a.rrd")
    for name in ("color", "depth"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.png").write_bytes(encode_png(DEPTH))
    write_unmapped(tmp_path, EVERYTHING, tmp_path / "folder.rrd")
    for name in ("a", "folder"):
        assert b"cameras" in (tmp_path / f"{name}.rrd").read_bytes()


def test_a_lens_that_none_can_be_is_told_and_its_images_are_shown(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = as_mcap(tmp_path / "a.mcap", [*ROBOT.drive(), *mounted(), *camera(focal_px=0.0)])
    write_unmapped(path, EVERYTHING, tmp_path / "a.rrd")
    (told,) = caplog.messages
    assert "/cam/image" in told and "singular" in told
    assert b"cameras" in (tmp_path / "a.rrd").read_bytes()
    caplog.clear()
    (_, image) = camera()
    write_unmapped(as_mcap(tmp_path / "b.mcap", [image]), EVERYTHING, tmp_path / "b.rrd")
    assert not caplog.messages, "nothing is claimed of it"


def test_a_recording_with_neither_is_refused(tmp_path: Path) -> None:
    path = as_mcap(tmp_path / "a.mcap", mounted())
    with pytest.raises(InputRefused):
        write_unmapped(path, EVERYTHING, tmp_path / "a.rrd")
