"""Runs all questions on a recording and makes one report."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from slamsim.check.diagnosis import explained
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.question import Question, QuestionGroup, judge
from slamsim.check.recorded import recorded_plot
from slamsim.check.registry import CHECKER_ERROR, registry
from slamsim.core.progress import Progress, silent
from slamsim.recording import RawScans, Recording
from slamsim.recording.choice import lidars
from slamsim.recording.frame_graph import outline

_log = logging.getLogger(__name__)


def check_recording(
    recording: Recording, *, quick: bool = False, progress: Progress = silent
) -> CheckReport:
    """Ask every question about a recording, which is compared with itself alone.

    quick: leave out questions that compare scans with one another. A question that raises does
    not cost the others: its finding is the fault ``checker_error``.
    """
    asked = list(_asked(recording, quick))
    errors = list[Exception]()
    findings: list[Finding] = []
    told_by: list[RecordingEvidence] = []
    seconds: dict[str, float] = {}
    for done, (group, evidence, lidar) in enumerate(asked):
        progress(done, len(asked))
        begun_s = time.perf_counter()
        answers = _answers(group, evidence, errors)
        told = [one for one in answers if lidar is None or _is_about(one, lidar)]
        findings += told
        told_by += [evidence] * len(told)
        seconds[group.part] = seconds.get(group.part, 0.0) + time.perf_counter() - begun_s
    progress(len(asked), len(asked))
    final = zip(explained(findings), told_by, strict=True)
    shown = tuple(_with_plot(finding, evidence) for finding, evidence in final)
    return CheckReport(recording.name, shown, seconds, tuple(outline(recording.transforms)))


def _with_plot(finding: Finding, evidence: RecordingEvidence) -> Finding:
    """A fault that its question drew no plot of, with one: of the streams that contradict each
    other, else of what was recorded."""
    if finding.verdict != "fault" or finding.plots:
        return finding
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        plot = evidence.plot_of(finding.check) or recorded_plot(
            evidence.recording, finding.subject, finding.check
        )
    return finding if plot is None else replace(finding, plots=(plot,))


def _asked(
    recording: Recording, quick: bool
) -> Iterator[tuple[QuestionGroup, RecordingEvidence, RawScans | None]]:
    """Each group of questions with the evidence that it is asked of.

    Those that compare scans with one another look at the first lidar. They are asked again of each
    further lidar as if it were alone, for what they say of that one.
    """
    groups, evidence = registry().groups, RecordingEvidence(recording)
    yield from ((group, evidence, None) for group in groups if not (quick and group.thorough))
    ranked = lidars(recording)
    frames = {lidar.frame_ids for lidar in ranked[:1]}
    for lidar in () if quick else ranked[1:]:
        if lidar.frame_ids in frames:
            continue  # the same lidar under another topic: another question tells
        frames.add(lidar.frame_ids)
        alone = RecordingEvidence(recording.with_streams(RawScans, [lidar]))
        yield from ((group, alone, lidar) for group in groups if group.thorough)


def _is_about(finding: Finding, lidar: RawScans) -> bool:
    return finding.subject in (lidar.topic, *lidar.frame_ids)


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
