"""What ``slamsim view`` shows of a recording that was not mapped."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from slamsim.core.types import FloatArray, IntArray, Log, PlanarTrajectory
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.cameras.base import Cameras
from slamsim.io.formats.ros import is_ros
from slamsim.io.open import open_recording
from slamsim.io.ros.images import without_transport
from slamsim.io.selection import Selection
from slamsim.perception.layers.labels import label_boxes
from slamsim.recording import RawScans, Recording
from slamsim.recording.cleaning.rising_stamps import epoch_of
from slamsim.recording.frames import BASE_FRAME, known_mounting, tree_of
from slamsim.report.viewer.images import MOST_IMAGES, ShownCamera
from slamsim.report.viewer.run import write_recording
from slamsim.report.viewer.unmapped import unmapped
from slamsim.run.naming import log_of

_log = logging.getLogger(__name__)

AHEAD: FloatArray = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""T_base_camera of a camera that looks ahead from the base, where nothing says where it is."""


def write_unmapped(run: Path, wanted: Selection, rerun: Path) -> None:
    """Write scans, odometry and cameras of a recording, or the images of a folder, for Rerun.

    Raises as ``open_recording`` and ``open_cameras``; a recording without scans is shown if it has
    camera images.
    """
    if run.is_dir() and is_image_folder(run):
        with open_cameras(run) as cameras:
            _write(rerun, _log_of_cameras(cameras), cameras, None)
        return
    path = log_of(run)
    found = open_recording(path, wanted)
    if not is_ros(path):
        write_recording(rerun, unmapped(found.log()))
        return
    with open_cameras(path) as cameras:
        has_scans = bool(found.recording.of(RawScans))
        if cameras.unread and not cameras.topics and not has_scans:
            raise cameras.refused("has no scans, and none of its images can be read")
        has_scans = has_scans or not cameras.topics
        log = found.log() if has_scans else _log_of_cameras(cameras)
        _write(rerun, log, cameras, found.recording)


def _write(rerun: Path, log: Log, cameras: Cameras, recording: Recording | None) -> None:
    shown = shown_cameras(cameras, recording)
    boxes = {} if recording is None else dict(_boxes(cameras, shown))
    write_recording(rerun, unmapped(log), cameras.thinned(MOST_IMAGES), shown, boxes)


def _boxes(
    cameras: Cameras, shown: Sequence[ShownCamera]
) -> Iterator[tuple[str, Iterator[tuple[int, IntArray, FloatArray]]]]:
    """Of true instances, where they were recorded, by the topic of the pictures that show them."""
    drawn = {each.topic for each in shown}
    for each in (one for one in cameras.pictures() if one.topic in drawn):
        imager = without_transport(each.topic).removesuffix("/image_raw")
        found = label_boxes(cameras.path, f"/ground_truth{imager}/instances", MOST_IMAGES)
        yield each.topic, ((one.stamp_ns, one.labels, one.boxes_px) for one in found)


def shown_cameras(cameras: Cameras, recording: Recording | None) -> list[ShownCamera]:
    """Those whose claim a camera can be, at their places by the fixed transforms. A claim that
    none can be is told."""
    tree = tree_of(() if recording is None else recording.transforms)
    found = []
    for name, topic in cameras.topics.items():
        try:
            model = cameras.model(name)
        except NotFound:  # nothing is claimed
            continue
        except InputRefused as refusal:
            _log.warning("%s is shown as flat images, without its place: %s", name, refusal)
            continue
        known = known_mounting(tree, BASE_FRAME, topic.frame_id)
        T_base_camera = AHEAD if known is None else known[0]
        found.append(ShownCamera(name, model, T_base_camera))
    return found


def _log_of_cameras(cameras: Cameras) -> Log:
    """A log without scans, of a robot that stands still; its clock is that of the images."""
    first = next(cameras.encoded(), None)
    stamps_ns = np.array([] if first is None else [first.stamp_ns], dtype=np.int64)
    epoch = epoch_of(0 if first is None else first.stamp_ns)
    standing = PlanarTrajectory(stamps_ns, np.zeros((len(stamps_ns), 3)))
    return Log(cameras.path.resolve().name, epoch, (), standing, None, None, np.eye(4))
