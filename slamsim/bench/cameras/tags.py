"""Tags in rendered images of worlds: how far they are from where they hang, and how sure that is.

The camera stands still before each tag, so that neither motion nor path is part of the errors:
what is asked is the detector, in images with texture, light, noise and JPEG.

Then SLAM in a hall whose walls no lidar of 4 m reaches: by wheels, and by ten tags on the walls.
What the camera sees of the tags is made by projecting their exact corners and adding noise of
pixels; poses and covariances are then those of ``tag_pose``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from slamsim.cameras.codecs.pictures import decode_picture
from slamsim.cameras.lens import pinhole
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.config.slam import MotionConfig
from slamsim.config.world import WorldConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose, se3_from_parts, se3_from_se2, xyzw_from_yaw
from slamsim.core.randomness import random_stream
from slamsim.core.spatial import CameraTrack, TagSeen
from slamsim.core.types import Drive, FloatArray, PlanarTrajectory, Trajectory
from slamsim.evaluate.consistency import nees_band
from slamsim.evaluate.spatial import compare_in_space
from slamsim.models.differential_drive import pose_reading
from slamsim.perception.recorded import grey_of_colour
from slamsim.perception.tag_edges import LEAST_SIDE_PX, Corners
from slamsim.perception.tag_families import TagKind
from slamsim.perception.tag_pose import square_corners, step_between, tag_pose
from slamsim.perception.tags import TagDetector, linear_light
from slamsim.recording.images import RawPackedImages
from slamsim.sensors.base import Site
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sensors.motion import Motion
from slamsim.slam.frontend.motion import Odometry, increments
from slamsim.slam.visual.camera_map import CameraMap, camera_map
from slamsim.world.build import build_world
from slamsim.world.looks.build import build_looks
from slamsim.world.looks.tags import Tag

Figures = dict[str, object]

WORLD, WORLDS, FIRST_SEED, VIEWS = "gallery", 20, 1000, 16
"""Constants of ``tag_edges`` were fitted on seeds below the first. Of each world so many views are
rendered; in some of them something else stands in between."""
DISTANCE_M, ASIDE_DEG, AWAY_DEG = (0.5, 2.8), 55.0, 15.0
"""Of the camera from a tag, aside of its normal, and of the tag aside of the image's middle."""
_IMAGER = {
    "lens": {"width": 424, "height": 240, "horizontal_fov_deg": 69.0},
    "exposure": {"lag_s": 0},
}
_CAMERA = {"type": "camera", "name": "camera", "mount": {"x_m": 0.1, "z_m": 0.4}}
_STAND_NS, _RATE_HZ, _PHASE_S = 400_000_000, 5.0, 0.1
"""Two images at each place, for the first one has the exposure of the place before."""


def measure_tag_nees(config: RunConfig, reporter: Reporter) -> Figures:
    """The mean over worlds of the squared error of positions in units of their covariances: 3 if
    these are true. In the band it is in 95 of 100 measurements if the tags of a world are all off
    alike, more often otherwise: a world counts as one of them."""
    world, errors, found = load_run_config(WORLD).world, [], 0
    with reporter.stage("tag errors", "worlds") as progress:
        for seed in range(WORLDS):
            steps, squares = tag_errors(world, FIRST_SEED + seed, VIEWS)
            if len(steps):
                off_m = float(np.median(np.linalg.norm(steps, axis=1)))
                errors.append([float(np.mean(squares)), off_m])
            found += len(steps)
            progress(seed + 1, WORLDS)
    nees, error_m = np.mean(errors, axis=0).tolist()
    return {
        "tag_nees": nees,
        "tag_nees_band": list(nees_band(len(errors))),
        "tag_error_m": error_m,
        "tags_measured": found,
    }


