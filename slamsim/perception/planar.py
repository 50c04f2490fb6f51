"""Tags in images as a robot in the plane sees them."""

from __future__ import annotations

import numpy as np

from slamsim.core.landmarks import TagObservation
from slamsim.core.types import FloatArray
from slamsim.perception.tags import TagSighting

AMBIGUOUS_RAD = 1.0
"""Standard deviation of the way that a tag faces which fits two ways: the likelier one is wrong in
the same way image after image, and no mean of many makes it right."""
STEEPEST = 0.7
"""A tag whose normal is steeper (of its unit length, along z) lies on the floor or the ceiling."""


def planar_observation(
    stamp_ns: int, sighting: TagSighting, T_base_camera: FloatArray
) -> TagObservation:
    """The tag's middle and the way it faces; that of its upper edge where it lies flat.

    T_base_camera: (4, 4) of the optical frame. Height, roll and pitch are left out: what a robot on
    a floor knows of them does not tell where it is.
    """
    T_base_tag = T_base_camera @ sighting.pose.T_camera_tag
    facing = _facing(T_base_tag)
    R_base_camera = T_base_camera[:3, :3]
    by_step = np.zeros((3, 6))
    by_step[:2, :3] = R_base_camera[:2]
    # A small turn w moves the facing f by w x f, and its heading by that across f, over |f|^2.
    x, y, z = facing
    heading = np.array([-x * z, -y * z, x * x + y * y]) / (x * x + y * y)
    by_step[2, 3:] = heading @ R_base_camera
    covariance = by_step @ sighting.pose.covariance @ by_step.T
    if sighting.pose.is_ambiguous:
        covariance[2, :] = covariance[:, 2] = 0.0
        covariance[2, 2] = AMBIGUOUS_RAD**2
    return TagObservation(stamp_ns, sighting.number, planar_tag(T_base_tag), covariance)


def planar_tag(T_map_tag: FloatArray) -> FloatArray:
    """(3,) x, y and the way that a tag (4, 4) faces, seen from above; in whichever frame."""
    facing = _facing(T_map_tag)
    return np.array([*T_map_tag[:2, 3], np.arctan2(facing[1], facing[0])])


def _facing(T_map_tag: FloatArray) -> FloatArray:
    """(3,) its normal; its upper edge where it lies flat."""
    flat = abs(T_map_tag[2, 2]) > STEEPEST
    return np.asarray(T_map_tag[:3, 1 if flat else 2])
