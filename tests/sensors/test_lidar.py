"""The lidar's geometry and timing against closed forms, exact rotations and a second engine."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation, Slerp
from sensing_example import (
    PERFECT_LIDAR,
    SECOND,
    drive_along,
    figure_eight,
    joined_meshes,
    prism,
    rectangle,
    room,
    scan,
    standing,
)

from slamsim.config.lidar import LidarConfig
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import Drive, FloatArray, OutsideTimeRange, TriangleMesh
from slamsim.sensors.base import Site
from slamsim.sensors.lidar import Lidar, scan_geometry
from slamsim.sensors.motion import Motion, beam_rays, joined
from slamsim.sensors.scene import Scene

WIDE = PERFECT_LIDAR.model_copy(
    update={"angle_min_deg": -180.0, "angle_step_deg": 0.5, "beam_count": 720, "rate_hz": 10.0}
)


def random_outlines(rng: np.random.Generator, count: int = 12) -> list[FloatArray]:
    """A ten-metre room with convex polygons in it, away from the middle."""
    outlines = [rectangle(-5.0, -5.0, 5.0, 5.0)]
    for _ in range(count):
        middle = rng.uniform(1.2, 4.5) * np.array([1.0, 0.0])
        middle = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).apply([*middle, 0.0])[:2]
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
        outlines.append(middle + 0.4 * np.column_stack([np.cos(angles), np.sin(angles)]))
    return outlines


def exact_ranges(
    outlines: list[FloatArray], origins: FloatArray, directions: FloatArray
) -> FloatArray:
    """(n,) distance to the nearest wall, by Cramer's rule on every ray and every segment."""
    starts = np.vstack(outlines)
    sides = np.vstack([np.roll(outline, -1, axis=0) - outline for outline in outlines])
    offset = starts[None] - origins[:, None]
    det = directions[:, None, 0] * -sides[None, :, 1] + directions[:, None, 1] * sides[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (offset[..., 0] * -sides[:, 1] + offset[..., 1] * sides[:, 0]) / det
        share = (
            directions[:, None, 0] * offset[..., 1] - directions[:, None, 1] * offset[..., 0]
        ) / det
    met = (along > 0) & (share >= 0) & (share <= 1)
    return np.asarray(np.where(met, along, np.inf).min(axis=1))


def exact_frames(
    drive: Drive, T_base_laser: FloatArray, beam_ns: np.ndarray
) -> tuple[FloatArray, Rotation]:
    """Origins (n, 3) and orientations of the laser, by SciPy's slerp."""
    t = drive.stamps_ns * 1e-9
    base = Slerp(t, Rotation.from_quat(drive.quats_xyzw))(beam_ns * 1e-9)
    place = [np.interp(beam_ns * 1e-9, t, drive.positions_m[:, axis]) for axis in range(3)]
    origins = np.column_stack(place) + base.apply(T_base_laser[:3, 3])
    return origins, base * Rotation.from_matrix(T_base_laser[:3, :3])


@pytest.mark.parametrize("seed", range(4))
def test_ranges_equal_the_closed_form_on_random_prisms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outlines = random_outlines(rng)
    mesh = joined_meshes([prism(outline) for outline in outlines])
    drive = drive_along(
        1.0, 240.0, yaw_rad=rng.uniform(-3, 3), yaw_rate_rad_s=rng.uniform(-3, 3), speed_m_s=0.3
    )
    mount = se3_from_parts(matrix_from_rpy(0, 0, 0.4), np.array([0.1, -0.05, 0.3]))
    ranges = scan(WIDE, mesh, drive, mount, scans=9)

    geometry = scan_geometry(WIDE)
    beam_ns = (np.arange(9)[:, None] * SECOND // 10 + geometry.offsets_ns()).ravel()
    origins, frames = exact_frames(drive, mount, beam_ns)
    angles = np.tile(geometry.angles_rad(), 9)
    in_laser = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    exact = exact_ranges(outlines, origins[:, :2], frames.apply(in_laser)[:, :2])

    error = np.abs(ranges.ravel() - exact)
    assert np.quantile(error, 0.5) < 3e-6
    assert np.quantile(error, 0.995) < 1e-4
    assert np.mean(error > 1e-3) < 1e-3  # rays that graze a corner may see past it


def test_ranges_agree_with_pybullet() -> None:
    rng = np.random.default_rng(7)
    outlines = random_outlines(rng)
    mesh = joined_meshes([prism(outline) for outline in outlines])
    ranges = scan(WIDE, mesh, standing(1.0))[0]
    client = pybullet.connect(pybullet.DIRECT)
    try:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=mesh.vertices_m.tolist(),
            indices=np.vstack([mesh.triangles, mesh.triangles[:, ::-1]]).ravel().tolist(),
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=client,
        )
        pybullet.createMultiBody(0.0, shape, physicsClientId=client)
        angles = scan_geometry(WIDE).angles_rad()
        ends = 20.0 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
        start = np.array([0.0, 0.0, 0.3])
        answers = pybullet.rayTestBatch(
            np.tile(start, (len(ends), 1)).tolist(), (start + ends).tolist(), physicsClientId=client
        )
    finally:
        pybullet.disconnect(client)
    error = np.abs(np.array([20.0 * answer[2] for answer in answers]) - ranges)
    assert np.quantile(error, 0.9) < 1e-3
    assert np.quantile(error, 0.98) < 1e-2


@pytest.mark.parametrize(
    ("drive", "mount"),
    [
        (figure_eight(), se3_from_parts(np.eye(3), np.array([0.1, 0.0, 0.3]))),
        (figure_eight(), se3_from_parts(matrix_from_rpy(0.3, -0.5, 2.0), np.array([0.2, 0.1, 1]))),
        (drive_along(2.0, 20.0, yaw_rate_rad_s=6.0, wobble_rad=0.2), np.eye(4)),
    ],
    ids=["eight", "eight, tilted mount", "coarse and fast"],
)
def test_each_beam_leaves_from_the_exact_pose_of_its_own_instant(
    drive: Drive, mount: FloatArray
) -> None:
    rng = np.random.default_rng(1)
    beam_ns = np.sort(rng.integers(drive.stamps_ns[0], drive.stamps_ns[-1], 5000))
    angles = rng.uniform(-np.pi, np.pi, beam_ns.size)
    samples = joined(None, drive).pose_samples(mount, int(beam_ns[0]), int(beam_ns[-1]))
    turned = np.stack([np.cos(angles), np.sin(angles)])
    rays = beam_rays(samples, beam_ns, turned, np.zeros(3)).astype(np.float64)

    origins, frames = exact_frames(drive, mount, beam_ns)
    exact = frames.apply(np.column_stack([*turned, np.zeros_like(angles)]))
    off_rad = np.linalg.norm(np.cross(rays[:, 3:], exact), axis=1)
    assert off_rad.max() < 1.3e-6  # what the samples promise, and single precision
    assert np.abs(np.linalg.norm(rays[:, 3:], axis=1) - 1.0).max() < 1e-6
    assert np.abs(rays[:, :3] - origins).max() < 2e-5


def test_spinning_robot_deskewed_with_the_truth_sees_straight_walls() -> None:
    drive = drive_along(2.0, 240.0, yaw_rate_rad_s=2.5, wobble_rad=0.0)
    config = PERFECT_LIDAR.model_copy(update={"range_max_m": 30.0})
    mount = se3_from_parts(np.eye(3), np.array([0.1, 0.0, 0.3]))
    ranges = scan(config, room(4.0, 3.0), drive, mount, scans=40).astype(np.float64)
    geometry = scan_geometry(config)
    beam_ns = (np.arange(40)[:, None] * SECOND // 40 + geometry.offsets_ns()).ravel()
    angles = np.tile(geometry.angles_rad(), 40)
    ends = ranges.ravel()[:, None] * np.column_stack(
        [np.cos(angles), np.sin(angles), np.zeros_like(angles)]
    )

    def off_the_walls_m(at_ns: np.ndarray) -> FloatArray:
        origins, frames = exact_frames(drive, mount, at_ns)
        points = np.abs(origins + frames.apply(ends))
        return np.minimum(np.abs(points[:, 0] - 4.0), np.abs(points[:, 1] - 3.0))

    assert off_the_walls_m(beam_ns).max() < 1e-3
    frozen = np.repeat(np.arange(40) * SECOND // 40, geometry.beam_count)
    assert np.quantile(off_the_walls_m(frozen), 0.9) > 0.02  # the motion is really in the scan


def test_directions_turn_with_the_laser() -> None:
    mesh = joined_meshes([room(), prism(rectangle(1.9, -0.1, 2.1, 0.1))])
    ahead = scan(WIDE, mesh, standing(0.2))[0]
    turned = scan(WIDE, mesh, standing(0.2, yaw_rad=np.radians(90.0)))[0]
    mounted = scan(
        WIDE,
        mesh,
        standing(0.2),
        se3_from_parts(matrix_from_rpy(0, 0, np.pi / 2), np.array([0, 0, 0.3])),
    )[0]
    assert np.argmin(ahead) == 360  # straight ahead is the beam at 0 of -180..180 deg
    assert np.argmin(turned) == 180
    np.testing.assert_allclose(turned, np.roll(ahead, -180), atol=1e-4)
    np.testing.assert_allclose(mounted, turned, atol=1e-4)


def test_a_range_belongs_to_the_angle_and_the_time_of_its_beam() -> None:
    """A wall ahead, approached at 0.8 m/s: beam i measures what is left at its own instant."""
    drive = drive_along(1.0, 240.0, speed_m_s=0.8, start_m=(-3.0, 0.0))
    ranges = scan(WIDE, room(4.0, 30.0), drive, scans=5)
    geometry = scan_geometry(WIDE)
    for number in range(5):
        x = -3.0 + 0.8 * (number * 0.1 + geometry.offsets_ns() * 1e-9)
        cos = np.cos(geometry.angles_rad())
        forward = cos > 0.5
        expected = (4.0 - x[forward]) / cos[forward]
        np.testing.assert_allclose(ranges[number, forward], expected, atol=1e-4)


def test_flash_scan_freezes_the_motion_and_has_no_beam_time() -> None:
    flash = WIDE.model_copy(update={"rolling": False})
    drive = drive_along(1.0, 240.0, yaw_rate_rad_s=3.0)
    assert scan_geometry(flash).beam_dt_ns == 0
    frozen = scan(flash, room(), drive)[0]
    still = scan(WIDE, room(), standing(1.0))[0]
    np.testing.assert_allclose(frozen, still, atol=1e-4)
    assert np.abs(scan(WIDE, room(), drive)[0] - still).max() > 0.05


@pytest.mark.parametrize("pitch_deg", [5.0, 20.0, 45.0])
def test_a_lidar_that_looks_down_sees_the_floor(pitch_deg: float) -> None:
    mount = se3_from_parts(matrix_from_rpy(0, np.radians(pitch_deg), 0), np.array([0, 0, 0.3]))
    ahead = scan(WIDE, room(20.0, 20.0), standing(0.2), mount)[0, 360]
    assert ahead == pytest.approx(0.3 / np.sin(np.radians(pitch_deg)), abs=1e-4)


def test_a_lidar_on_its_head_sees_the_mirrored_order() -> None:
    mesh = joined_meshes([room(), prism(rectangle(-0.1, 1.4, 0.1, 1.6))])
    mount = se3_from_parts(matrix_from_rpy(np.pi, 0, 0), np.array([0, 0, 0.3]))
    upright, mirrored = (
        scan(WIDE, mesh, standing(0.2))[0],
        scan(WIDE, mesh, standing(0.2), mount)[0],
    )
    assert int(np.argmin(upright)) == 540
    assert int(np.argmin(mirrored)) == 180
    np.testing.assert_allclose(mirrored[1:], upright[:0:-1], atol=1e-4)


def test_walls_end_at_their_height() -> None:
    above = se3_from_parts(np.eye(3), np.array([0, 0, 1.2]))
    assert np.isinf(scan(WIDE, room(), standing(0.2), above)).all()


def test_a_scan_that_the_motion_does_not_cover_is_refused() -> None:
    lidar = Lidar(WIDE, np.eye(4), Site(room(), seed=0, start_ns=0))
    with pytest.raises(OutsideTimeRange, match="covers 0"):
        lidar.scan_batch(joined(None, standing(0.05)), np.array([0]))


def test_damaged_meshes_are_refused_with_the_place() -> None:
    good = room()
    bad_number = TriangleMesh(good.vertices_m.copy(), good.triangles)
    bad_number.vertices_m[3, 1] = np.nan
    bad_index = TriangleMesh(good.vertices_m, good.triangles.copy())
    bad_index.triangles[:] += 1
    empty = TriangleMesh(good.vertices_m, good.triangles[:0])
    for mesh, words in (
        (bad_number, "finite"),
        (bad_index, "names the vertices"),
        (empty, "empty"),
    ):
        with pytest.raises(Exception, match=words):
            Lidar(LidarConfig(), np.eye(4), Site(mesh, seed=0, start_ns=0))


def test_motion_refuses_what_it_does_not_cover() -> None:
    motion: Motion = joined(None, standing(0.1))
    with pytest.raises(OutsideTimeRange):
        motion.positions_at(np.array([-1]))
    with pytest.raises(OutsideTimeRange):
        motion.positions_at(np.array([motion.covered_ns + 1]))


@pytest.mark.slow
def test_sensing_costs_less_than_three_bare_casts_of_the_same_rays() -> None:
    """Poses, noise, edges and bookkeeping together stay below twice the ray caster itself."""
    rng = np.random.default_rng(3)
    mesh = joined_meshes([prism(outline) for outline in random_outlines(rng, count=200)])
    motion = joined(None, figure_eight(4.0))
    lidar = Lidar(LidarConfig(), np.eye(4), Site(mesh, seed=0, start_ns=0))
    scan_ns = np.arange(150, dtype=np.int64) * (SECOND // 40)
    beam_ns = (scan_ns[:, None] + lidar.geometry.offsets_ns()).ravel()
    angles = np.tile(lidar.geometry.angles_rad(), scan_ns.size)
    scene = Scene(mesh, floor_reach_m=30.0)
    samples = motion.pose_samples(np.eye(4), int(beam_ns[0]), int(beam_ns[-1]))
    rays = beam_rays(samples, beam_ns, np.stack([np.cos(angles), np.sin(angles)]), scene.origin_m)

    def seconds(work: Callable[[], object]) -> float:
        start = time.thread_time()
        work()
        return time.thread_time() - start

    work = (lambda: lidar.scan_batch(motion, scan_ns), lambda: scene.cast(rays))
    sensing, casting = np.min([[seconds(each) for each in work] for _ in range(10)], axis=0)
    assert sensing < 3.0 * casting
