"""Questions about cameras, asked of recordings with images in them: healthy, and with a fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_data import ROS2, START_NS, Message, Robot, as_mcap
from numpy.typing import NDArray

from slamsim.check.check import check_recording
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.cameras.place import GROUP as PLACE
from slamsim.check.questions.cameras.shutter import SHUTTER
from slamsim.check.questions.cameras.stereo import disparity_px
from slamsim.check.registry import registry
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.survey import RUN, survey, with_cameras
from slamsim.io.open import read_recording
from slamsim.recording import Recording

ROBOT, TYPES = Robot(ROS2), ROS2.types
FRAMES, PERIOD_NS = 60, 50_000_000
WIDTH, HEIGHT = 320, 120
LONG = (PLACE.questions[0], SHUTTER)
QUESTIONS = (
    *("camera.intrinsics", "camera.frozen", "camera.duplicates", "camera.depth_unit"),
    *("camera.depth_time", "camera.exposure", "camera.stereo", "camera.damaged"),
)
Image = NDArray[Any]


def wall() -> NDArray[np.uint8]:
    """A long textured wall, along which the robot drives."""
    rng = np.random.default_rng(8)
    coarse = rng.uniform(40.0, 200.0, (HEIGHT // 8, 200)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (1600, HEIGHT)), np.uint8)


WALL = wall()


def seen(k: int, disparity_px: int = 0) -> NDArray[np.uint8]:
    """What the left camera sees at a step; the right one with the disparity of the wall."""
    rng = np.random.default_rng(1000 * disparity_px + k)
    begin = 5 * k + disparity_px
    view = WALL[:, begin : begin + WIDTH] + rng.normal(0.0, 2.0, (HEIGHT, WIDTH))
    return np.asarray(np.clip(view, 0, 255), np.uint8)


class Scene:
    """A stereo pair with depth on the left image; each fault changes one thing of it."""

    def __init__(self) -> None:
        self.left = [seen(k) for k in range(FRAMES)]
        self.right = [seen(k, 16) for k in range(FRAMES)]
        depths = np.random.default_rng(4).integers(1000, 9000, (FRAMES, HEIGHT, WIDTH))
        self.depth: list[Image] = list(depths.astype(np.uint16))
        self.depth_encoding, self.depth_late_ns = "16UC1", 0
        self.info: dict[str, Any] = {
            "height": HEIGHT,
            "width": WIDTH,
            "distortion_model": "plumb_bob",
            "d": np.array([0.05, -0.02, 0.0, 0.0, 0.0]),
            "k": np.array([200.0, 0, 159.5, 0, 200.0, 59.5, 0, 0, 1]),
        }

    def write(self, path: Path) -> Path:
        return as_mcap(path, self.messages())

    def messages(self) -> list[Message]:
        messages: list[Message] = []
        for k in range(FRAMES):
            at_ns = START_NS + PERIOD_NS * k
            messages.append(("/odom", at_ns, ROBOT.odometry(at_ns, 0.05 * k)))
            for name, images in (("left", self.left), ("right", self.right)):
                image = self._image(at_ns, name, images[k], "mono8")
                messages.append((f"/cam/{name}/image_raw", at_ns, image))
                messages.append((f"/cam/{name}/camera_info", at_ns, self._info(at_ns, name)))
            late_ns = at_ns + self.depth_late_ns
            depth = self._image(late_ns, "left", self.depth[k], self.depth_encoding)
            messages.append(("/cam/depth/image_raw", at_ns, depth))
        return messages

    def _image(self, at_ns: int, frame: str, pixels: Image, encoding: str) -> Any:
        data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
        about = (HEIGHT, WIDTH, encoding, 0, data.size // HEIGHT, data)
        return TYPES["sensor_msgs/msg/Image"](ROBOT.header(at_ns, frame), *about)

    def _info(self, at_ns: int, frame: str) -> Any:
        roi = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        rest = (np.eye(3).ravel(), np.zeros(12), 0, 0, roi)
        header = ROBOT.header(at_ns, frame)
        return TYPES["sensor_msgs/msg/CameraInfo"](header, *self.info.values(), *rest)


def recorded(scene: Scene, folder: Path) -> Recording:
    path = scene.write(folder / "a.mcap")
    return with_cameras(read_recording(path), path)


def answers(recording: Recording, *, place: bool = False) -> dict[str, list[Finding]]:
    """Of the questions about cameras; place: where they sit and how their shutters work too, which
    takes long, and of which a robot that drives straight on without a lidar tells nothing."""
    found: dict[str, list[Finding]] = {name: [] for name in QUESTIONS}
    evidence = RecordingEvidence(recording)
    for group in registry().groups:
        first = group.questions[0]
        if first.id.startswith("camera.") and (place or first not in LONG):
            for finding in group.ask(evidence):
                found.setdefault(finding.check, []).append(finding)
    return found


def test_nothing_is_wrong_with_a_healthy_pair(tmp_path: Path) -> None:
    for name, findings in answers(recorded(Scene(), tmp_path), place=True).items():
        assert findings and "fault" not in {one.verdict for one in findings}, (name, findings)
        assert name not in QUESTIONS or {one.verdict for one in findings} == {"ok"}, name


@pytest.mark.long
def test_the_checker_asks_them(tmp_path: Path) -> None:
    found = check_recording(recorded(Scene(), tmp_path), quick=True).findings
    assert set(QUESTIONS) <= {one.check for one in found}
    assert {one.verdict for one in found if one.check in QUESTIONS} == {"ok"}
    assert "checker_error" not in {one.fault for one in found}


def frozen(scene: Scene) -> None:
    scene.left[20:40] = [scene.left[20]] * 20


def duplicated(scene: Scene) -> None:
    scene.right[1::2] = scene.right[::2]


def metres(scene: Scene) -> None:
    scene.depth = [np.asarray(np.rint(1e-3 * image), np.uint16) for image in scene.depth]


def millimetres(scene: Scene) -> None:
    scene.depth = [image.astype(np.float32) for image in scene.depth]
    scene.depth_encoding = "32FC1"


def late(scene: Scene) -> None:
    scene.depth_late_ns = 23_000_000


def flickering(scene: Scene) -> None:
    """15 % deep, a third of a period from image to image, as light of 100 Hz at 30 images a
    second."""
    for k in range(FRAMES):
        light = 1.0 + 0.15 * np.sin(2.0 * np.pi * k / 3.0)
        scene.left[k] = np.asarray(np.clip(scene.left[k] * light, 0, 255), np.uint8)


def swapped(scene: Scene) -> None:
    scene.left, scene.right = scene.right, scene.left


def claiming(**changes: Any) -> Callable[[Scene], None]:
    return lambda scene: scene.info.update(changes)


LEFT, RIGHT, DEPTH = (f"/cam/{name}/image_raw" for name in ("left", "right", "depth"))
FAULTS: dict[str, tuple[Callable[[Scene], None], str, set[str]]] = {
    "frozen": (frozen, "camera_frozen", {LEFT}),
    "duplicated": (duplicated, "camera_duplicated", {RIGHT}),
    "metres": (metres, "camera_depth_unit", {DEPTH}),
    "millimetres": (millimetres, "camera_depth_unit", {DEPTH}),
    "late": (late, "camera_depth_time", {DEPTH}),
    "flicker": (flickering, "camera_flicker", {LEFT}),
    "swapped": (swapped, "camera_stereo_swapped", {LEFT}),
    "size": (claiming(width=640), "camera_intrinsics", {LEFT, RIGHT, DEPTH}),
    "singular": (claiming(k=np.zeros(9)), "camera_intrinsics", {LEFT, RIGHT, DEPTH}),
    "fold": (claiming(d=np.array([-3.0, 0, 0, 0, 0])), "camera_intrinsics", {LEFT, RIGHT, DEPTH}),
    "half": (
        claiming(k=np.array([100.0, 0, 79.5, 0, 100.0, 29.5, 0, 0, 1])),
        "camera_intrinsics",
        {LEFT, RIGHT, DEPTH},
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        # The others are named by default where ``test_camera_faults`` puts them in.
        name
        if name in ("metres", "millimetres", "singular", "half")
        else pytest.param(name, marks=pytest.mark.slow)
        for name in FAULTS
    ],
)
def test_a_fault_is_named_and_nothing_else(name: str, tmp_path: Path) -> None:
    change, fault, subjects = FAULTS[name]
    scene = Scene()
    change(scene)
    found = [one for each in answers(recorded(scene, tmp_path)).values() for one in each]
    told = {(one.fault, one.subject) for one in found if one.verdict == "fault"}
    assert told == {(fault, subject) for subject in subjects}
    assert all(one.advice for one in found if one.verdict == "fault")


def test_a_camera_that_stands_still_may_repeat_itself(tmp_path: Path) -> None:
    """Without motion, or an odometry, equal images are no fault."""
    scene = Scene()
    scene.left = [scene.left[0]] * FRAMES
    path = scene.write(tmp_path / "a.mcap")
    recording = with_cameras(read_recording(path), path)
    still = recording.with_streams(type(recording.odometries[0]), ())
    found = answers(still)
    for name in ("camera.frozen", "camera.duplicates"):
        assert {finding.verdict for finding in found[name]} == {"inconclusive"}, name


def test_images_that_show_nothing_may_be_alike(tmp_path: Path) -> None:
    """Open space has no depth, and a covered lens no light."""
    scene = Scene()
    scene.depth[10:40] = [np.zeros_like(scene.depth[0])] * 30
    scene.right[10:40] = [np.zeros_like(scene.right[0])] * 30
    found = answers(recorded(scene, tmp_path))
    assert {one.verdict for one in found["camera.frozen"] + found["camera.duplicates"]} == {"ok"}


def test_the_shift_of_two_images_is_found() -> None:
    view = np.asarray(cv2.resize(WALL, (800, 60)), np.uint8)
    for shift in (-9, 0, 4, 20):
        left, right = view[:, 100:260], view[:, 100 + shift : 260 + shift]
        assert disparity_px(left, right) == pytest.approx(shift, abs=0.05)
    noise = np.random.default_rng(0).integers(0, 255, (2, 60, 160), dtype=np.uint8)
    assert disparity_px(noise[0], noise[1]) is None
    assert disparity_px(view[:, :80], view[:, :80]) is None


def test_a_survey_holds_thumbnails_of_runs_of_three(tmp_path: Path) -> None:
    path = Scene().write(tmp_path / "a.mcap")
    with open_cameras(path) as cameras:
        (depth, left, _) = survey(cameras, most=15)
        (_, whole, _) = survey(cameras)
    assert [one.topic for one in (depth, left)] == [DEPTH, LEFT]
    assert left.sampled.tolist() == [k for k in range(FRAMES) if k % 12 < RUN]
    assert left.thumbnails.shape == (15, 60, 160) and depth.thumbnails.shape == (15, 0, 0)
    assert len(left) == FRAMES and np.unique(left.digests).size == FRAMES
    assert whole.sampled.size == FRAMES
    np.testing.assert_allclose(left.brightness[0], seen(0).mean())
    np.testing.assert_allclose(depth.depths_m[0], [1.08, 5.0, 8.92], rtol=0.02)
