"""Small versions of the scenarios stacking, collision and integrator, and how they are judged."""

from __future__ import annotations

import math
from typing import TypeVar

from slamsim.config.base import Config
from slamsim.config.scenarios.bodies import (
    CollisionConfig,
    IntegratorConfig,
    SolverConfig,
    StackingConfig,
    StepsConfig,
)
from slamsim.scenarios.base import Findings, Outcome, Scenario

COARSE = StepsConfig(first_s=0.02, last_s=0.03, by_s=0.01)
STACKS = StackingConfig(
    steps=COARSE,
    duration_s=8.0,
    max_boxes=16,
    compared_boxes=4,
    other_solvers={"few": SolverConfig(iterations=5)},
    other_steps_s=(0.03,),
)
DROPS = CollisionConfig(
    steps=StepsConfig(first_s=0.01, last_s=0.03, by_s=0.004),
    repeats=1,
    spheres_per_edge=2,
    duration_s=1.5,
    other_solvers={"substeps": SolverConfig(substeps=4)},
    other_steps_s=(0.004, 0.03),
)
FALLS = IntegratorConfig(steps=StepsConfig(first_s=0.003, last_s=0.03, by_s=0.003))

Parameters = TypeVar("Parameters", bound=Config)


def run_all(scenario: Scenario[Parameters], config: Parameters, seed: int = 0) -> list[Outcome]:
    return [trial.run() for trial in scenario.trials(config, seed)]


def plain(findings: Findings) -> bool:
    """Whether everything in it is a number, and the tables are rectangular."""
    numbers = [value for value in findings.numbers.values() if isinstance(value, float)]
    for chart in findings.charts:
        for series in chart.series:
            numbers += [*series.x, *series.y]
    rectangular = all(
        len(row) == len(table.header) for table in findings.tables for row in table.rows
    )
    whole = all(type(verdict.holds) in (bool, type(None)) for verdict in findings.verdicts)
    return all(math.isfinite(number) for number in numbers) and rectangular and whole


def holds(findings: Findings, words: str) -> bool | None:
    (found,) = (verdict for verdict in findings.verdicts if words in verdict.statement)
    return found.holds
