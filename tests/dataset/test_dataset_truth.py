"""The truth beside a sequence: what was met, what overlaps, where the robot was at any instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_example import produced, small_spec

from slamsim.config.lidar import LidarConfig
from slamsim.core.types import Drive, FloatArray, TriangleMesh
from slamsim.dataset.truth.key_scans import KeyScan, KeyScans
from slamsim.dataset.truth.overlap import overlap_shares
from slamsim.dataset.truth.surfaces import NO_SURFACE, TrueSurfaces, surfaces_of
from slamsim.dataset.truth.tables import read_drive
from slamsim.io.parquet.file import read_table, table_facts
from slamsim.sensors.motion import Motion, as_mounted
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sensors.scene import Scene
from slamsim.sim.drive.record import START_NS
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.world.build import build_world
from slamsim.world.model import World

LIDAR = LidarConfig(rate_hz=10.0, beam_count=271, angle_step_deg=1.0, range_max_m=4.0)


@dataclass
class Driven:
    world: World
    robot: RobotModel
    surfaces: TrueSurfaces
    windows: Sequence[Drive]
    readings: Sequence[Readings]
    keys: Sequence[KeyScan]


@pytest.fixture(scope="module")
def driven() -> Driven:
    config = small_spec("drive.physics.window_s=3.3", seconds=25.0).config
    sensors = config.sensors.model_copy(update={"lidar": LIDAR})
    world, robot = build_world(config.world, config.seed), build_robot(config.robot)
    windows = list(DriveRun(world, robot, plan_route(world, robot, config.drive), config.drive))
    rig = SensorRig(world.mesh, robot, sensors, config.seed, with_truth=True)
    readings = [rig.sense(window) for window in windows]
    surfaces = surfaces_of(world.mesh, LIDAR.range_max_m)
    keys = KeyScans(LIDAR, robot, as_mounted, surfaces)
    for sensed, window in zip(readings, windows, strict=True):
        keys.take(sensed.scans, window)
    return Driven(world, robot, surfaces, windows, readings, keys.scans)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sequence")
    produced(folder, "drive.physics.window_s=2.5")
    return folder


def cube(x_m: float) -> tuple[FloatArray, Any]:
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return corners + np.array([x_m, 0.0, 0.0]), np.array(faces, dtype=np.int32)


def test_two_cubes_have_six_surfaces_each_although_their_sides_share_planes() -> None:
    (first, faces), (second, _) = cube(0.0), cube(3.0)
    mesh = TriangleMesh(np.vstack([first, second]), np.vstack([faces, faces + 8]))
    surfaces = surfaces_of(mesh, 10.0)
    assert len(surfaces) == 13  # and the floor
    assert surfaces.bodies.tolist() == [0] * 6 + [1] * 6 + [-1]
    assert np.allclose(surfaces.areas_m2[:12], 1.0)
    assert np.allclose(np.abs(surfaces.normals).max(axis=1), 1.0)
    centres = 0.5 * (surfaces.low_m + surfaces.high_m)[:12]
    outward = centres - np.repeat([[0.5, 0.5, 0.5], [3.5, 0.5, 0.5]], 6, axis=0)
    assert (np.sum(outward * surfaces.normals[:12], axis=1) > 0.49).all()


def test_each_true_range_ends_on_the_surface_that_is_named(driven: Driven) -> None:
    """The plane of a surface is where the beam's end is, and its slant is the incidence."""
    surfaces, seen = driven.surfaces, 0
    vertices = driven.world.mesh.vertices_m[driven.world.mesh.triangles]
    for key in driven.keys:
        for end_m, number in zip(key.ends_m, key.surfaces, strict=True):
            corner = vertices[np.flatnonzero(surfaces.of_triangle[:-2] == number)[0], 0]
            assert abs((end_m - corner) @ surfaces.normals[number]) < 1e-4
            assert (end_m > surfaces.low_m[number] - 1e-4).all()
            assert (end_m < surfaces.high_m[number] + 1e-4).all()
            seen += 1
    assert seen > 500


