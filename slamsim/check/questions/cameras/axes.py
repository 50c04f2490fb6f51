"""Are images stamped with an optical frame, whose z axis looks ahead?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, decide
from slamsim.check.question import Question, judge, unanswered
from slamsim.check.questions.cameras.place import R_LEVEL, TURNS, turn_fit_of, turn_size
from slamsim.check.questions.cameras.tilt import CAMERA_MOUNT

_STEEP = np.cos(np.radians(45.0))
"""Of the way a frame looks: with an x axis that is as level as that, its z axis looks up."""


def check_axes(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each topic of colour or grey images whose frame looks up, as the frame of a camera's body
    does: whether images turn as if its x axis looked ahead."""
    for camera in evidence.recording.cameras:
        if camera.kind != "depth":
            yield _asked(evidence, camera)


AXES = Question(
    "camera.axes",
    "images are stamped with an optical frame: z ahead, x to the right",
    (CAMERA_MOUNT,),
    consequence="what it sees is put above the robot or beside it, and floors stand upright",
    excitation_wanted=TURNS.excitation_wanted,
    ask=check_axes,
)


def _asked(evidence: RecordingEvidence, camera: CameraSurvey) -> Finding:
    T_base_camera = evidence.frames.between(evidence.base, camera.frame_id)
    if T_base_camera is None:
        words = f"no fixed transform joins {camera.frame_id} to the robot"
        return unanswered(AXES, camera.topic, words)
    if T_base_camera[2, 2] < _STEEP:
        words = f"{camera.frame_id} does not look up, as the frame of a camera's body does"
        return judge(AXES, camera.topic, words, verdict="ok")
    ahead = T_base_camera.copy()
    ahead[:3, :3] = T_base_camera[:3, :3] @ R_LEVEL
    fit, reason = turn_fit_of(evidence, camera, ahead[:3, :3])
    if fit is None:
        words = f"{camera.frame_id} looks up, as the frame of a camera's body does; {reason}"
        return unanswered(AXES, camera.topic, words)
    turns = turn_size(ahead, fit)
    assert TURNS.limit is not None
    if decide(turns, TURNS.limit) != "ok":
        words = f"images do not turn as if the x axis of {camera.frame_id} looked ahead"
        return unanswered(AXES, camera.topic, words)
    return judge(
        AXES,
        camera.topic,
        f"by its frame {camera.frame_id} the camera looks up, but its images turn as if the x axis "
        "of that frame looked ahead: it is the frame of a body, not an optical one",
        verdict="fault",
        advice="Stamp images with the optical frame of the driver (REP 103), which has z ahead.",
    )
