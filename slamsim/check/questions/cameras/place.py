"""Where depth cameras sit, how long their depths are and when they were taken, by the scans."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.depth_slices import (
    FEWEST_IMAGES,
    NAMES,
    SliceFit,
    fit_slices,
    seen_beside,
)
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.check.questions.cameras.intrinsics import CAMERA_INTRINSICS
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.recording.choice import lidars
from slamsim.recording.repairs.base import Repair

_FLOORS = dict(zip(NAMES, (0.006, 0.006, 2e-3, 3e-3, 3e-3, 2e-3), strict=True))
"""What the fit does not know of: walls that are not upright, edges, quantised depths, beams that
are wide. The largest of twelve healthy drives with images 160 pixels wide, halved."""
_FLOOR_REGISTERED = 0.01
"""Of the scale of depths that were put into the pixels of another camera: of several the nearest
is kept."""

CAMERA_MOUNT = FaultKind("camera_mount", "a camera is mounted otherwise than declared")
CAMERA_TIME_OFFSET = FaultKind("camera_time_offset", "stamps of a camera are late or early")
WANTED = "walls at the height of the lidar before a depth camera, straight driving and turns"
YAW = Question(
    "camera.yaw",
    "a camera looks where it is declared to look",
    (CAMERA_MOUNT,),
    limit=1.0,
    unit="deg",
    consequence="what it sees is put beside the walls of the map",
    excitation_wanted=WANTED,
    repairs=("set_mounting",),
)
PLACE = tuple(
    Question(
        f"camera.{axis}",
        f"a camera sits where it is declared to sit, along {axis}",
        (CAMERA_MOUNT,),
        limit=30.0,
        unit="mm",
        consequence="what it sees is put before or behind the walls of the map",
        excitation_wanted=WANTED,
        repairs=("set_mounting",),
    )
    for axis in "xy"
)
SCALE = Question(
    "camera.depth_scale",
    "depths are as long as the ranges of the lidar",
    (FaultKind("camera_depth_scale", "depths are too long or too short by some per cent"),),
    limit=1.5,
    unit="%",
    consequence="clouds and maps made of them are too large or too small",
    excitation_wanted=WANTED,
    repairs=("scale_depths",),
)
FOCAL = Question(
    "camera.focal",
    "depth images are as wide as their CameraInfo says",
    (CAMERA_INTRINSICS,),
    limit=2.5,
    unit="%",
    consequence="depth clouds are too wide or too narrow",
    excitation_wanted=WANTED,
    repairs=("scale_focal",),
)
OFFSET = Question(
    "camera.time_offset",
    "images are stamped when they were taken, by the clock of scans and gyroscope",
    (CAMERA_TIME_OFFSET,),
    limit=20.0,
    unit="ms",
    consequence="what is seen in turns is put beside its place",
    excitation_wanted=WANTED,
    repairs=("shift_stamps",),
)
_QUESTIONS = (YAW, *PLACE, SCALE, FOCAL, OFFSET)


def check_place(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each topic of depth images; its frame once."""
    depths = [one for one in evidence.recording.cameras if one.kind == "depth"]
    placed = set[str]()
    for depth in depths:
        fit, reason = slice_fit(evidence, depth)
        if fit is None:
            yield from (unanswered(each, depth.topic, reason) for each in _QUESTIONS)
            continue
        if depth.frame_id not in placed:
            placed.add(depth.frame_id)
            yield from _mount(evidence, depth, fit)
        yield from _sizes(evidence, depth, fit)


GROUP = QuestionGroup("camera place", 70, _QUESTIONS, check_place, thorough=True)


