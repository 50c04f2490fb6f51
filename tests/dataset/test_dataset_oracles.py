"""The truth of a sequence, computed once more from its files, slowly and in another way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_example import small_spec
from scipy.spatial.transform import Rotation, Slerp

from slamsim.config.run import RunConfig
from slamsim.core.types import FloatArray
from slamsim.dataset.make.produce import produce
from slamsim.dataset.truth.overlap import CLOSURE_OVERLAP, CLOSURE_WAY_M
from slamsim.dataset.truth.surfaces import NO_SURFACE
from slamsim.io.parquet.file import read_table
from slamsim.sim.drive.record import START_NS
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world

OFFSET_S, DRIFT_PPM = 0.02, 150.0


@dataclass
class Files:
    """What a reader has of a sequence."""

    folder: Path
    config: RunConfig

    def table(self, name: str) -> dict[str, Any]:
        return read_table(self.folder / f"{name}.parquet")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("sequence")
    spec = small_spec(
        "drive=random_goals",
        *(f"sensors.{name}.clock.offset_s={OFFSET_S}" for name in ("lidar", "imu", "encoders")),
        *(f"sensors.{name}.clock.drift_ppm={DRIFT_PPM}" for name in ("lidar", "imu", "encoders")),
        "sensors.imu.gyro.noise_density=0",
        "sensors.imu.accelerometer.noise_density=0",
        "world.floor.friction=0.3",
        seconds=40.0,
        formats=("parquet",),
    )
    produce(spec, folder)
    return Files(folder, spec.config)


def base_at(files: Files, instant_ns: FloatArray) -> tuple[FloatArray, Rotation]:
    """Positions and orientations of the base, by SciPy."""
    path = files.table("truth/trajectory")
    positions = [np.interp(instant_ns, path["stamp_ns"], path[f"position_{a}_m"]) for a in "xyz"]
    quats = np.column_stack([path[f"quat_{a}"] for a in "xyzw"])
    return np.column_stack(positions), Slerp(path["stamp_ns"], Rotation.from_quat(quats))(
        instant_ns
    )


def first_hit(origin: FloatArray, direction: FloatArray, corners: FloatArray) -> tuple[float, int]:
    """Distance to the nearest of (t, 3, 3) triangles, and which (Moeller & Trumbore 1997)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    across = np.cross(direction, c - a)
    determinant = np.einsum("ij,ij->i", b - a, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", origin - a, across) / determinant
        turned = np.cross(origin - a, b - a)
        v = turned @ direction / determinant
        t = np.einsum("ij,ij->i", c - a, turned) / determinant
    inside = (np.abs(determinant) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    distances = np.where(inside, t, np.inf)
    return float(distances.min()), int(distances.argmin())


@pytest.mark.long
def test_beams_end_where_a_ray_through_all_triangles_ends(files: Files) -> None:
    scans, surfaces = files.table("truth/scans"), files.table("truth/surfaces")
    lidar, world = files.config.sensors.lidar, build_world(files.config.world, files.config.seed)
    T_base_laser = build_robot(files.config.robot).T_base_laser
    corners = world.mesh.vertices_m[world.mesh.triangles]
    random, wrong = np.random.default_rng(1), 0
    chosen = random.integers(0, len(scans["stamp_ns"]), 120)
    beams = random.integers(0, lidar.beam_count, 120)
    instants_ns = scans["true_stamp_ns"][chosen] + beams * lidar.beam_dt_ns
    positions, turns = base_at(files, instants_ns.astype(float))
    for scan, beam, position, turned in zip(chosen, beams, positions, turns, strict=True):
        bearing = math.radians(lidar.angle_min_deg + beam * lidar.angle_step_deg)
        ahead = T_base_laser[:3, :3] @ [math.cos(bearing), math.sin(bearing), 0.0]
        direction = turned.apply(ahead)
        origin = position + turned.apply(T_base_laser[:3, 3])
        range_m, triangle = first_hit(origin, direction, corners)
        told_m, surface = scans["true_ranges_m"][scan, beam], scans["surfaces"][scan, beam]
        if math.isinf(range_m):
            wrong += bool(np.isfinite(told_m) and surfaces["kind"][surface] != "floor")
            continue
        normal = np.cross(*np.diff(corners[triangle], axis=0))
        slant = abs(normal @ direction) / np.linalg.norm(normal)
        end = origin + range_m * direction
        named = surface != NO_SURFACE and all(
            surfaces[f"low_{a}_m"][surface] - 1e-3
            < end["xyz".index(a)]
            < surfaces[f"high_{a}_m"][surface] + 1e-3
            for a in "xyz"
        )
        same = (
            abs(told_m - range_m) < 2e-3
            and abs(math.cos(scans["incidence_rad"][scan, beam]) - slant) < 5e-3
        )
        wrong += not (same and named)
    assert wrong <= 1  # a beam along an edge may meet either side of it


@pytest.mark.long
def test_pairs_tell_the_way_and_the_motion_between_two_scans(files: Files) -> None:
    pairs, path = files.table("truth/pairs"), files.table("truth/trajectory")
    steps = np.hypot(np.diff(path["position_x_m"]), np.diff(path["position_y_m"]))
    driven_m = np.concatenate([[0.0], np.cumsum(steps)])
    a, b = (base_at(files, pairs[f"true_stamp_{name}_ns"].astype(float)) for name in "ab")
    moved = a[1].inv().apply(b[0] - a[0])
    turned = (a[1].inv() * b[1]).as_euler("zyx")[:, 0]
    assert np.abs(moved[:, :2] - np.column_stack([pairs["x_m"], pairs["y_m"]])).max() < 1e-3
    assert np.abs(np.remainder(turned - pairs["yaw_rad"] + np.pi, 2 * np.pi) - np.pi).max() < 1e-3
    ways_m = np.interp(pairs["true_stamp_b_ns"], path["stamp_ns"], driven_m)
    ways_m -= np.interp(pairs["true_stamp_a_ns"], path["stamp_ns"], driven_m)
    assert np.abs(ways_m - pairs["way_m"]).max() < 0.02 * driven_m[-1]
    both = np.minimum(pairs["overlap_a"], pairs["overlap_b"])
    closes = (both >= CLOSURE_OVERLAP) & (pairs["way_m"] >= CLOSURE_WAY_M)
    assert np.array_equal(closes, pairs["closes_loop"])
    assert len(closes) > 20


@pytest.mark.parametrize("name", ["scans", "imu", "encoders"])
def test_clocks_are_off_by_what_was_set(files: Files, name: str) -> None:
    truth = files.table(f"truth/{name}")
    expected_ns = OFFSET_S * 1e9 + DRIFT_PPM * 1e-6 * (truth["true_stamp_ns"] - START_NS)
    off_ns = truth["stamp_ns"] - truth["true_stamp_ns"] - expected_ns
    assert np.abs(off_ns - np.median(off_ns)).max() < 1e6  # what jitter there is
    assert abs(np.median(off_ns)) < 1e5
    assert np.array_equal(files.table(f"parquet/{name}")["stamp_ns"], truth["stamp_ns"])


def test_without_noise_an_imu_reads_its_truth_and_its_bias(files: Files) -> None:
    log, truth = files.table("parquet/imu"), files.table("truth/imu")
    for sensor, value in (
        ("gyro", "angular_velocity_{}_rad_s"),
        ("accelerometer", "linear_acceleration_{}_m_s2"),
    ):
        for axis in "xyz":
            bias = truth[f"{sensor}_bias_{axis}_{value.split('_{}_')[1]}"]
            read = log[value.format(axis)]
            assert np.abs(read - truth[value.format(axis)] - bias).max() < 1e-6
            assert np.abs(bias).max() > 0.0


def test_slip_is_what_the_rims_roll_beyond_the_way(files: Files) -> None:
    path, robot = files.table("truth/trajectory"), build_robot(files.config.robot)
    turned = Rotation.from_quat(np.column_stack([path[f"quat_{a}"] for a in "xyzw"]))
    steps_m = np.diff(np.column_stack([path[f"position_{a}_m"] for a in "xyz"]), axis=0)
    inside_m = turned[1:].inv().apply(steps_m)
    yaws = np.unwrap(turned.as_euler("zyx")[:, 0])
    step_s = np.diff(path["stamp_ns"]) * 1e-9
    for side, name in ((-1.0, "left"), (1.0, "right")):
        rolled_m = np.diff(path[f"wheel_{name}_rad"]) * robot.wheel_radius_m
        way_m = inside_m[:, 0] + side * 0.5 * robot.track_m * np.diff(yaws)
        slow = np.cumsum(rolled_m - way_m)
        fast = np.cumsum(path[f"slip_{name}_m_s"][1:] * step_s)
        assert np.abs(slow - fast).max() < 0.01
    sideways = np.cumsum(path["slip_sideways_m_s"][1:] * step_s)
    assert np.abs(np.cumsum(inside_m[:, 1]) - sideways).max() < 0.01
