"""Tags in the images of a recording, as SLAM takes them."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.frames import CameraFrame
from slamsim.cameras.lens import CameraModel
from slamsim.config.loading import load_model
from slamsim.config.slam import LandmarksConfig, SurveyedTag, SurveyedTags
from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.landmarks import AS_CLAIMED, CameraErrors, KnownTag, TagObservation, TagsSeen
from slamsim.core.progress import Progress, silent
from slamsim.core.types import Float32Array, FloatArray
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.guard.numbers import UNIT_WITHIN
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.perception.calibrated import (
    NO_CALIBRATION,
    NOT_CALIBRATED,
    CalibratedCamera,
    CalibratedCameras,
    CameraClock,
)
from slamsim.perception.planar import planar_observation, planar_tag
from slamsim.perception.tag_families import TagKind, parse_tags
from slamsim.perception.tags import TagDetector, TagSighting, linear_light
from slamsim.recording import Recording
from slamsim.recording.frames import base_frame_of, known_mounting, tree_of

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class UsedCamera:
    """model, T_base_camera (4, 4) and clock: as calibrated, else as the recording claims; errors:
    how sure they are."""

    model: CameraModel
    T_base_camera: FloatArray
    clock: CameraClock
    errors: CameraErrors = AS_CLAIMED


def tags_seen(
    path: Path,
    recording: Recording,
    config: LandmarksConfig,
    progress: Progress = silent,
    calibrated: CalibratedCameras = NO_CALIBRATION,
) -> TagsSeen:
    """The tags that a configuration asks for, in all images of the recording at path.

    Each has the instant at which the rows that show it were exposed. Cameras without camera info
    or place on the robot are left out. Raises UnknownTags for a family that is none, NotFound
    where no images have camera info, InputRefused for images that cannot be read, where no
    camera's place is known, and for a recording without images.
    """
    kind = parse_tags(config.tags)
    known = known_tags(config)
    with open_cameras(path) as cameras:
        usable = _usable(path, cameras, recording, calibrated)
        total = sum(cameras.topics[topic].messages for topic in usable)
        seen: list[tuple[str, int, TagSighting]] = []
        detectors = {topic: TagDetector(kind, each.model) for topic, each in usable.items()}
        for number, frame in enumerate(cameras.frames(tuple(usable))):
            sightings = detectors[frame.topic].detect(grey_of(frame), light_of(frame))
            seen += [(frame.topic, frame.stamp_ns, each) for each in sightings]
            progress(number + 1, total)
    found = [
        _observed(detectors[topic].settled(each), stamp_ns, topic, usable[topic])
        for topic, stamp_ns, each in seen
    ]
    errors = {topic: each.errors for topic, each in usable.items()}
    return TagsSeen(tuple(found), known, errors, family=kind.family)


def known_tags(config: LandmarksConfig) -> tuple[KnownTag, ...]:
    """Those of the survey that a configuration names. Raises InputRefused or NotFound."""
    if not config.surveyed:
        return ()
    found = []
    for tag, T_map_tag in surveyed_tags(Path(config.surveyed), parse_tags(config.tags)):
        sigmas = np.array([tag.sigma_m, tag.sigma_m, np.radians(tag.sigma_deg)])
        found.append(KnownTag(tag.id, planar_tag(T_map_tag), np.diag(np.square(sigmas))))
    return tuple(found)


def surveyed_tags(file: Path, kind: TagKind) -> list[tuple[SurveyedTag, FloatArray]]:
    """The tags of this kind in a survey, each with T_survey_tag (4, 4).

    Raises NotFound, and InputRefused for a quaternion that is no rotation or a tag that is there
    twice.
    """
    found: dict[int, tuple[SurveyedTag, FloatArray]] = {}
    for tag in load_model(SurveyedTags, file).tags:
        if tag.family not in ("", kind.family) or tag.size_m not in (None, kind.size_m):
            continue
        norm = float(np.linalg.norm(tag.quat_xyzw))
        if abs(norm - 1.0) > UNIT_WITHIN:
            reason = f"the quaternion of tag {tag.id} has the length {norm:.3g}, not 1"
            raise InputRefused(file, reason, "tags")
        if tag.id in found:
            raise InputRefused(file, f"tag {tag.id} is there twice", "tags")
        R_survey_tag = matrix_from_xyzw(np.array(tag.quat_xyzw) / norm)
        found[tag.id] = tag, se3_from_parts(R_survey_tag, np.array(tag.position_m))
    return list(found.values())


def grey_of(frame: CameraFrame) -> NDArray[np.uint8]:
    """(h, w) brightness of a colour or grey image."""
    if frame.kind == "colour":
        return grey_of_colour(frame.pixels)
    return np.asarray(frame.pixels, dtype=np.uint8)


def grey_of_colour(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) of (h, w, 3) RGB."""
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def light_of(frame: CameraFrame) -> Float32Array | None:
    """(h, w) linear light of a colour image, as detectors take it; none of a grey one."""
    return linear_light(frame.pixels) if frame.kind == "colour" else None


