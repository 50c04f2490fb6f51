"""Where cameras sit, how long depths are and when images were taken, by scans and gyroscope."""

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
)
from slamsim.check.motion.image_leans import seen_leans
from slamsim.check.motion.image_turns import (
    FEWEST_PAIRS,
    LEAST_TURNED_RAD,
    TurnFit,
    fit_turns,
    seen_turns,
)
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    anywhere,
    judge,
    unanswered,
)
from slamsim.check.questions.cameras.intrinsics import CAMERA_INTRINSICS
from slamsim.check.questions.cameras.tilt import CAMERA_MOUNT, as_tilted, seen_beside
from slamsim.check.wording import SIDES, signed_words
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.recording.choice import lidars
from slamsim.recording.repairs.base import Repair

_FLOORS = dict(zip(NAMES, (0.006, 0.006, 2e-3, 3e-3, 3e-3, 2e-3), strict=True))
"""Standard deviations of what the fit does not know of: walls that are not upright, edges,
quantised depths. More than the errors of healthy drives with images 160 pixels wide (3 mm, 0.1
deg, 0.3 %, 1.5 ms)."""
_USUALLY_MIXED = dict(zip(NAMES, (4.0, 2.5, 2.2, 6.5, 2.5, 1.3), strict=True))
"""By how much place and sizes are mixed up in drives with turns: medians of 26 of these. In a
corridor that is driven straight along, scale and focal length are by 15 and 12, and what the fit
does not know of moves them by as much more (5.8 and 5.7 %)."""
_REGISTERED = {"x_m": 1.0, "y_m": 1.0, "scale": 0.6, "focal": 0.5}
"""The same, times the angle of a pixel, of depths that were put into the pixels of another camera:
what the fit leaves of that the nearest is kept where several meet. Root mean squares of fifteen
healthy drives with images 160 pixels wide (an angle of 0.0086): 8 mm, 0.4 %, 0.4 %; of one with
424 pixels 3 mm, 0.1 %, 0.1 %. Of 0.006 and less, some 240 pixels, the scale of a healthy camera
lies within its limit."""

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
CAMERA_FLIPPED = FaultKind(
    "camera_flipped",
    "images of a camera are upside down or mirrored",
    (
        anywhere("camera_depth_scale", "camera_mount", "camera_time_offset"),
        anywhere("camera_intrinsics", "camera_rolling_shutter"),
    ),
)
TURNS = Question(
    "camera.turns",
    "images turn as fast as the robot, by the focal length of their CameraInfo",
    (CAMERA_INTRINSICS, CAMERA_FLIPPED),
    limit=15.0,
    unit="%",
    consequence="points are projected to wrong pixels, and visual odometry turns too far",
    excitation_wanted="turns, and texture some metres away",
)
_QUESTIONS = (YAW, *PLACE, SCALE, FOCAL, OFFSET)
_LIMIT_BY_TURNS_MS = 30.0
_PARALLAX_S = 8e-3
"""Where one side is nearer than the other what is driven looks like a turn, and a robot drives as
it begins and ends to turn: 4 to 12 ms in healthy drives."""
USUAL_DISTANCE_M, _GAIN_FLOOR = 1.5, 0.02
R_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Of an optical frame that looks ahead, in the axes of what carries it."""


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
        yield from _sizes(depth, fit)


def check_turns(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each topic of colour or grey images, against the gyroscope, or else the wheels."""
    for camera in evidence.recording.cameras:
        if camera.kind != "depth":
            fit, reason = turn_fit(evidence, camera)
            if fit is None:
                yield from (unanswered(each, camera.topic, reason) for each in (TURNS, OFFSET))
            else:
                yield from _turns(evidence, camera, fit)


