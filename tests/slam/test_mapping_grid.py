"""The occupancy grid against the walls it was drawn from, and the files made of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from simulated import HOKUYO, ScanList, box, drive, labyrinth, sense_scans

from slamsim.config.slam import MappingConfig
from slamsim.core.progress import silent
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory, Scan, ScanGeometry
from slamsim.guard.errors import SlamsimError
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.mapping.map_files import FREE, OCCUPIED, UNKNOWN, map_files, trinary_image

EVERY_SCAN = MappingConfig(min_travel_m=0.0, min_turn_deg=0.0)
FLASH = ScanGeometry(-np.pi, np.deg2rad(1.0), 360, 0, 0.1, 10.0)


def standing(stamps: int, step_ns: int = 100_000_000) -> PlanarTrajectory:
    return PlanarTrajectory(np.arange(stamps) * step_ns, np.zeros((stamps, 3)))


def flash_scans(ranges_m: FloatArray, count: int = 1) -> ScanList:
    ranges = ranges_m.astype(np.float32)
    return ScanList([Scan(k * 100_000_000, ranges, FLASH) for k in range(count)])


def value_at(grid: Grid, x_m: float, y_m: float) -> float:
    column = int(np.floor((x_m - grid.origin_m[0]) / grid.resolution_m))
    row = int(np.floor((y_m - grid.origin_m[1]) / grid.resolution_m))
    rows, columns = grid.occupancy.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return float("nan")
    return float(grid.occupancy[row, column])


def drawn_walls(grid: Grid) -> FloatArray:
    """(n, 2) centres of the cells that are drawn as walls."""
    rows, columns = np.nonzero(grid.occupancy > 0.65)
    cells = np.column_stack([columns, rows]).astype(np.float64) + 0.5
    return np.asarray(cells * grid.resolution_m + grid.origin_m, dtype=np.float64)


def distances_to_walls(points: FloatArray, walls: FloatArray) -> FloatArray:
    """(n,) distance of points from the nearest of segments (k, 4)."""
    start, step = walls[:, :2], walls[:, 2:] - walls[:, :2]
    share = ((points[:, None] - start) * step).sum(-1) / (step**2).sum(-1)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * step
    away = np.linalg.norm(points[:, None] - nearest, axis=-1)
    return np.asarray(away.min(axis=1), dtype=np.float64)


@pytest.fixture(scope="module")
def mapped() -> tuple[FloatArray, PlanarTrajectory, list[Scan]]:
    walls, tour = labyrinth(seed=4, cells=3)
    truth = drive(tour, max_s=40.0)
    return walls, truth, sense_scans(walls, truth, HOKUYO, 0.01, seed=4)


def at_scans(truth: PlanarTrajectory, scans: list[Scan]) -> PlanarTrajectory:
    stamps_ns = np.array([scan.stamp_ns for scan in scans])
    return PlanarTrajectory(stamps_ns, truth.at(stamps_ns))


@pytest.mark.long
@pytest.mark.parametrize("resolution_m", [0.03, 0.05, 0.1])
def test_walls_are_where_they_are_and_what_is_seen_through_is_free(
    mapped: tuple[FloatArray, PlanarTrajectory, list[Scan]], resolution_m: float
) -> None:
    walls, truth, scans = mapped
    config = MappingConfig(resolution_m=resolution_m)
    grid = build_grid(ScanList(scans), at_scans(truth, scans), np.eye(4), config, truth)
    drawn = drawn_walls(grid)
    precision = np.mean(distances_to_walls(drawn, walls) <= np.sqrt(2.0) * resolution_m)
    assert precision >= 0.98

    clear = [
        value_at(grid, *point)
        for point in truth.poses[::50, :2]
        if distances_to_walls(point[None], walls)[0] > 0.1
    ]
    assert np.max(clear) < 0.25


def test_the_map_shows_the_walls_that_the_beams_met(
    mapped: tuple[FloatArray, PlanarTrajectory, list[Scan]],
) -> None:
    _, truth, scans = mapped
    grid = build_grid(ScanList(scans), at_scans(truth, scans), np.eye(4), MappingConfig(), truth)
    drawn = drawn_walls(grid)
    ends = []
    for scan in scans[::20]:
        pose = truth.at(scan.stamp_ns + HOKUYO.offsets_ns())
        yaw = pose[:, 2] + HOKUYO.angles_rad()
        reach = scan.ranges_m[:, None].astype(np.float64)
        ends.append(pose[:, :2] + reach * np.column_stack([np.cos(yaw), np.sin(yaw)]))
    met = np.concatenate(ends)[::7]
    met = met[np.isfinite(met).all(axis=1)]
    nearest = np.array([np.abs(drawn - point).max(axis=1).min() for point in met])
    assert np.mean(nearest <= 1.5 * grid.resolution_m) >= 0.98


@pytest.mark.long
def test_the_same_scans_give_the_same_bytes_and_thinning_only_drops_scans(
    mapped: tuple[FloatArray, PlanarTrajectory, list[Scan]],
) -> None:
    _, truth, scans = mapped
    trajectory = at_scans(truth, scans)
    grids = [
        build_grid(ScanList(scans), trajectory, np.eye(4), MappingConfig(), truth) for _ in range(2)
    ]
    assert grids[0].occupancy.tobytes() == grids[1].occupancy.tobytes()
    full = build_grid(ScanList(scans), trajectory, np.eye(4), EVERY_SCAN, truth)
    both = np.nan_to_num(full.occupancy, nan=0.5) > 0.65
    assert both.sum() >= 0.95 * (grids[0].occupancy > 0.65).sum()


def test_growth_does_not_move_cells() -> None:
    ranges = np.full(360, 3.0)
    near, far = np.zeros(3), np.array([23.7, -11.3, 0.4])
    stamps_ns = np.array([0, 100_000_000])
    there = PlanarTrajectory(stamps_ns, np.stack([near, far]))
    grid = build_grid(flash_scans(ranges, 2), there, np.eye(4), EVERY_SCAN)
    alone = build_grid(
        flash_scans(ranges), PlanarTrajectory(stamps_ns[:1], near[None]), np.eye(4), EVERY_SCAN
    )
    for x_m, y_m in np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2)):
        assert np.array_equal(value_at(grid, x_m, y_m), value_at(alone, x_m, y_m), equal_nan=True)
    offset = np.array(grid.origin_m) / grid.resolution_m
    assert np.allclose(offset, np.round(offset), atol=1e-9)


def test_ranges_beyond_the_limit_clear_but_mark_nothing() -> None:
    config = MappingConfig(max_range_m=4.0)
    grid = build_grid(flash_scans(np.full(360, 6.0)), standing(1), np.eye(4), config)
    assert np.nanmax(grid.occupancy) < 0.5
    assert value_at(grid, 3.9, 0.0) < 0.5
    assert np.isnan(value_at(grid, 4.2, 0.0))


def test_silence_clears_as_far_as_configured_and_a_single_drop_out_nothing() -> None:
    ranges = np.full(360, 2.0)
    ranges[160:200] = np.inf
    ranges[90] = np.inf
    config = MappingConfig(clear_without_return_m=5.0)
    grid = build_grid(flash_scans(ranges), standing(1), np.eye(4), config)
    assert value_at(grid, 1.5, 0.02) < 0.5
    assert np.isnan(value_at(grid, 5.2, 0.02))
    assert np.isnan(value_at(grid, 0.0, -2.4))
    none = MappingConfig(clear_without_return_m=0.0)
    assert np.isnan(value_at(build_grid(flash_scans(ranges), standing(1), np.eye(4), none), 1.5, 0))


def test_a_laser_that_is_mounted_off_the_base_draws_from_where_it_is() -> None:
    T_base_laser = np.eye(4)
    T_base_laser[:2, 3] = (0.5, -0.25)
    scans = flash_scans(np.full(360, 2.01), 3)
    grid = build_grid(scans, standing(3), T_base_laser, EVERY_SCAN)
    assert value_at(grid, 2.51, -0.24) > 0.65
    assert value_at(grid, -1.51, -0.24) > 0.65
    assert value_at(grid, 0.5, -2.26) > 0.65


def test_one_return_alone_is_not_yet_a_wall() -> None:
    ranges = np.full(360, 2.01)
    once = build_grid(flash_scans(ranges, 1), standing(1), np.eye(4), EVERY_SCAN)
    twice = build_grid(flash_scans(ranges, 2), standing(2), np.eye(4), EVERY_SCAN)
    assert 0.5 < value_at(once, 2.01, 0.01) < 0.65 < value_at(twice, 2.01, 0.01)


def test_beams_are_placed_by_their_own_instants_while_the_robot_turns() -> None:
    walls = box(-2.0, -2.0, 2.0, 2.0)
    stamps_ns = np.arange(0, 2_000_000_000, 5_000_000)
    turning = np.column_stack([np.zeros((stamps_ns.size, 2)), stamps_ns * 1.2e-9])
    truth = PlanarTrajectory(stamps_ns, turning)
    scans = sense_scans(walls, truth, HOKUYO, 0.0, seed=1)
    trajectory = at_scans(truth, scans)
    grid = build_grid(ScanList(scans), trajectory, np.eye(4), MappingConfig(), truth)
    drawn = drawn_walls(grid)
    assert distances_to_walls(drawn, walls).max() <= grid.resolution_m


def test_scans_outside_the_trajectory_are_left_out_and_progress_reaches_the_end() -> None:
    told: list[tuple[float, float]] = []
    grid = build_grid(
        flash_scans(np.full(360, 2.0), count=5),
        standing(1),
        np.eye(4),
        MappingConfig(),
        progress=lambda done, total: told.append((done, total)),
    )
    assert told[-1] == (5, 5)
    assert grid.occupancy.shape[0] < 90


def test_a_map_that_would_be_huge_is_refused_with_its_size() -> None:
    stamps_ns = np.array([0, 100_000_000])
    apart = PlanarTrajectory(stamps_ns, np.array([[0.0, 0.0, 0.0], [1e6, 1e6, 0.0]]))
    with pytest.raises(SlamsimError, match="max_cells"):
        build_grid(flash_scans(np.full(360, 2.0), 2), apart, np.eye(4), MappingConfig())


def test_nothing_to_draw_is_said() -> None:
    empty = flash_scans(np.full(360, np.nan))
    with pytest.raises(SlamsimError, match="nothing to map"):
        build_grid(empty, standing(1), np.eye(4), MappingConfig(), None, silent)


def small_grid() -> Grid:
    occupancy = np.full((3, 4), np.nan, dtype=np.float32)
    occupancy[0, 0], occupancy[2, 3], occupancy[1, 1] = 0.9, 0.1, 0.5
    return Grid(occupancy, 0.05, (-1.0, 2.5))


def test_map_files_follow_map_server(tmp_path: Path) -> None:
    for name, data in map_files(small_grid()).items():
        (tmp_path / name).write_bytes(data)
    described = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert described["image"] == "map.pgm" and described["resolution"] == 0.05
    assert described["origin"] == [-1.0, 2.5, 0.0]
    image = cv2.imread(str(tmp_path / "map.pgm"), cv2.IMREAD_UNCHANGED)
    assert image is not None and image.shape == (3, 4)
    assert image[2, 0] == OCCUPIED and image[0, 3] == FREE and image[1, 1] == UNKNOWN
    picture = cv2.imread(str(tmp_path / "map.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None and np.array_equal(image, picture)


def test_map_server_reads_the_three_values_back_as_what_they_were() -> None:
    described = yaml.safe_load(map_files(small_grid())["map.yaml"])
    for value, meant in ((OCCUPIED, "occupied"), (FREE, "free"), (UNKNOWN, "unknown")):
        share = (255 - value) / 255.0
        if share > described["occupied_thresh"]:
            read = "occupied"
        else:
            read = "free" if share < described["free_thresh"] else "unknown"
        assert read == meant


def test_the_thresholds_themselves_are_unknown() -> None:
    grid = small_grid()
    image = trinary_image(replace(grid, occupancy=np.array([[0.65, 0.25]], dtype=np.float32)))
    assert (image == UNKNOWN).all()
    beyond = np.array([[0.651, 0.249]], dtype=np.float32)
    assert trinary_image(replace(grid, occupancy=beyond)).tolist() == [[OCCUPIED, FREE]]
