"""Layers of a map: rays against dense sampling, votes against counting, both on simple scenes."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from slamsim.cameras.codecs.pictures import decode_picture
from slamsim.config.loading import load_run_config
from slamsim.config.slam import LayersConfig, MappingConfig
from slamsim.console.reporter import Reporter
from slamsim.core.layers import ObstacleLayer, label_colours
from slamsim.core.types import Float32Array, FloatArray, Grid
from slamsim.evaluate.obstacles import score_obstacles
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.numbers import BadNumbers
from slamsim.io.open import open_recording
from slamsim.perception.calibrated import NO_CALIBRATION, CameraClock
from slamsim.perception.layers import labels as of_labels
from slamsim.perception.layers.labels import LabelVotes
from slamsim.perception.layers.obstacles import ObstacleGrid, hits_of
from slamsim.recording import Recording, TransformEdge
from slamsim.run.cameras import layers as of_layers
from slamsim.run.cameras.floor import floor_of
from slamsim.run.cameras.layers import layer_sources
from slamsim.run.mapping import map_recording, map_world
from slamsim.world.map_server import read_map

pytestmark = pytest.mark.usefixtures("drives_here")
K = np.array([[200.0, 0.0, 159.5], [0.0, 200.0, 119.5], [0.0, 0.0, 1.0]])
SHAPE = (240, 320)
R_MAP_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Looking along x."""


def looking(height_m: float, pitch_deg: float = 0.0) -> FloatArray:
    T = np.eye(4)
    sine, cosine = np.sin(np.radians(pitch_deg)), np.cos(np.radians(pitch_deg))
    down = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    T[:3, :3] = down @ R_MAP_OPTICAL
    T[2, 3] = height_m
    return T


def seen(
    T_map_camera: FloatArray, boxes: tuple[tuple[float, float, float, float, float, float], ...]
) -> Float32Array:
    """Depth of a floor z = 0 and boxes (x0, x1, y0, y1, z0, z1), by slabs."""
    v, u = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(SHAPE)], axis=2)
    d, o = rays @ T_map_camera[:3, :3].T, T_map_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = np.where(d[..., 2] < 0.0, -o[2] / d[..., 2], np.inf)
        for box in boxes:
            low, high = np.array(box[::2]), np.array(box[1::2])
            a, b = (low - o) / d, (high - o) / d
            enter, leave = np.minimum(a, b).max(axis=2), np.maximum(a, b).min(axis=2)
            hit = (enter < leave) & (enter > 0.0)
            depth_m = np.where(hit & (enter < depth_m), enter, depth_m)
    return np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float32)


def blank(side_m: float = 8.0) -> Grid:
    cells = round(side_m / 0.05)
    return Grid(np.full((cells, cells), np.nan, np.float32), 0.05, (-1.0, -side_m / 2.0))


def drawn(
    boxes: tuple[tuple[float, float, float, float, float, float], ...],
    *poses: FloatArray,
    **layers: float,
) -> ObstacleLayer:
    config = MappingConfig(layers=LayersConfig(**layers))  # type: ignore[arg-type]
    grid = ObstacleGrid(blank(), config)
    for pose in poses:
        for _ in range(5):
            grid.draw(seen(pose, boxes), K, pose)
    return grid.layer()


def at(layer: ObstacleLayer, x_m: float, y_m: float) -> float:
    column, row = np.floor((np.array([x_m, y_m]) - layer.grid.origin_m) / 0.05).astype(int)
    return float(layer.grid.occupancy[row, column])


LOW_BOX = (1.5, 1.8, -0.2, 0.2, 0.0, 0.12)
TABLE_TOP = (1.5, 2.2, -0.5, 0.5, 0.42, 0.45)


def test_a_box_below_the_lidar_is_an_obstacle_and_the_floor_is_free() -> None:
    layer = drawn((LOW_BOX,), looking(0.4, 10.0))
    assert at(layer, 1.52, 0.0) > Grid.OCCUPIED_ABOVE
    assert at(layer, 1.2, 0.0) < Grid.FREE_BELOW and at(layer, 2.0, 1.0) < Grid.FREE_BELOW
    assert np.isnan(at(layer, -0.5, 0.0)), "behind the camera"


