"""Are the two images of a stereo pair swapped?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.pairs import stereo_pairs
from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import BadNumbers
from slamsim.recording.repairs.base import Repair

MAX_APART_NS = 5_000_000
_MOST_PAIRS = 60
_FEWEST_PAIRS = 5
_SHIFTS = 24
"""Pixels of a thumbnail of 160: as near as seven baselines of a camera that sees 87 degrees."""
_LEAST_LIKE = 0.3
"""Correlation below which two images show no common surface."""


def check_stereo(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Where the right image must be shifted to lie on the left one: what is near lies farther to
    the right in the left image."""
    for left, right in stereo_pairs(evidence.recording.cameras):
        yield _judged(left, right)


STEREO = Question(
    "camera.stereo",
    "the left image of a stereo pair is that of the left camera",
    (FaultKind("camera_stereo_swapped", "left and right image of a stereo pair are swapped"),),
    limit=0.0,
    unit="px",
    consequence="no depth is found, or depth behind the camera",
    excitation_wanted="surfaces with texture, some metres away at most",
    ask=check_stereo,
    repairs=("exchange_images",),
    limit_of_ok=False,
)


def _judged(left: CameraSurvey, right: CameraSurvey) -> Finding:
    found = [shift for pair in _pairs(left, right) if (shift := disparity_px(*pair)) is not None]
    subject = left.topic
    if len(found) < _FEWEST_PAIRS:
        return unanswered(STEREO, subject, f"too few images of it and {right.topic} fit each other")
    scale = left.size[0] / left.thumbnails.shape[2]
    shifts = scale * np.array(found) - (_ahead_px(left) - _ahead_px(right))
    sigma = max(float(shifts.std(ddof=1)), 0.5 * scale) / np.sqrt(len(shifts))
    mean = float(shifts.mean())
    words = f"things lie {mean:.1f} px farther to the right in it than in {right.topic}"
    behind = Measurement(max(-mean, 0.0), sigma, "px")
    if abs(mean) < 3.0 * sigma:
        return unanswered(STEREO, subject, f"{words}, too little to tell which is left")
    verdict = "fault" if mean < 0.0 else "ok"
    return judge(
        STEREO,
        subject,
        words,
        behind,
        verdict="fault" if verdict == "fault" else "ok",
        limit=0.0,
        repairs=[Repair("exchange_images", left.topic, {"other": right.topic})],
        advice=f"Exchange {left.topic} and {right.topic}, or the two cables.",
    )


def _ahead_px(camera: CameraSurvey) -> float:
    """The column in which a camera sees what lies straight ahead of the pair, infinitely far away:
    in images that are not rectified, those of two cameras differ by as much as a near wall makes.
    The middle where nothing tells."""
    claim = camera.claim
    if claim is None or claim.image_size != camera.size or "rect" in camera.topic.split("/")[-1]:
        return 0.5 * (camera.size[0] - 1.0)
    try:
        pixels, seen = claim.model().project(claim.R.T[:, 2][None])
    except BadNumbers:
        return 0.5 * (camera.size[0] - 1.0)
    return float(pixels[0, 0]) if seen[0] else 0.5 * (camera.size[0] - 1.0)


def _pairs(
    left: CameraSurvey, right: CameraSurvey
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Thumbnails of one instant, evenly spread."""
    ours, theirs = left.stamps_ns[left.sampled], right.stamps_ns[right.sampled]
    if not theirs.size:
        return
    for k in range(0, ours.size, max(ours.size // _MOST_PAIRS, 1)):
        other = int(np.argmin(np.abs(theirs - ours[k])))
        if abs(int(theirs[other] - ours[k])) <= MAX_APART_NS:
            yield left.thumbnails[k], right.thumbnails[other]


def disparity_px(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> float | None:
    """By how many pixels things lie farther to the right in the left of two thumbnails.

    The shift of the best correlation of their edges; None where they are not alike. left, right:
    (h, w) grey.
    """
    if left.shape != right.shape or left.shape[1] <= 4 * _SHIFTS:
        return None
    one, other = _edges(left), _edges(right)
    middle = one[:, _SHIFTS:-_SHIFTS]
    width = middle.shape[1]
    likeness = [
        _correlation(middle, other[:, _SHIFTS - shift : _SHIFTS - shift + width])
        for shift in range(-_SHIFTS, _SHIFTS + 1)
    ]
    best = int(np.argmax(likeness))
    if likeness[best] < _LEAST_LIKE:
        return None
    return float(best - _SHIFTS) + _top(likeness[max(best - 1, 0) : best + 2])


def _top(around: list[float]) -> float:
    """Where the parabola through three values has its top, from the middle one on: lenses side by
    side shift what is some metres away by less than a pixel of a thumbnail."""
    if len(around) < 3:
        return 0.0
    before, middle, after = around
    bend = before - 2.0 * middle + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0


def _edges(image: NDArray[np.uint8]) -> FloatArray:
    """Changes along the rows: brightness itself differs between two cameras."""
    return np.asarray(np.diff(image.astype(np.float64), axis=1))


def _correlation(one: FloatArray, other: FloatArray) -> float:
    scale = float(np.sqrt((one * one).sum() * (other * other).sum()))
    return float((one * other).sum()) / scale if scale > 0.0 else 0.0
