"""``slamsim odometry``: the path of a depth camera, from its images alone."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from slamsim.cameras.lens import CameraModel, camera_matrix
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.types import FloatArray, Trajectory
from slamsim.evaluate.spatial import SpatialErrors, compare_in_space
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.base import Cameras, FolderCameras
from slamsim.io.cameras.converting import recorded_beside, true_path
from slamsim.io.text.tum import read_tum, write_tum
from slamsim.perception.recorded import grey_of
from slamsim.perception.rgbd_odometry import RgbdOdometry, RgbdStep
from slamsim.run.folder import TRAJECTORY

STEPS, REPORT = "steps.csv", "report.json"
WITHIN_NS = 20_000_000
"""Depth and colour whose stamps differ by more are of different instants: at 0.5 m/s, 10 mm."""
_HEAD = "time_ns,keyframe,points,status,sigma_m,sigma_rad"


@dataclass(frozen=True, slots=True)
class CameraPath:
    """Figures of a path. errors: None where the truth is not known. lost_frames: images whose
    motion since the key frame could not be told; the path goes on as before there."""

    depth_topic: str
    picture_topic: str
    frames: int
    lost_frames: int
    keyframes: int
    path_m: float
    errors: SpatialErrors | None


@dataclass(frozen=True, slots=True)
class Pairing:
    """Topics of depth and brightness of the same pixels, and the camera of both."""

    depth: str
    picture: str
    model: CameraModel


def camera_odometry(
    source: Path,
    folder: Path,
    reporter: Reporter,
    *,
    truth: Path | None = None,
    depth: str = "",
    intrinsics: str = "",
    overwrite: bool = False,
) -> CameraPath:
    """Write the path of a depth camera into a folder; figures of it.

    source: a recording, or a folder of images. truth: TUM file of the camera's optical frame; a
    recording that holds the truth tells it itself. depth: as for ``registered``. intrinsics: as
    for ``camera_matrix``, in the place of what the images come with. The folder gets
    ``trajectory.tum`` (T_first_camera of the optical frame), ``steps.csv`` and ``report.json``.
    Raises SlamsimError where no depth is registered to a picture, else as ``open_cameras``.
    """
    K = camera_matrix(intrinsics) if intrinsics else None
    with open_cameras(source) as cameras, partial_folder(folder, overwrite) as partial:
        pairing = registered(cameras, depth, K)
        with reporter.stage("odometry") as progress:
            total = cameras.topics[pairing.depth].messages
            steps = []
            for number, step in enumerate(_steps(cameras, pairing), 1):
                steps.append(step)
                progress(number, total)
        if len(steps) < 2:
            reason = f"{len(steps)} images of {pairing.depth} have a picture of the same instant"
            raise SlamsimError(f"{source}: {reason}; two are needed")
        path = _trajectory(steps)
        frame = cameras.topics[pairing.depth].frame_id
        true = read_tum(truth) if truth is not None else true_path(recorded_beside(source), frame)
        errors = None if true is None else compare_in_space(path, true)
        figures = _counted(pairing, steps, path, errors)
        write_tum(partial / TRAJECTORY, path)
        write_atomic(partial / STEPS, "\n".join([_HEAD, *map(_row, steps), ""]).encode())
        write_atomic(partial / REPORT, json.dumps(asdict(figures), indent=2).encode())
    return figures


def registered(cameras: Cameras, depth: str = "", K: FloatArray | None = None) -> Pairing:
    """Depth whose pixels are those of a colour or grey image, as in folders they always are.

    depth: topic, or empty for the one with the most images. K: (3, 3) in the place of what the
    recording claims. Raises SlamsimError or NotFound, InputRefused for a wrong camera, BadNumbers.
    """
    topics = cameras.of_kind("depth")
    if depth:
        known = ", ".join(one.topic for one in topics) or "none"
        topics = [one for one in topics if one.topic == depth]
        if not topics:
            raise SlamsimError(f"{cameras.path}: no depth on {depth}; there is {known}")
    for one in topics:
        for other in cameras.pictures():
            same_frame = one.frame_id == other.frame_id or isinstance(cameras, FolderCameras)
            if same_frame and (one.width, one.height) == (other.width, other.height):
                claimed = one.topic if one.topic in cameras.infos else other.topic
                given = None if K is None else CameraModel(one.width, one.height, K)
                return Pairing(one.topic, other.topic, given or cameras.model(claimed))
    raise cameras.refused(
        "no depth is registered to colour or grey images (the same frame and size); "
        "depth_image_proc or aligned_depth of the driver makes such images"
    )


def _steps(cameras: Cameras, pairing: Pairing) -> Iterator[RgbdStep]:
    odometry = RgbdOdometry(pairing.model)
    for near, seen in cameras.pairs(pairing.depth, pairing.picture, WITHIN_NS):
        yield odometry.step(seen.stamp_ns, grey_of(seen), near.pixels)


def _trajectory(steps: Sequence[RgbdStep]) -> Trajectory:
    return Trajectory(
        np.array([step.stamp_ns for step in steps], dtype=np.int64),
        np.array([step.T_odom_camera[:3, 3] for step in steps]),
        np.array([xyzw_from_matrix(step.T_odom_camera[:3, :3]) for step in steps]),
    )


def _counted(
    pairing: Pairing, steps: Sequence[RgbdStep], path: Trajectory, errors: SpatialErrors | None
) -> CameraPath:
    moved_m = np.linalg.norm(np.diff(path.positions_m, axis=0), axis=1)
    return CameraPath(
        depth_topic=pairing.depth,
        picture_topic=pairing.picture,
        frames=len(steps),
        lost_frames=sum(step.status == "lost" for step in steps),
        keyframes=sum(step.starts for step in steps),
        path_m=float(moved_m.sum()),
        errors=errors,
    )


def _row(step: RgbdStep) -> str:
    if step.covariance is None:
        sigmas = "nan,nan"
    else:
        variances = np.diag(step.covariance)
        shift, turn = np.sqrt(variances[:3].sum()), np.sqrt(variances[3:].sum())
        sigmas = f"{shift:.6f},{turn:.6f}"
    return f"{step.stamp_ns},{step.keyframe},{step.points},{step.status},{sigmas}"