def test_a_floor_seen_below_a_table_top_does_not_clear_it() -> None:
    edge_on, below = looking(0.43), looking(0.25, 33.0)
    layer = drawn((TABLE_TOP,), edge_on, below, below, below)
    assert at(layer, 1.52, 0.0) > Grid.OCCUPIED_ABOVE
    # one height for all: what was seen below it clears it
    flat = drawn((TABLE_TOP,), edge_on, below, below, below, step_m=1.0)
    assert at(flat, 1.52, 0.0) < at(layer, 1.52, 0.0)


def test_what_is_higher_than_the_robot_is_no_obstacle() -> None:
    layer = drawn((TABLE_TOP,), looking(0.43), highest_m=0.35)
    assert not (layer.grid.occupancy > Grid.OCCUPIED_ABOVE).any()
    assert drawn((TABLE_TOP,), looking(0.43)).grid.occupancy[80, 50:55].max() > 0.65


@pytest.mark.parametrize("height_m", [0.2, 0.4, 1.0])
def test_noise_and_tilt_make_no_obstacles_of_a_floor(height_m: float) -> None:
    config, random = LayersConfig(), np.random.default_rng(3)
    claimed = looking(height_m, 15.0)
    for tilt_deg in (-0.3, 0.3):
        depth_m = seen(looking(height_m, 15.0 + tilt_deg), ())
        noise = config.depth_noise_per_m * depth_m**2 * random.standard_normal(SHAPE)
        _, is_hit = hits_of((depth_m + noise).astype(np.float32), K, claimed, config)
        assert is_hit.mean() < 0.005


def test_an_obstacle_that_went_away_is_cleared() -> None:
    config, pose = MappingConfig(), looking(0.4, 10.0)
    grid = ObstacleGrid(blank(), config)
    for _ in range(3):
        grid.draw(seen(pose, (LOW_BOX,)), K, pose)
    assert at(grid.layer(), 1.52, 0.0) > Grid.OCCUPIED_ABOVE
    for _ in range(20):
        grid.draw(seen(pose, ()), K, pose)
    assert at(grid.layer(), 1.52, 0.0) < Grid.FREE_BELOW


@settings(max_examples=25)
@given(st.integers(0, 2**32))
def test_rays_enter_the_cells_and_heights_that_dense_sampling_finds(seed: int) -> None:
    """One ray, from outside or inside the grid; steps of a hundredth of a cell."""
    random = np.random.default_rng(seed)
    config = MappingConfig(layers=LayersConfig(lowest_m=0.05, highest_m=0.65, step_m=0.2))
    grid = ObstacleGrid(Grid(np.zeros((30, 30), np.float32), 0.1, (0.0, 0.0)), config)
    T = looking(random.uniform(0.1, 0.6))
    T[:2, 3] = random.uniform(-0.5, 3.5, 2)
    angle = random.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    T[:2, :3] = turn @ T[:2, :3]
    slope, depth_m = random.uniform(-0.3, 0.3), random.uniform(0.3, 3.0)
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -slope], [0.0, 0.0, 1.0]])
    grid.draw(np.full((1, 1), depth_m, np.float32), matrix, T)
    points, is_hit = hits_of(np.full((1, 1), depth_m, np.float32), matrix, T, config.layers)
    expected = _sampled(T[:3, 3], points[0], bool(is_hit[0]))
    found = {tuple(each) for each in np.argwhere(grid._log_odds != 0.0).tolist()}
    signs = {each: float(np.sign(grid._log_odds[each])) for each in found}
    # a ray through a corner of cells may be told otherwise
    assert len(set(signs.items()) ^ set(expected.items())) <= 2


