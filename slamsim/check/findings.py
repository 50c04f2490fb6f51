"""What the checker says: findings, each with its number, its evidence and the mend."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from slamsim.core.types import FloatArray
from slamsim.recording.fault_names import FAULT_NAMES
from slamsim.recording.repairs.base import Repair

Verdict = Literal["ok", "bad", "cannot tell"]
Mend = Repair


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured size with its standard deviation, in ``unit``; the interval is 95 %.

    bound: the least standard deviation that any method could have on these data (Cramer-Rao).
    """

    value: float
    sigma: float
    unit: str
    bound: float | None = None

    @property
    def interval(self) -> tuple[float, float]:
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma


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
    (from, to) of x that are shaded."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[float, ...] = ()
    spans: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """The answer to one question about one subject.

    check: stable dotted name of the question, such as ``laser.rotation`` or ``time.offset.lidar``.
    subject: the topic, frame or edge it is about. fault: the name of what is wrong, one of
    ``FAULT_NAMES``, if and only if the verdict is bad. words: one sentence saying what was found,
    with numbers; for "cannot tell" the reason and which motion or data would have told. advice:
    one sentence saying what to do, empty unless bad. statistic and limit: the number on which the
    verdict rests and the bound it is held against, in ``estimate.unit`` or the unit in words.
    """

    check: str
    subject: str
    verdict: Verdict
    words: str
    fault: str | None = None
    advice: str = ""
    estimate: Estimate | None = None
    limit: float | None = None
    mends: tuple[Mend, ...] = ()
    plots: tuple[Plot, ...] = ()

    def __post_init__(self) -> None:
        if (self.verdict == "bad") != (self.fault is not None):
            raise ValueError(f"{self.check}: a fault is named if and only if something is bad")
        if self.fault is not None and self.fault not in FAULT_NAMES:
            raise ValueError(f"{self.check}: {self.fault!r} is no known fault")

    def untold(self, reason: str) -> Finding:
        """The same as something that cannot be told, the reason added to its words."""
        words = f"{self.words}; {reason}"
        return replace(self, verdict="cannot tell", fault=None, words=words, advice="", mends=())


@dataclass(frozen=True, slots=True, eq=False)
class CheckReport:
    """All findings about a recording, in the order of the questions."""

    name: str
    findings: tuple[Finding, ...]
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def bad(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.verdict == "bad")

    @property
    def repairs(self) -> tuple[Repair, ...]:
        """What the bad findings propose, in their order."""
        return tuple(repair for finding in self.bad for repair in finding.mends)
