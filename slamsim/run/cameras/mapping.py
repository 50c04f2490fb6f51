"""``slamsim map`` without scans: by tags, corners in images, wheels and gyroscope."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.cameras.lens import CameraModel, camera_matrix
from slamsim.config.run import RunConfig
from slamsim.core.progress import Progress
from slamsim.core.spatial import CameraTrack
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.guard.numbers import as_json
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.cameras.base import Cameras
from slamsim.io.open import OpenRecording, open_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.io.text.g2o import write_g2o_space
from slamsim.io.text.tum import read_tum, write_tum
from slamsim.perception.camera_track import CameraTracker, Seen
from slamsim.perception.tag_families import parse_tags
from slamsim.perception.tags import TagDetector
from slamsim.recording.cleaning.log import clean_motion
from slamsim.recording.frames import base_frame_of, known_mounting, tree_of
from slamsim.report.pages.cameras import write_camera_report
from slamsim.run import folder as run_folder
from slamsim.run.cameras.odometry import WITHIN_NS, registered
from slamsim.run.cameras.telling import Robot, report_of, view_of
from slamsim.run.cameras.without_lidar import lidar_path
from slamsim.run.naming import log_of
from slamsim.run.stages import Report, Stages
from slamsim.simulation.own_files import write_config
from slamsim.slam.session import odometry_of
from slamsim.slam.visual.camera_map import camera_map

TUM_TRUTH = "groundtruth.txt"


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """picture, depth: topics, the latter empty without one. model: of both."""

    picture: str
    depth: str
    model: CameraModel
    frame_id: str


def map_by_camera(
    source: Path,
    config: RunConfig,
    folder: Path,
    stages: Stages,
    *,
    why: str = "",
    intrinsics: str = "",
    wanted: Selection = EVERYTHING,
    overwrite: bool = False,
) -> Report:
    """Map by what a camera sees, wheels and gyroscope, and tell how good that is.

    why: it is not the lidar that maps. intrinsics: as for ``camera_matrix``. The folder gets
    ``trajectory.tum`` of the robot's base (of the optical frame, for a camera on no robot),
    ``graph.g2o``, ``report.json`` and ``report.html``. Raises SlamsimError where images tell no
    motion, else as ``open_cameras``.
    """
    only_images = source.is_dir() and is_image_folder(source)
    path = source if only_images else log_of(source)
    opened = None if only_images else open_recording(path, wanted)
    with open_cameras(path) as cameras:
        camera = _camera(cameras, config, intrinsics)
        robot = _folder(source) if opened is None else _robot(opened, camera.frame_id)
        with stages.stage("images", "images/s") as progress:
            track = _tracked(cameras, camera, config, progress)
    with stages.stage("slam"):
        odometry = None if robot.log is None else odometry_of(robot.log)
        motion = config.slam.front_end.motion
        found = camera_map(track, robot.T_base_camera, odometry, motion)
    lidar = None if opened is None else lidar_path(opened, config.slam, stages.reporter)
    report = report_of(source, track, found, robot, lidar, why)
    view = view_of(source, report, track, found, robot, lidar)
    with partial_folder(folder, overwrite) as partial:
        write_config(partial, config)
        if robot.truth is not None:
            run_folder.write_truth(partial, robot.truth)
        write_tum(partial / run_folder.TRAJECTORY, found.trajectory)
        every = np.concatenate([found.poses, *(tag.T_map_tag[None] for tag in found.tags)])
        write_g2o_space(partial / "graph.g2o", every, found.edges)
        write_camera_report(partial / run_folder.REPORT, view)
        told = as_json(run_folder.REPORT_JSON, report.numbers)
        write_atomic(partial / run_folder.REPORT_JSON, told)
    return report


def _camera(cameras: Cameras, config: RunConfig, intrinsics: str) -> _Camera:
    """Depth registered to a picture where there is one; else, if tags are wanted, a picture."""
    K = camera_matrix(intrinsics) if intrinsics else None
    pictures = cameras.pictures()
    if cameras.of_kind("depth"):
        try:
            pair = registered(cameras, "", K)
        except SlamsimError:
            if not (config.slam.landmarks.tags and pictures):
                raise
        else:
            frame = cameras.topics[pair.depth].frame_id
            return _Camera(pair.picture, pair.depth, pair.model, frame)
    if not pictures or not config.slam.landmarks.tags:
        reason = "a map without lidar needs depth registered to pictures, or pictures and --tags"
        raise cameras.refused(reason)
    first = pictures[0]
    model = CameraModel(first.width, first.height, K) if K is not None else None
    return _Camera(first.topic, "", model or cameras.model(first.topic), first.frame_id)


def _folder(source: Path) -> Robot:
    """A folder of images: TUM's has the true path beside them."""
    truth = source / TUM_TRUTH
    return Robot(np.eye(4), truth=read_tum(truth) if truth.is_file() else None)


def _robot(opened: OpenRecording, frame_id: str) -> Robot:
    recording = opened.recording
    base = base_frame_of(recording)
    known = known_mounting(tree_of(recording.transforms), base, frame_id)
    if known is None:
        told = f"no fixed transform leads from {base!r} to {frame_id!r}: the camera alone is mapped"
        return Robot(np.eye(4), told=(f"{told}, without wheels and gyroscope",))
    log = clean_motion(recording, opened.path)
    return Robot(known[0], log, opened.truth(), log.warnings)


def _tracked(
    cameras: Cameras, camera: _Camera, config: RunConfig, progress: Progress
) -> CameraTrack:
    wanted = config.slam.landmarks.tags
    detector = TagDetector(parse_tags(wanted), camera.model) if wanted else None
    tracker, total = CameraTracker(camera.model, detector), cameras.topics[camera.picture].messages
    for number, (picture, depth) in enumerate(_images(cameras, camera), 1):
        tracker.add(picture, depth)
        progress(number, total)
    track = tracker.track()
    if len(track.stamps_ns) < 2:
        reason = f"{len(track.stamps_ns)} images of {camera.picture} can be used; two are needed"
        raise InputRefused(cameras.path, reason)
    return track


def _images(cameras: Cameras, camera: _Camera) -> Iterator[Seen]:
    if camera.depth:
        pairs = cameras.pairs(camera.depth, camera.picture, WITHIN_NS)
        return ((seen, near) for near, seen in pairs)
    return ((frame, None) for frame in cameras.frames((camera.picture,)))
