"""Camera images in a Rerun recording: cameras on the robot, depth as clouds before them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import encode_jpeg, encode_png
from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.frames import EncodedFrame
from slamsim.cameras.lens import CameraModel
from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.layers import label_colours
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.pictures import JPEG_MAGIC
from slamsim.report.run_view import RunView
from slamsim.report.viewer.stage import BASE, time_column

MOST_IMAGES = 300
"""Of each camera: half a minute at ten a second, and more thinly of a longer drive."""
_QUALITY = 80
_MOST_VIEWS = 4
_SHOWN_FIRST: tuple[Kind, ...] = ("colour", "depth", "grey")
_PLANE_M = 0.3
"""From a camera to where its picture is drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownCamera:
    """A camera at its place. T_base_camera: (4, 4) of its optical frame (z forward, x right)."""

    topic: str
    model: CameraModel
    T_base_camera: FloatArray


def log_cameras(recording: rr.RecordingStream, cameras: Sequence[ShownCamera]) -> None:
    """Each as a pinhole in the transform tree; its distortion is not drawn."""
    for camera in cameras:
        entity, T_base_camera = entity_of(camera.topic), camera.T_base_camera
        frame, image = f"{entity}/optical", f"{entity}/image"
        place = rr.Transform3D(
            translation=T_base_camera[:3, 3],
            quaternion=rr.Quaternion(xyzw=xyzw_from_matrix(T_base_camera[:3, :3])),
            parent_frame=BASE,
            child_frame=frame,
        )
        recording.log(f"tf/{entity}", place, static=True)
        pinhole = rr.Pinhole(
            image_from_camera=camera.model.K,
            resolution=(camera.model.width, camera.model.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            parent_frame=frame,
            child_frame=image,
            image_plane_distance=_PLANE_M,
        )
        recording.log(entity, pinhole, rr.CoordinateFrame(image), static=True)


def entity_of(topic: str) -> str:
    """Where the images of a topic are logged."""
    return f"cameras/{topic.strip('/')}"


def log_images(
    recording: rr.RecordingStream, view: RunView, images: Iterable[EncodedFrame]
) -> list[str]:
    """Log all that can be decoded: JPEG as it is, others as JPEG, distances as PNG.

    Returns the entities of the cameras: colour first, then depth, then grey.
    """
    entities: dict[str, Kind] = {}
    for image in images:
        with suppress(InputRefused):
            kind, columns = _columns(image)
            entity = entity_of(image.topic)
            entities.setdefault(entity, kind)
            stamps_ns = np.array([image.stamp_ns], dtype=np.int64)
            recording.send_columns(entity, [time_column(view, stamps_ns)], columns)
    return sorted(entities, key=lambda entity: _SHOWN_FIRST.index(entities[entity]))


def log_boxes(
    recording: rr.RecordingStream,
    view: RunView,
    topic: str,
    boxes: Iterable[tuple[int, IntArray, FloatArray]],
) -> None:
    """Boxes on the images of a topic, of a camera that is drawn: stamp, (k,) labels, and (k, 4)
    least and largest column and row of each."""
    entity = f"{entity_of(topic)}/boxes"
    frame = rr.CoordinateFrame(f"{entity_of(topic)}/image")
    recording.log(entity, frame, static=True)
    for stamp_ns, labels, corners_px in boxes:
        least, largest = corners_px[:, :2], corners_px[:, 2:]
        columns = rr.Boxes2D.columns(
            centers=0.5 * (least + largest + 1.0),
            half_sizes=0.5 * (largest - least + 1.0),
            labels=[f"thing {label}" for label in labels.tolist()],
            colors=label_colours(labels),
        )
        stamps_ns = np.array([stamp_ns], dtype=np.int64)
        whole = columns.partition([len(labels)])
        recording.send_columns(entity, [time_column(view, stamps_ns)], whole)


def camera_views(entities: list[str]) -> list[rrb.Spatial2DView]:
    """A view for each of the first cameras."""
    return [
        rrb.Spatial2DView(origin=entity, name=entity.removeprefix("cameras/"))
        for entity in entities[:_MOST_VIEWS]
    ]


def _columns(image: EncodedFrame) -> tuple[Kind, rr.ComponentColumnList]:
    kind, pixels = image.stored()
    if kind == "depth":
        packed = encode_png(_in_mm(pixels, image.unit_m))
        media = ["image/png"]
        return kind, rr.EncodedDepthImage.columns(blob=[packed], media_type=media, meter=[1e3])
    packed = image.packed()
    if not packed.startswith(JPEG_MAGIC):
        packed = encode_jpeg(pixels, _QUALITY)
    return kind, rr.EncodedImage.columns(blob=[packed], media_type=["image/jpeg"])


def _in_mm(pixels: NDArray[Any], unit_m: float) -> NDArray[np.uint16]:
    """Depths as they are stored, whether or not their unit can be right."""
    if pixels.dtype == np.uint16 and unit_m == 1e-3:
        return pixels
    in_mm = 1e3 * pixels * (unit_m if pixels.dtype == np.uint16 else 1.0)
    known = np.nan_to_num(in_mm, nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(np.rint(known), 0, 65535).astype(np.uint16)
