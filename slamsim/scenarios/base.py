"""Base class of scenarios: parallel trials and the findings drawn from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from numpy.typing import NDArray

from slamsim.config.base import Config
from slamsim.core.types import FloatArray, Grid, Trajectory

Value = float | int | str | bool | None
Row = Mapping[str, Value]

Source = Literal["slamsim", "unity", "gazebo", "reality", "theory"]
"""Whose result: each has its own colour in every figure."""

Settings = TypeVar("Settings", bound=Config)


@dataclass(frozen=True, slots=True)
class Solid:
    """The shape of a body that is shown. size_m: box (x, y, z), sphere (r,), robot (r, height)."""

    kind: Literal["box", "sphere", "robot"]
    size_m: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """How one body moved, coarse enough to be looked at. A fixed body has a single pose."""

    name: str
    solid: Solid
    T_map_body: Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one trial came to. values: a row of the scenario's raw numbers, finite or None.

    motions: what to show of it; empty for most trials. arrays: what ``conclude`` needs and no row
    can hold, such as a path.
    """

    values: Row
    motions: tuple[BodyMotion, ...] = ()
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Trial:
    """One piece of work. run: a partial of a function of a module, so that it can be sent away.

    label: unlike that of any other trial of the scenario. cost: about how many seconds of one core
    it takes; the longest begin first.
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
class ResultTable:
    """A table for people. rows: as texts, numbers with as many digits as they are worth."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One curve. x, y: (n,). spread: (n, 5) least, quartiles, largest of boxes, else None."""

    name: str
    source: Source
    x: FloatArray
    y: FloatArray
    kind: Literal["line", "points", "line+points", "boxes"] = "line"
    spread: FloatArray | None = None
    dashed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """A figure. equal: one metre is as long on both axes. grid: drawn below the curves."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    equal: bool = False
    logarithmic: tuple[bool, bool] = (False, False)
    grid: Grid | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What the trials of a scenario say together. numbers: the few that matter, unit-bearing."""

    summary: str
    numbers: Row
    verdicts: tuple[Verdict, ...]
    tables: tuple[ResultTable, ...] = ()
    charts: tuple[Chart, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TrialScene:
    """What one trial has to show. title: its label."""

    title: str
    motions: tuple[BodyMotion, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ScenarioResult:
    """A scenario that was run. rows: of all trials that ended well, in their order.

    engine: parameters of the physics engine that were used. failures: label and reason. busy_s:
    what all trials together took of one core.
    """

    name: str
    title: str
    config: Config
    rows: tuple[Row, ...]
    findings: Findings
    scenes: tuple[TrialScene, ...]
    engine: Row
    failures: tuple[tuple[str, str], ...] = ()
    busy_s: float = 0.0


@dataclass(frozen=True)
class Scenario(Generic[Settings]):
    """One of the nine. All its functions are pure.

    engine: parameters of the physics engine that its trials use, as they stand in the report.
    trials: the work for settings and seed, in the order in which it is reported. conclude: what
    the outcomes, in the order of the trials, say; some may be missing.
    """

    title: str
    engine: Callable[[Settings], Row]
    trials: Callable[[Settings, int], Sequence[Trial]]
    conclude: Callable[[Settings, Sequence[Outcome]], Findings]
