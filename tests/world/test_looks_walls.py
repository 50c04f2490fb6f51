"""What hangs on walls: where, how large, and what is seen of it; no texture in two splits."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
import yaml
from hypothesis import given
from hypothesis import strategies as st
from looks_example import looks_of, room
from world_helpers import PLAIN, world

from slamsim.config.layout import PostersConfig, Split, tags_in
from slamsim.config.run import RunConfig
from slamsim.config.world import WorldConfig
from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import Float32Array, FloatArray
from slamsim.simulation.own_files import write_world
from slamsim.world.build import build_world
from slamsim.world.looks.build import Looks
from slamsim.world.looks.decals import Decal, decal_table
from slamsim.world.looks.families import FAMILIES, draw_finish
from slamsim.world.looks.finishes import MaterialId, split_share
from slamsim.world.looks.paint import _decal_colour
from slamsim.world.looks.places import Place
from slamsim.world.looks.posters import hang_posters, poster_pixels
from slamsim.world.looks.tags import Tag, tag_pixels, tags_yaml
from slamsim.world.model import World
from slamsim.world.parts import WALL


class FreeWalls:
    """Room for every sheet."""

    def hang(self, size_m: tuple[float, float], *_: object) -> Place:
        return Place(0, 0.0, 0.0, *size_m)

    def middle_m(self, place: Place) -> FloatArray:
        return np.zeros(3)


CLUTTERED = {"clutter": {"per_cell": 1.0}, "dents": {"share": 0.5}, "doors": {"share": 0.3}}
TAGS = {"count": 15, "size_m": (0.1, 0.3)}


def front_of(looks: Looks, tag: Tag, pixels: int, border: float = 2.0) -> Float32Array:
    """(pixels, pixels) grey picture of the wall around a tag, seen from straight before it."""
    half = 0.5 * border * tag.size_m
    step = 2.0 * half / pixels
    across = (np.arange(pixels) + 0.5) * step - half
    x, y = np.meshgrid(across, -across)
    points = np.column_stack([x.ravel(), y.ravel()]) @ tag.T_map_tag[:3, :2].T
    points = points + tag.T_map_tag[:3, 3]
    plane = int(np.argmin(np.linalg.norm(_offsets(looks, tag), axis=1)))
    triangle = int(np.flatnonzero(looks.painting.plane_of == plane)[0])
    colours = looks.albedo(points, np.full(len(points), triangle), step)
    return np.asarray(colours[:, 1].reshape(pixels, pixels))


def _offsets(looks: Looks, tag: Tag) -> FloatArray:
    """How far the axes of each plane are from the tag's; a plane without this tag is far."""
    painting = looks.painting
    off = np.hstack(
        [painting.u_axes - tag.T_map_tag[:3, 0], painting.v_axes - tag.T_map_tag[:3, 1]]
    )
    centre = tag.T_map_tag[:3, 3]
    for plane in range(len(off)):
        span = slice(painting.decals.first_of[plane], painting.decals.first_of[plane + 1])
        places = painting.decals.places_m[span]
        at = np.array([centre @ painting.u_axes[plane], centre @ painting.v_axes[plane]])
        middles = places[:, :2] + 0.5 * places[:, 2:]
        if not (np.linalg.norm(middles - at, axis=1) < 1e-9).any():
            off[plane] += 10.0
    return off


@pytest.mark.parametrize("family", ["apriltag_36h11", "aruco_4x4_50", "aruco_5x5_100"])
def test_opencv_reads_tags_where_they_are_said_to_be(family: str) -> None:
    looks = looks_of(room(half_m=3.0), tags={**TAGS, "count": 6, "family": family, "first_id": 7})
    kind = "APRILTAG_36h11" if family == "apriltag_36h11" else family[6:].upper()
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{kind}"))
    detector = cv2.aruco.ArucoDetector(dictionary)

    assert [tag.id for tag in looks.tags] == list(range(7, 13))
    for tag in looks.tags:
        picture = (255 * front_of(looks, tag, 300)).astype(np.uint8)
        corners, ids, _ = detector.detectMarkers(cv2.merge([picture] * 3))
        assert ids.ravel().tolist() == [tag.id]
        # the black square is from 1/4 to 3/4 of a picture twice as wide; upper left first
        low, high = 75.0 - 0.5, 225.0 - 0.5
        expected = [[low, low], [high, low], [high, high], [low, high]]
        np.testing.assert_allclose(corners[0][0], expected, atol=1.0)


