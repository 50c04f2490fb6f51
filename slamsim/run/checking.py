"""``slamsim check``: a recording in, findings out."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from rich.table import Table
from rich.text import Text

from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport, Finding, Verdict
from slamsim.check.question import Question
from slamsim.check.registry import registry
from slamsim.check.wording import as_json, headline, shown
from slamsim.console.reporter import Reporter
from slamsim.io.open import read_recording
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
        recording = read_recording(source, wanted)
    reporter.say(in_words(choices(recording)))
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
    with stages.stage("check", "questions/s") as progress:
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
    if by_verdict["fault"]:
        reporter.show(_table("Faults", by_verdict["fault"], "bold red"))
    if by_verdict["inconclusive"]:
        reporter.show(_table("Inconclusive", by_verdict["inconclusive"], "yellow"))
    if show_all and by_verdict["ok"]:
        reporter.show(_table("Fine", by_verdict["ok"], "green"))
    elif by_verdict["ok"]:
        reporter.say(f"Fine: {_folded(by_verdict['ok'])} (--all shows them)")
    reporter.say(f"{report.name}: {headline(report)}")


def _table(title: str, findings: list[Finding], style: str) -> Table:
    table = Table(title=title, title_justify="left", title_style=style, show_header=False)
    table.add_column(max_width=30)
    table.add_column(ratio=1)
    for finding in findings:
        what = Text.assemble(
            (finding.fault or finding.check, style), "\n", (finding.subject, "dim")
        )
        number = shown(finding.estimate, finding.limit)
        words = Text(f"{_sentence(finding.words)} {finding.advice}".strip())
        if number:
            words.append(f"\n{number}", style="cyan")
        table.add_row(what, words)
    return table


def _sentence(words: str) -> str:
    return words if words.endswith(".") else f"{words}."


def _folded(findings: list[Finding]) -> str:
    """How many questions, and which."""
    names = list(dict.fromkeys(finding.check for finding in findings))
    return f"{len(findings)} answers to {', '.join(names)}"
