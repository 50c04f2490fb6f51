"""Which cameras of a recording tags are looked for with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recording_data import odometry_at, stamps
from scipy.spatial.transform import Rotation

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter
from slamsim.core.landmarks import TagObservation
from slamsim.core.types import Log
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.cameras.writers import calibration_yaml
from slamsim.perception import recorded
from slamsim.perception.calibrated import NO_CALIBRATION, CameraClock, read_calibration
from slamsim.recording import Recording, TransformEdge
from slamsim.recording.frames import base_frame_of
from slamsim.run.cameras.asked import from_images, refuse_wrong_files
from slamsim.run.stages import Stages

CAMERA = pinhole(64, 48, 60.0)


class Opened:
    """Of the topics only those in ``known`` have camera info."""

    def __init__(self, *known: str) -> None:
        self.known = known

    def pictures(self) -> Sequence[Any]:
        return [SimpleNamespace(topic=name, frame_id=name) for name in ("/front", "/rear")]

    def model(self, topic: str) -> CameraModel:
        if topic not in self.known:
            raise NotFound(f"{topic} has no camera info")
        return CAMERA


def mount_of(path: Path, topic: str, frame: str, *_: object) -> np.ndarray:
    return np.eye(4)


def test_a_camera_without_camera_info_is_left_out_and_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorded, "mount_of", mount_of)
    opened: Any = Opened("/rear")
    assert list(recorded._usable(Path("drive"), opened, opened, NO_CALIBRATION)) == ["/rear"]
    assert "a camera is left out: /front has no camera info" in caplog.text


def test_no_camera_at_all_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(path: Path, topic: str, frame: str, *_: object) -> np.ndarray:
        raise InputRefused(path, "no fixed transform", f"topic {topic}")

    monkeypatch.setattr(recorded, "mount_of", mount_of)
    opened: Any = Opened()
    with pytest.raises(NotFound, match="/front has no camera info"):
        recorded._usable(Path("drive"), opened, opened, NO_CALIBRATION)
    monkeypatch.setattr(recorded, "mount_of", nowhere)
    opened = Opened("/front", "/rear")
    with pytest.raises(InputRefused, match="topic /front"):
        recorded._usable(Path("drive"), opened, opened, NO_CALIBRATION)


def test_a_tag_has_the_instant_of_the_rows_that_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = [
        SimpleNamespace(
            corners_px=np.array([[5.0, row - 2.0], [9, row - 2], [9, row + 2], [5, row + 2]])
        )
        for row in (0.0, 23.5, 47.0)
    ]
    monkeypatch.setattr(
        recorded,
        "planar_observation",
        lambda at_ns, *_: TagObservation(at_ns, 1, np.ones(3), np.eye(3)),
    )
    camera = recorded.UsedCamera(CAMERA, np.eye(4), CameraClock(0.012, 0.03))
    found = [recorded._observed(one, 10**18, "front", camera) for one in seen]
    assert [one.stamp_ns - 10**18 for one in found] == [-12_000_000, 3_000_000, 18_000_000]
    assert [(one.camera, one.row) for one in found] == [("front", share) for share in (0, 0.5, 1)]


ENTRY = """\
cameras:
  /front/color/image_raw/compressed:
    frame: front_optical
    camera_info: front.yaml
    base_frame: base_footprint
    mount: {x_m: 0.1, y_m: -0.2, z_m: 0.3, roll_deg: 0.0, pitch_deg: 10.0, yaw_deg: 90.0}
    stamps_late_s: 0.012
    readout_s: 0.03
    verdicts: {x: fault, z: inconclusive, stamps late by: fault}
