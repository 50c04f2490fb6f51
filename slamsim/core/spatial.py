"""What images tell of a camera's path in space, as values that cross from perception to SLAM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from slamsim.core.types import FloatArray, IntArray

SpatialEdgeKind = Literal["camera", "wheels", "floor", "guess", "closure", "tag"]


@dataclass(frozen=True, slots=True, eq=False)
class SpatialEdge:
    """A measured T_source_target (4, 4).

    covariance: (6, 6) of a small step of the target in its own frame, metres along its axes, then
    radians about them. weight: what the robust estimator left of a closure or a tag: 1 believed, 0
    withdrawn. Of kind ``floor`` the pose itself, source and target alike, is measured.
    """

    source: int
    target: int
    T_source_target: FloatArray
    covariance: FloatArray
    kind: SpatialEdgeKind
    weight: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class TagSeen:
    """A tag as seen from a key frame. T_camera_tag: (4, 4). covariance: (6, 6) as of an edge."""

    keyframe: int
    number: int
    T_camera_tag: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CameraTrack:
    """What one camera saw, image by image.

    stamps_ns: (n,) of the images. T_keyframe_camera: (n, 4, 4) since the last key frame at or
    before each, the identity where images alone do not tell it. keyframe_of: (n,) its number.
    keyframes: (k,) the image of each. edges: between key frames, in the optical frame. lost: images
    whose motion since the key frame could not be told.
    refused: pairs of images that look alike, but show no common scene.
    """

    stamps_ns: IntArray
    T_keyframe_camera: FloatArray
    keyframe_of: IntArray
    keyframes: IntArray
    edges: tuple[SpatialEdge, ...]
    tags: tuple[TagSeen, ...]
    lost: int
    refused: int

    @property
    def keyframe_stamps_ns(self) -> IntArray:
        """(k,)"""
        return self.stamps_ns[self.keyframes]
