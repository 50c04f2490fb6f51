"""Does the brightness of images flicker?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN

MAX_FLICKER = 0.03
"""Of the brightness: mains light under a short exposure moves it by ten per cent and more, what
passes through the view by less between two images of one camera."""
_FEWEST_TRIPLES = 10
_DARK = 4.0
"""Of 255: the logarithm of a black image says nothing."""


def check_exposure(evidence: RecordingEvidence) -> Iterator[Finding]:
    """How far each image's brightness is from the mean of its neighbours: steady change is none."""
    for camera in evidence.recording.cameras:
        if camera.kind != "depth":
            yield _flicker(camera)


EXPOSURE = Question(
    "camera.exposure",
    "the brightness of images does not flicker",
    (FaultKind("camera_flicker", "the brightness of images flickers"),),
    limit=MAX_FLICKER,
    consequence="features are lost from image to image, and direct methods see motion",
    excitation_wanted="more images, and light",
    ask=check_exposure,
    limit_of_ok=False,
)


def _flicker(camera: CameraSurvey) -> Finding:
    numbers, brightness = camera.sampled, camera.brightness
    first = np.flatnonzero((numbers[2:] - numbers[:-2] == 2) & (brightness[1:-1] > _DARK))
    if first.size < _FEWEST_TRIPLES:
        words = f"fewer than {_FEWEST_TRIPLES} images with light have neighbours"
        return unanswered(EXPOSURE, camera.topic, words)
    level = np.log(np.maximum(brightness, 1.0))
    bends = level[first] - 2.0 * level[first + 1] + level[first + 2]
    # Of independent errors of equal size s, such a second difference has 6 s^2.
    flicker = SIGMAS_PER_MEDIAN * float(np.median(np.abs(bends))) / np.sqrt(6.0)
    # A median of absolute values is 37 % as efficient as the standard deviation.
    sigma = flicker / np.sqrt(2.0 * 0.37 * first.size)
    since_s = 1e-9 * (camera.stamps_ns[numbers] - camera.stamps_ns[0])
    curve = Curve("mean of an image", since_s, brightness, "line")
    return judge(
        EXPOSURE,
        camera.topic,
        f"brightness scatters by {flicker:.1%} from image to image",
        Measurement(flicker, float(sigma), ""),
        advice="Expose for a whole period of the mains (10 or 8.3 ms), or fix exposure and gain.",
        fault_plots=(Plot(f"Brightness of {camera.topic}", "stamp (s)", "of 255", (curve,)),),
    )
