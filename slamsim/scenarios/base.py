"""What a scenario is: trials that run side by side, and what they say together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

from slamsim.config.base import Config
from slamsim.types import FloatArray, Trajectory

Value = float | int | str | bool | None
Row = Mapping[str, Value]

Who = Literal["slamsim", "unity", "gazebo", "reality", "theory"]
"""Whose result: each has its own colour in every figure."""

Settings_contra = TypeVar("Settings_contra", bound=Config, contravariant=True)


@dataclass(frozen=True, slots=True)
class Solid:
    """The shape of a body that is shown. size_m: box (x, y, z), sphere (r,), robot (r, height)."""

    kind: Literal["box", "sphere", "robot"]
    size_m: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How one body moved, coarse enough to be looked at. A fixed body has a single pose."""

    name: str
    solid: Solid
    T_map_body: Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one trial came to. values: a row of the scenario's raw numbers, finite or None.

    motions: what to show of it; empty for most trials.
    """

    values: Row
    motions: tuple[Motion, ...] = ()


@dataclass(frozen=True, slots=True)
class Trial:
    """One piece of work. run: a partial of a function of a module, so that it can be sent away.

    cost: how long it takes beside other trials, in any unit; the longest begin first.
    """

    label: str
    run: Callable[[], Outcome]
    cost: float = 1.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """A statement of the study, of theory or of ours, and whether it holds here.

    holds: None if this run cannot tell. numbers: what it was judged by, with units.
    """

    statement: str
    source: Literal["study", "theory", "reality", "target"]
    holds: bool | None
    numbers: str


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table for people. rows: as texts, numbers with as many digits as they are worth."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One curve. x, y: (n,). spread: (n, 5) least, quartiles, largest of boxes, else None."""

    name: str
    who: Who
    x: FloatArray
    y: FloatArray
    kind: Literal["line", "points", "line+points", "boxes"] = "line"
    spread: FloatArray | None = None
    dashed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """A figure. equal: one metre is as long on both axes."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    equal: bool = False
    logarithmic: tuple[bool, bool] = (False, False)
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What the trials of a scenario say together. numbers: the few that matter, unit-bearing."""

    lead: str
    numbers: Row
    verdicts: tuple[Verdict, ...]
    sheets: tuple[Sheet, ...] = ()
    charts: tuple[Chart, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ScenarioResult:
    """A scenario that was run. rows: of all trials, in their order; failures: label and reason.

    engine: parameters of the physics engine that were used.
    """

    name: str
    title: str
    config: Config
    rows: tuple[Row, ...]
    findings: Findings
    motions: tuple[Motion, ...]
    engine: Row
    failures: tuple[tuple[str, str], ...] = ()
    wall_s: float = 0.0


class Scenario(Protocol[Settings_contra]):
    """One of the nine. All its methods are pure functions of what they are given."""

    name: str
    title: str

    def trials(self, config: Settings_contra, seed: int) -> Sequence[Trial]:
        """The work, in the order in which it is told of."""

    def conclude(self, config: Settings_contra, outcomes: Sequence[Outcome]) -> Findings:
        """What the outcomes, in the order of the trials, say. Some may be missing."""
