"""``slamsim check``: a recording in, findings out."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from rich.text import Text

from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport, Finding, Verdict
from slamsim.check.question import Question
from slamsim.check.registry import registry
from slamsim.check.wording import as_json, headline, shown
from slamsim.console.reporter import Cell, Reporter
from slamsim.io.cameras.survey import read_with_cameras
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.recording import Recording
from slamsim.recording.choice import choices, in_words
from slamsim.run.stages import Stages


def check_log(
    source: Path,
    reporter: Reporter,
    *,
    wanted: Selection = EVERYTHING,
    quick: bool = False,
    html: Path | None = None,
    show_all: bool = False,
) -> CheckReport:
    """Read, check, show. Raises NotFound and InputRefused."""
    stages = Stages(reporter)
    with stages.stage("read"):
        recording = read_with_cameras(source, wanted)
    reporter.note(in_words(choices(recording)))
    report = check_stage(recording, stages, quick=quick)
    if html is not None:
        from slamsim.report.pages.check import write_check_page

        write_check_page(html, report)
    show_verdicts(reporter, recording, report, show_all=show_all)
    reporter.result(
        {
            **as_json(report),
            "odd": list(recording.anomalies),
            "unread": [f"{u.topic} ({u.type_name}): {u.reason}" for u in recording.unread],
            "seconds": {**report.seconds, **stages.so_far()},
        }
    )
    return report


def question_table() -> dict[str, str]:
    """Every question by its id: what is asked, its limit, which faults it finds."""
    return {one.id: _declared(one) for one in registry().questions.values()}


def question_facts() -> list[dict[str, object]]:
    """The same with all that is declared of each."""
    return [
        {
            "id": one.id,
            "meaning": one.meaning,
            "faults": {fault.name: fault.meaning for fault in one.faults},
            "limit": one.limit,
            "unit": one.unit,
            "consequence": one.consequence,
            "excitation_wanted": one.excitation_wanted,
            "repairs": list(one.repairs),
        }
        for one in registry().questions.values()
    ]


def _declared(question: Question) -> str:
    faults = ", ".join(fault.name for fault in question.faults)
    size = f"{question.limit or 0.0:.3g} {question.unit}".strip()
    limit = "" if question.limit is None else f" (limit {size})"
    needs = f" Needs {question.excitation_wanted}." if question.excitation_wanted else ""
    found = f" Faults: {faults}." if faults else ""
    return f"{question.meaning}{limit}; if not, {question.consequence}.{needs}{found}"


def check_stage(recording: Recording, stages: Stages, *, quick: bool = False) -> CheckReport:
    """Check a recording under a progress bar."""
    with stages.stage("check") as progress:
        return check_recording(recording, quick=quick, progress=progress)


def show_verdicts(
    reporter: Reporter, recording: Recording, report: CheckReport, *, show_all: bool = False
) -> None:
    """Tables of faults and of what is inconclusive, a line for the rest, and the verdict."""
    for words in recording.anomalies:
        reporter.say(f"  {words}")
    by_verdict = {
        verdict: [finding for finding in report.findings if finding.verdict == verdict]
        for verdict in get_args(Verdict)
    }
    for verdict, title, style in _TABLES:
        if by_verdict[verdict] and (verdict != "ok" or show_all):
            rows = [_row(finding, style) for finding in by_verdict[verdict]]
            reporter.rows(Text(title, style), rows)
    if by_verdict["ok"] and not show_all:
        answers, questions = len(by_verdict["ok"]), len({f.check for f in by_verdict["ok"]})
        reporter.say(f"OK: {answers} answers to {questions} questions (--all shows them)")
    reporter.say(f"{report.name}: {headline(report)}")


_TABLES: tuple[tuple[Verdict, str, str], ...] = (
    ("fault", "Faults", "bold red"),
    ("inconclusive", "Inconclusive", "yellow"),
    ("ok", "OK", "green"),
)


def _row(finding: Finding, style: str) -> tuple[Cell, Cell]:
    words = f"{_sentence(finding.words)} {finding.advice}".strip()
    number = shown(finding.estimate, finding.limit)
    what: Cell = ((finding.fault or finding.check, style), (finding.subject, "dim"))
    return what, ((words, ""), *(((number, "cyan"),) if number else ()))


def _sentence(words: str) -> str:
    return words if words.endswith(".") else f"{words}."
