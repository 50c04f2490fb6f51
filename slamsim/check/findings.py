"""Findings of the checker: value, evidence and proposed repair."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from html import escape
from typing import Literal

from slamsim.core.types import FloatArray
from slamsim.recording.frame_graph import FramePlace
from slamsim.recording.repairs.base import Repair

Verdict = Literal["ok", "fault", "inconclusive"]


SURE_SIGMAS = 4.5
"""A size must be so far from healthy: some sixty questions are asked of every recording, and one
false alarm in a thousand recordings allows each of them 1e-5 (two-sided normal: 4.4 sigmas). A
95 % interval alone would raise a false alarm on every other recording where sigmas are as large
as limits."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """A measured size with its standard deviation, in ``unit``; the interval is 95 %.

    bound: the least standard deviation that any method could have on these data (Cramer-Rao).
    allowed: the part of sigma that is of what healthy robots do and limits allow for already, such
    as tyres that give.
    """

    value: float
    sigma: float
    unit: str
    bound: float | None = None
    allowed: float = 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % interval, in ``unit``."""
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma

    @property
    def scatter(self) -> float:
        """What is left of sigma without what is allowed: that of this recording."""
        if self.allowed == 0.0:
            return self.sigma
        return math.sqrt(max(self.sigma**2 - self.allowed**2, 0.0))


def decide(size: Measurement, limit: float, healthy: float = 0.0) -> Verdict:
    """The one rule for every size: where its 95 % interval lies against the limit, as wide as it is
    without what limits allow for.

    "fault" if the interval lies beyond the limit and the size is no accident (``SURE_SIGMAS``),
    "ok" if the interval lies inside, else "inconclusive". limit: how far the size of a healthy
    recording may be from ``healthy``, in the unit of the size. What limits allow for widens the
    interval that is told, but does not count here again: wheels found 2.4 ms late with a sigma of
    0.5, of which 0.3 is of tyres that give, would be inconclusive by a limit of 1.5 ms that is as
    wide as it is for that give.
    """
    off, half = abs(size.value - healthy), 1.96 * size.scatter
    if off - half > limit and off > SURE_SIGMAS * size.scatter:
        return "fault"
    return "ok" if off + half <= limit else "inconclusive"


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line or cloud of a plot: x, y (n,)."""

    label: str
    x: FloatArray
    y: FloatArray
    style: Literal["line", "points"] = "points"


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Evidence to look at: curves over labelled axes (with units), horizontal limits, and spans
    (from, to) of x that are shaded. row_names: of y = 0, 1, ..., drawn from the top down, where y
    is no number."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[float, ...] = ()
    spans: tuple[tuple[float, float], ...] = ()
    row_names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """The answer to one question about one subject; ``question.judge`` makes it.

    check: id of the question, such as ``laser.rotation`` or ``time.offset.lidar``. subject: the
    topic, frame or edge it is about. fault: the name of what is wrong, if and only if the verdict
    is "fault". words: one sentence saying what was found, with numbers; of an inconclusive answer
    the reason, and which motion or data would tell. advice: one sentence saying what to do, empty
    unless a fault. estimate and limit: the size on which the verdict rests and the largest healthy
    one, in ``estimate.unit`` or the unit in words.
    """

    check: str
    subject: str
    verdict: Verdict
    words: str
    fault: str | None = None
    advice: str = ""
    estimate: Measurement | None = None
    limit: float | None = None
    repairs: tuple[Repair, ...] = ()
    plots: tuple[Plot, ...] = ()

    def __post_init__(self) -> None:
        if (self.verdict == "fault") != (self.fault is not None):
            raise ValueError(f"{self.check}: a fault has a name, other verdicts have none")

    def inconclusive(self, reason: str) -> Finding:
        """The same as an inconclusive answer, the reason added to its words."""
        words = f"{self.words}; {reason}"
        return replace(self, verdict="inconclusive", fault=None, words=words, advice="", repairs=())


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CheckReport:
    """All findings about a recording, in the order of the questions.

    seconds: wall time of each part of the check. frames: the transform tree.
    """

    name: str
    findings: tuple[Finding, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    frames: tuple[FramePlace, ...] = ()

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings with the verdict "fault"."""
        return tuple(finding for finding in self.findings if finding.verdict == "fault")

    @property
    def repairs(self) -> tuple[Repair, ...]:
        """What the faults propose, in their order."""
        return tuple(repair for finding in self.faults for repair in finding.repairs)

    def __repr__(self) -> str:
        names = ", ".join(finding.fault or "" for finding in self.faults) or "no fault"
        return f"CheckReport({self.name!r}: {names}; {len(self.findings)} answers)"

    def _repr_html_(self) -> str:
        """The faults as a table, in a notebook."""
        rows = "".join(
            '<tr style="text-align:left">'
            + "".join(
                f'<td style="text-align:left">{escape(cell)}</td>'
                for cell in (finding.fault or "", finding.subject, finding.words, finding.advice)
            )
            + "</tr>"
            for finding in self.faults
        )
        return f"<p>{escape(repr(self))}</p><table>{rows}</table>"
