"""``tags.yaml``: where the tags of a world hang, as a surveyor would have it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from slamsim.core.geometry import xyzw_from_matrix
from slamsim.world.looks.tags import Tag

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