def _observed(
    sighting: TagSighting, stamp_ns: int, topic: str, camera: UsedCamera
) -> TagObservation:
    share = float(sighting.corners_px[:, 1].mean()) / max(camera.model.height - 1, 1)
    exposed_ns = camera.clock.at_row(stamp_ns, share)
    one = planar_observation(exposed_ns, sighting, camera.T_base_camera)
    return replace(one, camera=topic, row=share)


def _usable(
    path: Path, cameras: Cameras, recording: Recording, calibrated: CalibratedCameras
) -> dict[str, UsedCamera]:
    """Each topic with pictures; without a lens or a place a topic is left out, and that is told.
    Raises what the first one lacks where none is left."""
    pictures = cameras.pictures()
    if not pictures:
        raise cameras.refused("holds no colour or grey images in which tags could be seen")
    found: dict[str, UsedCamera] = {}
    lacking: list[SlamsimError] = []
    for each in pictures:
        try:
            known = calibrated.of(each.topic, each.frame_id)
            mount = mount_of(path, each.topic, each.frame_id, recording, known)
            x_m, y_m = mount[:2, 3].tolist()
            errors = replace(known.errors, middle_m=(x_m, y_m))
            lens = _lens_of(cameras, each, known)
            found[each.topic] = UsedCamera(lens, mount, known.clock, errors)
        except (InputRefused, NotFound) as error:
            lacking.append(error)
    if not found:
        raise lacking[0]
    for reason in lacking:
        _log.warning("a camera is left out: %s", reason)
    return found


def _lens_of(cameras: Cameras, topic: CameraTopic, calibrated: CalibratedCamera) -> CameraModel:
    """As calibrated or as claimed. Raises InputRefused where images of another size were
    calibrated, and as ``Cameras.model``."""
    model = calibrated.model
    if model is None:
        return cameras.model(topic.topic)
    if (model.width, model.height) != (topic.width, topic.height):
        size = f"images of {topic.width} x {topic.height}"
        reason = f"has {size}; calibrated were {model.width} x {model.height}"
        raise InputRefused(cameras.path, reason, f"topic {topic.topic}")
    return model


def mount_of(
    path: Path,
    topic: str,
    frame: str,
    recording: Recording,
    calibrated: CalibratedCamera = NOT_CALIBRATED,
) -> FloatArray:
    """T_base_camera (4, 4) of the optical frame of a topic, as calibrated or as claimed. Raises
    InputRefused where no fixed transform leads to it, or to the base that was calibrated."""
    base, tree = base_frame_of(recording), tree_of(recording.transforms)
    T_base_camera, wanted = calibrated.T_base_camera, frame
    if T_base_camera is not None:
        wanted = calibrated.base_frame
        if wanted == base:
            return T_base_camera
    mounting = known_mounting(tree, base, wanted)
    if mounting is None:
        reason = f"no fixed transform leads from {base!r} to its frame {wanted!r}"
        raise InputRefused(path, reason, f"topic {topic}")
    return mounting[0] if T_base_camera is None else np.asarray(mounting[0] @ T_base_camera)
