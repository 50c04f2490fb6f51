"""Square tags (AprilTag, ArUco) in grey images: which, where, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import Float32Array, FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.perception.tag_edges import Corners, refine_corners
from slamsim.perception.tag_families import FAMILIES, TagKind
from slamsim.perception.tag_pose import TagPose, tag_pose

FEWEST_TOLD, SURE_SIGMAS = 10, 4.0
"""Sightings, and standard deviations of their median, by which the usual reading of a camera's
images is wrong: 79 tags of a robot in MuJoCo say so by 6, 86 of a simulated camera that codes
colours the contrary by 9, and so do 17 in a photograph of a board (by 10)."""


@dataclass(frozen=True, slots=True, eq=False)
class TagSighting:
    """A tag in one image. number: its own. pose: where it is in the camera's optical frame.
    otherwise: the same by the other reading of the image, see ``TagDetector.detect``."""

    kind: TagKind
    number: int
    corners: Corners
    pose: TagPose
    otherwise: TagSighting | None = None

    @property
    def corners_px(self) -> FloatArray:
        """(4, 2) in the image as it is, top left first, then clockwise as one looks at the tag."""
        return self.corners.pixels


class TagDetector:
    """Finds the tags of one family and size in images of one camera.

    Which tags are seen is told by ``cv2.aruco``; their corners come from ``tag_edges``. These lie
    where brightness is half way between black and white, so it matters whether pixels tell light
    as it is or coded (sRGB). Cameras code colours, and most grey images are as dark as light is;
    but simulators that draw with OpenGL blend colours as they are coded. So tags are looked for by
    both readings, and all images of the camera tell by which of them edges rise evenly.
    """

    def __init__(self, kind: TagKind, model: CameraModel) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[kind.family]))
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        self._kind, self._model = kind, model
        self._cells = int(dictionary.markerSize) + 2
        self._asymmetries: list[tuple[float, float]] = []
        self._decided = (0, False)

    def detect(
        self, grey: NDArray[np.uint8], light: Float32Array | None = None
    ) -> tuple[TagSighting, ...]:
        """The tags in grey (height, width), by their numbers; each number at most once.

        light: (height, width) of a colour image, as ``linear_light`` has it. By default tags are
        read in it, or else in grey as it is; ``settled`` says which reading all images support.
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
        as_coded = grey.astype(np.float32)
        readings = (as_coded, _SRGB_LIGHT[grey]) if light is None else (light, as_coded)
        sightings = []
        for corners, number in zip(found, np.ravel(numbers).tolist(), strict=True):
            one, other = (self._sighting(each, int(number), corners[0]) for each in readings)
            if one is not None:
                sightings.append(replace(one, otherwise=other))
        once = _once_each(sightings)
        self._asymmetries += [
            (one.corners.asymmetry, one.otherwise.corners.asymmetry)
            for one in once
            if one.otherwise is not None
        ]
        return once

    def settled(self, sighting: TagSighting) -> TagSighting:
        """By the reading of the camera's images that is right, as far as those that were seen until
        now tell: by the other one where its edges rise more evenly, and that surely."""
        if self._decided[0] != len(self._asymmetries):
            self._decided = len(self._asymmetries), self._reads_wrong()
        other = sighting.otherwise
        return other if other is not None and self._decided[1] else sighting

    def _reads_wrong(self) -> bool:
        pairs = np.array(self._asymmetries).reshape(-1, 2)
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        if len(pairs) < FEWEST_TOLD:
            return False
        # Half way between both, its sign says which of them is nearer to even.
        middles, side = pairs.mean(axis=1), np.sign((pairs[:, 0] - pairs[:, 1]).sum())
        sigma = 1.25 * float(np.std(middles)) / np.sqrt(len(middles))
        return bool(side * np.median(middles) > SURE_SIGMAS * sigma)

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