def slow_share(a: KeyScan, b: KeyScan, scene: Scene) -> float:
    """Rays from b to what a saw: those that nothing stops, within b's reach and view."""
    origin = b.T_map_laser[:3, 3]
    towards = a.ends_m - origin
    distances = np.linalg.norm(towards, axis=1)
    directions = towards / distances[:, None]
    rays = np.hstack([np.tile(origin - scene.origin_m, (len(directions), 1)), directions])
    hits = scene.cast(rays.astype(np.float32))
    inside = directions @ b.T_map_laser[:3, :3]
    bearings = np.degrees(np.arctan2(inside[:, 1], inside[:, 0]))
    free = np.abs(hits.ranges_m - distances) < 0.01
    least = np.cos(np.radians(LIDAR.max_incidence_deg))
    seen = free & (distances <= LIDAR.range_max_m) & (hits.cos_incidence >= least)
    seen &= (np.abs(bearings) <= 135.0) & (distances >= LIDAR.range_min_m)
    return float(seen.mean())


def test_overlap_agrees_with_rays_cast_from_scan_to_scan(driven: Driven) -> None:
    scene = Scene(driven.world.mesh, LIDAR.range_max_m)
    keys = driven.keys
    shares = overlap_shares(keys, driven.surfaces, np.radians(2.0))
    slow = np.array([[slow_share(a, b, scene) for b in keys] for a in keys])
    assert len(keys) > 10
    assert 0.2 < slow.mean() < 0.9
    assert np.abs(shares - slow).max() < 0.25
    assert np.abs(shares - slow).mean() < 0.02
    assert np.allclose(np.diag(shares), 1.0)


def test_overlap_of_nothing_is_nothing(driven: Driven) -> None:
    assert overlap_shares([], driven.surfaces, 0.1).shape == (0, 0)


@pytest.mark.long
def test_the_drive_on_the_disk_tells_any_instant_as_the_sensors_had_it(sequence: Path) -> None:
    config = small_spec().config
    world, robot = build_world(config.world, config.seed), build_robot(config.robot)
    windows = DriveRun(world, robot, plan_route(world, robot, config.drive), config.drive)
    whole = Motion(
        Drive(
            *(
                np.concatenate([getattr(window, name) for window in list(windows)])
                for name in Drive.__dataclass_fields__
            )
        )
    )
    read = Motion(read_drive(sequence / "truth" / "trajectory.parquet"))
    for name in Drive.__dataclass_fields__:
        assert np.array_equal(getattr(read.drive, name), getattr(whole.drive, name)), name
    instants = np.random.default_rng(3).integers(START_NS, whole.covered_ns, 100)
    assert np.array_equal(read.positions_at(instants), whole.positions_at(instants))
    assert np.array_equal(read.quats_xyzw_at(instants), whole.quats_xyzw_at(instants))


def test_noise_is_what_stands_between_the_log_and_the_truth(sequence: Path) -> None:
    log = read_table(sequence / "parquet" / "scans.parquet")
    truth = read_table(sequence / "truth" / "scans.parquet")
    assert np.array_equal(log["stamp_ns"], truth["stamp_ns"])
    assert np.array_equal(log["sample"], np.arange(len(truth["stamp_ns"])))
    head_on = np.isfinite(log["ranges_m"]) & (truth["incidence_rad"] < 0.5)
    errors = (log["ranges_m"] - truth["true_ranges_m"])[head_on]
    assert 0.004 < np.median(np.abs(errors)) < 0.008  # of a normal error of 8 mm: 5.4 mm
    surfaces = read_table(sequence / "truth" / "surfaces.parquet")
    met = truth["surfaces"][truth["surfaces"] != NO_SURFACE]
    assert met.max() < len(surfaces["area_m2"])


def test_what_an_imu_reads_is_its_truth_its_bias_and_noise(sequence: Path) -> None:
    log = read_table(sequence / "parquet" / "imu.parquet")
    truth = read_table(sequence / "truth" / "imu.parquet")
    for axis in "xyz":
        rest = (
            log[f"angular_velocity_{axis}_rad_s"]
            - truth[f"angular_velocity_{axis}_rad_s"]
            - truth[f"gyro_bias_{axis}_rad_s"]
        )
        assert abs(rest.mean()) < 5e-4
        assert 0.0015 < rest.std() < 0.0035  # 1.7e-4 x sqrt(200 Hz)


def test_encoders_count_the_true_angles(sequence: Path) -> None:
    log = read_table(sequence / "parquet" / "encoders.parquet")
    facts = table_facts(sequence / "parquet" / "encoders.parquet")
    truth = read_table(sequence / "truth" / "encoders.parquet")
    turned = log["ticks_left"] * 2.0 * np.pi / facts["ticks_per_revolution"]
    assert np.abs(turned - truth["wheel_left_rad"] * 1.0005).max() < 0.003
