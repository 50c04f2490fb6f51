"""What ``slamsim calibrate`` looks at: boards and tags in images, and the path of the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.config.slam import SlamConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.io.cameras.base import Cameras, CameraTopic, FolderCameras
from slamsim.io.open import open_recording
from slamsim.io.text.tum import read_tum
from slamsim.perception.calibration.boards import Board
from slamsim.perception.calibration.drive import MOUNT
from slamsim.perception.calibration.mount import MountFit
from slamsim.perception.calibration.rig import Sighting
from slamsim.perception.calibration.sightings import TagViews, gather
from slamsim.perception.recorded import grey_of, light_of, surveyed_tags
from slamsim.perception.tag_families import TagKind
from slamsim.perception.tags import TagDetector, TagSighting
from slamsim.recording import RawScans, Recording
from slamsim.slam.backend.correction import densify
from slamsim.slam.session import map_log, motion_of

MOST_BOARDS = 300
"""Images of a topic in which a board is looked for: a chessboard that is not there takes 0.1 s."""
USUAL_FOV_DEG = 70.0
"""Of a camera of which nothing is claimed, as good as any to find corners of tags with."""
VISIT_GAP_S, VISIT_S = 2.0, 8.0
"""Odometry drifts: a tag that is seen again after so long, or for so long, counts as another."""
VISIT = 1_000_000
WHEEL_SIGMAS = (0.01, 0.01, 0.0, 0.0, 0.0, np.radians(0.5))
"""By how much a mount by odometry may be off however often it is measured (m, rad): tags are some
metres away, and uncalibrated wheels some tenths of a per cent off in size, alike and against each
other. A drive of the simulator with its default encoders: 4 mm, 13 mm, 0.57 degrees."""


def pictures_of(cameras: Cameras, wanted: Sequence[str]) -> list[CameraTopic]:
    """The topics with colour or grey images, one of each imager, or those that are wanted.

    Raises InputRefused where there is none, SlamsimError for one that is not there.
    """
    found = [*cameras.of_kind("colour"), *cameras.of_kind("grey")]
    if not found:
        raise cameras.refused("holds no colour or grey images to calibrate a camera by")
    known = [each.topic for each in found]
    for topic in wanted:
        if topic not in known:
            raise SlamsimError(
                f"{cameras.path}: no images on {topic}; there are {', '.join(known)}"
            )
    return [each for each in found if each.topic in wanted] or cameras.pictures()


def boards_seen(
    cameras: Cameras, topics: Sequence[CameraTopic], board: Board, reporter: Reporter
) -> dict[str, dict[int, Sighting]]:
    """Of each topic by stamp, where its images show the board; ``view`` is not set yet.

    Raises InputRefused where none does.
    """
    found: dict[str, dict[int, Sighting]] = {each.topic: {} for each in topics}
    every = {each.topic: -(-each.messages // MOST_BOARDS) for each in topics}
    total, looked = sum(each.messages for each in topics), 0
    with reporter.stage("board", "images/s") as progress:
        for frame in cameras.encoded(tuple(found)):
            looked += 1
            progress(looked, total)
            if frame.number % every[frame.topic]:
                continue
            seen = board.corners(grey_of(frame.decoded()))
            if seen is not None:
                found[frame.topic][frame.stamp_ns] = Sighting(0, 0, *seen)
    if not any(found.values()):
        looked = sum(-(-each.messages // every[each.topic]) for each in topics)
        raise InputRefused(
            cameras.path,
            f"none of {looked} images shows a board of {board.columns} x {board.rows}; a "
            "chessboard counts its inner corners and must be seen whole",
        )
    return found


def tags_of(
    cameras: Cameras, topics: Sequence[CameraTopic], kind: TagKind, reporter: Reporter
) -> dict[str, tuple[TagViews, CameraModel]]:
    """Of each topic that shows any, the tags and the camera with which they were looked at.

    Raises InputRefused where none does.
    """
    models = {each.topic: camera_of(cameras, each) for each in topics}
    detectors = {topic: TagDetector(kind, model) for topic, model in models.items()}
    stamps_ns: dict[str, list[int]] = {topic: [] for topic in models}
    seen: dict[str, list[TagSighting]] = {topic: [] for topic in models}
    total = sum(each.messages for each in topics)
    with reporter.stage("tags", "images/s") as progress:
        for number, frame in enumerate(cameras.frames(tuple(models)), 1):
            sightings = detectors[frame.topic].detect(grey_of(frame), light_of(frame))
            seen[frame.topic] += sightings
            stamps_ns[frame.topic] += [frame.stamp_ns] * len(sightings)
            progress(number, total)
    if not any(seen.values()):
        raise InputRefused(
            cameras.path, f"none of {total} images shows a tag of {kind.family}, 10 px wide"
        )
    return {
        topic: (
            gather(stamps_ns[topic], [*map(detectors[topic].settled, each)], models[topic]),
            models[topic],
        )
        for topic, each in seen.items()
        if each
    }


def camera_of(cameras: Cameras, topic: CameraTopic) -> CameraModel:
    """The claimed camera; one with a usual lens where nothing is claimed, or no camera."""
    try:
        return cameras.model(topic.topic)
    except (InputRefused, NotFound):
        return pinhole(topic.width, topic.height, USUAL_FOV_DEG)


def path_of(
    source: Cameras, trajectory: Path | None, reporter: Reporter
) -> tuple[PlanarTrajectory, Recording | None, str]:
    """T_map_base, the recording, and by what the path is known: its file, lidar or odometry.

    Raises InputRefused for a source that tells no path.
    """
    opened = None if isinstance(source, FolderCameras) else open_recording(source.path)
    recording = None if opened is None else opened.recording
    if trajectory is not None:
        return read_tum(trajectory).planar(), recording, str(trajectory)
    if opened is not None and recording is not None and recording.of(RawScans):
        with reporter.stage("slam", "scans/s") as progress:
            result, _ = map_log(opened.log(), SlamConfig(), progress)
        motion = motion_of(result.log or opened.log(), result.calibration)
        path = result.trajectory
        return (path if motion is None else densify(path, motion)), recording, "lidar"
    if recording is not None and recording.odometries:
        first = recording.odometries[0]
        stamps_ns, rows = np.unique(first.stamps_ns, return_index=True)
        yaws_rad = yaw_from_xyzw(first.quats_xyzw[rows])
        poses = np.column_stack([first.positions_m[rows, :2], yaws_rad])
        return PlanarTrajectory(stamps_ns, poses), recording, "odometry"
    raise InputRefused(
        source.path,
        "tells no path of the robot: tags are compared with lidar scans, odometry or a path given "
        "by --trajectory; a lens alone is told by --board",
    )


def by_visits(views: TagViews) -> TagViews:
    """Each visit to a tag as a tag of its own, for a path that drifts."""
    numbers = views.numbers.copy()
    for tag in np.unique(views.numbers):
        mine = np.flatnonzero(views.numbers == tag)
        at_s = (views.stamps_ns[mine] - views.stamps_ns[mine[0]]) * 1e-9
        visit, begun_s = 0, at_s[0]
        for k in range(len(mine)):
            if k and (at_s[k] - at_s[k - 1] > VISIT_GAP_S or at_s[k] - begun_s > VISIT_S):
                visit, begun_s = visit + 1, at_s[k]
            numbers[mine[k]] += VISIT * visit
    return replace(views, numbers=numbers)


def unsure_by_wheels(fit: MountFit) -> MountFit:
    """As unsure as wheels that nothing checks make it, see ``WHEEL_SIGMAS``."""
    more = np.zeros(len(fit.estimate.names))
    more[: len(MOUNT)] = np.square(WHEEL_SIGMAS)
    covariance = fit.estimate.covariance + np.diag(more)
    return replace(fit, estimate=replace(fit.estimate, covariance=covariance))


def survey_of(file: Path | None, kind: TagKind) -> Mapping[int, tuple[FloatArray, FloatArray]]:
    """T_survey_tag (4, 4) and standard deviations (6,), m and rad, of the tags in a file.

    Raises InputRefused or NotFound.
    """
    if file is None:
        return {}
    return {
        tag.id: (T, np.array([tag.sigma_m] * 3 + [np.radians(tag.sigma_deg)] * 3))
        for tag, T in surveyed_tags(file, kind)
    }
