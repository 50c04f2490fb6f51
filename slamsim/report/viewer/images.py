"""Camera images in a Rerun recording."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from slamsim.core.types import DEPTHS_M, CameraImage
from slamsim.report.run_view import RunView
from slamsim.report.viewer.stage import time_column

MOST_IMAGES = 300
"""Of each camera: half a minute at ten a second, and more thinly of a longer drive."""
_QUALITY = 80
_MOST_VIEWS = 4
_TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
}


def log_images(
    recording: rr.RecordingStream, view: RunView, images: Iterable[CameraImage]
) -> list[str]:
    """Log all of them as they were packed, or as JPEG; distances as PNG.

    Returns the entities of the cameras.
    """
    entities: dict[str, None] = {}
    for image in images:
        entity = f"cameras/{image.topic.strip('/')}"
        entities.setdefault(entity)
        columns = _columns(image)
        stamps_ns = np.array([image.stamp_ns], dtype=np.int64)
        recording.send_columns(entity, [time_column(view, stamps_ns)], columns)
    return list(entities)


def camera_views(entities: list[str]) -> list[rrb.Spatial2DView]:
    """A view for each of the first cameras."""
    return [
        rrb.Spatial2DView(origin=entity, name=entity.removeprefix("cameras/"))
        for entity in entities[:_MOST_VIEWS]
    ]


def _columns(image: CameraImage) -> rr.ComponentColumnList:
    if image.pixels is None:
        return rr.EncodedImage.columns(blob=[image.packed], media_type=[image.media_type])
    if image.encoding in DEPTHS_M:
        metres = np.nan_to_num(image.pixels * DEPTHS_M[image.encoding], posinf=0.0, neginf=0.0)
        in_mm = np.clip(np.rint(1e3 * metres), 0, 65535).astype(np.uint16)
        packed = cv2.imencode(".png", in_mm)[1].tobytes()
        return rr.EncodedDepthImage.columns(blob=[packed], media_type=["image/png"], meter=[1e3])
    pixels = image.pixels
    if pixels.dtype != np.uint8:
        pixels = (pixels >> 8).astype(np.uint8)
    code = _TO_BGR.get(image.encoding)
    ready = pixels if code is None else cv2.cvtColor(pixels, code)
    packed = cv2.imencode(".jpg", ready, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    return rr.EncodedImage.columns(blob=[packed], media_type=["image/jpeg"])
