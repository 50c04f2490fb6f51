"""Whole worlds: the robot fits, occupancy is true, the seed decides."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely
import world_helpers
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from world_helpers import covered_cells, digest, ground_m2, prisms, unmatched_edges, world

from slamsim.config.bundled import bundled_names
from slamsim.config.loading import load_world_config
from slamsim.config.world import WorldConfig
from slamsim.guard.errors import SlamsimError
from slamsim.world.build import build_world
from slamsim.world.preview import preview_png
from slamsim.world.prism import polygons_of
from slamsim.world.raster import Raster

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


@settings(max_examples=30)
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
    # What is kept free ends in polygons of 64 corners within a circle: 0.13 % narrower at most.
    radius_m = 0.5 * config.clearance_m * math.cos(math.pi / 64)
    blocked = shapely.union_all(shadows).buffer(radius_m - 1e-6)
    free = polygons_of(shapely.box(*built.bounds_m).difference(blocked))
    start = shapely.Point(built.start_pose[:2])
    here = [part for part in free if part.intersects(start)]
    assert len(here) == 1
    assert shapely.intersects(here[0], shapely.points(built.visit_points_m)).all()
    assert len(built.visit_points_m) >= 1
    assert unmatched_edges(built.mesh) == 0
    assert np.isfinite(built.mesh.vertices_m).all()
    assert built.mesh.vertices_m[:, 2].min() == 0.0


@settings(max_examples=12)
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
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONHASHSEED": "1"},  # here it is another in each run
        cwd=Path(world_helpers.__file__).parent,
        capture_output=True,
        text=True,
        timeout=60,
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


@pytest.mark.parametrize("name", bundled_names("worlds"))
def test_bundled_worlds_build_and_have_a_preview(name: str) -> None:
    config = load_world_config(name)
    assert config.name == name
    built = build_world(config, 0)
    image = cv2.imdecode(np.frombuffer(preview_png(built), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert 1200 <= max(image.shape) <= 1310
    red = (image[:, :, 2] > 180) & (image[:, :, 1] < 80)
    assert red.sum() > 30, "the start is drawn"


def test_the_worlds_are_there() -> None:
    expected = {
        "corridor",
        "gallery",
        "labyrinth",
        "labyrinth_large",
        "loop",
        "rooms",
        "symmetric",
        "tiny",
    }
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
