"""The topics of a camera, and its images as streams of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.frames import readout_key
from slamsim.cameras.lens import COEFFICIENTS
from slamsim.cameras.settings import ImagerConfig, LensConfig
from slamsim.core.geometry import xyzw_from_matrix
from slamsim.recording import RawStream
from slamsim.recording.images import RawCameraInfos, RawFrameTruths, RawImages, RawPackedImages
from slamsim.sensors.cameras.imager import image_topic, raw_encoding, told_format
from slamsim.sensors.cameras.viewpoint import Moved, Taken

if TYPE_CHECKING:
    from slamsim.sensors.cameras.entry import CameraSettings

_ENCODINGS = {
    "depth": "32FC1",
    "normals": "32FC3",
    "instances": "32SC1",
    "materials": "8UC1",
    "flow": "32FC2",
}
"""Of images of the truth, which are never packed."""


@dataclass(frozen=True, slots=True)
class ImageTopic:
    """Where images of an imager go, with their CameraInfo. lens: the true one; claimed: what
    CameraInfo says."""

    topic: str
    type_name: str
    info_topic: str
    frame: str
    lens: LensConfig
    claimed: LensConfig
    right_of_m: float = 0.0


class CameraTopics:
    """All topics of an entry."""

    def __init__(self, entry: CameraSettings) -> None:
        self._entry = entry
        imagers = entry.enabled_imagers
        self._images = {name: _own(entry, name) for name in imagers}
        self._aligned = {
            name: _aligned(entry, name) for name, c in imagers.items() if c.depth.aligned_to
        }

    @property
    def types(self) -> dict[str, str]:
        """The ROS type of each topic."""
        found = {}
        for at in (*self._images.values(), *self._aligned.values()):
            found[at.topic] = at.type_name
            found[at.info_topic] = RawCameraInfos.schema.type_name
        for name, config in self._entry.enabled_imagers.items():
            found[self._truth(name, "frame")] = RawFrameTruths.schema.type_name
            found[self._truth(name, "camera_info")] = RawCameraInfos.schema.type_name
            for what in config.truth:
                found[self._truth(name, what)] = RawImages.schema.type_name
        return found

    @property
    def custom_data(self) -> dict[str, str]:
        """How long the shutter of each image of light takes, which no message tells."""
        return {
            readout_key(f"/{self._entry.name}/{name}/image_raw"): f"{config.readout_s:.7g}"
            for name, config in self._entry.enabled_imagers.items()
            if not config.is_depth
        }

    def streams(self, taken: Sequence[Taken | Moved]) -> tuple[RawStream, ...]:
        """The messages of one window."""
        found: list[RawStream] = []
        for name, config in self._entry.enabled_imagers.items():
            images = [t for t in taken if isinstance(t, Taken) and t.imager == name]
            moved = [t for t in taken if isinstance(t, Moved) and t.imager == name]
            if images:
                found += self._image_streams(config, images)
                found += self._truth_streams(config, images)
            found += [self._moved(each) for each in moved]
        return tuple(found)

    def _image_streams(self, config: ImagerConfig, taken: Sequence[Taken]) -> Iterator[RawStream]:
        name = taken[0].imager
        own = [each.image.payload.result() for each in taken]
        yield from _messages(config, self._images[name], taken, own)
        if name in self._aligned:
            others = [each.image.aligned for each in taken]
            packed = [future.result() for future in others if future is not None]
            yield from _messages(config, self._aligned[name], taken, packed)

    def _truth_streams(self, config: ImagerConfig, taken: Sequence[Taken]) -> Iterator[RawStream]:
        name, frame = taken[0].imager, self._images[taken[0].imager].frame
        yield _frames(self._truth(name, "frame"), taken)
        beside_m = self._entry.right_of_m(name, is_claimed=False)
        yield _infos(self._truth(name, "camera_info"), frame, taken, config.lens, beside_m)
        for what in taken[0].truth:
            images = np.stack([each.truth[what] for each in taken])
            when = _stamps(taken)
            yield _true_images(self._truth(name, what), frame, when, images, _ENCODINGS[what])

    def _moved(self, moved: Moved) -> RawImages:
        topic, frame = self._truth(moved.imager, "flow"), self._images[moved.imager].frame
        return _true_images(topic, frame, _stamps([moved]), moved.flow_px[None], _ENCODINGS["flow"])

    def _truth(self, imager: str, what: str) -> str:
        return f"/ground_truth/{self._entry.name}/{imager}/{what}"


def _own(entry: CameraSettings, name: str) -> ImageTopic:
    config, at = entry.imagers[name], f"/{entry.name}/{name}"
    claimed = config.claimed_lens or config.lens
    names = (*image_topic(config, at), f"{at}/camera_info", entry.optical_frame(name))
    return ImageTopic(*names, config.lens, claimed, entry.right_of_m(name, is_claimed=True))


def _aligned(entry: CameraSettings, name: str) -> ImageTopic:
    config = entry.imagers[name]
    other = _own(entry, config.depth.aligned_to)
    at = f"/{entry.name}/aligned_depth_to_{config.depth.aligned_to}"
    names = (*image_topic(config, at), f"{at}/camera_info", other.frame)
    return ImageTopic(*names, other.lens, other.claimed)


def _stamps(taken: Sequence[Taken | Moved]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n,) stamps and (n,) arrivals."""
    stamps_ns = np.array([each.stamp_ns for each in taken], dtype=np.int64)
    return stamps_ns, np.array([each.arrival_ns for each in taken], dtype=np.int64)


