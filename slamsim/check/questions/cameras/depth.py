"""Are depths in the unit of their encoding, and of the instant of the image they lie on?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, anywhere, judge, same_subject, unanswered
from slamsim.recording.repairs.base import Repair

NEAREST_M, FARTHEST_M = 0.07, 100.0
"""No depth camera sees nearer (RealSense D405) or farther."""
MAX_APART_S = 0.02
"""At 1 rad/s an image moves by a dozen pixels meanwhile."""


def check_unit(evidence: RecordingEvidence) -> Iterator[Finding]:
    """How far what depth images show is, as their encoding means it."""
    for camera in evidence.recording.cameras:
        if camera.kind == "depth":
            yield _unit(camera)


UNIT = Question(
    "camera.depth_unit",
    "depth images are in the unit of their encoding: 16UC1 millimetres, 32FC1 metres",
    (
        FaultKind(
            "camera_depth_unit",
            "depths are a thousand times too small or too large",
            # Rounded to whole metres, images are often the one before again.
            (same_subject("camera_frozen", "camera_duplicated"),),
        ),
    ),
    consequence="obstacles are at the lens, or beyond the horizon",
    excitation_wanted="images with depths",
    ask=check_unit,
    repairs=("scale_depths",),
)


def _unit(camera: CameraSurvey) -> Finding:
    known = camera.depths_m[np.isfinite(camera.depths_m).all(axis=1)]
    if not len(known):
        return unanswered(UNIT, camera.topic, "hardly any pixel of it has a depth")
    low_m, middle_m, high_m = np.median(known, axis=0)
    words = f"depths reach from {low_m:.3g} to {high_m:.3g} m, half of them to {middle_m:.3g} m"
    if high_m < NEAREST_M:
        advice = "Publish millimetres in 16UC1, or metres as 32FC1 (REP 118): these are metres."
        verdict, words = "fault", f"{words}, nearer than any depth camera sees"
    elif low_m > FARTHEST_M:
        advice = (
            "Publish metres in 32FC1, or millimetres as 16UC1 (REP 118): these are millimetres."
        )
        verdict, words = "fault", f"{words}, farther than any depth camera sees"
    else:
        advice, verdict = "", "ok"
    # Metres that were rounded to integers cannot be told apart again.
    is_far = camera.is_metric and low_m > FARTHEST_M
    repairs = [Repair("scale_depths", camera.topic, {"factor": 1e-3})] if is_far else []
    return judge(
        UNIT,
        camera.topic,
        words,
        verdict="fault" if verdict == "fault" else "ok",
        advice=advice,
        repairs=repairs,
    )


def check_instants(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Stamps of depth images against those of the images on which they lie pixel by pixel."""
    cameras = evidence.recording.cameras
    for depth in (one for one in cameras if one.kind == "depth" and len(one)):
        for image in (one for one in cameras if one.kind != "depth" and len(one)):
            if (depth.frame_id, depth.size) == (image.frame_id, image.size) and depth.frame_id:
                yield _apart(depth, image)


INSTANTS = Question(
    "camera.depth_time",
    "a depth image is of the instant of the image on which it lies",
    (
        FaultKind(
            "camera_depth_time",
            "image and registered depth are of different instants",
            (anywhere("camera_time_offset"),),
        ),
    ),
    limit=MAX_APART_S,
    unit="s",
    consequence="colours lie beside their surfaces while the robot turns",
    ask=check_instants,
    repairs=("shift_stamps",),
)


def _apart(depth: CameraSurvey, image: CameraSurvey) -> Finding:
    ours, theirs = np.sort(depth.stamps_ns), np.sort(image.stamps_ns)
    at = np.clip(np.searchsorted(theirs, ours), 1, max(theirs.size - 1, 1))
    near = np.stack([theirs[np.minimum(at, theirs.size - 1)], theirs[at - 1]])
    nearest = np.take_along_axis(near, np.abs(near - ours).argmin(axis=0)[None], axis=0)[0]
    later_s = 1e-9 * (ours - nearest)
    apart_s = np.abs(later_s)
    # Of a stream with fewer images only those that have a partner at all are asked.
    usual_s = float(np.sort(apart_s)[: min(ours.size, theirs.size)].mean())
    words = f"its images are {1e3 * usual_s:.1f} ms from those of {image.topic}, on average"
    advice = "Synchronise the cameras, or register depth to the image of the same instant."
    shift = Repair("shift_stamps", depth.topic, {"offset_s": -float(np.median(later_s))})
    size = Measurement(usual_s, 0.0, "s")
    return judge(INSTANTS, depth.topic, words, size, advice=advice, repairs=[shift])
