"""Looks through the camera images of a recording once, holding thumbnails alone."""

from __future__ import annotations

import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.depth import DEPTH_HEAD_BYTES
from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.frames import EncodedFrame
from slamsim.cameras.survey import CameraSurvey
from slamsim.guard.errors import InputRefused
from slamsim.guard.pictures import JPEG_MAGIC, PNG_MAGIC, picture_of
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.cameras.base import Cameras
from slamsim.io.formats.ros import is_ros
from slamsim.io.open import read_recording, recording_at, require_something
from slamsim.io.ros.images import INFO
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.recording import Recording

MOST_SAMPLED = 300
"""Images of a topic that are decoded, in runs of three: a second or so of each camera."""
RUN = 3
"""Successive images that are decoded together: what flickers shows between neighbours."""
_THUMBNAIL_PX = 160
"""Width; disparities of a stereo pair are still some pixels."""
_FEWEST = 0.01
"""Share of an image's pixels that must have a depth."""
_NO_DEPTHS = (np.nan, np.nan, np.nan)
_GRID_PX = 80
"""Columns of a depth image that are kept: a wall at 3 m still has one every 5 cm."""
_PATCHES = (8, 6)
"""(columns, rows) over which colours are averaged: surfaces, not details."""
_Seen = tuple[
    float, tuple[float, ...], NDArray[np.uint8], NDArray[np.float32], NDArray[np.float64], bool
]
_NO_GRID, _NO_THUMBNAIL = np.zeros((0, 0), np.float32), np.zeros((0, 0), np.uint8)
_NO_COLOURS = np.zeros((0, 0, 3))


def with_cameras(recording: Recording, path: Path) -> Recording:
    """The recording that was read from path with what its images show; raises as ``open_cameras``.

    Formats without images stay as they are.
    """
    path = recording_at(path)
    if not is_ros(path):
        return recording
    with open_cameras(path) as cameras:
        return _with_survey(recording, cameras)


def _with_survey(recording: Recording, cameras: Cameras) -> Recording:
    """With what images show, and why topics cannot be read: those of CameraInfo are anomalies."""
    looks = survey(cameras)
    looked_at = {each.topic for each in looks} | {
        claim.source.removeprefix("topic ") for claim in cameras.infos.values()
    }
    infos = {each.topic for each in recording.topics if each.type_name == INFO}
    unread = cameras.unread.items()
    odd = (f"{topic}: cannot be read: {why}" for topic, why in unread if topic in infos)
    return replace(
        recording,
        cameras=looks,
        unread_cameras=tuple(each for each in unread if each[0] not in infos),
        anomalies=(*recording.anomalies, *odd),
        unread=tuple(
            each for each in recording.unread if each.topic not in looked_at | set(cameras.unread)
        ),
    )


def read_with_cameras(path: Path, wanted: Selection = EVERYTHING) -> Recording:
    """What a recording says and shows; a folder of images is one with nothing else in it.

    Raises as ``read_recording`` and ``open_cameras``.
    """
    if path.is_dir() and is_image_folder(path):
        with open_cameras(path) as cameras:
            return _with_survey(Recording(path.name, "images"), cameras)
    recording = with_cameras(read_recording(path, wanted, may_be_empty=True), path)
    require_something(recording_at(path), recording)
    return recording


