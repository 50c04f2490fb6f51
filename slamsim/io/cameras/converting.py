"""``slamsim convert``: camera images of a recording as a folder that other programs read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import FloatArray, Trajectory
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.guard.output import partial_folder
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.cameras.base import Cameras
from slamsim.io.cameras.writers import EurocFolder, TumRgbdFolder, in_frame
from slamsim.io.open import OpenRecording, open_recording
from slamsim.recording import TransformEdge
from slamsim.recording.frames import BASE_FRAME, known_mounting, tree_of

Layout = Literal["tum", "euroc"]


@dataclass(slots=True)
class WrittenImages:
    """Of one camera: how many were written, and how many not. stamps_ns: the first and the last."""

    topic: str
    images: int = 0
    left_out: int = 0
    first_reason: str = ""
    stamps_ns: list[int] = field(default_factory=list)

    @property
    def rate_hz(self) -> float:
        """Of those written; 0 for a single one."""
        span_ns = self.stamps_ns[-1] - self.stamps_ns[0] if self.stamps_ns else 0
        return 1e9 * (self.images - 1) / span_ns if span_ns > 0 else 0.0


def convert_images(
    source: Path, folder: Path, layout: Layout, *, overwrite: bool = False
) -> Mapping[str, WrittenImages]:
    """Write the images of a recording, or of a folder of them, in a layout; what each camera of it
    holds, by its name there.

    TUM RGB-D holds one camera for colour (or grey) and its depth; EuRoC all colour and grey
    cameras, the first IMU and the true path of the body, which is the IMU or else the base. An
    image that cannot be decoded, or has the stamp of an earlier one, is left out and counted.
    Raises SlamsimError without images that the layout can hold, else as ``open_cameras``.
    """
    with open_cameras(source) as cameras, partial_folder(folder, overwrite) as partial:
        recorded = recorded_beside(source)
        return (_to_tum if layout == "tum" else _to_euroc)(cameras, recorded, partial)


def recorded_beside(source: Path) -> OpenRecording | None:
    """What was recorded besides the images; None for a folder of images."""
    if source.is_dir() and is_image_folder(source):
        return None
    return open_recording(source)


def true_path(recorded: OpenRecording | None, frame: str) -> Trajectory | None:
    """Of a frame that is fixed to the base; None where the recording does not tell it."""
    truth = None if recorded is None else recorded.truth()
    T_base_frame = _mounting(recorded, frame)
    return None if truth is None or T_base_frame is None else in_frame(truth, T_base_frame)


def _to_tum(
    cameras: Cameras, recorded: OpenRecording | None, folder: Path
) -> Mapping[str, WrittenImages]:
    depths = cameras.of_kind("depth")
    colours = cameras.of_kind("colour") or cameras.of_kind("grey")
    if not colours and not depths:
        raise cameras.refused("there are no camera images")
    depth = depths[0].topic if depths else ""
    colour = cameras.depth_partners().get(depth, colours[0].topic if colours else "")
    names = {topic: name for topic, name in ((colour, "rgb"), (depth, "depth")) if topic}
    with TumRgbdFolder(folder) as writer:
        written = _written(cameras, writer, names)
        for topic, model in _models(cameras, names):
            writer.camera(names[topic], model)
        truth = true_path(recorded, cameras.topics[colour or depth].frame_id)
        if truth is not None:
            writer.truth(truth)
    return written


def _to_euroc(
    cameras: Cameras, recorded: OpenRecording | None, folder: Path
) -> Mapping[str, WrittenImages]:
    shown = sorted(each.topic for each in cameras.pictures())
    if not shown:
        raise cameras.refused("there are no colour or grey images, as EuRoC has")
    names = {topic: f"cam{number}" for number, topic in enumerate(shown)}
    T_base_body, truth = _body(recorded)
    with EurocFolder(folder) as writer:
        written = _written(cameras, writer, names)
        for topic, model in _models(cameras, names):
            T_base_camera = _mounting(recorded, cameras.topics[topic].frame_id)
            known = T_base_body if T_base_camera is None else T_base_camera
            T_body_camera, rate_hz = (
                np.linalg.inv(T_base_body) @ known,
                written[names[topic]].rate_hz,
            )
            try:
                writer.camera(names[topic], model, T_body_camera, rate_hz)
            except ValueError as error:
                raise SlamsimError(f"{cameras.path}, topic {topic}: {error}") from None
        for imu in recorded.recording.imus[:1] if recorded is not None else ():
            writer.imu(imu.stamps_ns, imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2)
        if truth is not None:
            writer.truth(truth)
    return written


def _body(recorded: OpenRecording | None) -> tuple[FloatArray, Trajectory | None]:
    """(T_base_body, true path of the body): the first IMU, where it is known to be mounted."""
    if recorded is None:
        return np.eye(4), None
    frames = [imu.frame_ids[0] for imu in recorded.recording.imus[:1]]
    known = _mounting(recorded, frames[0]) if frames else None
    T_base_body = np.eye(4) if known is None else known
    truth = recorded.truth()
    return T_base_body, None if truth is None else in_frame(truth, T_base_body)


def _written(
    cameras: Cameras, writer: TumRgbdFolder | EurocFolder, names: Mapping[str, str]
) -> Mapping[str, WrittenImages]:
    """By the name in the layout."""
    found = {name: WrittenImages(topic) for topic, name in names.items()}
    for frame in cameras.encoded(set(names)):
        one = found[names[frame.topic]]
        try:
            writer.add(names[frame.topic], frame)
        except FileExistsError:
            one.left_out += 1
            one.first_reason = one.first_reason or "an earlier image has the same stamp"
        except InputRefused as refusal:
            one.left_out += 1
            one.first_reason = one.first_reason or f"{refusal.where}: {refusal.reason}"
        else:
            one.images += 1
            one.stamps_ns[1:] = [frame.stamp_ns]
    return found


def _models(cameras: Cameras, topics: Mapping[str, str]) -> Iterator[tuple[str, CameraModel]]:
    """Those of the topics whose claim a camera can be."""
    for topic in topics:
        with suppress(InputRefused, NotFound):
            yield topic, cameras.model(topic)


def _mounting(recorded: OpenRecording | None, frame: str) -> FloatArray | None:
    edges: tuple[TransformEdge, ...] = () if recorded is None else recorded.recording.transforms
    known = known_mounting(tree_of(edges), BASE_FRAME, frame)
    return None if known is None else known[0]
