"""Findings as text and as JSON."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import asdict

from slamsim.check.findings import CheckReport, Finding, Measurement, Verdict
from slamsim.check.registry import fault_meaning
from slamsim.guard.quantities import as_interval, as_number

JSON_VERDICTS: dict[Verdict, str] = {
    "ok": "ok",
    "fault": "bad",
    "inconclusive": "cannot tell",
}
"""What verdicts are called in ``--json``, where names never change."""
SIDES = {"x": ("forward", "back"), "y": ("to the left", "to the right")}
"""Where something sits along an axis of the base, if more and if less."""
_NOTHING = 1e-6
"""Share of its limit below which a size is nothing."""
_ROUNDING = 1e-9
"""What rounding leaves of equal numbers is less, in every unit of ours."""
_REPEATED = 0.6
"""Share of the words of a meaning from which on a sentence repeats it. Chosen by reading five
meanings beside their sentences: those that repeat share 0.63 and more, the others 0.43 and less."""


def headline(report: CheckReport) -> str:
    """The verdict in one sentence."""
    names = list(
        dict.fromkeys(fault_meaning(f.fault) for f in report.faults if f.fault is not None)
    )
    if names:
        return f"Something is wrong: {'; '.join(names)}."
    unknown = sum(finding.verdict == "inconclusive" for finding in report.findings)
    questions = "1 question stays" if unknown == 1 else f"{unknown} questions stay"
    return "Nothing is wrong" + (f", but {questions} open." if unknown else ".")


def shown(estimate: Measurement | None, limit: float | None = None) -> str:
    """A number with its interval and its limit, empty without one."""
    if estimate is None:
        return ""
    value, within = estimate.value, 1.96 * estimate.sigma
    if limit and abs(value) + within < _NOTHING * limit:  # what rounding leaves of equal numbers
        value = within = 0.0
    text = f"{as_interval(value, within)} {estimate.unit}".rstrip()
    return text if limit is None else f"{text} (limit {limit:.3g})"


def signed_words(value: float, unit: str, more: str, less: str, places: int | None = None) -> str:
    """A size with its sign in words: -40.2 mm that are "too long" if positive and "too short" if
    negative are "40.2 mm too short".

    places: so many digits behind the point, else three significant ones. Nothing is "0 mm too
    long", from whichever side it was rounded.
    """
    size = value if places is None else round(value, places)
    if abs(size) <= _ROUNDING:
        return f"0 {unit} {more}"
    return f"{as_number(abs(size), 3)} {unit} {more if size > 0.0 else less}"


def taken_off(value: float, unit: str, what: str) -> str:
    """How to correct what is too large by a size: -0.04 s of "its stamps" are "Add 0.04 s to its
    stamps"."""
    size = f"{abs(value):.4g} {unit}".rstrip()
    return f"Subtract {size} from {what}" if value > 0.0 else f"Add {size} to {what}"


def warning(finding: Finding) -> str:
    """A fault, as it stands among the warnings of a run: without its meaning where the evidence
    says the same in the same words."""
    meaning = fault_meaning(finding.fault or "")
    known, said = (set(re.findall(r"\w+", text.lower())) for text in (meaning, finding.words))
    if len(known & said) >= _REPEATED * len(known):
        return f"{finding.subject}: {finding.words}"
    return f"{meaning} ({finding.subject}): {finding.words}"


def as_json(report: CheckReport) -> dict[str, object]:
    """All findings under stable keys; what is not a finite number is null."""
    counts = Counter(finding.verdict for finding in report.findings)
    return {
        "name": report.name,
        "bad": counts["fault"],
        "cannot_tell": counts["inconclusive"],
        "ok": counts["ok"],
        "ok_questions": len({each.check for each in report.findings if each.verdict == "ok"}),
        "faults": sorted({finding.fault for finding in report.faults if finding.fault is not None}),
        "findings": [finding_json(finding) for finding in report.findings],
        "seconds": {name: round(seconds, 3) for name, seconds in report.seconds.items()},
    }


def finding_json(finding: Finding) -> dict[str, object]:
    """One finding under stable keys."""
    estimate = finding.estimate
    return {
        "check": finding.check,
        "subject": finding.subject,
        "verdict": JSON_VERDICTS[finding.verdict],
        "fault": finding.fault,
        "words": finding.words,
        "advice": finding.advice,
        "value": None if estimate is None else _number(estimate.value),
        "sigma": None if estimate is None else _number(estimate.sigma),
        "allowed": None if estimate is None else _number(estimate.allowed),
        "interval": None if estimate is None else [_number(end) for end in estimate.interval],
        "unit": None if estimate is None else estimate.unit,
        "limit": _number(finding.limit),
        "repairs": [asdict(repair) for repair in finding.repairs],
    }


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
