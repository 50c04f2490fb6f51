"""``slamsim map`` without a lidar: by tags, depth images, wheels and gyroscope."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.cameras.lens import CameraModel, camera_matrix
from slamsim.config.run import RunConfig
from slamsim.core.geometry import compose, inverse, xyzw_from_matrix
from slamsim.core.progress import Progress
from slamsim.core.spatial import CameraTrack
from slamsim.core.types import FloatArray, Log, PlanarTrajectory, Trajectory
from slamsim.evaluate.spatial import SpatialErrors, compare_in_space
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.guard.numbers import as_json
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.io.cameras import is_image_folder, open_cameras
from slamsim.io.cameras.base import Cameras
from slamsim.io.open import OpenRecording, open_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.io.text.g2o_space import write_g2o_space
from slamsim.io.text.tum import read_tum, write_tum
from slamsim.perception.camera_track import CameraTracker, Seen
from slamsim.perception.tag_families import parse_tags
from slamsim.perception.tags import TagDetector
from slamsim.recording.cleaning.log import clean_motion
from slamsim.recording.mountings import BASE_FRAME, known_mounting, tree_of
from slamsim.report.pages.camera import CameraView, write_camera_report
from slamsim.run import folder as run_folder
from slamsim.run.cameras.odometry import WITHIN_NS, registered
from slamsim.run.naming import log_of, recording_name
from slamsim.run.stages import Report, Stages
from slamsim.simulation.own_files import write_config
from slamsim.slam.session import odometry_of, run_slam
from slamsim.slam.visual.camera_map import CameraMap, MappedTag, camera_map

MANY_LOST = 0.1
"""Share of lost images from which on it is told."""
TUM_TRUTH = "groundtruth.txt"


@dataclass(frozen=True, slots=True, eq=False)
class _Robot:
    """What is known besides the images. T_base_camera: (4, 4). log: of wheels and gyroscope. truth:
    of what is mapped: the base, or else the optical frame. told: what to warn of."""

    T_base_camera: FloatArray
    log: Log | None = None
    truth: Trajectory | None = None
    told: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """picture, depth: topics, the latter empty without one. model: of both."""

    picture: str
    depth: str
    model: CameraModel
    frame_id: str


def is_only_images(source: Path) -> bool:
    """Whether this is a folder of images, which holds no scans at all."""
    return source.is_dir() and is_image_folder(source)


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
    path = source if is_only_images(source) else log_of(source)
    opened = None if is_only_images(source) else open_recording(path, wanted)
    with open_cameras(path) as cameras:
        camera = _camera(cameras, config, intrinsics)
        robot = _folder(source) if opened is None else _robot(opened, camera.frame_id)
        with stages.stage("images", "images/s") as progress:
            track = _tracked(cameras, camera, config, progress)
    with stages.stage("slam"):
        odometry = None if robot.log is None else odometry_of(robot.log)
        motion = config.slam.front_end.motion
        found = camera_map(track, robot.T_base_camera, odometry, motion)
    lidar = None if opened is None else _by_lidar(opened, config, stages)
    report = _report(source, track, found, robot, lidar, why)
    view = _view(source, report, track, found, robot, lidar)
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
    pictures = [*cameras.of_kind("colour"), *cameras.of_kind("grey")]
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
        raise InputRefused(cameras.path, reason)
    first = pictures[0]
    model = CameraModel(first.width, first.height, K) if K is not None else None
    return _Camera(first.topic, "", model or cameras.model(first.topic), first.frame_id)


def _folder(source: Path) -> _Robot:
    """A folder of images: TUM's has the true path beside them."""
    truth = source / TUM_TRUTH
    return _Robot(np.eye(4), truth=read_tum(truth) if truth.is_file() else None)


def _robot(opened: OpenRecording, frame_id: str) -> _Robot:
    recording, base = opened.recording, BASE_FRAME
    for odometry in recording.odometries[:1]:
        base = odometry.child_frame_ids[0]
    known = known_mounting(tree_of(recording.transforms), base, frame_id)
    if known is None:
        told = f"no fixed transform leads from {base!r} to {frame_id!r}: the camera alone is mapped"
        return _Robot(np.eye(4), told=(f"{told}, without wheels and gyroscope",))
    log = clean_motion(recording, opened.path)
    return _Robot(known[0], log, opened.truth(), log.warnings)


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


def _by_lidar(opened: OpenRecording, config: RunConfig, stages: Stages) -> PlanarTrajectory | None:
    """The path that the lidar gives, to compare with; None where it gives none."""
    if not opened.recording.scans:
        return None
    try:
        with stages.stage("lidar", "scans/s") as progress:
            return run_slam(opened.log(), config.slam, progress).trajectory
    except SlamsimError:
        return None


