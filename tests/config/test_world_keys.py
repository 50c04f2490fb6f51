"""Every key of a world acts as it says, or is refused with the numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapely
from pydantic import ValidationError
from world_helpers import ground_m2, prisms, world

from slamsim.config.world import WorldConfig
from slamsim.guard.errors import SlamsimError
from slamsim.world.prism import Prism, polygons_of


@pytest.mark.parametrize(
    ("changes", "more"),
    [
        ({"walls": {"thickness_m": 0.3}}, True),
        ({"pillars": {"share": 0.5}}, True),
        ({"maze": {"walls_removed": 0.5}}, False),
        ({"maze": {"dead_ends_opened": 1.0}}, False),
        ({"maze": {"halls": 1, "hall_cells": [3, 4]}}, False),
        ({"doors": {"share": 1.0}}, True),
        ({"clutter": {"per_cell": 1.0, "shapes": ["cylinder"], "height_m": [0.5, 1.0]}}, True),
    ],
)
def test_a_key_adds_or_removes_solid_ground(changes: dict[str, Any], more: bool) -> None:
    assert (ground_m2(world(**changes)) > ground_m2(world()) + 0.1) is more


def test_jitter_makes_walls_differ() -> None:
    heights = {prism.z_max_m for prism in prisms(world(walls={"height_jitter_m": 0.2}))}
    assert len(heights) > 20
    assert 0.8 <= min(heights) < 0.9
    assert 1.1 < max(heights) <= 1.2
    faces = np.unique(world(walls={"thickness_jitter_m": 0.05}).mesh.vertices_m[:, 0].round(9))
    assert len(faces) > 2 * len(np.unique(world().mesh.vertices_m[:, 0].round(9)))


def test_dents_go_in_and_out() -> None:
    deep = {"share": 1.0, "depth_m": [0.07, 0.07], "width_m": [0.5, 0.5]}
    plain = shapely.union_all([prism.section(0.3) for prism in prisms(world())])
    dented = shapely.union_all([prism.section(0.3) for prism in prisms(world(dents=deep))])
    niches, bumps = polygons_of(plain - dented), polygons_of(dented - plain)
    assert len(niches) > 5
    assert len(bumps) > 5
    for part in (*niches, *bumps):
        assert part.area == pytest.approx(0.035, rel=1e-6)


def test_doors_narrow_passages_and_close_above() -> None:
    keys = {"share": 1.0, "width_m": 0.8, "height_m": 1.5, "offset_m": 0.0, "frame_m": 0.05}
    built = world(maze={"rows": 1, "columns": 2}, doors=keys, walls={"height_m": 2.5})
    low = shapely.union_all([prism.section(0.3) for prism in prisms(built)])
    high = shapely.union_all([prism.section(2.0) for prism in prisms(built)])
    across = shapely.LineString([(2.0, 0.0), (2.0, 2.0)])
    assert across.difference(low).length == pytest.approx(0.8)
    assert across.difference(high).length == pytest.approx(0.0)
    beside = shapely.LineString([(2.1, 0.3), (2.1, 1.7)])
    assert beside.intersection(low).length == pytest.approx(2 * 0.05)


def shapes_of(shape: str) -> list[Prism]:
    def key(prism: Prism) -> tuple[Any, ...]:
        return prism.footprint.wkb, prism.z_min_m, prism.z_max_m

    bare = {key(prism) for prism in prisms(world())}
    full = prisms(world(clutter={"per_cell": 0.5, "shapes": [shape]}))
    return [prism for prism in full if key(prism) not in bare]


def test_clutter_comes_in_its_shapes() -> None:
    assert all(len(p.footprint.exterior.coords) == 5 for p in shapes_of("box"))
    assert all(len(p.footprint.exterior.coords) == 25 for p in shapes_of("cylinder"))
    assert all(len(p.footprint.exterior.coords) == 7 for p in shapes_of("l_shape"))
    assert all(p.lean_m != (0.0, 0.0) for p in shapes_of("panel"))
    for shape, parts in (("table", 5), ("chair", 6)):
        found = shapes_of(shape)
        assert len(found) % parts == 0
        assert sum(p.z_min_m > 0.3 for p in found) == len(found) // parts * (parts - 4)


def test_floor_patches_and_start_are_handed_on() -> None:
    patch = {"x_m": [0, 1], "y_m": [2, 3], "friction": 0.1}
    start = {"x_m": 3, "y_m": 1, "yaw_deg": 180}
    built = world(floor={"friction": 0.7, "patches": [patch]}, start=start)
    assert built.floor_friction == 0.7
    found = built.floor_patches[0]
    assert (found.x_min_m, found.y_min_m, found.x_max_m, found.y_max_m) == (0, 2, 1, 3)
    assert found.friction == 0.1
    assert built.start_pose == pytest.approx([3.0, 1.0, np.pi])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"clearance_m": 1.9}, r"clearance_m is 1\.9 m, more than 1\.85 m"),
        ({"walls": {"thickness_m": 1.5}}, "does not fit: clearance_m is 0.6 m"),
        ({"doors": {"share": 1, "width_m": 0.5}}, r"0\.6 m, more than 0\.5 m \(doors\.width_m"),
        ({"doors": {"share": 1, "width_m": 1.7}}, r"doors\.width_m"),
        ({"pillars": {"share": 1, "size_m": [0.3, 1.5]}}, r"pillars\.size_m"),
        ({"dents": {"share": 1, "depth_m": [0.1, 0.14]}}, r"dents\.depth_m"),
        ({"dents": {"share": 1, "width_m": [0.1, 2.0]}}, r"dents\.width_m"),
        ({"start": {"x_m": 0.2, "y_m": 1.0}}, r"start x_m 0\.2.*0\.3 m"),
        ({"start": {"x_m": 2.0, "y_m": 0.0}}, r"0\.000 m to the nearest"),
        ({"start": {"x_m": -5.0, "y_m": 1.0}}, "no way"),
        ({"clutter": {"per_cell": 20.0}, "maze": {"rows": 60, "columns": 60}}, "72000 things"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_numbers(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(SlamsimError, match=says):
        world(**changes)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"maze": {}, "rooms": {}}, "one layout"),
        ({"maze": {"rows": 400, "columns": 400}}, "160000 cells"),
        ({"maze": {"algorithm": "willson"}}, "algorithm"),
        ({"maze": {"rows": 1, "halls": 1}}, "hall_cells begins at 2"),
        ({"walls": {"height_m": 1.0, "height_jitter_m": 0.9}}, "height_jitter_m"),
        ({"clutter": {"size_m": [0.5, 0.2]}}, "smaller value comes first"),
        ({"clutter": {"size_m": ["0.1", 0.2]}}, "valid number"),
        ({"clutter": {"shapes": []}}, "shapes"),
        ({"floor": {"patches": [{"x_m": [1, 1], "y_m": [0, 1], "friction": 1}]}}, "empty"),
        ({"clearance_m": float("nan")}, "clearance_m"),
        ({"seed": -1}, "seed"),
    ],
)
def test_senseless_configurations_are_refused(keys: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        WorldConfig.model_validate(keys)
