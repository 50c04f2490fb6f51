"""Tags as many images saw them, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.cameras.lens import CameraModel
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.perception.calibration.projection import project_slopes
from slamsim.perception.tags import TagSighting


@dataclass(frozen=True, slots=True, eq=False)
class TagViews:
    """n sightings of tags of one size by one camera.

    stamps_ns: (n,) of the images. numbers: (n,) of the tags. corners_px: (n, 4, 2) as ``Corners``
    has them, with covariances_px (n, 8, 8). T_camera_tag: (n, 2, 4, 4) what each alone tells of the
    pose, the second time the rival where there is one.
    """

    stamps_ns: IntArray
    numbers: IntArray
    corners_px: FloatArray
    covariances_px: FloatArray
    T_camera_tag: FloatArray
    size_m: float

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def those(self, chosen: BoolArray | IntArray) -> TagViews:
        """Those that (n,) chosen names."""
        return TagViews(
            self.stamps_ns[chosen],
            self.numbers[chosen],
            self.corners_px[chosen],
            self.covariances_px[chosen],
            self.T_camera_tag[chosen],
            self.size_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class CornerMisfits:
    """Corners (n, 2) px as seen, by how much the fit has them elsewhere (n, 2) px, and when, s, or
    in which view (n,)."""

    corners_px: FloatArray
    off_px: FloatArray
    at: FloatArray


def gather(
    stamps_ns: Sequence[int], sightings: Sequence[TagSighting], model: CameraModel
) -> TagViews:
    """Sightings of one kind of tag, each with the stamp of its image; model: that of the detector.

    Raises ValueError of none.
    """
    if not sightings:
        raise ValueError("no tag was seen")
    corners_px = np.array([one.corners.pixels for one in sightings])
    rays = np.array([one.corners.rays_xy for one in sightings])
    ahead = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    by_ray = project_slopes(model, ahead.reshape(-1, 3))[:, :, :2].reshape(-1, 4, 2, 2)
    spread = np.zeros((len(sightings), 8, 8))
    for corner in range(4):
        place = slice(2 * corner, 2 * corner + 2)
        spread[:, place, place] = by_ray[:, corner]
    of_rays = np.array([one.corners.covariance for one in sightings])
    poses = [[one.pose.T_camera_tag, _rival(one)] for one in sightings]
    return TagViews(
        np.array(stamps_ns, dtype=np.int64),
        np.array([one.number for one in sightings], dtype=np.int64),
        corners_px,
        spread @ of_rays @ np.swapaxes(spread, 1, 2),
        np.array(poses),
        sightings[0].kind.size_m,
    )


def _rival(sighting: TagSighting) -> FloatArray:
    pose = sighting.pose
    return pose.T_camera_tag if pose.other is None else pose.other
