"""Prisms, their surface, and exact rasters, each against a slow second opinion."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from world_helpers import covered_cells, unmatched_edges

from slamsim.core.types import BoolArray, FloatArray, TriangleMesh
from slamsim.world.mesh_solids import MeshSolids
from slamsim.world.prism import (
    Prism,
    PrismSolids,
    Solids,
    circle,
    merge_prisms,
    moved,
    polygons_of,
    prism_mesh,
)
from slamsim.world.raster import Raster, rasterise


def volume(mesh: TriangleMesh) -> float:
    """By the divergence theorem; positive only if triangles face outwards."""
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def random_prisms(seed: int) -> list[Prism]:
    """Boxes on a grid that often touch or share faces, rings, and leaning boards."""
    rng = np.random.default_rng(seed)
    prisms = []
    for x, y, w, h, top in rng.integers(1, 9, (12, 5)).tolist():
        ground = shapely.box(x / 4, y / 4, (x + w) / 4, (y + h) / 4)
        prisms.append(Prism(ground, 0.0, 0.5 if top < 5 else 1.0))
    for x, y, outer in rng.uniform(0.3, 2.5, (3, 3)).tolist():
        ring = circle((x, y), outer).difference(circle((x, y), 0.6 * outer))
        prisms += [Prism(part, 0.2, 0.9) for part in polygons_of(ring)]
    board = Prism(shapely.box(0, 0, 0.7, 0.03), 0.0, 0.8, (0.1, 0.4))
    return [*prisms, *(moved(board, np.array([2.0, y, y])) for y in rng.uniform(0, 3, 2).tolist())]


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32))
def test_prism_surfaces_are_closed_and_face_outwards(seed: int) -> None:
    prisms = merge_prisms(random_prisms(seed))
    assert prisms
    for prism in prisms:
        mesh = prism_mesh([prism])
        assert unmatched_edges(mesh) == 0
        expected = prism.footprint.area * (prism.z_max_m - prism.z_min_m)
        assert volume(mesh) == pytest.approx(expected, rel=1e-9)


def test_merging_unites_what_has_the_same_height_and_keeps_the_rest() -> None:
    low = [Prism(shapely.box(x, 0, x + 1, 1), 0.0, 0.5) for x in (0, 1, 0.5)]
    high = Prism(shapely.box(0, 0, 3, 1), 0.0, 1.0)
    leaning = Prism(shapely.box(0, 0, 3, 1), 0.0, 0.5, (0.1, 0.0))
    merged = merge_prisms([*low, high, leaning])
    assert sorted(prism.footprint.area for prism in merged) == [2.0, 3.0, 3.0]


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32),
    resolution=st.sampled_from([0.05, 0.1, 0.07, 0.3]),
    height=st.sampled_from([0.0, 0.3, 0.5, 0.7, 1.0]),
)
def test_a_cell_is_solid_if_any_part_of_it_is(seed: int, resolution: float, height: float) -> None:
    prisms = random_prisms(seed)
    raster = Raster.covering((-0.3, -0.2, 3.1, 4.4), resolution)
    for found, polygons in (
        (PrismSolids(prisms).section(height), [prism.section(height) for prism in prisms]),
        (PrismSolids(prisms).shadow(0.4, 0.6), [prism.shadow(0.4, 0.6) for prism in prisms]),
    ):
        expected, unsure = covered_cells(polygons, raster)
        np.testing.assert_array_equal(rasterise(found, raster) | unsure, expected | unsure)


def test_faces_on_cell_borders_do_not_spill_over() -> None:
    raster = Raster.covering((0.0, 0.0, 4.0, 4.0), 0.05)
    wall = PrismSolids([Prism(shapely.box(1.95, 0.3, 2.05, 3.7), 0.0, 1.0)])
    columns = np.flatnonzero(rasterise(wall.section(0.3), raster).any(axis=0))
    assert columns.tolist() == [39, 40]


def test_rasters_lie_on_multiples_of_the_resolution() -> None:
    raster = Raster.covering((-0.175, 0.31, 1.0, 2.0), 0.05)
    assert raster.origin_m == pytest.approx((-0.2, 0.3))
    assert raster.shape == (34, 24)
    assert Raster.covering((0.1, 0.15, 0.3, 0.45), 0.05).shape == (6, 4)


def test_a_leaning_prism_is_where_its_height_carries_it() -> None:
    board = Prism(shapely.box(0, 0, 1, 0.1), 0.0, 1.0, (0.0, 0.4))
    assert board.section(0.5).bounds == pytest.approx((0, 0.2, 1, 0.3))
    assert board.shadow(0.25, 0.5).bounds == pytest.approx((0, 0.1, 1, 0.3))
    assert board.section(1.0).is_empty
    assert board.shadow(1.0, 2.0).is_empty


def masks(solids: Solids, raster: Raster) -> list[BoolArray]:
    outlines = [solids.section(h) for h in (0.1, 0.3, 0.55)] + [solids.shadow(0.01, 0.5)]
    return [rasterise(outline, raster) for outline in outlines]


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32))
def test_a_mesh_of_prisms_is_as_solid_as_the_prisms(seed: int) -> None:
    prisms = merge_prisms(random_prisms(seed))
    raster = Raster.covering((-0.3, -0.2, 5.1, 5.4), 0.0437)
    for of_mesh, of_prisms in zip(
        masks(MeshSolids(prism_mesh(prisms)), raster),
        masks(PrismSolids(prisms), raster),
        strict=True,
    ):
        # Both are exact up to rounding, which decides about a cell that is only just touched.
        assert np.count_nonzero(of_mesh != of_prisms) <= 2


def box_mesh(low: FloatArray, high: FloatArray) -> TriangleMesh:
    return prism_mesh([Prism(shapely.box(low[0], low[1], high[0], high[1]), low[2], high[2])])


def without_lids(mesh: TriangleMesh) -> TriangleMesh:
    heights = mesh.vertices_m[mesh.triangles, 2]
    return TriangleMesh(mesh.vertices_m, mesh.triangles[np.ptp(heights, axis=1) > 0])


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes[:-1])])
    return TriangleMesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([m.triangles + s for m, s in zip(meshes, starts, strict=True)]),
    )


def flipped(mesh: TriangleMesh, which: slice = slice(None)) -> TriangleMesh:
    triangles = mesh.triangles.copy()
    triangles[which] = triangles[which, ::-1]
    return TriangleMesh(mesh.vertices_m, triangles)


BOX = box_mesh(np.array([0.5, 0.5, 0.0]), np.array([2.5, 1.5, 1.0]))
RASTER = Raster.covering((0.0, 0.0, 3.0, 2.0), 0.1)


def count(mesh: TriangleMesh) -> int:
    return int(np.count_nonzero(rasterise(MeshSolids(mesh).section(0.3), RASTER)))


def test_boxes_without_lids_or_with_torn_orientation_are_solid_all_the_same() -> None:
    assert count(BOX) == 200
    assert count(without_lids(BOX)) == 200
    assert 200 <= count(flipped(without_lids(BOX), slice(0, 3))) <= 260


def test_a_shell_within_a_shell_encloses_free_space() -> None:
    inner = box_mesh(np.array([0.7, 0.7, 0.2]), np.array([2.3, 1.3, 0.8]))
    assert count(joined(BOX, flipped(inner))) == 200 - 16 * 6
    assert count(joined(BOX, inner)) == 200


def test_a_shell_that_faces_inwards_is_a_room() -> None:
    mask = rasterise(MeshSolids(flipped(BOX)).section(0.3), RASTER)
    assert not mask[6:14, 6:24].any()
    assert mask.any()


def test_an_open_sheet_has_no_thickness_but_blocks_its_cells() -> None:
    corners = np.array([[0.55, 0.15, 0.0], [0.55, 1.85, 0.0], [0.55, 1.85, 1.0], [0.55, 0.15, 1.0]])
    sheet = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    solids = MeshSolids(sheet)
    for outline in (solids.section(0.3), solids.shadow(0.01, 0.5)):
        rows, columns = np.nonzero(rasterise(outline, RASTER))
        assert set(columns.tolist()) == {5}
        assert sorted(rows.tolist()) == list(range(1, 19))


def test_a_table_over_the_robot_casts_no_shadow_and_a_low_step_does() -> None:
    table = box_mesh(np.array([0.5, 0.5, 0.7]), np.array([1.0, 1.0, 0.75]))
    step = box_mesh(np.array([2.0, 0.5, 0.0]), np.array([2.5, 1.0, 0.1]))
    shadow = rasterise(MeshSolids(joined(table, step)).shadow(0.01, 0.5), RASTER)
    assert np.count_nonzero(shadow) == 25
    assert shadow[5:10, 20:25].all()
    assert not rasterise(MeshSolids(joined(table, step)).section(0.3), RASTER).any()