def slice_fit(evidence: RecordingEvidence, depth: CameraSurvey) -> tuple[SliceFit | None, str]:
    """The fit of depths to scans, or why there is none."""
    lidar = next(iter(lidars(evidence.recording)), None)
    if lidar is None:
        return None, f"no lidar sees the same walls; what would tell: {WANTED}"
    if depth.claim is None:
        return None, "no CameraInfo says which camera it is"
    frames = evidence.frames
    T_base_camera = frames.between(evidence.base, depth.frame_id)
    T_base_laser = frames.between(evidence.base, lidar.frame_ids[0])
    if T_base_camera is None or T_base_laser is None:
        return None, f"no fixed transforms join {depth.frame_id} and the lidar to {evidence.base}"
    try:
        fit = fit_slices(evidence.recording, depth, lidar, T_base_camera, T_base_laser)
    except BadNumbers as error:
        return None, f"its CameraInfo cannot be right: {error}"
    seen = f"fewer than {FEWEST_IMAGES} images show walls at the height of the lidar"
    return fit, "" if fit is not None else f"{seen}; what would tell: {WANTED}"


def _mount(evidence: RecordingEvidence, depth: CameraSurvey, fit: SliceFit) -> Iterator[Finding]:
    T_base_camera = evidence.frames.between(evidence.base, depth.frame_id)
    assert T_base_camera is not None
    repair = Repair("set_mounting", depth.frame_id, _mounted(evidence.base, T_base_camera, fit))
    yaw = _measured(fit, "yaw_rad", np.degrees(1.0), "deg")
    words = f"it looks {yaw.value:+.2f} deg to the left of where its frame says"
    advice = "Correct the fixed transform to its frame, or the mount."
    yield judge(YAW, depth.frame_id, words, yaw, advice=advice, repairs=[repair])
    for question, axis in zip(PLACE, "xy", strict=True):
        off = _measured(fit, f"{axis}_m", 1e3, "mm")
        words = f"it sits {off.value:+.0f} mm along {axis} of {evidence.base} from where it says"
        yield judge(question, depth.frame_id, words, off, advice=advice, repairs=[repair])


def _mounted(base: str, T_base_camera: FloatArray, fit: SliceFit) -> dict[str, float | str]:
    """The parameters of ``set_mounting``."""
    x_m, y_m, turn_rad = (float(value) for value in fit.values[:3])
    yaw_rad = float(np.arctan2(T_base_camera[1, 0], T_base_camera[0, 0])) + turn_rad
    place = {"x_m": float(T_base_camera[0, 3]) + x_m, "y_m": float(T_base_camera[1, 3]) + y_m}
    return {"parent": base, **place, "yaw_rad": yaw_rad}


def _sizes(evidence: RecordingEvidence, depth: CameraSurvey, fit: SliceFit) -> Iterator[Finding]:
    is_registered = seen_beside(evidence.recording, depth)
    scale = _measured(fit, "scale", -100.0, "%", _FLOOR_REGISTERED if is_registered else 0.0)
    yield judge(
        SCALE,
        depth.topic,
        f"depths are {scale.value:+.1f} % longer than ranges of the lidar to the same walls",
        scale,
        advice="Calibrate the depth camera, or correct the unit of its depths.",
        repairs=[Repair("scale_depths", depth.topic, {"factor": 1.0 - 0.01 * scale.value})],
    )
    focal = _measured(fit, "focal", -100.0, "%")
    yield judge(
        FOCAL,
        depth.topic,
        f"the claimed focal length is {focal.value:+.1f} % longer than walls in scans say",
        focal,
        advice="Calibrate the camera at the size and mode in which it records.",
        repairs=[Repair("scale_focal", depth.topic, {"factor": 1.0 - 0.01 * focal.value})],
    )
    delay = _measured(fit, "delay_s", 1e3, "ms")
    yield judge(
        OFFSET,
        depth.topic,
        f"its stamps are {delay.value:+.1f} ms late against scans of the same walls",
        delay,
        advice="Stamp images when they are exposed, by the clock of the other sensors.",
        repairs=[Repair("shift_stamps", depth.topic, {"offset_s": -1e-3 * delay.value})],
    )


def _measured(
    fit: SliceFit, name: str, factor: float, unit: str, floor: float = 0.0
) -> Measurement:
    place = NAMES.index(name)
    sigma = np.hypot(fit.sigmas[place], max(_FLOORS[name], floor))
    return Measurement(factor * float(fit.values[place]), abs(factor) * float(sigma), unit)
