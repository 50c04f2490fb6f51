"""SLAM in a hall whose walls no lidar of 4 m reaches: by wheels, and by ten tags on the walls.

What the camera sees of the tags is made by projecting their exact corners and adding noise of
pixels; poses and covariances are then those of ``tag_pose``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.cameras.lens import pinhole
from slamsim.config.run import RunConfig
from slamsim.config.slam import MotionConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose, se3_from_parts, se3_from_se2, xyzw_from_yaw
from slamsim.core.randomness import random_stream
from slamsim.core.spatial import CameraTrack, TagSeen
from slamsim.core.types import FloatArray, PlanarTrajectory, Trajectory
from slamsim.evaluate.spatial import compare_in_space
from slamsim.models.differential_drive import pose_reading
from slamsim.perception.tag_edges import LEAST_SIDE_PX, Corners
from slamsim.perception.tag_pose import square_corners, tag_pose
from slamsim.slam.frontend.motion import Odometry, increments
from slamsim.slam.visual.camera_map import CameraMap, camera_map

Figures = dict[str, object]

TAGS, SIZE_M, HEIGHT_M = 10, 0.4, 0.5
HALL_M = (17.0, 12.0)
CAMERA = pinhole(640, 480, 69.0)
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BASE_CAMERA = se3_from_parts(_OPTICAL, np.array([0.1, 0.02, 0.3]))
NOISE_PX = 0.12
"""Of a corner: what lines through edges leave in images of tags this far away (``tag_edges``)."""
WORLDS = 3
SECONDS = 120.0
_PERIOD_NS, _SPEED_M_S = 66_666_667, 0.4
_WHEELS_TOO_LARGE = 1.015
_SLIP_M, _TURN_RAD = 0.001, 0.001
"""Standard deviation of a step between two images."""
_UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def measure_tags(config: RunConfig, reporter: Reporter) -> Figures:
    """RMSE of the path, once aligned, over some drives, with tags and by wheels alone."""
    with reporter.stage("tags", "halls") as progress:
        both = []
        for seed in range(WORLDS):
            true, track, odometry = hall(seed)
            without = replace(track, tags=())
            both.append([ate_m(mapped(one, odometry), true) for one in (track, without)])
            progress(seed + 1, WORLDS)
    with_tags, wheels = np.sqrt(np.mean(np.square(both), axis=0)).tolist()
    return {"tag_ate_m": with_tags, "tag_ate_without_m": wheels}


def mapped(track: CameraTrack, odometry: Odometry) -> CameraMap:
    """What SLAM makes of it."""
    return camera_map(track, T_BASE_CAMERA, odometry, MotionConfig())


def hall(seed: int, seconds: float = SECONDS) -> tuple[PlanarTrajectory, CameraTrack, Odometry]:
    """True path, what the camera sees, and wheels that are too large, of one drive."""
    stamps_ns = np.arange(round(seconds * 1e9 / _PERIOD_NS), dtype=np.int64) * _PERIOD_NS
    true = PlanarTrajectory(stamps_ns, _rounds(np.asarray(1e-9 * stamps_ns, dtype=np.float64)))
    rng = random_stream(seed, "hall", "tags")
    seen = [
        TagSeen(k, number, *view)
        for k, pose in enumerate(true.poses)
        for number, T_map_tag in enumerate(_tags())
        if (view := _view(se3_from_se2(pose), T_map_tag, rng)) is not None
    ]
    count = np.arange(len(stamps_ns))
    since = np.tile(np.eye(4), (len(count), 1, 1))
    track = CameraTrack(stamps_ns, since, count, count, (), tuple(seen), 0, 0)
    return true, track, _wheels(true, seed)


def _rounds(seconds: FloatArray) -> FloatArray:
    """(n, 3) poses on an oval in the middle of the hall."""
    turn = _SPEED_M_S * seconds / 2.4
    x, y = 8.5 + 3.2 * np.sin(turn), 6.0 - 1.8 * np.cos(turn)
    yaw = np.arctan2(1.8 * np.sin(turn), 3.2 * np.cos(turn))
    return np.column_stack([x, y, yaw])


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


def _view(
    T_map_base: FloatArray, T_map_tag: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray] | None:
    """(4, 4) T_camera_tag with (6, 6) covariance; None for a tag that is not seen."""
    T_camera_tag = np.linalg.inv(T_map_base @ T_BASE_CAMERA) @ T_map_tag
    if T_camera_tag[2, 3] < 0.3 or T_camera_tag[2, 2] > -0.2:  # behind, or from the side
        return None
    corners_m = square_corners(SIZE_M) @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3]
    pixels, seen = CAMERA.project(corners_m)
    sides = np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1)
    if not (seen & CAMERA.contains(pixels)).all() or sides.min() < LEAST_SIDE_PX:
        return None
    noise = NOISE_PX / float(CAMERA.focal_px[0])
    rays_xy = corners_m[:, :2] / corners_m[:, 2:] + rng.normal(0.0, noise, (4, 2))
    pose = tag_pose(Corners(rays_xy, np.eye(8) * noise**2, pixels), SIZE_M)
    return None if pose is None else pose.in_own_frame()


def _wheels(true: PlanarTrajectory, seed: int) -> Odometry:
    rng = random_stream(seed, "hall", "wheels")
    steps = between(true.poses[:-1], true.poses[1:])
    steps[:, :2] *= _WHEELS_TOO_LARGE
    steps += rng.normal(0.0, [_SLIP_M, _SLIP_M, _TURN_RAD], steps.shape)
    poses = [true.poses[0]]
    for step in steps:
        poses.append(compose(poses[-1], step))
    path = PlanarTrajectory(true.stamps_ns, np.array(poses))
    return Odometry(increments(path), pose_reading(path))


def ate_m(found: CameraMap, true: PlanarTrajectory) -> float:
    """RMSE of positions once aligned."""
    places = np.column_stack([true.poses[:, :2], np.zeros(len(true))])
    truth = Trajectory(true.stamps_ns, places, xyzw_from_yaw(true.poses[:, 2]))
    return compare_in_space(found.trajectory, truth).ate_rmse_m