def test_tags_hang_on_walls_and_face_the_room() -> None:
    at = world(4, **CLUTTERED)
    looks = looks_of(at, tags=TAGS, posters={"count": 40}, panes={"glass": 3, "mirrors": 2})
    corners = at.mesh.vertices_m[at.mesh.triangles[at.parts.owners == WALL]]

    assert len(looks.tags) == 15
    for tag in looks.tags:
        T = tag.T_map_tag
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        assert T[:3, 1] == pytest.approx([0, 0, 1])
        assert 0.25 <= T[2, 3] <= 0.7 and 0.1 <= tag.size_m <= 0.3
        _assert_on_wall(tag, corners)
        _assert_free_before(at, tag)


def _assert_on_wall(tag: Tag, corners: FloatArray) -> None:
    """Triangles of walls in the tag's own plane cover its square with its border."""
    T_tag_map = np.linalg.inv(tag.T_map_tag)
    seen = corners @ T_tag_map[:3, :3].T + T_tag_map[:3, 3]
    flat = seen[np.abs(seen[..., 2]).max(axis=1) < 1e-4]
    half = 0.5 * tag.size_m * 10 / 8
    cover = shapely.union_all(shapely.polygons(flat[..., :2])).buffer(1e-6)
    assert cover.contains(shapely.box(-half, -half, half, half))


