"""How depth cameras are tilted, and how high they sit, by the floor that they see."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.depth_floor import FloorFit, fit_floor
from slamsim.check.motion.depth_slices import FEWEST_IMAGES
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.recording import Recording
from slamsim.recording.frames import FOOTPRINT, footprint_height_m, tree_of
from slamsim.recording.repairs.base import Repair

CAMERA_MOUNT = FaultKind("camera_mount", "a camera is mounted otherwise than declared")
WANTED = "a depth camera that sees the floor"
_LIMIT_DEG = 1.0
_FLOOR_DEG, _FLOOR_MM = 0.25, 6.0
"""Standard deviations of what the fit does not know of: a robot that rocks, floors that are not
level, depths that are bent. ``mapping.layers`` takes floors for as level. Depths that were put into
the pixels of another camera show the floor a pixel too high: of several that meet in one the
nearest is kept (0.8 to 1 pixel in four healthy drives)."""
_TILTS = (
    Question(
        "camera.pitch",
        "a camera looks as far up or down as it is declared to",
        (CAMERA_MOUNT,),
        limit=_LIMIT_DEG,
        unit="deg",
        consequence="a floor becomes an obstacle, or what lies on it is lost",
        excitation_wanted=WANTED,
        repairs=("turn_frame",),
    ),
    Question(
        "camera.roll",
        "a camera is as level as it is declared to be",
        (CAMERA_MOUNT,),
        limit=_LIMIT_DEG,
        unit="deg",
        consequence="on one side a floor becomes an obstacle, on the other it is lost",
        excitation_wanted=WANTED,
        repairs=("turn_frame",),
    ),
)
HEIGHT = Question(
    "camera.z",
    "a camera sits as high above the floor as it is declared to",
    (CAMERA_MOUNT,),
    limit=30.0,
    unit="mm",
    consequence="a floor becomes an obstacle, or what lies on it is lost",
    excitation_wanted=f"{WANTED}, and a transform to {FOOTPRINT}",
    repairs=("set_height",),
)


def check_tilt(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each frame of depth images."""
    depths = {one.frame_id: one for one in evidence.recording.cameras if one.kind == "depth"}
    for depth in depths.values():
        T_base_camera = evidence.frames.between(evidence.base, depth.frame_id)
        fit, reason = floor_fit(evidence, depth)
        if fit is None or T_base_camera is None:
            yield from (unanswered(each, depth.frame_id, reason) for each in (*_TILTS, HEIGHT))
            continue
        floor_deg = _FLOOR_DEG
        if seen_beside(evidence.recording, depth):
            assert depth.claim is not None
            pixel_rad = 1.0 / float(depth.claim.model().focal_px[1])
            floor_deg = float(np.hypot(floor_deg, np.degrees(pixel_rad)))
        yield from _tilts(depth.frame_id, fit, T_base_camera[:3, :3], floor_deg)
        yield _height(evidence, depth.frame_id, fit, float(T_base_camera[2, 3]))


GROUP = QuestionGroup("camera tilt", 71, (*_TILTS, HEIGHT), check_tilt)


def as_tilted(evidence: RecordingEvidence, depth: CameraSurvey) -> FloatArray | None:
    """T_base_camera (4, 4) as claimed, but for a tilt that is a fault: what else is asked of its
    place is asked of where it truly looks."""
    T_base_camera = evidence.frames.between(evidence.base, depth.frame_id)
    fit, _ = floor_fit(evidence, depth)
    if T_base_camera is None or fit is None or np.degrees(np.abs(fit.tilt_rad).max()) < _LIMIT_DEG:
        return T_base_camera
    tilted = T_base_camera.copy()
    tilted[:3, :3] = T_base_camera[:3, :3] @ _shortest_turn(fit.up, T_base_camera[2, :3])
    return tilted


def floor_fit(evidence: RecordingEvidence, depth: CameraSurvey) -> tuple[FloorFit | None, str]:
    """The floor as a depth camera sees it, or why it is not known."""
    return evidence.once(f"floor of {depth.topic}", lambda: _floor_fit(evidence, depth))


def _floor_fit(evidence: RecordingEvidence, depth: CameraSurvey) -> tuple[FloorFit | None, str]:
    T_base_camera = evidence.frames.between(evidence.base, depth.frame_id)
    if depth.claim is None:
        return None, "no CameraInfo says which camera it is"
    if T_base_camera is None:
        return None, f"no fixed transform joins {depth.frame_id} to the robot"
    try:
        fit = fit_floor(depth, T_base_camera[:3, :3])
    except BadNumbers as error:
        return None, f"its CameraInfo cannot be right: {error}"
    return fit, f"fewer than {FEWEST_IMAGES} images show a floor; what would tell: {WANTED}"


def _tilts(
    frame: str, fit: FloorFit, R_base_camera: FloatArray, floor_deg: float
) -> Iterator[Finding]:
    turn = Repair("turn_frame", frame, _parameters(_shortest_turn(fit.up, R_base_camera[2])))
    words = (
        "it looks {:.2f} deg further {} than its frame says",
        "it leans {:.2f} deg further to the {} than its frame says",
    )
    sides = (("down", "up"), ("left", "right"))
    told = zip(_TILTS, words, sides, np.degrees(fit.tilt_rad), fit.sigmas[:2], strict=True)
    for question, text, (below, above), tilt_deg, sigma_rad in told:
        sigma_deg = float(np.hypot(np.degrees(sigma_rad), floor_deg))
        yield judge(
            question,
            frame,
            text.format(abs(tilt_deg), above if tilt_deg > 0.0 else below)
            + f", by the floor in {fit.images} images",
            Measurement(float(tilt_deg), sigma_deg, "deg"),
            advice="Correct the fixed transform to its frame, or the mount.",
            repairs=[turn],
        )


def _shortest_turn(one: FloatArray, other: FloatArray) -> FloatArray:
    """(3, 3) from one direction (3,) to another (Rodrigues)."""
    x, y, z = np.cross(one, other)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + across + across @ across / (1.0 + float(one @ other)))


def _parameters(R: FloatArray) -> dict[str, float | str]:
    """Of ``turn_frame``, for a turn (3, 3) about the frame's own axes."""
    return {
        "roll_rad": float(np.arctan2(R[2, 1], R[2, 2])),
        "pitch_rad": float(np.arcsin(-R[2, 0])),
        "yaw_rad": float(np.arctan2(R[1, 0], R[0, 0])),
    }


def _height(evidence: RecordingEvidence, frame: str, fit: FloorFit, claimed_m: float) -> Finding:
    floor_m = footprint_height_m(tree_of(evidence.recording.transforms), evidence.base)
    if floor_m is None:
        return unanswered(HEIGHT, frame, f"no transform to {FOOTPRINT} says where the floor is")
    off_mm = 1e3 * (fit.height_m - (claimed_m - floor_m))
    side = "higher" if off_mm > 0.0 else "lower"
    return judge(
        HEIGHT,
        frame,
        f"it sits {abs(off_mm):.0f} mm {side} above the floor than its frame says",
        Measurement(off_mm, float(np.hypot(1e3 * fit.sigmas[2], _FLOOR_MM)), "mm"),
        advice="Correct the fixed transform to its frame, or the mount.",
        repairs=[
            Repair("set_height", frame, {"parent": evidence.base, "z_m": fit.height_m + floor_m})
        ],
    )


def seen_beside(recording: Recording, depth: CameraSurvey) -> bool:
    """Whether depths lie in the pixels of an image."""
    mine = depth.frame_id, depth.size
    images = (one for one in recording.cameras if one.kind != "depth")
    return any((one.frame_id, one.size) == mine for one in images)
