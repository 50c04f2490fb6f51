"""Square tags (AprilTag, ArUco) in grey images: which, where, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import Float32Array, FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.perception.tag_edges import Corners, refine_corners
from slamsim.perception.tag_families import FAMILIES, TagKind
from slamsim.perception.tag_pose import TagPose, tag_pose


@dataclass(frozen=True, slots=True, eq=False)
class TagSighting:
    """A tag in one image. number: its own. pose: where it is in the camera's optical frame."""

    kind: TagKind
    number: int
    corners: Corners
    pose: TagPose

    @property
    def corners_px(self) -> FloatArray:
        """(4, 2) in the image as it is, top left first, then clockwise as one looks at the tag."""
        return self.corners.pixels


class TagDetector:
    """Finds the tags of one family and size in images of one camera.

    Which tags are seen is told by ``cv2.aruco``; their corners come from ``tag_edges``.
    """

    def __init__(self, kind: TagKind, model: CameraModel) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[kind.family]))
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        self._kind, self._model = kind, model
        self._cells = int(dictionary.markerSize) + 2

    def detect(
        self, grey: NDArray[np.uint8], light: Float32Array | None = None
    ) -> tuple[TagSighting, ...]:
        """The tags in grey (height, width), by their numbers; each number at most once.

        light: (height, width) proportional to the light, if grey is not (``linear_light``): edges
        between black and white lie where light is half way, which in coded values is too dark.
        A number that is seen twice in one image is left out: nothing tells which of them it is.
        Raises BadNumbers for an image of another size than the camera's.
        """
        size = (self._model.height, self._model.width)
        if grey.shape != size or grey.dtype != np.uint8:
            raise BadNumbers(
                f"an image of {grey.shape} {grey.dtype} is none of a camera of {size} uint8"
            )
        found, numbers, _ = self._detector.detectMarkers(grey)
        if numbers is None:
            return ()
        pixels = grey.astype(np.float32) if light is None else light
        sightings = [
            sighting
            for corners, number in zip(found, np.ravel(numbers).tolist(), strict=True)
            if (sighting := self._sighting(pixels, int(number), corners[0])) is not None
        ]
        return _once_each(sightings)

    def _sighting(
        self, grey: NDArray[np.float32], number: int, rough_px: FloatArray
    ) -> TagSighting | None:
        corners = refine_corners(grey, rough_px, self._cells, self._model)
        if corners is None:
            return None
        pose = tag_pose(corners, self._kind.size_m)
        return None if pose is None else TagSighting(self._kind, number, corners, pose)


def linear_light(colour: NDArray[np.uint8]) -> Float32Array:
    """(h, w) luminance, 0 to 1, of (h, w, 3) RGB coded as colour images are: sRGB (IEC 61966-2-1).

    Without it, edges of a simulated camera's tags are found 0.12 px inside of where they are.
    """
    light: Float32Array = _SRGB_LIGHT[colour] @ _LUMINANCE
    return light


_CODED = np.arange(256) / 255.0
_SRGB_LIGHT = np.where(_CODED <= 0.04045, _CODED / 12.92, ((_CODED + 0.055) / 1.055) ** 2.4).astype(
    np.float32
)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
"""Of ITU-R BT.709."""


def _once_each(sightings: Sequence[TagSighting]) -> tuple[TagSighting, ...]:
    numbers = [sighting.number for sighting in sightings]
    once = (s for s in sightings if numbers.count(s.number) == 1)
    return tuple(sorted(once, key=lambda sighting: sighting.number))