def _assert_free_before(at: World, tag: Tag) -> None:
    grid = at.obstacle_grid(0.05)
    for distance in (0.15, 0.3, 0.5):
        point = tag.T_map_tag[:2, 3] + distance * tag.T_map_tag[:2, 2]
        column, row = ((point - grid.origin_m) // 0.05).astype(int)
        assert grid.occupancy[row, column] == 0.0


def test_sheets_never_overlap_and_no_wall_shows_through_two() -> None:
    looks = looks_of(
        world(4, **CLUTTERED), tags=TAGS, posters={"count": 60}, panes={"glass": 4, "mirrors": 4}
    )
    decals = looks.painting.decals
    assert np.bincount(decals.materials)[10:].tolist()[1] == 15
    assert len(decals.materials) > 60
    for first, end in zip(decals.first_of[:-1], decals.first_of[1:], strict=True):
        low = decals.places_m[first:end, :2]
        boxes = shapely.box(*low.T, *(low + decals.places_m[first:end, 2:]).T)
        assert shapely.union_all(boxes).area == pytest.approx(shapely.area(boxes).sum())


def test_posters_do_not_move_tags() -> None:
    at = world(4, **CLUTTERED)
    some, others = (looks_of(at, tags=TAGS, posters={"count": n}).tags for n in (0, 30))

    assert [tag.id for tag in some] == [tag.id for tag in others]
    assert all(np.array_equal(a.T_map_tag, b.T_map_tag) for a, b in zip(some, others, strict=True))


def test_tags_that_find_no_room_are_told(caplog: pytest.LogCaptureFixture) -> None:
    looks = looks_of(room(height_m=0.3), tags={"count": 2, "size_m": (0.5, 0.5)})

    assert looks.tags == ()
    assert "only 0 of 2 tags find room" in caplog.text


def test_the_file_of_tags_says_where_they_hang() -> None:
    tags = looks_of(room(), tags={"count": 4}).tags

    said = yaml.safe_load(tags_yaml(tags))["tags"]

    assert [each["id"] for each in said] == [0, 1, 2, 3]
    for each, tag in zip(said, tags, strict=True):
        assert (each["family"], each["size_m"]) == (tag.family, tag.size_m)
        assert each["position_m"] == tag.T_map_tag[:3, 3].tolist()
        turned = matrix_from_xyzw(np.array(each["quat_xyzw"]))
        np.testing.assert_allclose(turned, tag.T_map_tag[:3, :3], atol=1e-12)


def test_a_world_is_written_with_its_tags(tmp_path: Path) -> None:
    for count in (0, 2):
        keys = {**PLAIN, "looks": {"tags": {"count": count}}}
        config = RunConfig(world=WorldConfig.model_validate(keys))
        folder = tmp_path / str(count)
        folder.mkdir()
        write_world(folder, config, build_world(config.world, 0))
        assert (folder / "tags.yaml").exists() == (count > 0)
        assert ("looks" in (folder / "world.yaml").read_text()) == (count > 0)


def test_a_hit_on_a_pane_is_glass() -> None:
    at = room(half_m=3.0)
    looks = looks_of(at, panes={"glass": 1, "mirrors": 1}, posters={"count": 0})
    assert looks_of(at).mirroring is None
    assert looks.mirroring is not None
    assert np.flatnonzero(looks.mirroring).tolist() == [MaterialId.GLASS, MaterialId.MIRROR]
    decals = looks.painting.decals
    for material in (MaterialId.GLASS, MaterialId.MIRROR):
        number = decals.materials.tolist().index(material)
        plane = int(np.searchsorted(decals.first_of, number, side="right")) - 1
        triangle = int(np.flatnonzero(looks.painting.plane_of == plane)[0])
        u, v = decals.places_m[number, :2] + 0.5 * decals.places_m[number, 2:]
        axes = looks.painting.u_axes[plane], looks.painting.v_axes[plane]
        normal = np.cross(*axes)
        corner = at.mesh.vertices_m[at.mesh.triangles[triangle, 0]]
        point = (corner @ normal) * normal + u * axes[0] + v * axes[1]
        assert looks.materials(np.array([triangle]), point[None]) == [material]
        assert looks.albedo(point[None], np.array([triangle]), 0.01).max() < 0.1


@given(
    x=st.floats(0.0, 0.999), y=st.floats(0.0, 0.999), px=st.floats(0.001, 1.5), crisp=st.booleans()
)
def test_sheets_are_averaged_over_the_pixel(x: float, y: float, px: float, crisp: bool) -> None:
    """Against the mean of 200 x 200 points of the pixel that lie on the sheet."""
    pixels = np.random.default_rng(3).random((5, 4, 3)).astype(np.float32)
    place = Place(0, 2.0, -1.0, 1.0, 1.0)
    table = decal_table([Decal(place, MaterialId.PAPER, pixels, is_crisp=crisp)], 1)

    found = _decal_colour(table, 0, 2.0 + x, -1.0 + y, px)

    wide, high = (max(px, 0.0 if crisp else 1.0 / n) for n in (4, 5))
    share = (np.arange(200) + 0.5) / 200 - 0.5
    at_x, at_y = x + wide * share, 1.0 - y + high * share
    columns = (4 * at_x[(at_x >= 0) & (at_x < 1)]).astype(int)
    rows = (5 * at_y[(at_y >= 0) & (at_y < 1)]).astype(int)
    expected = pixels[np.ix_(rows, columns)].mean(axis=(0, 1))
    np.testing.assert_allclose(found, expected, atol=0.02)


@given(share=st.floats(0, 1, exclude_max=True), other=st.floats(0, 1, exclude_max=True))
def test_splits_have_no_number_in_common(share: float, other: float) -> None:
    train, test = split_share(share, "train"), split_share(other, "test")

    assert 0.0 <= train < 1.0 and 0.0 <= test < 1.0
    assert int(8 * train) % 2 == 0 and int(8 * test) % 2 == 1


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_no_texture_is_in_two_splits(family: str) -> None:
    """Sizes and noise of all finishes that 200 draws give, and the prints of posters."""
    sizes: dict[str, set[float]] = {"train": set(), "test": set()}
    seeds: dict[str, set[int]] = {"train": set(), "test": set()}
    for number in range(200):
        for split in ("train", "test"):
            rng = np.random.default_rng(number)
            finish = draw_finish(family, ("wall", "floor", "box", "chair")[number % 4], split, rng)  # type: ignore[arg-type]
            sizes[split].add(finish.size_m)
            seeds[split].update(range(finish.noise_seed, finish.noise_seed + 64))

    assert sizes["train"].isdisjoint(sizes["test"])
    assert seeds["train"].isdisjoint(seeds["test"])


def test_prints_of_a_world_are_those_of_its_split() -> None:
    """Each poster of a world is one of those that even (train) or odd (test) numbers draw."""
    pages = [poster_pixels(number, 160).tobytes() for number in range(20)]

    assert len(set(pages)) == 20
    assert poster_pixels(4, 224).shape == (224, 160, 3)
    space = FreeWalls()
    drawn: dict[Split, set[bytes]] = {"train": set(), "test": set()}
    for split, sheets in drawn.items():
        rng = np.random.default_rng(0)
        posters = hang_posters(space, PostersConfig(), 12, split, rng)  # type: ignore[arg-type]
        sheets.update(poster.pixels.tobytes() for poster in posters)
    assert len(drawn["train"]) == len(drawn["test"]) == 12
    assert drawn["train"].isdisjoint(drawn["test"])


def test_tags_are_as_many_as_opencv_has() -> None:
    for family, name in (
        ("apriltag_36h11", "APRILTAG_36h11"),
        ("aruco_4x4_50", "4X4_50"),
        ("aruco_6x6_1000", "6X6_1000"),
        ("aruco_original", "ARUCO_ORIGINAL"),
    ):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
        assert tags_in(family) == len(dictionary.bytesList)  # type: ignore[arg-type]
        cells = dictionary.markerSize + 4
        assert tag_pixels(family, 3).shape == (cells, cells, 3)  # type: ignore[arg-type]
