"""To which thing each triangle of a world belongs."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from world_helpers import world

from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.world.model import World
from slamsim.world.parts import NOTHING, WALL, Parts, Thing, parts_of
from slamsim.world.prism import Prism, merge_prisms, prism_mesh

CLUTTER = {"per_cell": 3.0}


def corners_of(at: World, number: int) -> FloatArray:
    """(t, 3, 3) of the triangles of one part."""
    corners: FloatArray = at.mesh.vertices_m[at.mesh.triangles[at.parts.owners == number]]
    return corners


def test_a_thing_is_closed_and_stands_apart() -> None:
    """Each edge of a part belongs to two triangles, and parts do not overlap on the floor."""
    cluttered = world(4, clutter=CLUTTER)
    shadows = []
    for number in range(WALL, len(cluttered.parts.kinds)):
        corners = corners_of(cluttered, number).round(9)
        ends = [
            (tuple(a), tuple(b))
            for tri in corners
            for a, b in zip(tri, np.roll(tri, -1, 0), strict=True)
        ]
        assert sorted(ends) == sorted((b, a) for a, b in ends)
        shadows.append(shapely.union_all(shapely.polygons(corners[..., :2])).buffer(-1e-6))

    assert len(shadows) > 20
    assert {"box", "table", "chair", "panel"} <= set(cluttered.parts.kinds)
    assert (cluttered.parts.owners > NOTHING + 1).all()
    tree = shapely.STRtree(shadows[1:])
    pairs = tree.query(shadows[1:], predicate="overlaps")
    assert pairs.size == 0


def test_a_table_is_one_thing() -> None:
    cluttered = world(4, clutter={"per_cell": 3.0, "shapes": ["table"]})
    for number in range(WALL + 1, len(cluttered.parts.kinds)):
        corners = corners_of(cluttered, number).reshape(-1, 3)
        top = corners[:, 2].max()
        assert 0.7 <= top <= 0.76
        assert corners[:, 2].min() == 0.0
        # four legs and a top: 5 boxes of 12 triangles
        assert (cluttered.parts.owners == number).sum() == 60


def test_clutter_does_not_change_what_walls_are() -> None:
    bare, cluttered = world(4), world(4, clutter=CLUTTER)

    walls = (corners_of(bare, WALL), corners_of(cluttered, WALL))

    assert np.array_equal(*walls)


def test_a_box_as_high_as_the_wall_beside_it_is_a_thing() -> None:
    wall = Prism(shapely.box(0, 0, 4, 0.1), 0.0, 1.0)
    box = Prism(shapely.box(1, 0.5, 1.5, 1), 0.0, 1.0)
    prisms = merge_prisms([wall, box])
    mesh = prism_mesh(prisms)

    parts = parts_of(mesh, prisms, [Thing("box", (box,))])

    y_m = mesh.vertices_m[mesh.triangles][..., 1]
    assert (parts.owners[(y_m >= 0.5).all(axis=1)] == 3).all()
    assert (parts.owners[(y_m <= 0.1).all(axis=1)] == WALL).all()
    assert parts.kinds[3] == "box"


def test_parts_of_holes() -> None:
    """A ring has corners outside and inside."""
    ring = Prism(shapely.box(0, 0, 3, 3).difference(shapely.box(1, 1, 2, 2)), 0.0, 1.0)
    box = Prism(shapely.box(1.2, 1.2, 1.5, 1.5), 0.0, 0.4)
    prisms = [ring, box]
    mesh = prism_mesh(prisms)

    parts = parts_of(mesh, prisms, [Thing("box", (box,))])

    heights = mesh.vertices_m[mesh.triangles][..., 2].max(axis=1)
    assert (parts.owners[heights == 0.4] == 3).all()
    assert (parts.owners == 3).sum() == 12


def test_owners_must_be_parts() -> None:
    with pytest.raises(BadNumbers, match="the owner of a triangle names number 7"):
        Parts(np.array([1, 7], dtype=np.int32))
