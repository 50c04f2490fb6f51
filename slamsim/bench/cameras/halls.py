"""SLAM in a hall of whose walls a lidar of 4 m sees nothing: without tags, and with ten.

What the camera sees of the tags is made by projecting their exact corners and adding noise of
pixels; poses and covariances are then those of ``tag_pose``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import shapely

from slamsim.cameras.lens import pinhole
from slamsim.config.lidar import LidarConfig
from slamsim.config.run import RunConfig
from slamsim.config.slam import SlamConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose, se3_from_parts, se3_from_se2, xyzw_from_yaw
from slamsim.core.landmarks import NO_TAGS, TagObservation, TagsSeen
from slamsim.core.randomness import random_stream
from slamsim.core.result import SlamResult
from slamsim.core.types import Drive, FloatArray, Log, PlanarTrajectory, Scan
from slamsim.evaluate.trajectory import compare
from slamsim.perception.planar import planar_observation
from slamsim.perception.tag_edges import LEAST_SIDE_PX, Corners
from slamsim.perception.tag_families import TagKind
from slamsim.perception.tag_pose import square_corners, tag_pose
from slamsim.perception.tags import TagSighting
from slamsim.sensors.base import Site
from slamsim.sensors.lidar import Lidar
from slamsim.sensors.motion import Motion
from slamsim.slam.session import map_log
from slamsim.world.prism import Prism, prism_mesh

TAGS, KIND, HEIGHT_M = 10, TagKind("apriltag_36h11", 0.4), 0.5
HALL_M = (17.0, 12.0)
CAMERA = pinhole(640, 480, 69.0)
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BASE_CAMERA = se3_from_parts(_OPTICAL, np.array([0.1, 0.02, 0.3]))
T_BASE_LASER = se3_from_parts(np.eye(3), np.array([0.0, 0.0, 0.2]))
NOISE_PX = 0.12
"""Of a corner: what lines through edges leave in images of tags this far away (``tag_edges``)."""
HALL_WORLDS = 3
SECONDS = 120.0
_PERIOD_NS, _STEPS_AN_IMAGE = 20_000_000, 5
_TURN_RAD_S = 1.0 / 6.0
_MIDDLE_M, _RADII_M, _START_M = np.array([10.0, 6.0]), np.array([2.6, 1.8]), 1.5
"""Rounds 4.2 m and more from the walls, after a way along a wall on which the lidar sees them."""
_LIDAR = LidarConfig(rate_hz=10.0, angle_step_deg=1.0, beam_count=271, range_max_m=4.0)
_WHEELS_TOO_LARGE, _TURNS_TOO_LARGE = 1.015, 1.04
"""As the wheels in the tests of SLAM: larger than told, and closer together."""
_SLIP_M, _SLIP_RAD = 0.0005, 0.0005
"""Standard deviation of a step of the odometry."""
_UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Axes of a tag (x to its right, y up, z out of it) in a frame whose x points out of the wall."""


def measure_tags(config: RunConfig, reporter: Reporter) -> dict[str, object]:
    """RMSE of the path, once aligned, over some drives, with tags and without."""
    with reporter.stage("tags", "halls") as progress:
        both = []
        for seed in range(HALL_WORLDS):
            true, log, tags = hall(seed)
            both.append([ate_m(mapped(log, each), true) for each in (tags, NO_TAGS)])
            progress(seed + 1, HALL_WORLDS)
    with_tags, without = np.sqrt(np.mean(np.square(both), axis=0)).tolist()
    return {"tag_ate_m": with_tags, "tag_ate_without_m": without}


def mapped(log: Log, tags: TagsSeen) -> SlamResult:
    """What SLAM makes of it."""
    return map_log(log, SlamConfig(), tags=tags)[0]


def ate_m(found: SlamResult, true: PlanarTrajectory) -> float:
    """RMSE of positions once aligned."""
    off_m = compare(found.trajectory, true).translation_m
    return float(np.sqrt(np.mean(np.square(off_m))))


def hall(seed: int, seconds: float = SECONDS) -> tuple[PlanarTrajectory, Log, TagsSeen]:
    """True path, what was recorded, and what the camera sees of the tags, of one drive."""
    stamps_ns = np.arange(round(seconds * 1e9 / _PERIOD_NS), dtype=np.int64) * _PERIOD_NS
    true = PlanarTrajectory(stamps_ns, _rounds(np.asarray(1e-9 * stamps_ns, dtype=np.float64)))
    log = Log(
        name="hall",
        epoch="simulation",
        scans=_scans(true, seed),
        odometry=_wheels(true, seed),
        imu=None,
        encoders=None,
        T_base_laser=T_BASE_LASER,
    )
    return true, log, TagsSeen(tuple(_observed(true, seed)), family=KIND.family)