def check_cameras(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Depth cameras by scans, which tell more exactly, after the others by turns: of two repairs of
    one clock the last is made."""
    yield from check_turns(evidence)
    yield from check_place(evidence)


GROUP = QuestionGroup("camera place", 70, (*_QUESTIONS, TURNS), check_cameras)


def turn_fit(evidence: RecordingEvidence, camera: CameraSurvey) -> tuple[TurnFit | None, str]:
    """The fit of turns as images show them to those of gyroscope or wheels, or why there is
    none."""
    return evidence.once(f"turns of {camera.topic}", lambda: _turn_fit(evidence, camera))


def _turn_fit(evidence: RecordingEvidence, camera: CameraSurvey) -> tuple[TurnFit | None, str]:
    T_base_camera = evidence.frames.between(evidence.base, camera.frame_id)
    R = R_LEVEL if T_base_camera is None else T_base_camera[:3, :3]
    return turn_fit_of(evidence, camera, R)


def turn_fit_of(
    evidence: RecordingEvidence, camera: CameraSurvey, R: FloatArray
) -> tuple[TurnFit | None, str]:
    """As ``turn_fit``, of a camera that looks another way; R: (3, 3) from its axes to the base."""
    inputs = evidence.inputs
    other = inputs.gyro or inputs.wheels
    if other is None:
        return None, "neither gyroscope nor odometry tells how the robot turned"
    if camera.claim is None:
        return None, "no CameraInfo says which camera it is"
    if camera.claim.image_size != camera.size:
        return None, "its CameraInfo is for images of another size"
    try:
        model = camera.claim.model()
        fit = fit_turns(seen_turns(camera, model, R), seen_leans(camera, model, R), other)
    except BadNumbers as error:
        return None, f"its CameraInfo cannot be right: {error}"
    few = f"fewer than {FEWEST_PAIRS} pairs of successive images show features"
    least = f"less than {LEAST_TURNED_RAD:g} rad altogether"
    seen = f"{few}, or they or {other.topic} show turns of {least}"
    return fit, "" if fit is not None else f"{seen}; what would tell: turns and texture"


def _turns(evidence: RecordingEvidence, camera: CameraSurvey, fit: TurnFit) -> Iterator[Finding]:
    size = turn_size(evidence.frames.between(evidence.base, camera.frame_id), fit)
    # No focal length turns images against the robot.
    if size.value + 1.96 * size.sigma < -100.0:
        yield judge(
            TURNS,
            camera.topic,
            "images turn against the robot: they are upside down or mirrored, or the camera is "
            "mounted upside down",
            size,
            verdict="fault",
            fault=CAMERA_FLIPPED,
            advice="Turn or flip the images in the driver, or turn the fixed transform to the "
            "camera's frame.",
        )
        yield unanswered(OFFSET, camera.topic, "its images turn against the robot")
        return
    delay_s, sigma_s = fit.delay_s
    delay = Measurement(1e3 * delay_s, 1e3 * float(np.hypot(sigma_s, _PARALLAX_S)), "ms")
    yield judge(
        OFFSET,
        camera.topic,
        f"its stamps are {signed_words(delay.value, 'ms', 'late', 'early', 0)}, by turns in "
        f"{fit.pairs} pairs of images",
        delay,
        limit=_LIMIT_BY_TURNS_MS,
        advice="Stamp images when they are exposed, by the clock of the other sensors.",
        repairs=[Repair("shift_stamps", camera.topic, {"offset_s": -delay_s})],
    )
    yield judge(
        TURNS,
        camera.topic,
        f"images turn {signed_words(size.value, '%', 'farther', 'less far', 0)} than the robot",
        size,
        advice="Calibrate the camera at the size and mode in which it records.",
    )


def turn_size(T_base_camera: FloatArray | None, fit: TurnFit) -> Measurement:
    """By how much farther images turn than the robot, %; T_base_camera: (4, 4)."""
    lever_m = 0.1 if T_base_camera is None else float(np.hypot(*T_base_camera[:2, 3]))
    by_lever = 0.5 * lever_m / USUAL_DISTANCE_M
    # A camera before the axle moves sideways in turns: what is near seems to turn faster; behind
    # it, slower.
    gain = fit.gain[0] - before_the_axle_m(T_base_camera) / USUAL_DISTANCE_M
    sigma = float(np.linalg.norm([fit.gain[1], by_lever, _GAIN_FLOOR]))
    return Measurement(100.0 * gain, 100.0 * sigma, "%")


def before_the_axle_m(T_base_camera: FloatArray | None) -> float:
    """How far a camera sits from the base to where it looks; T_base_camera: (4, 4)."""
    if T_base_camera is None:
        return 0.0
    ahead, place_m = T_base_camera[:2, 2], T_base_camera[:2, 3]
    return float(ahead @ place_m) / max(float(np.hypot(*ahead)), 1e-9)


def slice_fit(evidence: RecordingEvidence, depth: CameraSurvey) -> tuple[SliceFit | None, str]:
    """The fit of depths to scans, or why there is none."""
    lidar = next(iter(lidars(evidence.recording)), None)
    if lidar is None:
        return None, f"no lidar sees the same walls; what would tell: {WANTED}"
    if depth.claim is None:
        return None, "no CameraInfo says which camera it is"
    if depth.claim.image_size != depth.size:
        return None, "its CameraInfo is for images of another size"
    T_base_camera = as_tilted(evidence, depth)
    T_base_laser = evidence.frames.between(evidence.base, lidar.frame_ids[0])
    if T_base_camera is None or T_base_laser is None:
        return None, f"no fixed transforms join {depth.frame_id} and the lidar to {evidence.base}"
    try:
        is_registered = seen_beside(evidence.recording, depth)
        places = T_base_camera, T_base_laser
        fit = fit_slices(evidence.recording, depth, lidar, *places, is_registered)
    except BadNumbers as error:
        return None, f"its CameraInfo cannot be right: {error}"
    seen = f"fewer than {FEWEST_IMAGES} images show the walls of the scans"
    return fit, "" if fit is not None else f"{seen}; what would tell: {WANTED}"


def _mount(evidence: RecordingEvidence, depth: CameraSurvey, fit: SliceFit) -> Iterator[Finding]:
    T_base_camera = evidence.frames.between(evidence.base, depth.frame_id)
    assert T_base_camera is not None
    repair = Repair("set_mounting", depth.frame_id, _mounted(evidence.base, T_base_camera, fit))
    yaw = _measured(fit, "yaw_rad", np.degrees(1.0), "deg")
    to_side = signed_words(yaw.value, "deg", "to the left", "to the right", 2)
    words = f"it looks {to_side} of where its frame says"
    advice = "Correct the fixed transform to its frame, or the mount."
    yield judge(YAW, depth.frame_id, words, yaw, advice=advice, repairs=[repair])
    for question, axis in zip(PLACE, "xy", strict=True):
        off = _measured(fit, f"{axis}_m", 1e3, "mm")
        words = f"it sits {signed_words(off.value, 'mm', *SIDES[axis], 0)} of where its frame says"
        yield judge(question, depth.frame_id, words, off, advice=advice, repairs=[repair])


def _mounted(base: str, T_base_camera: FloatArray, fit: SliceFit) -> dict[str, float | str]:
    """The parameters of ``set_mounting``."""
    x_m, y_m, turn_rad = (float(value) for value in fit.values[:3])
    yaw_rad = float(np.arctan2(T_base_camera[1, 0], T_base_camera[0, 0])) + turn_rad
    place = {"x_m": float(T_base_camera[0, 3]) + x_m, "y_m": float(T_base_camera[1, 3]) + y_m}
    return {"parent": base, **place, "yaw_rad": yaw_rad}


def _sizes(depth: CameraSurvey, fit: SliceFit) -> Iterator[Finding]:
    scale = _measured(fit, "scale", -100.0, "%")
    yield judge(
        SCALE,
        depth.topic,
        f"its depths are {signed_words(scale.value, '%', 'too long', 'too short', 1)}, by the "
        "scans of the same walls",
        scale,
        advice="Calibrate the depth camera, or correct the unit of its depths.",
        repairs=[Repair("scale_depths", depth.topic, {"factor": 1.0 - 0.01 * scale.value})],
    )
    focal = _measured(fit, "focal", -100.0, "%")
    off = signed_words(focal.value, "%", "too long", "too short", 1)
    yield judge(
        FOCAL,
        depth.topic,
        f"the claimed focal length is {off}, by the scans of the same walls",
        focal,
        advice="Calibrate the camera at the size and mode in which it records.",
        repairs=[Repair("scale_focal", depth.topic, {"factor": 1.0 - 0.01 * focal.value})],
    )
    delay = _measured(fit, "delay_s", 1e3, "ms")
    yield judge(
        OFFSET,
        depth.topic,
        f"its stamps are {signed_words(delay.value, 'ms', 'late', 'early', 1)}, by the scans of "
        "the same walls",
        delay,
        advice="Stamp images when they are exposed, by the clock of the other sensors.",
        repairs=[Repair("shift_stamps", depth.topic, {"offset_s": -1e-3 * delay.value})],
    )


def _measured(fit: SliceFit, name: str, factor: float, unit: str) -> Measurement:
    place = NAMES.index(name)
    by_pixels = fit.pixel_rad * _REGISTERED.get(name, 0.0)
    mixed = max(float(fit.mixed[place]) / _USUALLY_MIXED[name], 1.0)
    sigma = np.hypot(fit.sigmas[place], mixed * np.hypot(_FLOORS[name], by_pixels))
    return Measurement(factor * float(fit.values[place]), abs(factor) * float(sigma), unit)
