"""What is wrong with a recording: every question in turn, then one report."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from slamsim.check.description import check_description
from slamsim.check.diagnosis import explained
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.inertial import check_inertial
from slamsim.check.motion import check_motion
from slamsim.check.published import check_published
from slamsim.check.publishers import check_publishers
from slamsim.check.ranges import check_ranges
from slamsim.check.streams import check_streams
from slamsim.check.transforms import check_transforms
from slamsim.core.progress import Progress, silent
from slamsim.recording import Recording

Question = Callable[[Recording], Sequence[Finding]]

_log = logging.getLogger(__name__)

QUICK: dict[str, Question] = {
    "stamps": check_streams,
    "transforms": check_transforms,
    "publishers": check_publishers,
    "ranges": check_ranges,
    "inertial unit": check_inertial,
    "odometry": check_published,
    "robot description": check_description,
}
"""What can be told without comparing scans with one another."""
THOROUGH: dict[str, Question] = {"motion": check_motion}
"""What the motion between scans tells."""


def check_recording(
    recording: Recording, *, quick: bool = False, progress: Progress = silent
) -> CheckReport:
    """Every verdict about a recording of which nothing is known but itself.

    quick leaves out what compares scans with one another.
    """
    questions = QUICK if quick else {**QUICK, **THOROUGH}
    findings: list[Finding] = []
    seconds: dict[str, float] = {}
    for done, (name, question) in enumerate(questions.items()):
        progress(done, len(questions))
        begun_s = time.perf_counter()
        findings += _answered(name, question, recording)
        seconds[name] = time.perf_counter() - begun_s
    progress(len(questions), len(questions))
    return CheckReport(recording.name, explained(findings), seconds)


def _answered(name: str, question: Question, recording: Recording) -> Sequence[Finding]:
    """The answer; one that fails on an odd recording must not cost the others."""
    try:
        # Recordings hold inf and nan, and nothing at all: that is judged, not warned of.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return question(recording)
    except Exception as error:
        _log.debug("the question about %s failed", name, exc_info=True)
        kind, detail = type(error).__name__, " ".join(str(error).split())[:200]
        words = f"this part of the check failed on this recording ({kind}: {detail})"
        return [Finding(f"check.{name.replace(' ', '_')}", recording.name, "cannot tell", words)]