def _rounds(seconds: FloatArray) -> FloatArray:
    """(n, 3) poses: straight into the middle of the hall, then on an oval."""
    low_m = _MIDDLE_M - (0.0, _RADII_M[1])
    turned = _TURN_RAD_S * seconds - (low_m[0] - _START_M) / _RADII_M[0]
    turn = np.maximum(turned, 0.0)
    x = _MIDDLE_M[0] + _RADII_M[0] * (np.sin(turn) + np.minimum(turned, 0.0))
    y = _MIDDLE_M[1] - _RADII_M[1] * np.cos(turn)
    yaw = np.arctan2(_RADII_M[1] * np.sin(turn), _RADII_M[0] * np.cos(turn))
    return np.column_stack([x, y, yaw])


def _scans(true: PlanarTrajectory, seed: int) -> list[Scan]:
    """What the lidar sees of the walls on the way."""
    outside = shapely.box(-0.1, -0.1, HALL_M[0] + 0.1, HALL_M[1] + 0.1)
    walls = shapely.difference(outside, shapely.box(0.0, 0.0, *HALL_M))
    lidar = Lidar(_LIDAR, T_BASE_LASER, Site(prism_mesh([Prism(walls, 0.0, 1.0)]), seed, 0))
    batch = lidar.sense(Motion(_drive(true)))
    return [
        Scan(stamp_ns, ranges_m, batch.geometry)
        for stamp_ns, ranges_m in zip(batch.stamps_ns.tolist(), batch.ranges_m, strict=True)
    ]


def _drive(true: PlanarTrajectory) -> Drive:
    count, still = len(true), np.zeros((len(true), 3))
    return Drive(
        stamps_ns=true.stamps_ns,
        positions_m=np.column_stack([true.poses[:, :2], still[:, 0]]),
        quats_xyzw=xyzw_from_yaw(true.poses[:, 2]),
        linear_velocity_m_s=still,
        angular_velocity_rad_s=still,
        wheel_angles_rad=still[:, :2],
        wheel_speeds_rad_s=still[:, :2],
        commands=still[:, :2],
        wall_contact=np.zeros(count, dtype=np.bool_),
    )


def _observed(true: PlanarTrajectory, seed: int) -> Iterator[TagObservation]:
    rng = random_stream(seed, "hall", "tags")
    for stamp_ns, pose in zip(true.stamps_ns.tolist(), true.poses, strict=True):
        if stamp_ns % (_STEPS_AN_IMAGE * _PERIOD_NS) == 0:
            for number, T_map_tag in enumerate(_tags()):
                seen = _sighting(se3_from_se2(pose), T_map_tag, number, rng)
                if seen is not None:
                    yield planar_observation(stamp_ns, seen, T_BASE_CAMERA)


def _tags() -> list[FloatArray]:
    """(4, 4) T_map_tag spread along the walls, facing inwards."""
    w, h = HALL_M
    found = []
    for at in (np.arange(TAGS) + 0.5) / TAGS * 2.0 * (w + h):
        if at < w:
            place = (at, 0.0, np.pi / 2)
        elif at < w + h:
            place = (w, at - w, np.pi)
        elif at < 2 * w + h:
            place = (2 * w + h - at, h, -np.pi / 2)
        else:
            place = (0.0, 2 * (w + h) - at, 0.0)
        hung = se3_from_parts(_UPRIGHT, np.array([0.0, 0.0, HEIGHT_M]))
        found.append(se3_from_se2(np.array(place)) @ hung)
    return found


def _sighting(
    T_map_base: FloatArray, T_map_tag: FloatArray, number: int, rng: np.random.Generator
) -> TagSighting | None:
    """None for a tag that is not seen."""
    T_camera_tag = np.linalg.inv(T_map_base @ T_BASE_CAMERA) @ T_map_tag
    if T_camera_tag[2, 3] < 0.3 or T_camera_tag[2, 2] > -0.2:  # behind, or from the side
        return None
    corners_m = square_corners(KIND.size_m) @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3]
    pixels, seen = CAMERA.project(corners_m)
    sides = np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1)
    if not (seen & CAMERA.contains(pixels)).all() or sides.min() < LEAST_SIDE_PX:
        return None
    noise = NOISE_PX / float(CAMERA.focal_px[0])
    rays_xy = corners_m[:, :2] / corners_m[:, 2:] + rng.normal(0.0, noise, (4, 2))
    corners = Corners(rays_xy, np.eye(8) * noise**2, pixels)
    pose = tag_pose(corners, KIND.size_m)
    return None if pose is None else TagSighting(KIND, number, corners, pose)


def _wheels(true: PlanarTrajectory, seed: int) -> PlanarTrajectory:
    rng = random_stream(seed, "hall", "wheels")
    steps = between(true.poses[:-1], true.poses[1:])
    steps *= (_WHEELS_TOO_LARGE, _WHEELS_TOO_LARGE, _TURNS_TOO_LARGE)
    steps += rng.normal(0.0, [_SLIP_M, _SLIP_M, _SLIP_RAD], steps.shape)
    poses = [true.poses[0]]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return PlanarTrajectory(true.stamps_ns, np.array(poses))