def tag_errors(config: WorldConfig, seed: int, views: int) -> tuple[FloatArray, FloatArray]:
    """(n, 3) by how much tags in so many images are off, m, and (n,) the squares of that in units
    of the covariances."""
    world = build_world(config, seed)
    looks = build_looks(world, config.looks)
    kind = TagKind(looks.tags[0].family, looks.tags[0].size_m)
    sensors = SensorsConfig.model_validate(
        {
            "additional": [
                {**_CAMERA, "rate_hz": _RATE_HZ, "phase_s": _PHASE_S, "imagers": {"color": _IMAGER}}
            ]
        }
    )
    entry = sensors.additional[0]
    assert isinstance(entry, CameraEntry)
    imager = entry.imagers["color"]
    poses = np.array(list(_places(looks.tags, seed, views)))
    camera = entry.build(Site(world.mesh, seed, 0, appearance=lambda: looks))
    streams = camera.sense(Motion(_standing(poses[[*range(views), -1]]))).streams()
    packed = [each.data[0] for each in streams if isinstance(each, RawPackedImages)]
    detector = TagDetector(kind, imager.lens.model())
    T_map_tag = {tag.id: tag.T_map_tag for tag in looks.tags}
    steps, squares = [], []
    for pose, data in zip(poses, packed[1 : 2 * views : 2], strict=True):
        colour = decode_picture(data.tobytes()).astype(np.uint8)
        T_camera_map = np.linalg.inv(se3_from_se2(pose) @ entry.T_base_imager(imager))
        for seen in detector.detect(grey_of_colour(colour), linear_light(colour)):
            true = T_camera_map @ T_map_tag[seen.number]
            step = step_between(seen.pose.T_camera_tag, true)[:3]
            steps.append(step)
            squares.append(step @ np.linalg.solve(seen.pose.covariance[:3, :3], step))
    return np.array(steps).reshape(-1, 3), np.array(squares)


def _places(tags: tuple[Tag, ...], seed: int, views: int) -> Iterator[FloatArray]:
    """(3,) of the base before one tag after the other."""
    rng = random_stream(seed, "tag nees", "places")
    for number in range(views):
        T = tags[number % len(tags)].T_map_tag
        aside, away = np.radians(rng.uniform(-1.0, 1.0, 2) * [ASIDE_DEG, AWAY_DEG])
        heading = np.arctan2(T[1, 2], T[0, 2]) + aside
        far_m = rng.uniform(*DISTANCE_M)
        x_m, y_m = T[:2, 3] + far_m * np.array([np.cos(heading), np.sin(heading)])
        yield np.array([x_m, y_m, heading + np.pi + away])


def _standing(poses: FloatArray) -> Drive:
    """A robot that stands at each of poses (n, 3), and is at the next one at once."""
    begin_ns = np.arange(len(poses)) * _STAND_NS
    stamps_ns = np.column_stack([begin_ns, begin_ns + _STAND_NS - 1_000_000]).ravel()
    twice, still = np.repeat(poses, 2, axis=0), np.zeros((2 * len(poses), 3))
    return Drive(
        stamps_ns=stamps_ns,
        positions_m=np.column_stack([twice[:, :2], still[:, 0]]),
        quats_xyzw=xyzw_from_yaw(twice[:, 2]),
        linear_velocity_m_s=still,
        angular_velocity_rad_s=still,
        wheel_angles_rad=still[:, :2],
        wheel_speeds_rad_s=still[:, :2],
        commands=still[:, :2],
        wall_contact=np.zeros(len(still), dtype=np.bool_),
    )


TAGS, SIZE_M, HEIGHT_M = 10, 0.4, 0.5
HALL_M = (17.0, 12.0)
CAMERA = pinhole(640, 480, 69.0)
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BASE_CAMERA = se3_from_parts(_OPTICAL, np.array([0.1, 0.02, 0.3]))
NOISE_PX = 0.12
"""Of a corner: what lines through edges leave in images of tags this far away (``tag_edges``)."""
HALL_WORLDS = 3
SECONDS = 120.0
_PERIOD_NS, _SPEED_M_S = 66_666_667, 0.4
_WHEELS_TOO_LARGE = 1.015
_SLIP_M, _TURN_RAD = 0.001, 0.001
"""Standard deviation of a step between two images."""
_UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""From the frame of a tag (x right, y up, z out of the sheet) to a wall whose normal is x."""


def measure_tags(config: RunConfig, reporter: Reporter) -> Figures:
    """RMSE of the path, once aligned, over some drives, with tags and by wheels alone."""
    with reporter.stage("tags", "halls") as progress:
        both = []
        for seed in range(HALL_WORLDS):
            true, track, odometry = hall(seed)
            without = replace(track, tags=())
            both.append([ate_m(mapped(one, odometry), true) for one in (track, without)])
            progress(seed + 1, HALL_WORLDS)
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
