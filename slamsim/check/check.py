"""Runs all questions on a recording and makes one report."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Sequence

import numpy as np

from slamsim.check.diagnosis import explained
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.question import Question, QuestionGroup, judge
from slamsim.check.registry import CHECKER_ERROR, registry
from slamsim.core.progress import Progress, silent
from slamsim.recording import Recording

_log = logging.getLogger(__name__)


def check_recording(
    recording: Recording, *, quick: bool = False, progress: Progress = silent
) -> CheckReport:
    """Ask every question about a recording, which is compared with itself alone.

    quick: leave out questions that compare scans with one another. A question that raises does
    not cost the others: its finding is the fault ``checker_error``.
    """
    groups = [group for group in registry().groups if not (quick and group.thorough)]
    evidence, errors = RecordingEvidence(recording), list[Exception]()
    findings: list[Finding] = []
    seconds: dict[str, float] = {}
    for done, group in enumerate(groups):
        progress(done, len(groups))
        begun_s = time.perf_counter()
        findings += _answers(group, evidence, errors)
        seconds[group.part] = seconds.get(group.part, 0.0) + time.perf_counter() - begun_s
    progress(len(groups), len(groups))
    return CheckReport(recording.name, explained(findings), seconds)


def _answers(
    group: QuestionGroup, evidence: RecordingEvidence, errors: list[Exception]
) -> Sequence[Finding]:
    """The findings of a group; errors: those that are reported already, appended to."""
    try:
        # Recordings hold inf and nan, and nothing at all: that is judged, not warned of.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return list(group.ask(evidence))
    except Exception as error:
        _log.warning("the questions about %s failed", group.part, exc_info=True)
        if any(error is known for known in errors):
            return []
        errors.append(error)
        return [_internal_error(group, evidence.recording.name, error)]


def _internal_error(group: QuestionGroup, recording_name: str, error: Exception) -> Finding:
    part = group.part.replace(" ", "_")
    asked = ", ".join(question.id for question in group.questions)
    detail = " ".join(str(error).split())[:200]
    return judge(
        Question(f"check.{part}", "the checker answers its questions", (CHECKER_ERROR,)),
        recording_name,
        f"internal error in the question {asked} ({type(error).__name__}: {detail})",
        verdict="fault",
        advice="Report it with this recording; what these questions would tell is not known.",
    )
