"""The looks of small worlds: colours, light, instances, and the same bytes however asked."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from looks_example import looks_of, nothing_between, points_on, room
from pydantic import ValidationError
from world_helpers import world

from slamsim.config.layout import LooksConfig
from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.world.looks.finishes import MATERIALS, MaterialId
from slamsim.world.looks.lamps import light_of, lit_by
from slamsim.world.parts import WALL

PX_M = 0.004


def test_instances_are_those_of_the_world() -> None:
    at = room()
    looks = looks_of(at)
    none = np.uint32(0xFFFFFFFF)
    count = len(at.mesh.triangles)
    numbers = np.append(np.arange(count + 2, dtype=np.uint32), none)

    instances = looks.instances(numbers)

    assert np.array_equal(instances[:count], at.parts.owners)
    assert instances[count:].tolist() == [1, 1, 0]
    assert looks.kinds == ("nothing", "floor", "wall", "box")
    assert looks.materials(numbers, np.zeros((len(numbers), 3)))[-1] == MaterialId.NOTHING


def test_a_texture_runs_on_over_the_triangles_of_a_wall() -> None:
    """Beside the diagonal of a wall both triangles give the same colour."""
    at = room()
    looks = looks_of(at, family="bricks", posters={"count": 0})
    corners = at.mesh.vertices_m[at.mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    pairs = [
        (one, other)
        for one in range(len(corners))
        for other in range(one)
        if np.allclose(normals[one], normals[other])
        and len({*map(tuple, corners[one])} & {*map(tuple, corners[other])}) == 2
    ]
    assert len(pairs) >= 12
    for one, other in pairs:
        ends = np.array(sorted({*map(tuple, corners[one])} & {*map(tuple, corners[other])}))
        edge = ends[0] + np.linspace(0.05, 0.95, 40)[:, None] * (ends[1] - ends[0])
        mine, others = (looks.albedo(edge, np.full(40, each), PX_M) for each in (one, other))
        assert np.array_equal(mine, others)
        assert mine.std() > 0.0


def test_the_same_bytes_however_hits_are_divided() -> None:
    at = room()
    looks, again = looks_of(at, tags={"count": 3}), looks_of(at, tags={"count": 3})
    triangles, points, normals = points_on(at, 1000)

    whole = looks.shade(points, normals, triangles, PX_M, nothing_between)
    parts = [
        again.shade(points[part], normals[part], triangles[part], PX_M, nothing_between)
        for part in np.array_split(np.arange(1000), 7)
    ]

    assert np.array_equal(whole, np.concatenate(parts))


def test_looks_follow_their_seed() -> None:
    at = room()
    triangles, points, _ = points_on(at, 300)

    def digest(**changes: object) -> str:
        colours = looks_of(at, **changes).albedo(points, triangles, PX_M)
        return hashlib.sha256(colours.tobytes()).hexdigest()

    assert digest() == digest(seed=0)
    assert len({digest(), digest(seed=1), digest(split="test"), digest(texture=0.5)}) == 4


def test_clutter_does_not_change_the_walls() -> None:
    bare, cluttered = world(4), world(4, clutter={"per_cell": 2.0})
    numbers, points, _ = points_on(bare, 500)
    same = np.flatnonzero(cluttered.parts.owners == WALL)[numbers]

    one = looks_of(bare, posters={"count": 0}).albedo(points, numbers, PX_M)
    other = looks_of(cluttered, posters={"count": 0}).albedo(points, same, PX_M)

    assert np.array_equal(bare.mesh.triangles.shape, [(cluttered.parts.owners == WALL).sum(), 3])
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_without_texture_each_surface_has_one_colour() -> None:
    at = room()
    looks = looks_of(at, family="bricks", texture=0.0)
    triangles, points, _ = points_on(at, 2000)

    colours = looks.albedo(points, triangles, PX_M)

    planes = looks.painting.plane_of[triangles]
    assert all(np.ptp(colours[planes == plane], axis=0).max() == 0.0 for plane in set(planes))
    assert (looks.materials(triangles, points) != MaterialId.PAPER).all()
    rich = looks_of(at, family="bricks").albedo(points, triangles, PX_M)
    assert rich[planes == planes[0]].std(axis=0).min() > 0.01


def test_light_is_that_of_a_panel_that_faces_the_floor() -> None:
    """Against the formula in numpy, lamp by lamp, and the strongest few of all."""
    at = room(half_m=6.0)
    looks = looks_of(at, lamps={"shadowing": 2, "spacing_m": 2.5, "reach_m": 5.0})
    lamps = looks.lamps
    _, points, normals = points_on(at, 400)

    away = lamps.positions_m[None] - points[:, None]
    square = np.sum(away**2, axis=2)
    cosine = np.einsum("nlx,nx->nl", away, normals) / np.sqrt(square)
    down = away[..., 2] / np.sqrt(square)
    window = np.clip(1.0 - (square / 25.0) ** 2, 0.0, None) ** 2
    light = 0.8 * 2.6**2 * window * np.clip(cosine, 0, None) * np.clip(down, 0, None) / square
    one = [light_of(lamps, lamp, points[7], normals[7]) for lamp in range(len(away[0]))]
    np.testing.assert_allclose(one, light[7], rtol=1e-9, atol=1e-12)
    ranked = np.sort(light, axis=1)[:, ::-1]
    expected = np.clip(ranked[:, :2] - ranked[:, 2:3], 0.0, None).sum(axis=1)
    lit = lit_by(lamps, points, normals)
    found = np.bincount(lit.points, weights=lit.strengths, minlength=400)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=3e-4)


def test_lamps_hang_apart_and_no_place_is_left_for_another() -> None:
    at = room(half_m=6.0)
    lamps = looks_of(at, lamps={"spacing_m": 2.0}).lamps
    places = lamps.positions_m[:, :2]

    apart = np.linalg.norm(places[:, None] - places[None], axis=2)

    assert (apart[~np.eye(len(places), dtype=bool)] >= 2.0).all()
    free = np.random.default_rng(0).uniform(-5.9, 5.2, (500, 2))
    assert (np.linalg.norm(free[:, None] - places, axis=2).min(axis=1) < 2.1).all()
    assert (np.abs(places) < 6.0).all()


def test_shadows_are_where_the_caster_says() -> None:
    at = room()
    looks = looks_of(at, lamps={"ambient": 0.0})
    triangles, points, normals = points_on(at, 500)
    asked: list[FloatArray] = []

    def behind(
        origins_m: FloatArray, directions: Float32Array, distances_m: Float32Array
    ) -> BoolArray:
        asked.append(origins_m + directions * distances_m[:, None])
        return np.asarray(origins_m[:, 0] < 0.0)

    radiance = looks.shade(points, normals, triangles, PX_M, behind)

    lit = looks.shade(points, normals, triangles, PX_M, nothing_between)
    dark = points[:, 0] < -2e-3
    assert (radiance[dark] == 0.0).all() and (lit[dark].max(axis=1) > 0.0).any()
    bright = points[:, 0] > 2e-3
    assert np.array_equal(radiance[bright], lit[bright])
    ends = np.linalg.norm(asked[0][:, None] - looks.lamps.positions_m, axis=2).min(axis=1)
    np.testing.assert_allclose(ends, 1e-3, atol=1e-5)


def test_nothing_is_black_and_the_background_is_where_nothing_was_hit() -> None:
    at = room()
    looks = looks_of(at)
    triangles, points, normals = points_on(at, 500)
    triangles[::2] = 0xFFFFFFFF

    def dark(
        origins_m: FloatArray, directions: Float32Array, distances_m: Float32Array
    ) -> BoolArray:
        return np.ones(len(origins_m), dtype=bool)

    radiance = looks.shade(points, normals, triangles, PX_M, dark)

    assert (radiance > 0.0).all()
    assert (radiance[::2] == looks.background).all()
    assert (looks.albedo(points, triangles, PX_M)[::2] == 0.0).all()


def test_no_hits_at_all() -> None:
    looks = looks_of(room())
    none, points = np.zeros(0, dtype=np.uint32), np.zeros((0, 3))

    assert looks.shade(points, points.astype(np.float32), none, 0.1, nothing_between).shape == (
        0,
        3,
    )
    assert looks.materials(none, points).size == looks.instances(none).size == 0


def test_hits_of_other_shapes_are_refused() -> None:
    looks = looks_of(room())
    with pytest.raises(BadNumbers, match=r"points that rays hit: an array of \(2, 3\)"):
        looks.albedo(np.zeros((3, 3)), np.zeros(2, dtype=np.int64), 0.1)
    with pytest.raises(BadNumbers, match="begin at 0, not at -1"):
        looks.instances(np.array([-1]))
    with pytest.raises(BadNumbers, match="whole numbers"):
        looks.instances(np.array([0.5]))


def test_materials_are_in_the_order_of_their_numbers() -> None:
    assert [material.name for material in MATERIALS] == [m.name.lower() for m in MaterialId]
    assert sum(m.is_glass for m in MATERIALS) == sum(m.is_mirror for m in MATERIALS) == 1
    looks = looks_of(room())
    assert looks.ir_reflectances[MaterialId.PAPER] == np.float32(0.8)
    assert looks.roughnesses[MaterialId.MIRROR] == 0.0


def test_a_labyrinth_has_things_of_their_own_materials() -> None:
    at = world(4, clutter={"per_cell": 2.0})
    looks = looks_of(at, family="home")

    tables = [number for number, kind in enumerate(looks.kinds) if kind == "table"]

    assert len(tables) > 1
    of_tables = looks.material_of[np.isin(looks.part_of, tables)]
    assert (of_tables == MaterialId.WOOD).all()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"family": "castle"}, "mixed"),
        ({"texture": 1.5}, "less than or equal to 1"),
        ({"tags": {"family": "aruco_4x4_50", "count": 51}}, "more than the 50 of aruco_4x4_50"),
        ({"tags": {"first_id": 587, "count": 1}}, "more than the 587 of apriltag_36h11"),
        ({"tags": {"size_m": [0.3, 0.1]}}, "tags.size_m"),
        ({"lamps": {"spacing_m": 0.0}}, "greater than or equal to 0.5"),
        ({"lanterns": {}}, "Extra inputs"),
    ],
)
def test_bad_looks_are_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        LooksConfig.model_validate(keys)
