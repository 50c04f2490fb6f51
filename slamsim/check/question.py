"""Questions that the checker asks: one declaration each, and the one rule that answers them.

Table, documentation, diagnosis and names of faults follow from the declarations (``registry.py``);
every ``Finding`` is made by ``judge``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from slamsim.check.findings import Finding, Measurement, Plot, Verdict, decide
from slamsim.recording.repairs.base import Repair

if TYPE_CHECKING:
    from slamsim.check.evidence import RecordingEvidence

Ask = Callable[["RecordingEvidence"], Iterable[Finding]]

Where = Literal["same subject", "anywhere", "lidar stamps"]


@dataclass(frozen=True, slots=True)
class Explains:
    """Faults that are no news beside another: it makes their questions go wrong.

    where: "same subject": of the topic, frame or edge that has the fault. "anywhere": of all.
    "lidar stamps": of all, where the subject with the fault is a lidar's topic.
    """

    faults: tuple[str, ...]
    where: Where


def anywhere(*faults: str) -> Explains:
    """What a fault makes of everything."""
    return Explains(faults, "anywhere")


def same_subject(*faults: str) -> Explains:
    """What a fault makes of the topic, frame or edge that has it."""
    return Explains(faults, "same subject")


def lidar_stamps(*faults: str) -> Explains:
    """What a fault of a lidar's stamps makes of everything."""
    return Explains(faults, "lidar stamps")


@dataclass(frozen=True, slots=True)
class FaultKind:
    """Something that can be wrong with a recording. Several questions may find the same.

    name: under which it is reported and injected. meaning: a clause that says what is wrong.
    explains: what else it makes questions report, which is then inconclusive (``diagnosis.py``).
    """

    name: str
    meaning: str
    explains: tuple[Explains, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """One question about a recording.

    id: stable dotted name, the first part its subject: ``laser.yaw``. meaning: what is asked, as
    a clause that is true when all is well. faults: what it can find. limit: the size up to which
    all is well, in ``unit``; None where no size decides, or the recording says how large it may
    be. consequence: what an unnoticed fault does to a map or its user. excitation_wanted: motion
    or data that answers it. repairs: operations of ``slamsim fix`` that it may propose.

    ask: answers it; None where a ``QuestionGroup`` does. thorough: whether it compares scans with
    one another, which ``check --quick`` leaves out. limit_of_ok: whether "ok" reports the limit.
    """

    id: str
    meaning: str
    faults: tuple[FaultKind, ...]
    limit: float | None = None
    unit: str = ""
    consequence: str = ""
    excitation_wanted: str = ""
    repairs: tuple[str, ...] = ()
    ask: Ask | None = None
    thorough: bool = False
    limit_of_ok: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class QuestionGroup:
    """Questions that one function answers, for they share what it computes or exclude each other.

    part: of the check, as ``seconds`` in ``--json`` names it. order: place in the report.
    """

    part: str
    order: int
    questions: tuple[Question, ...]
    ask: Ask
    thorough: bool = False


def judge(
    question: Question,
    subject: str,
    words: str | Mapping[Verdict, str],
    size: Measurement | None = None,
    *,
    verdict: Verdict | None = None,
    limit: float | None = None,
    healthy: float = 0.0,
    fault: FaultKind | None = None,
    advice: str = "",
    repairs: Iterable[Repair] = (),
    plots: Iterable[Plot] = (),
    fault_plots: Iterable[Plot] = (),
) -> Finding:
    """The answer to a question about one subject: a topic, frame or edge.

    words: what was found, with numbers, a clause without full stop; by verdict where they differ.
    size: which ``decide`` judges by limit (default: the question's) and healthy. verdict: given
    where no size decides. fault: which of the question's it is, the first by default. advice,
    repairs, fault_plots: of a fault alone. Raises ValueError for what the question does not
    declare, and without size and verdict.
    """
    shown = question.limit if limit is None and size is not None else limit
    reason = ""
    if verdict is None:
        verdict, reason = _by_size(question, size, shown, healthy)
    is_fault = verdict == "fault"
    finding = Finding(
        *(question.id, subject, verdict),
        (words if isinstance(words, str) else words[verdict]) + reason,
        (fault or question.faults[0]).name if is_fault else None,
        advice if is_fault else "",
        *(size, shown if question.limit_of_ok or verdict != "ok" else None),
        tuple(repairs) if is_fault else (),
        (*plots, *fault_plots) if is_fault else tuple(plots),
    )
    _require_declared(question, finding)
    return finding


def _by_size(
    question: Question, size: Measurement | None, limit: float | None, healthy: float
) -> tuple[Verdict, str]:
    """The verdict, and why it is inconclusive."""
    if size is None or limit is None:
        raise ValueError(f"{question.id}: no verdict without a size and its limit")
    verdict = decide(size, limit, healthy)
    if verdict != "inconclusive":
        return verdict, ""
    reason = f", too unsure to tell whether it is within {limit:.3g} {question.unit}".rstrip()
    return verdict, f"{reason}; what would tell: {question.excitation_wanted}"


def _require_declared(question: Question, finding: Finding) -> None:
    names = [fault.name for fault in question.faults]
    if finding.fault is not None and finding.fault not in names:
        raise ValueError(f"{question.id} declares no fault {finding.fault!r}")
    if undeclared := {one.operation for one in finding.repairs} - set(question.repairs):
        raise ValueError(f"{question.id} declares no repair {', '.join(sorted(undeclared))}")


def unanswered(question: Question, subject: str, words: str, plots: Iterable[Plot] = ()) -> Finding:
    """The finding about a question for which the recording lacks something; words: what."""
    return Finding(question.id, subject, "inconclusive", words, plots=tuple(plots))