def _sampled(start: FloatArray, end: FloatArray, is_hit: bool) -> dict[tuple[int, int, int], float]:
    shares = np.linspace(0.0, 1.0, 20_000)
    way = start + shares[:, None] * (end - start)
    cells = np.floor(way[:, :2] / 0.1).astype(int)
    last = tuple(np.floor(end[:2] / 0.1).astype(int))
    found: dict[tuple[int, int, int], float] = {}
    for column, row in {(int(x), int(y)) for x, y in cells} - {last}:
        inside = (cells == (column, row)).all(axis=1)
        z = way[inside][[0, -1], 2].mean()
        if 0 <= column < 30 and 0 <= row < 30 and 0.05 <= z < 0.65:
            found[row, column, min(int((z - 0.05) / 0.2), 2)] = -1.0
    if is_hit and 0 <= last[0] < 30 and 0 <= last[1] < 30:
        level = min(max(int((end[2] - 0.05) / 0.2), 0), 2)
        found[int(last[1]), int(last[0]), level] = 1.0
    return found


@settings(max_examples=20)
@given(st.integers(0, 2**32))
def test_votes_are_those_that_are_counted(seed: int) -> None:
    random = np.random.default_rng(seed)
    grid, votes = blank(2.0), LabelVotes(blank(2.0), 3.0, 0.6)
    counts: dict[tuple[int, int], Counter[int]] = {}
    for _ in range(4):
        labels = random.integers(-1, 4, (12, 16)).astype(np.int32)
        depth_m = random.uniform(0.3, 3.5, (12, 16)).astype(np.float32)
        depth_m[random.random((12, 16)) < 0.2] = np.nan
        T, matrix = looking(0.3), np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1.0]])
        votes.draw(labels, depth_m, matrix, T)
        of_image = set()
        for v, u in np.ndindex(12, 16):
            z = float(depth_m[v, u])
            if labels[v, u] >= 0 and z <= 3.0:
                optical = np.array([(u - 7.5) / 20.0 * z, (v - 5.5) / 20.0 * z, z, 1.0])
                x, y, up, _ = T @ optical
                column, row = np.floor((np.array([x, y]) - grid.origin_m) / 0.05).astype(int)
                if 0 <= column < 40 and 0 <= row < 40 and up <= 0.6:
                    of_image.add((int(row), int(column), int(labels[v, u])))
        for row, column, label in of_image:
            counts.setdefault((row, column), Counter())[label] += 1
    layer = votes.layer("/labels")
    for row, column in np.ndindex(40, 40):
        counter = counts.get((row, column), Counter())
        most = max(counter.values(), default=0)
        expected = min((label for label, n in counter.items() if n == most), default=-1)
        assert layer.labels[row, column] == expected
        if counter:
            assert layer.shares[row, column] == pytest.approx(most / counter.total())


