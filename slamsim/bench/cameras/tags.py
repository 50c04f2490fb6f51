"""Tags in rendered images of worlds: how far they are from where they hang, and how sure that is.

The camera stands still before each tag, so that neither motion nor path is part of the errors:
what is asked is the detector, in images with texture, light, noise and JPEG.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.bench import Figures
from slamsim.cameras.codecs.pictures import decode_picture
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.config.world import WorldConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import se3_from_se2, xyzw_from_yaw
from slamsim.core.randomness import random_stream
from slamsim.core.types import Drive, FloatArray
from slamsim.evaluate.consistency import nees_band
from slamsim.perception.recorded import grey_of_colour
from slamsim.perception.tag_families import TagKind
from slamsim.perception.tag_pose import step_between
from slamsim.perception.tags import TagDetector, linear_light
from slamsim.recording.images import RawPackedImages
from slamsim.sensors.base import Site
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sensors.motion import Motion
from slamsim.world.build import build_world
from slamsim.world.looks.build import build_looks
from slamsim.world.looks.tags import Tag

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