def survey(cameras: Cameras, most: int = MOST_SAMPLED) -> tuple[CameraSurvey, ...]:
    """Each topic in the order of names, in one pass; at most so many images of each are decoded."""
    looks = {
        name: _Look(topic.kind, max(-(-topic.messages * RUN // most), RUN))
        for name, topic in sorted(cameras.topics.items())
    }
    for frame in cameras.encoded() if looks else ():
        looks[frame.topic].add(frame)
    return tuple(look.survey(cameras, name) for name, look in looks.items())


class _Look:
    """One topic, of whose every so many images the first ``RUN`` are decoded."""

    def __init__(self, kind: Kind, every: int) -> None:
        self._kind, self._every, self._bytes = kind, every, 0
        self._damaged: list[int] = []
        self._times: list[tuple[int, int]] = []
        self._digests: list[int] = []
        self._sampled: list[int] = []
        self._seen: list[_Seen] = []

    def add(self, frame: EncodedFrame) -> None:
        self._times.append((frame.stamp_ns, frame.received_ns))
        content = frame.content()
        self._digests.append(zlib.crc32(content))
        is_looked_at = frame.number % self._every < RUN
        if not is_looked_at and self._is_whole(content):
            return
        try:
            kind, pixels = frame.stored()
        except InputRefused:
            self._damaged.append(frame.number)
            return
        self._bytes = len(content)
        if kind != self._kind:
            self._damaged.append(frame.number)
        if kind != self._kind or not is_looked_at:
            return
        self._sampled.append(frame.number)
        self._seen.append(_of_depth(frame, pixels) if kind == "depth" else _of_image(pixels))

    def _is_whole(self, content: bytes | memoryview) -> bool:
        """As far as checksums and end marks of PNG and JPEG, or else as many bytes as before,
        tell: nothing is decoded for that."""
        for begin in (0, DEPTH_HEAD_BYTES):
            data = bytes(content[begin:])
            if data.startswith((PNG_MAGIC, JPEG_MAGIC)):
                return _has_end(data)
        return len(content) == self._bytes

    def survey(self, cameras: Cameras, name: str) -> CameraSurvey:
        topic = cameras.topics[name]
        times = np.array(self._times, dtype=np.int64).reshape(-1, 2)
        looks = zip(*self._seen, strict=True) if self._seen else ((),) * 6
        brightness, depths, thumbnails, grids, colours, metric = looks
        return CameraSurvey(
            name,
            topic.kind,
            topic.frame_id,
            (topic.width, topic.height),
            cameras.infos.get(name),
            times[:, 0],
            times[:, 1],
            np.array(self._digests, dtype=np.uint32),
            np.array(self._sampled, dtype=np.int64),
            np.array(brightness, dtype=np.float64),
            np.array(depths, dtype=np.float64).reshape(-1, 3),
            np.stack(thumbnails) if thumbnails else np.zeros((0, 0, 0), np.uint8),
            np.array(self._damaged, dtype=np.int64),
            np.stack(grids) if grids else np.zeros((0, 0, 0), np.float32),
            _grid_step(topic.width),
            np.stack(colours) if colours else np.zeros((0, 0, 0, 3)),
            any(metric),
            name,
            np.arange(len(times)),
        )


def _has_end(data: bytes) -> bool:
    try:
        picture_of(data)
    except ValueError:
        return False
    return True


def _of_depth(frame: EncodedFrame, pixels: NDArray[Any]) -> _Seen:
    is_metric = pixels.dtype != np.uint16
    unit_m = 1.0 if is_metric else frame.unit_m
    step = _grid_step(pixels.shape[1])
    grid = pixels[step // 2 :: step, step // 2 :: step]
    there = np.isfinite(grid) & (grid > 0)
    grid_m = np.where(there, grid * np.float32(unit_m), np.nan).astype(np.float32)
    return np.nan, _quantiles(pixels, unit_m), _NO_THUMBNAIL, grid_m, _NO_COLOURS, is_metric


def _of_image(pixels: NDArray[Any]) -> _Seen:
    colours = _NO_COLOURS
    if pixels.ndim == 3:
        patches = cv2.resize(pixels, _PATCHES, interpolation=cv2.INTER_AREA)
        colours = np.asarray(patches, np.float64)
    seen = float(pixels.mean()), _NO_DEPTHS, _thumbnail(pixels)
    return *seen, _NO_GRID, colours, False


def _grid_step(width: int) -> int:
    return max(-(-width // _GRID_PX), 1)


def _quantiles(pixels: NDArray[Any], unit_m: float) -> tuple[float, ...]:
    there = pixels[np.isfinite(pixels) & (pixels > 0)]
    if there.size <= _FEWEST * pixels.size:
        return _NO_DEPTHS
    return tuple((unit_m * np.quantile(there, (0.01, 0.5, 0.99))).tolist())


def _thumbnail(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    size = (_THUMBNAIL_PX, max(round(height * _THUMBNAIL_PX / width), 1))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