def test_each_row_of_a_rolling_shutter_counts_from_its_own_pose() -> None:
    """A wall 2 m ahead, seen while the robot turns: every row of the map's cells is the wall's."""
    clock, rows = CameraClock(0.005, 0.04), 21
    rows_ns = clock.of_rows(1_000_000_000, rows)
    assert rows_ns[0] == 995_000_000 and rows_ns[-1] == clock.at_row(1_000_000_000, 1.0)
    assert CameraClock(0.005).of_rows(0, rows).tolist() == [-5_000_000]
    upside_down = CameraClock(0.005, -0.04)
    assert upside_down.of_rows(10**18, 3).tolist() == [
        upside_down.at_row(10**18, share) for share in (0.0, 0.5, 1.0)
    ]
    turned = np.linspace(-0.1, 0.1, rows)
    T = np.array(
        [
            [
                [np.cos(a), -np.sin(a), 0, 0],
                [np.sin(a), np.cos(a), 0, 0],
                [0, 0, 1, 0],
                [0, 0, 0, 1],
            ]
            for a in turned
        ]
    ) @ looking(0.3)
    matrix = np.array([[200.0, 0, 50.0], [0, 200.0, 10.0], [0, 0, 1.0]])
    v, u = np.mgrid[0:rows, 0:101]
    rays = np.stack([(u - 50.0) / 200.0, (v - 10.0) / 200.0, np.ones(v.shape)], axis=2)
    ahead = np.einsum("vij,vuj->vui", T[:, :3, :3], rays)[..., 0]
    depth_m = (2.025 / ahead).astype(np.float32)
    by_row, by_one = (LabelVotes(blank(6.0), 4.0, 1.0) for _ in range(2))
    by_row.draw(np.ones(v.shape, np.int32), depth_m, matrix, T)
    by_one.draw(np.ones(v.shape, np.int32), depth_m, matrix, T[rows // 2])
    columns = [
        np.unique(np.nonzero(votes.layer("/l").labels == 1)[1]).size for votes in (by_row, by_one)
    ]
    assert columns[0] == 1 and columns[1] > 1


@pytest.mark.long
def test_bad_labels_do_not_take_the_obstacles_along(
    mapped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(self: object, *_: object) -> None:
        raise BadNumbers("labels are cut off")

    monkeypatch.setattr(LabelVotes, "draw", cut)
    monkeypatch.setattr(of_layers, "floor_of", lambda *_: (0.0, ("the floor is assumed",)))
    config = load_run_config(str(mapped / "config.yaml"))
    report = map_recording(mapped, config, tmp_path / "again", Reporter(quiet=True))
    assert [(each.stage, each.reason) for each in report.failed] == [
        ("semantic", "labels are cut off")
    ]
    assert report.mapped and (tmp_path / "again" / "obstacles.pgm").exists()
    told = json.loads((tmp_path / "again" / "report.json").read_text())["warnings"]
    assert told.count("the floor is assumed") == report.warnings.count("the floor is assumed") == 1
    assert "the floor is assumed" in (tmp_path / "again" / "report.html").read_text()
    assert not (tmp_path / "again" / "semantic.png").exists()


BARE = Recording("bare", "memory")
URDF = """<robot name="r"><link name="base_link"/><link name="wheel"><collision>
<origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.1" length="0.03"/></geometry></collision>
</link><joint name="j" type="continuous"><parent link="base_link"/><child link="wheel"/>
<origin xyz="0 0.2 -0.02"/><axis xyz="0 1 0"/></joint></robot>"""

TURNING_LIDAR = """<link name="lidar"><collision><geometry><box size="0.1 0.1 {height_m}"/>
</geometry></collision></link><joint name="pan" type="continuous"><parent link="base_link"/>
<child link="lidar"/><origin xyz="0 0 0.3" rpy="{rpy}"/><axis xyz="{axis}"/></joint></robot>"""


def with_lidar(urdf: str, rpy: str, axis: str, height_m: float = 0.08) -> str:
    """It turns about an upright axis, as rpy and axis in its own frame say."""
    lidar = TURNING_LIDAR.format(rpy=rpy, axis=axis, height_m=height_m)
    return urdf.replace("</robot>", lidar)


def held(parent: str, child: str, z_m: float) -> TransformEdge:
    zero, quat = np.zeros(1, np.int64), np.array([[0.0, 0.0, 0.0, 1.0]])
    at = np.array([[0.0, 0.0, z_m]])
    return TransformEdge("/tf_static", parent, child, True, zero, None, at, quat)


@pytest.mark.parametrize(
    ("recording", "floor_m", "floor"),
    [
        (replace(BARE, base_frame="base_footprint"), None, 0.0),
        (replace(BARE, base_frame="r1/base_footprint"), None, 0.0),
        (
            replace(
                BARE,
                base_frame="base_link",
                transforms=(held("base_footprint", "base_link", 0.07),),
            ),
            None,
            -0.07,
        ),
        (replace(BARE, base_frame="base_link", robot_description=URDF), None, -0.12),
        (replace(BARE, base_frame="base_link", robot_description=URDF), -0.3, -0.3),
        # a mast that hangs lower than the wheels, as the box around a mesh may
        (
            replace(
                BARE,
                base_frame="base_link",
                robot_description=with_lidar(URDF, "0 0 0", "0 0 1", 1.0),
            ),
            None,
            -0.12,
        ),
    ],
)
def test_heights_count_from_the_floor(
    recording: Recording, floor_m: float | None, floor: float
) -> None:
    found, told = floor_of(recording, LayersConfig(floor_m=floor_m))
    assert found == pytest.approx(floor, abs=1e-6) and not told


NO_WHEELS = "<robot name='r'><link name='base_link'/></robot>"


@pytest.mark.parametrize(
    "urdf",
    [
        None,
        "<robot",
        "<robot><link name='base_link'/></robot>",
        with_lidar(NO_WHEELS, "0 0 0", "0 0 1"),
        with_lidar(NO_WHEELS, "1.5708 0 0", "0 1 0"),
    ],
    ids=["none", "broken", "no name", "lidar", "lidar in a turned frame"],
)
def test_an_unknown_floor_is_told(urdf: str | None) -> None:
    recording = replace(BARE, base_frame="base_link", robot_description=urdf)
    found, told = floor_of(recording, LayersConfig())
    assert found == 0.0 and "mapping.layers.floor_m" in told[0]


def message(pixels: NDArray[np.generic], encoding: str, **changes: object) -> SimpleNamespace:
    rows = pixels.shape[0]
    padded = np.zeros((rows, pixels.strides[0] + 3), np.uint8)
    padded[:, : pixels.strides[0]] = np.ascontiguousarray(pixels).view(np.uint8).reshape(rows, -1)
    told = {
        "encoding": encoding,
        "height": rows,
        "width": pixels.shape[1],
        "step": padded.shape[1],
        "is_bigendian": 0,
        "data": padded.ravel(),
    }
    return SimpleNamespace(**{**told, **changes})


def test_label_images_are_read_with_any_padding_and_byte_order() -> None:
    labels = np.array([[1, -2, 70_000], [0, 5, 6]], np.int32)
    _, found = of_labels._labels(message(labels, "32SC1"))
    np.testing.assert_array_equal(found, labels)
    big = message(labels.astype(">i4"), "32SC1", is_bigendian=1)
    np.testing.assert_array_equal(of_labels._labels(big)[1], labels)
    _, small = of_labels._labels(message(np.array([[1, 255]], np.uint8), "mono8"))
    assert small.tolist() == [[1, 255]] and small.dtype == np.int32


def test_layers_that_cannot_be_are_refused() -> None:
    grid = Grid(np.zeros((4, 4), np.float32), 0.1, (0.0, 0.0))
    with pytest.raises(BadNumbers, match=r"\(4, 4\) are not those of depths of \(5, 5\)"):
        LabelVotes(grid, 5.0, 1.0).draw(
            np.zeros((4, 4), np.int32), np.ones((5, 5), np.float32), K, np.eye(4)
        )
    with pytest.raises(ValueError, match="must be above lowest_m"):
        LayersConfig(lowest_m=0.6)


def test_label_images_that_are_cut_are_refused() -> None:
    cut = message(np.zeros((4, 4), np.int32), "32SC1", data=np.zeros(10, np.uint8))
    with pytest.raises(ValueError, match="cut off"):
        of_labels._labels(cut)
    with pytest.raises(ValueError, match="pixels"):
        of_labels._labels(message(np.zeros((4, 4), np.int32), "32SC1", width=10**6, height=10**6))


def test_scores_ask_for_what_only_the_body_meets() -> None:
    """A low bar across the way, of which the layer shows a half, and one cell that is nothing."""
    plane = np.zeros((60, 60), np.float32)
    plane[:, 50:] = 1.0
    body = plane.copy()
    body[20:40, 30:32] = 1.0
    shown = np.full((60, 60), 0.1, np.float32)
    shown[20:30, 30] = 0.9
    shown[10, 10] = 0.9
    shown[:, 50] = 0.9
    view = np.array([[0.5, 1.5, 0.0]])
    true_plane, true_body, grid = (Grid(cells, 0.05, (0.0, 0.0)) for cells in (plane, body, shown))
    layer = ObstacleLayer(grid, view, 0.7, 4.0)
    scores = score_obstacles(layer, true_plane, true_body, true_plane, np.zeros(3))
    assert scores.false_cells == 1 and scores.precision == pytest.approx(70 / 71)
    assert scores.hidden_recall == pytest.approx(0.55, abs=0.06)
    assert scores.lidar_recall == 0.0
    away = ObstacleLayer(grid, np.array([[0.5, 1.5, np.pi]]), 0.7, 4.0)
    behind = score_obstacles(away, true_plane, true_body, true_plane, np.zeros(3))
    assert behind.hidden_cells == 0 and behind.hidden_recall is None


def test_labels_have_colours_of_their_own() -> None:
    colours = label_colours(np.arange(-1, 30))
    assert len({tuple(each) for each in colours.tolist()}) == 31
    assert colours[0].tolist() == [235, 235, 235]


CAMERA = {
    "type": "camera",
    "name": "front",
    "rate_hz": 4,
    "mount": {"z_m": 0.35, "pitch_deg": 15},
    "imagers": {
        "color": {
            "lens": {"width": 80, "height": 60},
            "truth": ["depth", "instances", "materials"],
        },
        "depth": {
            "kind": "depth",
            "lens": {"width": 80, "height": 60},
            "encoding": "png",
            "depth": {"is_exact": True},
        },
    },
}


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layers")
    layers = {"obstacles": True, "labels": "/ground_truth/front/color/instances"}
    settings_file = folder / "camera.yaml"
    settings_file.write_text(
        yaml.safe_dump({"sensors": {"additional": [CAMERA]}, "mapping": {"layers": layers}})
    )
    short = ("drive.route.max_duration_s=8", "sensors.lidar.rate_hz=10", "world.clutter.per_cell=1")
    config = load_run_config("tiny", str(settings_file), short, 3)
    map_world(config, folder / "run", Reporter(quiet=True, as_json=False))
    return folder / "run"


@pytest.mark.long
def test_layers_are_written_beside_the_map_in_its_cells(mapped: Path) -> None:
    lidar, obstacles = read_map(mapped / "map.yaml"), read_map(mapped / "obstacles.yaml")
    assert obstacles.occupancy.shape == lidar.occupancy.shape
    assert (obstacles.resolution_m, tuple(obstacles.origin_m)) == (
        lidar.resolution_m,
        tuple(lidar.origin_m),
    )
    legend = yaml.safe_load((mapped / "semantic.yaml").read_text())
    pixels = decode_picture((mapped / "semantic.png").read_bytes())
    assert pixels.shape[:2] == lidar.occupancy.shape
    named = {one["name"]: one for one in legend["labels"]}
    assert {"floor", "wall"} <= set(named)
    for one in legend["labels"]:
        assert (pixels == one["rgb"]).all(axis=2).sum() == one["cells"]
    # the floor is where the lidar has free space, and the cells are not turned over
    floor = (pixels == named["floor"]["rgb"]).all(axis=2)[::-1]
    assert (lidar.occupancy[floor] == 0.0).mean() > 0.9
    walls = obstacles.occupancy == 1.0
    beside = ndimage.binary_dilation(lidar.occupancy == 1.0, np.ones((3, 3), np.bool_))
    assert walls.sum() > 50 and beside[walls].mean() > 0.8


def test_the_report_tells_of_layers(mapped: Path) -> None:
    numbers = json.loads((mapped / "report.json").read_text())
    assert numbers["failed_stages"] == []
    assert numbers["obstacle_precision"] > 0.95 and numbers["obstacle_cells"] > 50
    assert numbers["obstacle_false_cells"] <= 0.05 * numbers["obstacle_cells"]
    assert numbers["semantic_cells"] > 500
    page = (mapped / "report.html").read_text()
    assert "Obstacles that depth images show" in page
    assert "Most frequent label of /ground_truth/front/color/instances" in page


@pytest.mark.parametrize(
    ("layers", "match"),
    [
        ({"labels": "/labels"}, "no images of labels on /labels; raw images are on /ground_truth"),
        ({"labels": "/ground_truth/front/color/depth"}, "32FC1 hold no labels; mono8, 8UC1, 32SC1"),
    ],
)
def test_topics_without_labels_are_named(mapped: Path, layers: dict[str, str], match: str) -> None:
    recording, config = (
        open_recording(mapped / "log").recording,
        LayersConfig(labels=layers["labels"]),
    )
    with pytest.raises((NotFound, InputRefused), match=match):
        layer_sources(mapped / "log", recording, config, NO_CALIBRATION)


def test_obstacles_without_a_depth_camera_are_refused(small_set: Path) -> None:
    log = next(small_set.glob("train/*/log"))
    recording = open_recording(log).recording
    with pytest.raises(InputRefused, match="holds no depth images"):
        layer_sources(log, recording, LayersConfig(obstacles=True), NO_CALIBRATION)
