"""Square marks on walls that cameras recognise: AprilTag and ArUco, as OpenCV draws them; and
``tags.yaml``, where they hang, as a surveyor would have it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from slamsim.config.layout import TagFamily, TagsConfig
from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.types import Float32Array, FloatArray
from slamsim.world.looks.decals import Decal
from slamsim.world.looks.finishes import MaterialId
from slamsim.world.looks.places import Place, Surfaces, WallSpace

_BLACK, _WHITE = 0.04, 0.85
"""Reflectance of printer's ink and of paper."""


@dataclass(frozen=True, slots=True, eq=False)
class Tag:
    """A tag on a wall. size_m: side of its black square, without the white border.

    T_map_tag: (4, 4); the tag's frame has its origin in the middle, x to the right and y up as it
    is read, z out of the wall.
    """

    id: int
    family: TagFamily
    size_m: float
    T_map_tag: FloatArray


def tag_pixels(family: TagFamily, number: int) -> Float32Array:
    """(n, n, 3) linear colours of a tag with one white cell around its black border, one pixel a
    cell: 10 x 10 for AprilTag 36h11 and ArUco 6x6."""
    name = f"DICT_{family.removeprefix('aruco_')}".upper()
    kinds = {"apriltag_36h11": "DICT_APRILTAG_36h11", "aruco_original": "DICT_ARUCO_ORIGINAL"}
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, kinds.get(family, name)))
    cells = dictionary.markerSize + 2
    marker = np.pad(
        cv2.aruco.generateImageMarker(dictionary, number, cells), 1, constant_values=255
    )
    grey = np.where(marker > 127, _WHITE, _BLACK).astype(np.float32)
    return np.repeat(grey[..., None], 3, axis=2)


def hang_tags(
    space: WallSpace, surfaces: Surfaces, config: TagsConfig, rng: np.random.Generator
) -> tuple[list[Tag], list[Decal]]:
    """Tags as many as find room, with their sheets; numbers count up, none is left out."""
    tags: list[Tag] = []
    decals: list[Decal] = []
    for _ in range(config.count):
        number = config.first_id + len(tags)
        pixels = tag_pixels(config.family, number)
        size_m = float(rng.uniform(*config.size_m))
        side_m = size_m * len(pixels) / (len(pixels) - 2)
        others_m = np.array([tag.T_map_tag[:3, 3] for tag in tags]).reshape(-1, 3)
        place = space.hang((side_m, side_m), config.height_m, others_m, rng)
        if place is not None:
            T_map_tag = _pose(surfaces, place, space.middle_m(place))
            tags.append(Tag(number, config.family, size_m, T_map_tag))
            decals.append(Decal(place, MaterialId.TAG, pixels, is_crisp=True))
    return tags, decals


def _pose(surfaces: Surfaces, place: Place, middle_m: FloatArray) -> FloatArray:
    T_map_tag = np.eye(4)
    T_map_tag[:3, 0] = surfaces.u_axes[place.plane]
    T_map_tag[:3, 1] = surfaces.v_axes[place.plane]
    T_map_tag[:3, 2] = surfaces.normals[place.plane]
    T_map_tag[:3, 3] = middle_m
    return T_map_tag


_HEAD = """\
# Tags on walls, in the map frame: middle of the tag in metres; quaternion of its frame, x to the
# right and y up as it is read, z out of the wall. size_m: side of the black square.
tags:
"""


def tags_yaml(tags: Iterable[Tag]) -> bytes:
    """The file; numbers in the shortest form that gives the same bits."""
    return (_HEAD + "".join(map(_line, tags))).encode()


def _line(tag: Tag) -> str:
    quat = xyzw_from_matrix(tag.T_map_tag[:3, :3])
    return (
        f"  - {{id: {tag.id}, family: {tag.family}, size_m: {tag.size_m!r}, "
        f"position_m: {_numbers(tag.T_map_tag[:3, 3])}, quat_xyzw: {_numbers(quat)}}}\n"
    )


def _numbers(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return str([value + 0.0 for value in values.tolist()])
