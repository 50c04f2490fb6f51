"""Is what CameraInfo says a camera that could have taken the images?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, anywhere, judge, unanswered
from slamsim.guard.numbers import BadNumbers
from slamsim.recording.repairs.base import Repair

MOST_OFF_CENTRE = 0.2
"""Of the width or height: lenses sit within some per cent of the middle, rectified images of a
stereo pair within ten. A camera matrix of twice the image is a quarter off."""

CAMERA_INTRINSICS = FaultKind(
    "camera_intrinsics",
    "CameraInfo belongs to no camera with such images",
    (
        anywhere("camera_depth_scale", "camera_mount", "camera_time_offset"),
        anywhere("camera_rolling_shutter"),
    ),
)


def check_intrinsics(evidence: RecordingEvidence) -> Iterator[Finding]:
    """The claim beside each topic of images."""
    for camera in evidence.recording.cameras:
        if camera.claim is None:
            yield unanswered(INTRINSICS, camera.topic, "no CameraInfo says which camera it is")
        else:
            yield _judged(camera)


INTRINSICS = Question(
    "camera.intrinsics",
    "CameraInfo describes a camera that could have taken the images",
    (CAMERA_INTRINSICS,),
    limit=MOST_OFF_CENTRE,
    consequence="points are projected to wrong pixels, and depth clouds are bent or scaled",
    excitation_wanted="a CameraInfo beside the images",
    ask=check_intrinsics,
    repairs=("set_camera_size",),
    limit_of_ok=False,
)


def _judged(camera: CameraSurvey) -> Finding:
    claim = camera.claim
    assert claim is not None
    advice = "Calibrate the camera at the size and mode in which it records."
    try:
        if claim.image_size != camera.size:
            told, seen = ("{} x {}".format(*size) for size in (claim.image_size, camera.size))
            raise BadNumbers(f"it is for images of {told}, these are {seen}")
        model = claim.model()
    except BadNumbers as error:
        words = f"its CameraInfo ({claim.source}) cannot be right: {error}"
        repairs = [Repair("set_camera_size", camera.topic)] if _is_scaled(camera) else []
        return judge(
            INTRINSICS, camera.topic, words, verdict="fault", advice=advice, repairs=repairs
        )
    middle = 0.5 * (np.array(camera.size) - 1.0)
    off = float(np.abs((model.centre_px - middle) / camera.size).max())
    x, y = model.centre_px
    words = f"the principal point is at ({x:.0f}, {y:.0f}), {off:.1%} of the image off its middle"
    return judge(INTRINSICS, camera.topic, words, Measurement(off, 0.0, ""), advice=advice)


def _is_scaled(camera: CameraSurvey) -> bool:
    """Whether CameraInfo is for larger or smaller images of the same shape."""
    assert camera.claim is not None
    (width, height), (claimed_width, claimed_height) = camera.size, camera.claim.image_size
    if not claimed_width or not claimed_height or camera.size == camera.claim.image_size:
        return False
    return round(claimed_height * width / claimed_width) == height
