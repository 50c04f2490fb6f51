"""When a measured size is ok, bad or not to be told, the same way for all that the fit measures."""

from __future__ import annotations

from dataclasses import dataclass, field

from slamsim.check.findings import Estimate, Finding, Mend, Plot, Verdict

SURE_SIGMAS = 4.5
"""So far from healthy must a size be: many questions are asked of every recording."""


@dataclass(frozen=True, slots=True)
class Question:
    """One size: what it is, which fault a large one is, and from where on it matters.

    limit: sizes up to this are healthy. harm: "ok" is said only if the 95 % interval excludes
    larger ones. wanted: the motion that tells this size.
    """

    check: str
    subject: str
    fault: str
    limit: float
    harm: float
    wanted: str


@dataclass(frozen=True, slots=True)
class Answer:
    """words: with numbers. advice, mends: for a bad one."""

    words: str
    advice: str = ""
    mends: tuple[Mend, ...] = ()
    plots: tuple[Plot, ...] = field(default_factory=tuple)


def verdict(estimate: Estimate, limit: float, harm: float) -> Verdict:
    """Of a size that is 0 when all is well."""
    size = abs(estimate.value)
    if size > limit and size > SURE_SIGMAS * estimate.sigma:
        return "bad"
    return "ok" if size + 1.96 * estimate.sigma < harm else "cannot tell"


def judged(question: Question, estimate: Estimate, answer: Answer) -> Finding:
    """The finding about one size."""
    found = verdict(estimate, question.limit, question.harm)
    words = answer.words
    if found == "cannot tell":
        words += f", {_why(estimate, question.limit)}; what would tell: {question.wanted}"
    bad = found == "bad"
    return Finding(
        question.check,
        question.subject,
        found,
        words,
        question.fault if bad else None,
        answer.advice if bad else "",
        estimate,
        question.limit,
        answer.mends if bad else (),
        answer.plots,
    )


def _why(estimate: Estimate, limit: float) -> str:
    """Why a size can be neither healthy nor bad."""
    sure = SURE_SIGMAS * estimate.sigma < abs(estimate.value) <= limit
    if not sure:
        return "too unsure to tell"
    return f"which is less than can be held against such sensors ({limit:.3g} {estimate.unit})"
