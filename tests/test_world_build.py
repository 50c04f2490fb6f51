"""Whole worlds: the robot fits, occupancy is true, the seed decides, every key acts."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import ndimage
from world_helpers import covered_cells, digest, unmatched_edges

from slamsim.config.loading import bundled_names, load_world_config
from slamsim.config.world import WorldConfig
from slamsim.safe.errors import SlamsimError
from slamsim.world.build import World, build_world
from slamsim.world.preview import preview_png
from slamsim.world.prism import Prism, polygons_of
from slamsim.world.raster import Raster
from slamsim.world.solids import PrismSolids

PLAIN: dict[str, Any] = {
    "maze": {"rows": 4, "columns": 5, "dead_ends_opened": 0.0, "walls_removed": 0.0},
    "doors": {"share": 0.0},
    "pillars": {"share": 0.0},
    "dents": {"share": 0.0},
    "clutter": {"per_cell": 0.0},
}


def world(seed: int = 0, **changes: Any) -> World:
    """A bare maze with the sections of ``changes`` laid over it, key by key."""
    keys = dict(PLAIN)
    for name, value in changes.items():
        is_section = isinstance(value, dict) and isinstance(keys.get(name), dict)
        keys[name] = {**keys[name], **value} if is_section else value
    return build_world(WorldConfig.model_validate(keys), seed)


def prisms(of: World) -> list[Prism]:
    assert isinstance(of.solids, PrismSolids)
    return list(of.solids.prisms)


def ground_m2(of: World, height_m: float = 0.3) -> float:
    return float(shapely.union_all([prism.section(height_m) for prism in prisms(of)]).area)


RANGES = st.tuples(st.floats(0.1, 0.9), st.floats(0.1, 0.9)).map(sorted)
LAYOUTS = st.one_of(
    st.fixed_dictionaries(
        {
            "rows": st.integers(1, 5),
            "columns": st.integers(1, 5),
            "cell_m": st.floats(1.5, 3.0),
            "dead_ends_opened": st.floats(0, 1),
            "walls_removed": st.floats(0, 1),
        }
    ).map(lambda keys: {"maze": keys}),
    st.fixed_dictionaries(
        {
            "cell_m": st.floats(1.5, 2.5),
            "length_cells": st.integers(1, 7),
            "depth_cells": st.integers(1, 3),
            "linked": st.floats(0, 1),
        }
    ).map(lambda keys: {"rooms": keys}),
)
DRESSES = st.fixed_dictionaries(
    {
        "walls": st.fixed_dictionaries(
            {
                "thickness_m": st.floats(0.12, 0.3),
                "thickness_jitter_m": st.floats(0, 0.04),
                "height_m": st.floats(0.4, 3.0),
                "height_jitter_m": st.floats(0, 0.3),
            }
        ),
        "doors": st.fixed_dictionaries(
            {
                "share": st.floats(0, 1),
                "width_m": st.floats(0.6, 1.0),
                "height_m": st.floats(0.3, 2.5),
                "offset_m": st.floats(0, 0.2),
                "frame_m": st.floats(0, 0.08),
            }
        ),
        "pillars": st.fixed_dictionaries({"share": st.floats(0, 1), "size_m": RANGES}),
        "dents": st.fixed_dictionaries(
            {"share": st.floats(0, 1), "depth_m": RANGES.map(lambda r: [0.07 * x for x in r])}
        ),
        "clutter": st.fixed_dictionaries({"per_cell": st.floats(0, 2), "size_m": RANGES}),
        "clearance_m": st.floats(0.3, 0.8),
    }
)


@settings(max_examples=60, deadline=None)
@given(layout=LAYOUTS, dress=DRESSES, seed=st.integers(0, 2**40))
def test_a_disc_of_the_clearance_reaches_every_place_or_the_world_is_refused(
    layout: dict[str, Any], dress: dict[str, Any], seed: int
) -> None:
    config = WorldConfig.model_validate({**layout, **dress})
    try:
        built = build_world(config, seed)
    except SlamsimError as error:
        assert "does not fit" in str(error)
        return
    shadows = [prism.shadow(0.0, 3.0) for prism in prisms(built) if prism.z_min_m < 0.25]
    blocked = shapely.union_all(shadows).buffer(0.5 * config.clearance_m - 1e-6)
    free = polygons_of(shapely.box(*built.bounds_m).difference(blocked))
    start = shapely.Point(built.start_pose[:2])
    here = [part for part in free if part.intersects(start)]
    assert len(here) == 1
    assert shapely.intersects(here[0], shapely.points(built.visit_points_m)).all()
    assert len(built.visit_points_m) >= 1
    assert unmatched_edges(built.mesh) == 0
    assert np.isfinite(built.mesh.vertices_m).all()
    assert built.mesh.vertices_m[:, 2].min() == 0.0


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 2**40),
    resolution=st.sampled_from([0.05, 0.1, 0.066]),
    height=st.sampled_from([0.1, 0.3, 0.75]),
)
def test_the_grid_is_true_to_the_polygons(seed: int, resolution: float, height: float) -> None:
    built = world(
        seed,
        maze={"rows": 2, "columns": 2},
        doors={"share": 0.3},
        dents={"share": 0.5},
        pillars={"share": 0.5},
        clutter={"per_cell": 2.0},
    )
    grid = built.grid(resolution, height)
    assert grid.occupancy.dtype == np.float32
    assert np.array(grid.origin_m) / resolution == pytest.approx(
        np.round(np.array(grid.origin_m) / resolution)
    )
    raster = Raster.covering(built.bounds_m, resolution)
    solid, unsure = covered_cells([prism.section(height) for prism in prisms(built)], raster)
    np.testing.assert_array_equal((grid.occupancy == 1.0) | unsure, solid | unsure)
    labels, _ = ndimage.label(grid.occupancy != 1.0)
    row, column = raster.cell_of(built.start_pose[None, :2])[0]
    np.testing.assert_array_equal(grid.occupancy == 0.0, labels == labels[row, column])
    assert (grid.occupancy[labels == 0] == 1.0).all()


def test_low_things_are_obstacles_but_not_seen() -> None:
    built = world(clutter={"per_cell": 3.0, "shapes": ["box"], "height_m": [0.1, 0.25]})
    seen, felt = built.grid(0.05, 0.3).occupancy, built.obstacle_grid(0.05).occupancy
    assert np.count_nonzero(felt == 1.0) > np.count_nonzero(seen == 1.0) + 200
    bare = world().grid(0.05, 0.3).occupancy
    np.testing.assert_array_equal(seen, bare)


def test_outside_is_out_of_reach() -> None:
    grid = world(pillars={"share": 1.0, "size_m": [0.5, 0.5]}).grid(0.05, 0.3).occupancy
    assert np.isnan(grid[0]).any()
    assert not (grid[0] == 0.0).any()


def test_the_seed_decides_and_nothing_else() -> None:
    rich = WorldConfig()
    assert digest(build_world(rich, 4)) == digest(build_world(rich, 4))
    assert digest(build_world(rich, 4)) != digest(build_world(rich, 5))
    own = rich.model_copy(update={"seed": 4})
    assert digest(build_world(own, 99)) == digest(build_world(rich, 4))


def test_every_process_builds_the_same_world() -> None:
    code = (
        "from slamsim.config.world import WorldConfig;"
        "from slamsim.world.build import build_world;"
        "from world_helpers import digest;"
        "print(digest(build_world(WorldConfig(), 11)), end='')"
    )
    expected = digest(build_world(WorldConfig(), 11))
    for hash_seed in ("1", "2"):
        result = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": hash_seed},
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
        assert result.stdout == expected


def test_turning_one_effect_on_leaves_the_others_alone() -> None:
    plain, dented = world(), world(dents={"share": 0.5})
    assert ground_m2(plain) != ground_m2(dented)
    np.testing.assert_array_equal(plain.visit_points_m, dented.visit_points_m)
    cluttered = world(clutter={"per_cell": 0.5})
    both = world(clutter={"per_cell": 0.5}, pillars={"share": 0.3})
    only_pillars = world(pillars={"share": 0.3})
    extra = ground_m2(cluttered) - ground_m2(plain)
    assert ground_m2(both) - ground_m2(only_pillars) == pytest.approx(extra, rel=0.6)


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


@pytest.mark.parametrize("name", bundled_names("worlds"))
def test_bundled_worlds_build_fast_and_have_a_preview(name: str) -> None:
    config = load_world_config(name)
    assert config.name == name
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        built = build_world(config, 0)
        seconds.append(time.perf_counter() - began)
    assert min(seconds) < 2.0
    image = cv2.imdecode(np.frombuffer(preview_png(built), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert 1200 <= max(image.shape) <= 1310
    red = (image[:, :, 2] > 180) & (image[:, :, 1] < 80)
    assert red.sum() > 30, "the start is drawn"


def test_the_seven_worlds_are_there() -> None:
    expected = {"corridor", "labyrinth", "labyrinth_large", "loop", "rooms", "symmetric", "tiny"}
    assert expected <= set(bundled_names("worlds"))


def test_the_preview_shows_walls_where_they_are() -> None:
    built = world(floor={"patches": [{"x_m": [0.5, 1.5], "y_m": [0.5, 1.5], "friction": 0.1}]})
    image = cv2.imdecode(np.frombuffer(preview_png(built), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    inner = image[48:-48, 48:-48]
    wall = (inner.max(axis=2) < 80)[::-1]
    grid = built.grid(max(10.15, 8.15) / 1200, 0.3).occupancy == 1.0
    assert wall.shape == grid.shape
    assert np.mean(wall == grid) > 0.995
    blue = (inner[:, :, 0] > 200) & (inner[:, :, 2] < 160)
    assert blue.sum() * (10.15 / 1200) ** 2 == pytest.approx(1.0, rel=0.2)
