"""Worlds from occupancy images and from triangle meshes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from slamsim.config.loading import load_run_config, load_world_config
from slamsim.config.world import WorldConfig
from slamsim.core.types import BoolArray
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.world.build import build_world
from slamsim.world.map_server import outline_cells
from slamsim.world.model import World

Image = NDArray[np.uint8]

ROOM: Image = np.full((40, 60), 254, dtype=np.uint8)
ROOM[[0, -1]] = ROOM[:, [0, -1]] = 0
ROOM[:25, 30] = 0  # a wall from the top of the image, that is from the largest y


def write_map(folder: Path, pixels: Image, kind: str = "pgm", /, **keys: Any) -> Path:
    """A map_server map; keys change or, if None, leave out what its YAML says."""
    cv2.imwrite(str(folder / f"map.{kind}"), pixels)
    said = {
        "image": f"map.{kind}",
        "resolution": 0.1,
        "origin": [-1.0, 2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        **keys,
    }
    lines = [f"{key}: {value}" for key, value in said.items() if value is not None]
    path = folder / "map.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def world_of(path: Path, *overrides: str) -> World:
    of_the_world = [f"world.{text}" for text in overrides]
    return build_world(load_run_config(str(path), overrides=of_the_world).world, 0)


def solid(world: World, resolution_m: float = 0.1) -> BoolArray:
    return np.asarray(world.grid(resolution_m, 0.3).occupancy == 1.0)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32), share=st.floats(0.05, 0.95))
def test_the_outlines_of_a_mask_cover_it_exactly(seed: int, share: float) -> None:
    mask = np.random.default_rng(seed).random((12, 17)) < share
    polygons = outline_cells(mask)
    rows, columns = np.indices(mask.shape)
    points = shapely.points(columns + 0.5, rows + 0.5)
    inside = np.zeros(mask.shape, dtype=bool)
    for polygon in polygons:
        inside |= shapely.contains(polygon, points)
    np.testing.assert_array_equal(inside, mask)
    assert sum(polygon.area for polygon in polygons) == mask.sum()


def test_an_image_becomes_the_same_cells_lowest_row_first(tmp_path: Path) -> None:
    world = world_of(write_map(tmp_path, ROOM))
    grid = world.grid(0.1, 0.3)
    assert grid.origin_m == pytest.approx((-1.0, 2.0))
    np.testing.assert_array_equal(grid.occupancy == 1.0, ROOM[::-1] == 0)
    assert world.name == "map"
    assert world.mesh.vertices_m[:, 2].max() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("levels", "keys"),
    [
        ((0, 254, 205), {}),
        ((255, 1, 100), {"negate": 1}),
        ((255, 1, 100), {"negate": "true"}),
        ((0, 254, 205), {"mode": "scale"}),
        ((100, 0, 255), {"mode": "raw"}),
        ((66, 19, 50), {"mode": "raw"}),
        ((80, 240, 150), {"occupied_thresh": 0.6, "free_thresh": 0.3}),
    ],
)
@pytest.mark.parametrize("unknown", ["solid", "open"])
def test_grey_levels_are_read_as_map_server_does(
    tmp_path: Path, levels: tuple[int, int, int], keys: dict[str, Any], unknown: str
) -> None:
    occupied, free, neither = levels
    image = np.where(ROOM == 0, occupied, free).astype(np.uint8)
    image[30:33, 10:13] = neither
    path = write_map(tmp_path, image, "png", **keys)
    found = solid(world_of(path, f"image.unknown={unknown}"))
    expected = ROOM == 0
    expected[30:33, 10:13] = unknown == "solid"
    np.testing.assert_array_equal(found, expected[::-1])


def test_transparent_is_unknown_in_scale_mode_only(tmp_path: Path) -> None:
    image = np.dstack([ROOM, ROOM, ROOM, np.full_like(ROOM, 255)])
    image[30, 10, 3] = 100
    for mode, is_solid in (("scale", True), ("trinary", False)):
        found = solid(world_of(write_map(tmp_path, image, "png", mode=mode)))
        assert found[::-1][30, 10] == is_solid


def test_an_origin_with_yaw_turns_the_map(tmp_path: Path) -> None:
    world = world_of(write_map(tmp_path, ROOM, origin=[1.0, 2.0, math.pi / 2]))
    np.testing.assert_array_equal(solid(world), np.rot90(ROOM[::-1] == 0, -1))
    assert world.bounds_m == pytest.approx((-3.0, 2.0, 1.0, 8.0))
    slanted = world_of(write_map(tmp_path, ROOM, origin=[1.0, 2.0, 0.3]))
    area = sum(p.footprint.area for p in slanted.solids.prisms)  # type: ignore[attr-defined]
    assert area == pytest.approx(np.count_nonzero(ROOM == 0) * 0.01)


def test_the_tour_stays_where_the_robot_fits(tmp_path: Path) -> None:
    image = ROOM.copy()
    image[:, 30] = 0
    image[35:38, 30] = 254  # 0.3 m: too narrow for 0.6 m
    world = world_of(write_map(tmp_path, image), "image.visit_spacing_m=1.0")
    left = (world.visit_points_m[:, 0] - (-1.0)) < 3.0
    assert left.all() or not left.any()
    grid = world.grid(0.1, 0.3)
    assert np.count_nonzero(grid.occupancy == 0.0) > 2000, "the narrow gap joins both halves"
    with pytest.raises(SlamsimError, match=r"clearance_m 3.*widest spot has 2\.\d+ m"):
        world_of(tmp_path / "map.yaml", "clearance_m=3.0")


def test_a_given_start_decides_which_part_counts(tmp_path: Path) -> None:
    image = ROOM.copy()
    image[:, 30] = 0
    path = write_map(tmp_path, image)
    for x in (0.5, 3.5):
        world = world_of(path, f"start={{x_m: {x}, y_m: 4.0, yaw_deg: 90}}")
        assert world.start_pose == pytest.approx([x, 4.0, math.pi / 2])
        assert ((world.visit_points_m[:, 0] < 2.0) == (x < 2.0)).all()
    for x, says in ((2.1, "0.6 needs 0.3 m"), (90.0, "out of the world")):
        with pytest.raises(SlamsimError, match=says):
            world_of(path, f"start={{x_m: {x}, y_m: 4.0}}")


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"resolution": None}, "resolution"),
        ({"resolution": -0.1}, "resolution"),
        ({"resolution": "'0.1'"}, "resolution"),
        ({"origin": [0.0, 0.0]}, "origin"),
        ({"origin": [0.0, 0.0, ".nan"]}, "origin"),
        ({"negate": 2}, "negate"),
        ({"mode": "trinery"}, "mode"),
        ({"free_thresh": 0.9}, "exceeds occupied_thresh"),
        ({"image": "../map.pgm"}, "inside the folder"),
        ({"image": "/etc/passwd"}, "inside the folder"),
        ({"image": "map.yaml"}, "not an image"),
        ({"occupied_thresh": 1.0}, "not one of its 2,400 cells is occupied"),
    ],
)
def test_bad_maps_are_refused(tmp_path: Path, keys: dict[str, Any], says: str) -> None:
    path = write_map(tmp_path, ROOM, **keys)
    with pytest.raises(InputRefused, match=says):
        build_world(load_world_config_of(path), 0)


def test_further_keys_of_other_programs_are_told_and_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plain = solid(world_of(write_map(tmp_path, ROOM)))
    assert caplog.messages == []
    further = {"map_type": "occupancy", "free_tresh": 0.2, "layers": "{a: [1, .nan]}"}
    found = solid(world_of(write_map(tmp_path, ROOM, **further)))
    np.testing.assert_array_equal(found, plain)
    path = tmp_path / "map.yaml"
    assert caplog.messages == [
        f"{path}: these keys of the map are not used: map_type, free_tresh, layers"
    ]


def load_world_config_of(path: Path) -> WorldConfig:
    """As a world file would name it, whether or not the map is recognised as one."""
    world = path.with_name("world.yaml")
    world.write_text(f"image:\n  file: {path.name}\n")
    return load_world_config(str(world))


def test_missing_files_are_named(tmp_path: Path) -> None:
    path = write_map(tmp_path, ROOM, image="gone.pgm")
    with pytest.raises(NotFound, match=r"gone\.pgm"):
        world_of(path)
    world = tmp_path / "world.yaml"
    world.write_text("mesh: {file: gone.stl}\n")
    with pytest.raises(NotFound, match=r"gone\.stl"):
        world_of(world)


def hall() -> Any:
    """Four walls round 6 x 4 m, a box on the floor and a lamp under the ceiling."""
    boxes = [
        ((0, 0, 0), (6, 0.2, 1)),
        ((0, 3.8, 0), (6, 4, 1)),
        ((0, 0.2, 0), (0.2, 3.8, 1)),
        ((5.8, 0.2, 0), (6, 3.8, 1)),
        ((2, 1, 0), (3, 1.5, 0.2)),
        ((4, 1, 0.8), (4.5, 1.5, 0.9)),
    ]
    return trimesh.util.concatenate([trimesh.creation.box(bounds=pair) for pair in boxes])


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_every_mesh_format_gives_the_same_world(tmp_path: Path, suffix: str) -> None:
    mesh, path, overrides = hall(), tmp_path / f"hall.{suffix}", []
    if suffix == "glb":  # the format says that y points up
        mesh.apply_transform(np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]]))
    if suffix == "stl":
        mesh.apply_scale(1000.0)
        overrides = ["mesh.scale=0.001"]
    if suffix == "obj":
        mesh.apply_translation([0, 0, 7.0])
        overrides = ["mesh.floor_m=7.0"]
    mesh.export(path)
    world = world_of(path, *overrides)
    assert world.bounds_m == pytest.approx((0.0, 0.0, 6.0, 4.0), abs=1e-5)
    grid, body = world.grid(0.25, 0.3), world.obstacle_grid(0.25)
    assert np.count_nonzero(grid.occupancy == 1.0) == 24 * 16 - 22 * 14
    assert (grid.occupancy[4:6, 8:12] == 0.0).all(), "the low box is not at the lidar's height"
    assert (body.occupancy[4:6, 8:12] == 1.0).all()
    assert (body.occupancy[4:6, 16:18] == 0.0).all(), "the lamp hangs above the robot"
    assert len(world.visit_points_m) >= 4


def test_bad_meshes_are_refused(tmp_path: Path) -> None:
    good = hall()
    cases = {
        "empty.stl": b"",
        "cut.stl": trimesh.exchange.stl.export_stl(good)[:500],
        "text.ply": b"hello",
        "foreign.glb": b"glTF" + bytes(20),
        "hall.dae": b"<COLLADA/>",
    }
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        config = tmp_path / "world.yaml"
        config.write_text(f"mesh:\n  file: {name}\n")
        with pytest.raises(InputRefused, match=name.replace(".", r"\.")):
            build_world(load_world_config(str(config)), 0)
    vertices = good.vertices.tolist()
    lines = [f"v {x} {y} {z}" for x, y, z in [*vertices[:-1], (np.nan, 0, 0)]]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in good.faces.tolist()]
    (tmp_path / "nan.obj").write_text("\n".join(lines))
    with pytest.raises(InputRefused, match="finite"):
        world_of(tmp_path / "nan.obj")


def test_a_mesh_below_the_floor_is_refused(tmp_path: Path) -> None:
    hall().export(tmp_path / "hall.ply")
    with pytest.raises(InputRefused, match="1 m below the floor"):
        world_of(tmp_path / "hall.ply", "mesh.floor_m=2.0")


def test_a_solid_block_has_no_room_for_a_robot(tmp_path: Path) -> None:
    trimesh.creation.box(bounds=[(0, 0, 0), (4, 4, 1)]).export(tmp_path / "block.ply")
    with pytest.raises(SlamsimError, match=r"clearance_m 0\.6: nowhere"):
        world_of(tmp_path / "block.ply")


@pytest.mark.long
@pytest.mark.parametrize(
    ("unit", "warned"), [(1.0, False), (60.0, True), (1000.0, None), (0.0254, False)]
)
def test_a_mesh_in_another_unit_is_told(
    unit: float, warned: bool | None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A room of 6 x 4 m whose numbers are metres, or much larger."""
    hall().apply_scale(unit).export(tmp_path / "hall.ply")
    if warned is None:
        size = r"is 6000 x 4000 m large and 1000 m high: too large .* --set world.mesh.scale=0.001$"
        with pytest.raises(InputRefused, match=size):
            world_of(tmp_path / "hall.ply")
    elif unit < 1.0:
        with pytest.raises(SlamsimError, match="nowhere is there so much room"):
            world_of(tmp_path / "hall.ply")
    else:
        world_of(tmp_path / "hall.ply", "mesh.visit_spacing_m=50.0")
    told = [message for message in caplog.messages if "360 x 240 m large and 60 m" in message]
    assert len(told) == len(caplog.messages) == int(bool(warned))


@pytest.mark.long
def test_an_image_of_the_wrong_resolution_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world_of(write_map(tmp_path, ROOM, resolution=5.0), "image.visit_spacing_m=50.0")
    assert len(caplog.messages) == 1
    assert "300 x 200 m" in caplog.messages[0] and "metres per pixel" in caplog.messages[0]
