"""Are red and blue of a camera exchanged?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.check.questions.cameras.stereo import MAX_APART_NS
from slamsim.core.types import FloatArray

_MOST_PAIRS, _FEWEST_PAIRS = 60, 10
_SAME_VIEW = 0.8
"""Correlation of brightness over the patches of two images that show the same."""
_LEAST_LIKE = 0.3
_LEAST_COLOUR = 2.0
"""Of 255: how far red and blue must be apart, patch by patch, to tell anything."""


def check_colours(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each colour topic beside another that shows the same: what is red in one must not be blue in
    the other. Which surfaces are red is not known."""
    colours = [one for one in evidence.recording.cameras if one.kind == "colour"]
    for camera in colours:
        others = [one for one in colours if one is not camera]
        alike = [found for one in others if (found := likeness(camera, one)) is not None]
        if not alike:
            words = "no other topic shows the same in colour, and an image alone does not tell"
            yield unanswered(COLOURS, camera.topic, words)
            continue
        value, sigma = max(alike, key=lambda found: abs(found[0]))
        if abs(value) < _LEAST_LIKE:
            words = f"colours of topics with the same view hardly agree ({value:+.2f})"
            yield unanswered(COLOURS, camera.topic, words)
            continue
        # Of two that contradict each other either may be wrong: both are named.
        yield judge(
            COLOURS,
            camera.topic,
            f"what is red in it is {'blue' if value < 0.0 else 'red'} in another topic with the "
            f"same view (correlation {value:+.2f})",
            Measurement(max(-value, 0.0), sigma, ""),
            limit=0.0 if value < 0.0 else 1.0,
            advice="Look for BGR published as RGB: compare the encoding with the driver's order.",
        )


COLOURS = Question(
    "camera.colours",
    "red and blue are not exchanged",
    (FaultKind("camera_colours_swapped", "red and blue of a camera are exchanged"),),
    consequence="networks and colour thresholds see another world",
    excitation_wanted="a second topic with the same view in colour",
    ask=check_colours,
    limit_of_ok=False,
)


def likeness(one: CameraSurvey, other: CameraSurvey) -> tuple[float, float] | None:
    """How red less blue of one goes with that of the other, from -1 to 1, with its sigma; None
    where too few images of one instant show the same in colour."""
    ours, theirs = one.stamps_ns[one.sampled], other.stamps_ns[other.sampled]
    if not theirs.size:
        return None
    found = []
    for k in range(0, ours.size, max(ours.size // _MOST_PAIRS, 1)):
        near = int(np.argmin(np.abs(theirs - ours[k])))
        pair = one.colours[k], other.colours[near]
        if abs(int(theirs[near] - ours[k])) <= MAX_APART_NS:
            found.append(_pair(*pair))
    alike = np.array([each for each in found if each is not None])
    if alike.size < _FEWEST_PAIRS or alike.size < 0.5 * len(found):
        return None
    return float(alike.mean()), float(max(alike.std(ddof=1), 0.05) / np.sqrt(alike.size))


def _pair(one: FloatArray, other: FloatArray) -> float | None:
    """Of two images; None where they show other things, or no colours."""
    if _correlation(one.mean(axis=2), other.mean(axis=2)) < _SAME_VIEW:
        return None
    differences = [each[..., 0] - each[..., 2] for each in (one, other)]
    if min(float(each.std()) for each in differences) < _LEAST_COLOUR:
        return None
    return _correlation(*differences)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    a, b = one - one.mean(), other - other.mean()
    scale = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / scale if scale > 0.0 else 0.0