"""


def calibrated(folder: Path, text: str = ENTRY) -> str:
    (folder / "front.yaml").write_text(calibration_yaml("front", CAMERA))
    (folder / "calibration.yaml").write_text(text)
    return str(folder / "calibration.yaml")


def test_what_was_calibrated_counts_for_a_topic_and_its_frame(tmp_path: Path) -> None:
    found = read_calibration(calibrated(tmp_path))
    raw = found.of("/front/color/image_raw", "front_optical")
    assert raw.model is not None and np.allclose(raw.model.K, CAMERA.K)
    assert raw.clock == CameraClock(0.012, 0.03) and raw.T_base_camera is not None
    body = Rotation.from_euler("xyz", [0.0, 10.0, 90.0], degrees=True).as_matrix()
    np.testing.assert_allclose(raw.T_base_camera[:3, 2], body[:, 0], atol=1e-12)
    np.testing.assert_allclose(raw.T_base_camera[:3, 3], [0.1, -0.2, 0.3])
    depth = found.of("/front/aligned_depth/image_raw", "front_optical")
    assert depth.model is None and depth.clock == raw.clock
    assert found.of("/rear/image_raw", "rear_optical").T_base_camera is None
    far = ENTRY.replace("x_m: 0.1", "x_m: -2.6").replace("z_m: 0.3", "z_m: -0.1")
    long = read_calibration(calibrated(tmp_path, far))
    ahead = long.of("/front/color/image_raw", "").T_base_camera
    assert ahead is not None and ahead[[0, 2], 3].tolist() == [-2.6, -0.1]


def test_cameras_that_were_not_calibrated_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = read_calibration(calibrated(tmp_path, ENTRY.replace("front_optical", "''")))
    assert found.of("/rear/image_raw", "").T_base_camera is None
    assert "/rear/image_raw is none of the calibrated cameras" in caplog.text
    caplog.clear()
    found.of("/front/color/image_raw", "")
    NO_CALIBRATION.of("/rear/image_raw", "rear")
    assert not caplog.text


def test_images_of_another_size_than_calibrated_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded, "mount_of", mount_of)
    found = read_calibration(calibrated(tmp_path))
    opened: Any = SimpleNamespace(path=tmp_path)
    for width in (64, 128):
        topic = SimpleNamespace(topic="/front/color/image_raw", frame_id="", width=width, height=48)
        opened.pictures = lambda topic=topic: [topic]
        if width == 64:
            assert list(recorded._usable(tmp_path, opened, opened, found)) == [topic.topic]
            continue
        with pytest.raises(InputRefused, match="images of 128 x 48; calibrated were 64 x 48"):
            recorded._usable(tmp_path, opened, opened, found)


def test_what_is_inconclusive_and_what_is_not_used_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = calibrated(tmp_path, ENTRY.replace("late by: fault", "late by: inconclusive"))
    config = load_run_config(None, None, [f"slam.camera_calibration={file}"])
    found = refuse_wrong_files(config)
    assert list(found.cameras) == ["/front/color/image_raw/compressed"]
    assert caplog.text.count("is inconclusive") == 1
    stages, log = Stages(Reporter(quiet=True)), Log("r", "unknown", [], None, None, None, np.eye(4))
    from_images(tmp_path, Recording("r", "memory"), log, config, stages, found)
    assert "--calibration changes nothing" in caplog.text


@pytest.mark.parametrize(
    ("changed", "place_is_known", "clock"),
    [
        ("{x: inconclusive, stamps late by: ok}", False, CameraClock(0.012, 0.03)),
        ("{x: ok, stamps late by: inconclusive}", True, CameraClock()),
        ("{x: ok, readout: inconclusive}", True, CameraClock()),
    ],
)
def test_what_was_inconclusive_stays_as_recorded(
    tmp_path: Path, changed: str, place_is_known: bool, clock: CameraClock
) -> None:
    text = ENTRY.replace("{x: fault, z: inconclusive, stamps late by: fault}", changed)
    found = read_calibration(calibrated(tmp_path, text)).of("/front/color/image_raw", "")
    assert (found.T_base_camera is not None) is place_is_known and found.clock == clock


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("cameras:", "camera:", "calibration of cameras"),
        (ENTRY, "cameras: {}", "there is no camera in it"),
        ("stamps_late_s: 0.012", "stamps_late_s: 1e9", "stamps_late_s is 1e.09"),
        ("x_m: 0.1", "x_m: .nan", "camera /front/color"),
        ("front.yaml", "../front.yaml", "must lie inside the folder"),
        ("    base_frame: base_footprint\n", "", "base_frame"),
    ],
)
def test_wrong_calibrations_are_refused(tmp_path: Path, was: str, now: str, said: str) -> None:
    with pytest.raises(InputRefused, match=said):
        read_calibration(calibrated(tmp_path, ENTRY.replace(was, now)))


def moved(parent: str, child: str, by_m: float) -> TransformEdge:
    at_ns, quats = np.arange(2), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    return TransformEdge("/tf", parent, child, False, at_ns, None, by_m * np.eye(2, 3), quats)


def test_the_base_is_what_the_odometry_that_is_read_moves() -> None:
    wheels, visual = (
        replace(odometry_at(stamps(10.0, 2.0)), topic=topic, child_frame_ids=(frame,))
        for topic, frame in (("/odom", "base_link"), ("/vio/odom", "camera_link"))
    )
    both = Recording("both", "memory", (wheels, visual))
    assert base_frame_of(both) == "base_link"
    assert base_frame_of(replace(both, streams=(visual, wheels))) == "camera_link"
    assert base_frame_of(replace(both, base_frame="base_footprint")) == "base_footprint"
    by_transforms = (moved("odom", "base", 1.0), moved("base", "arm", 0.0))
    assert base_frame_of(Recording("tf", "memory", transforms=by_transforms)) == "base"
    assert base_frame_of(Recording("bare", "memory")) == "base_footprint"