def _messages(
    config: ImagerConfig, at: ImageTopic, taken: Sequence[Taken], payloads: Sequence[bytes]
) -> Iterator[RawStream]:
    """Images and their CameraInfo: in one stream if all are of one size, else each in its own."""
    frame = (at.frame,)
    if config.encoding == "raw":
        data = np.stack([np.frombuffer(payload, dtype=np.uint8) for payload in payloads])
        size, encoding = (at.lens.height, at.lens.width), (raw_encoding(config),)
        yield RawImages(at.topic, frame, *_stamps(taken), *size, data, encoding)
    else:
        for each, payload in zip(taken, payloads, strict=True):
            data = np.frombuffer(payload, dtype=np.uint8)[None]
            told = (told_format(config),)
            yield RawPackedImages(at.topic, frame, *_stamps([each]), data, told)
    yield _infos(at.info_topic, at.frame, taken, at.claimed, at.right_of_m)


def _infos(
    topic: str, frame: str, taken: Sequence[Taken], lens: LensConfig, right_of_m: float
) -> RawCameraInfos:
    camera = lens.model()
    coefficients = np.zeros(COEFFICIENTS[camera.distortion_model])
    coefficients[: len(camera.coefficients)] = camera.coefficients
    size = camera.height, camera.width
    return RawCameraInfos(
        *(topic, (frame,), *_stamps(taken), *size, camera.K, coefficients),
        (camera.distortion_model,),
        right_of_m,
    )


def _frames(topic: str, taken: Sequence[Taken]) -> RawFrameTruths:
    rows = len(taken[0].poses.instants_ns)
    quats = [xyzw_from_matrix(each.poses.R_map_optical) for each in taken]
    return RawFrameTruths(
        topic,
        ("map",),
        *_stamps(taken),
        np.array([each.instant_ns for each in taken], dtype=np.int64),
        np.array([each.image.exposure_s for each in taken]),
        np.array([each.image.gain for each in taken]),
        np.stack([each.poses.instants_ns for each in taken]),
        np.stack([each.poses.origins_m.ravel() for each in taken]),
        np.array(quats).reshape(len(taken), 4 * rows),
    )


def _true_images(
    topic: str,
    frame: str,
    when_ns: tuple[NDArray[np.int64], NDArray[np.int64]],
    images: NDArray[np.generic],
    encoding: str,
) -> RawImages:
    little = np.ascontiguousarray(images, images.dtype.newbyteorder("<"))
    data = little.reshape(len(images), -1).view(np.uint8)
    height, width = images.shape[1:3]
    return RawImages(topic, (frame,), *when_ns, height, width, data, (encoding,))