def _in_space(path: PlanarTrajectory) -> Trajectory:
    count, (x, y, yaw) = len(path), path.poses.T
    quats = np.column_stack([np.zeros((count, 2)), np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    return Trajectory(path.stamps_ns, np.column_stack([x, y, np.zeros(count)]), quats)


def _errors(path: Trajectory, truth: Trajectory | None) -> SpatialErrors | None:
    """None where the truth shares too little of the path."""
    if truth is None:
        return None
    try:
        return compare_in_space(path, truth)
    except SlamsimError:
        return None


def _report(
    source: Path,
    track: CameraTrack,
    found: CameraMap,
    robot: _Robot,
    lidar: PlanarTrajectory | None,
    why: str,
) -> Report:
    errors = _errors(found.trajectory, robot.truth)
    beside = None if lidar is None else _errors(found.trajectory, _in_space(lidar))
    lidar_errors = None if lidar is None else _errors(_in_space(lidar), robot.truth)
    moved_m = np.linalg.norm(np.diff(found.poses[:, :3, 3], axis=0), axis=1)
    stamps_ns, (accepted, withdrawn) = found.trajectory.stamps_ns, found.closures
    numbers: dict[str, object] = {
        "name": recording_name(str(source)),
        "ate_rmse_m": None if errors is None else errors.ate_rmse_m,
        "odometry_drift_percent": None if errors is None else errors.drift_percent,
        "lidar_ate_rmse_m": None if beside is None else beside.ate_rmse_m,
        "lidar_own_ate_rmse_m": None if lidar_errors is None else lidar_errors.ate_rmse_m,
        "sigma_end_m": float(found.sigmas_m[-1]),
        "sigma_max_m": float(found.sigmas_m.max()),
        "path_length_m": float(moved_m.sum()),
        "duration_s": float(stamps_ns[-1] - stamps_ns[0]) * 1e-9,
        "images": len(track.stamps_ns),
        "images_lost": track.lost,
        "keyframes": len(found.poses),
        "guessed_steps": found.guessed,
        "loop_closures": accepted,
        "loop_closures_rejected": withdrawn + track.refused,
        "sources": "" if robot.log is None else robot.log.sources,
        "tags": [_tag(tag) for tag in found.tags],
    }
    told = (*robot.told, *_doubts(track, found))
    numbers["verdict"] = verdict = _verdict(numbers, why)
    numbers["warnings"] = list(told)
    return Report(numbers, warnings=told, weighed=told, verdict=verdict)


def _tag(tag: MappedTag) -> dict[str, object]:
    return {
        "number": tag.number,
        "position_m": tag.T_map_tag[:3, 3].tolist(),
        "quat_xyzw": xyzw_from_matrix(tag.T_map_tag[:3, :3]).tolist(),
        "sigma_m": float(np.sqrt(np.trace(tag.covariance[:3, :3]))),
        "seen": tag.seen,
        "doubted": tag.doubted,
    }


def _doubts(track: CameraTrack, found: CameraMap) -> Iterator[str]:
    if track.lost > MANY_LOST * len(track.stamps_ns):
        yield f"{track.lost} of {len(track.stamps_ns)} images told no motion"
    if found.guessed:
        yield (
            f"nothing tells how the camera moved in {found.guessed} steps between key frames: the "
            "path goes on there as before, or stands"
        )


def _verdict(numbers: dict[str, object], why: str) -> str:
    """What it is, and how much worse than with a lidar."""
    begin = f"Mapped without lidar ({why})" if why else "Mapped without lidar"
    sigma_mm, beside = 1e3 * _number(numbers, "sigma_max_m"), numbers["lidar_ate_rmse_m"]
    ate, own = numbers["ate_rmse_m"], numbers["lidar_own_ate_rmse_m"]
    if isinstance(ate, float) and isinstance(own, float):
        return (
            f"{begin}: {1e3 * ate:.3g} mm off the truth (RMSE), with it {1e3 * own:.3g} mm; the "
            f"two paths are {1e3 * _number(numbers, 'lidar_ate_rmse_m'):.3g} mm apart."
        )
    if isinstance(beside, float):
        return f"{begin}: {1e3 * beside:.3g} mm (RMSE) off the path that the lidar gives."
    known = f"{1e3 * ate:.3g} mm off the truth (RMSE), " if isinstance(ate, float) else ""
    return f"{begin}: {known}sure to {sigma_mm:.3g} mm where it is least sure, by its own account."


def _number(numbers: dict[str, object], key: str) -> float:
    value = numbers[key]
    assert isinstance(value, float)
    return value


def _view(
    source: Path,
    report: Report,
    track: CameraTrack,
    found: CameraMap,
    robot: _Robot,
    lidar: PlanarTrajectory | None,
) -> CameraView:
    """A camera on no robot looks along z, and its paths are seen along y, which points down."""
    plane = [0, 1] if robot.log is not None else [0, 2]
    stamps_ns = track.keyframe_stamps_ns
    truth = robot.truth if robot.log is not None else None
    tags_m = np.array([tag.T_map_tag[:3, 3] for tag in found.tags]).reshape(-1, 3)
    return CameraView(
        recording_name(str(source)),
        report.verdict,
        report.numbers,
        found.trajectory.positions_m[:, plane],
        None if truth is None else _moved_onto(truth.planar(), found.trajectory),
        None if lidar is None else _moved_onto(lidar, found.trajectory),
        tags_m[:, plane],
        found.sigmas_m,
        1e-9 * (stamps_ns - stamps_ns[0]),
        report.warnings,
    )


def _moved_onto(other: PlanarTrajectory, path: Trajectory) -> FloatArray:
    """(n, 2) points of another path of the same robot, as it stood where both begin."""
    mine = path.planar()
    begin = np.array([max(int(other.stamps_ns[0]), int(mine.stamps_ns[0]))])
    T_map_other = compose(mine.at(begin)[0], inverse(other.at(begin)[0]))
    inside = (other.stamps_ns >= begin[0]) & (other.stamps_ns <= mine.stamps_ns[-1])
    return compose(T_map_other, other.poses[inside])[:, :2]
