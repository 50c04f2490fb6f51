"""Scenarios that cost nothing and can go wrong on demand, for the tests of what is around them."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.config.base import Config
from slamsim.core.types import Trajectory
from slamsim.scenarios.base import (
    BodyMotion,
    Chart,
    Findings,
    Outcome,
    ResultTable,
    Row,
    Scenario,
    Series,
    Solid,
    Trial,
    Verdict,
)

Way = Literal["well", "raises", "not finite", "dies", "hangs"]
HOSTILE = "<script>alert('&')</script>"


class StubConfig(Config):
    """A scenario that squares numbers."""

    trials: int = Field(default=4, ge=0, le=100)
    """How many."""
    ways: Mapping[str, Way] = Field(default_factory=dict)
    """How single trials end, by their number."""
    conclusive: bool = True
    """Whether anything can be concluded."""


def _trials(config: StubConfig, seed: int) -> Sequence[Trial]:
    return [
        Trial(f"number {k}", partial(square, k, seed, config.ways.get(str(k), "well")), k % 3)
        for k in range(config.trials)
    ]


def _conclude(config: StubConfig, outcomes: Sequence[Outcome]) -> Findings:
    if not config.conclusive:
        raise KeyError("square")
    x = np.array([outcome.values["number"] for outcome in outcomes], dtype=np.float64)
    y = np.array([outcome.values["square"] for outcome in outcomes], dtype=np.float64)
    curves = (
        Series(f"ours {HOSTILE}", "slamsim", x, y, "line+points"),
        Series("theory", "theory", x, x**2, dashed=True),
    )
    return Findings(
        summary=f"Squares grow {HOSTILE}.",
        numbers={"largest": y.max()},
        verdicts=(
            Verdict("squares grow", "theory", True, f"{len(y)} of them {HOSTILE}"),
            Verdict("they shrink", "study", False, "not at all"),
            Verdict("they are blue", "reality", None, ""),
        ),
        tables=(ResultTable(f"Numbers {HOSTILE}", ("n", "n²"), ((HOSTILE, "0"),), HOSTILE),),
        charts=(Chart(f"Squares {HOSTILE}", "n", "n² [m] $x", curves, note=HOSTILE),),
    )


def square(number: int, seed: int, way: Way) -> Outcome:
    """The later trials are the faster ones, so that they overtake the earlier."""
    if way == "raises":
        raise ValueError("no such square")
    if way == "dies":
        os.abort()
    if way == "hangs":
        time.sleep(60.0)
    stamps_ns = np.arange(3) * 100_000_000
    moved = Trajectory(
        stamps_ns, np.outer(np.arange(3), [number, 0.0, 0.5]), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    )
    values: Row = {
        "number": number,
        "square": np.float64(number**2 if way == "well" else np.nan),
        "drawn": float(np.random.default_rng((seed, number)).normal()),
        "odd": np.bool_(number % 2).item(),
    }
    motions = (BodyMotion("box", Solid("box", (1.0, 1.0, 1.0)), moved),) if number == 0 else ()
    return Outcome(values, motions, {"path": moved.positions_m})


SCENARIO = Scenario[StubConfig](
    f"Squares {HOSTILE}",
    lambda config: {"time_step_s": 0.01, "solver": HOSTILE},
    _trials,
    _conclude,
)
