"""A recording with cameras, as slamsim and rosbags read it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_example import sensors, small
from rosbags.highlevel import AnyReader
from sensing_example import Robot, drive_along, room, windows

from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.core.types import Drive
from slamsim.io.cameras import open_cameras
from slamsim.io.open import read_log
from slamsim.sensors.rig import SensorRig
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.simulate import appearance_of, in_pieces
from slamsim.world.build import build_world
from slamsim.world.looks.finishes import MATERIALS

DRIVE = drive_along(1.0, 240.0, 0.3, 0.5, 0.3)
IMAGERS = {
    "color": small(encoding="jpeg", readout_s=0.02, truth=["depth", "flow", "instances"]),
    "depth": small(kind="depth", encoding="png", depth={"aligned_to": "color", "baseline_m": 0.02}),
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Written window by window, as ``simulate`` does."""
    on: dict[str, dict[str, Any]] = {name: {} for name in ("lidar", "imu", "encoders")}
    entries = sensors(imagers=IMAGERS).additional
    given = [entry.model_dump(mode="json") for entry in entries]
    config = RunConfig.model_validate({"sensors": {**on, "additional": given}})
    robot, folder = build_robot(config.robot), tmp_path_factory.mktemp("camera") / "log"
    rig = SensorRig(room(), robot, config.sensors, seed=1)
    with LogWriter(folder, log_header(robot, config)) as log:
        for window in windows(DRIVE, [60, 130]):
            log.write(rig.sense(window), window)
    return folder


def test_images_are_read_with_their_cameras(recording: Path) -> None:
    with open_cameras(recording) as cameras:
        colour = "/cam/color/image_raw/compressed"
        aligned = "/cam/aligned_depth_to_color/image_raw/compressedDepth"
        assert {image.topic for image in cameras.of_kind("colour")} == {colour}
        assert aligned in {image.topic for image in cameras.of_kind("depth")}
        assert cameras.model(colour).width == 32
        told_s = {topic: claim.readout_s for topic, claim in cameras.infos.items()}
        assert {topic for topic, known in told_s.items() if known is not None} == {colour}
        assert told_s[colour] == 0.02
        frames = list(cameras.frames([colour, aligned]))
    assert len(frames) == 20
    assert {frame.pixels.shape for frame in frames} == {(24, 32, 3), (24, 32)}
    stamps = sorted({frame.stamp_ns for frame in frames})
    np.testing.assert_array_equal(np.diff(stamps), 100_000_000)


def test_rosbags_reads_every_message(recording: Path) -> None:
    counts: dict[str, int] = {}
    with AnyReader([recording]) as reader:
        for connection, _, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            if connection.topic.endswith("color/frame"):
                assert len(message.row_instants_ns) == 24
    assert counts["/cam/color/camera_info"] == counts["/ground_truth/cam/color/frame"] == 10
    assert counts["/ground_truth/cam/color/flow"] == 9


def test_pieces_of_a_window_are_the_window() -> None:
    drive = drive_along(3.1, 240.0, 0.3, 0.5, 0.3)
    cameras, none = (
        sensors(imagers=IMAGERS),
        sensors(imagers=IMAGERS).model_copy(update={"additional": ()}),
    )
    assert [len(piece) for piece in in_pieces(drive, none)] == [len(drive)]
    pieces = list(in_pieces(drive, cameras))
    assert len(pieces) > 4
    for field in fields(Drive):
        whole = np.concatenate([getattr(piece, field.name) for piece in pieces])
        np.testing.assert_array_equal(whole, getattr(drive, field.name))


def test_the_world_s_looks_are_what_is_seen() -> None:
    """In a world with furniture: colours, things and materials are those of its looks."""
    config = load_run_config("tiny", None, [])
    world = build_world(config.world, config.seed)
    imager = small(truth=["instances", "materials", "depth"], lens={"width": 64, "height": 48})
    x_m, y_m, _ = world.start_pose
    drive = drive_along(0.2, 240.0, 0.3, 0.5, 0.3, (x_m, y_m))
    looks = appearance_of(world, config.world.looks)
    rig = SensorRig(world.mesh, Robot(), sensors(imagers={"color": imager}), 1, appearance=looks)
    found = {s.topic: s for batch in rig.sense(drive).additional for s in batch.streams()}
    images = {topic: stream.data[0] for topic, stream in found.items() if hasattr(stream, "data")}
    instances = images["/ground_truth/cam/color/instances"].view("<i4")
    depth = images["/ground_truth/cam/color/depth"].view("<f4")
    assert ((instances == 0) == np.isnan(depth)).all()
    assert set(instances.tolist()) <= set(range(len(world.parts.kinds)))
    assert len(set(instances.tolist())) >= 3
    assert images["/ground_truth/cam/color/materials"].max() < len(MATERIALS)
    colours = images["/cam/color/image_raw"].reshape(-1, 3).astype(int)
    assert np.ptp(colours, axis=1).max() > 5


def test_slam_sees_neither_images_nor_truth(recording: Path) -> None:
    log = read_log(recording)
    assert len(log.scans) > 30
    assert not [source for source in log.sources if "cam" in source or "truth" in source]
