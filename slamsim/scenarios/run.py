"""Runs all trials of the chosen scenarios in parallel and collects the findings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from slamsim.config.base import Config
from slamsim.guard.errors import SlamsimError, reason_of
from slamsim.process.worker import WorkerDied, Workers, time_limit
from slamsim.scenarios.base import (
    Findings,
    Outcome,
    Row,
    Scenario,
    ScenarioResult,
    Trial,
    TrialScene,
    Value,
)

TRIAL_LIMIT_S = 600.0
"""A trial that takes longer hangs, or was asked for too much."""

Listener = Callable[[str, int, int], None]
"""Called with the name of a scenario, how many of its trials are done, and how many it has."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """A scenario to be run, with its parameters."""

    name: str
    scenario: Scenario[Any]
    config: Config


@dataclass(frozen=True, slots=True)
class _Ran:
    """How a trial ended: with its outcome, or with a reason why there is none."""

    outcome: Outcome | None
    reason: str = ""
    busy_s: float = 0.0


def run_scenarios(
    chosen: Sequence[Chosen],
    seed: int,
    *,
    jobs: int | None = None,
    limit_s: float = TRIAL_LIMIT_S,
    listen: Listener = lambda name, done, total: None,
) -> tuple[ScenarioResult, ...]:
    """The result of each scenario, the same for any number of jobs but for the times.

    jobs: how many processes; as many as there are cores for us, if none is given. limit_s: the
    most that a trial may take. A trial that fails, dies or takes longer is told of in its
    scenario's ``failures``; the others go on. Raises what planning the trials raises, and
    SlamsimError if no process can be started.
    """
    trials = [one.scenario.trials(one.config, seed) for one in chosen]
    ran = _run_trials(chosen, trials, jobs, limit_s, listen)
    return tuple(map(_concluded, chosen, trials, ran))


def _run_trials(
    chosen: Sequence[Chosen],
    trials: Sequence[Sequence[Trial]],
    jobs: int | None,
    limit_s: float,
    listen: Listener,
) -> list[list[_Ran]]:
    """For each scenario how each of its trials ended; the longest begin first."""
    ran = [[_Ran(None)] * len(some) for some in trials]
    done = [0] * len(chosen)
    places = [(at, k) for at, some in enumerate(trials) for k in range(len(some))]
    places.sort(key=lambda place: -trials[place[0]][place[1]].cost)
    with Workers(jobs) as workers:
        futures: dict[Future[_Ran], tuple[int, int]] = {
            workers.submit(partial(_run_trial, trials[at][k].run, limit_s), limit_s): (at, k)
            for at, k in places
        }
        for future in as_completed(futures):
            at, k = futures[future]
            ran[at][k] = _ended(future)
            done[at] += 1
            listen(chosen[at].name, done[at], len(trials[at]))
    return ran


def _run_trial(run: Callable[[], Outcome], limit_s: float) -> _Ran:
    """In a worker: the outcome with plain numbers."""
    begin_s = time.monotonic()
    try:
        with time_limit(limit_s):
            outcome = run()
        ended, reason = replace(outcome, values=_plain(outcome.values)), ""
    except MemoryError:  # after which the process is not to be trusted
        raise
    except Exception as error:
        ended, reason = None, reason_of(error)
    return _Ran(ended, reason, time.monotonic() - begin_s)


def _ended(future: Future[_Ran]) -> _Ran:
    try:
        return future.result()
    except WorkerDied as died:
        return _Ran(None, died.reason)


def _concluded(chosen: Chosen, trials: Sequence[Trial], ran: Sequence[_Ran]) -> ScenarioResult:
    """What came of one scenario."""
    well = [(trial, one.outcome) for trial, one in zip(trials, ran, strict=True) if one.outcome]
    failures = [
        (trial.label, one.reason)
        for trial, one in zip(trials, ran, strict=True)
        if one.outcome is None
    ]
    findings = Findings("No trial came to an end.", {}, ())
    if well or not trials:
        try:
            told = chosen.scenario.conclude(chosen.config, [outcome for _, outcome in well])
            findings = replace(told, numbers=_plain(told.numbers))
        except Exception as error:  # what the other scenarios found is not to be lost
            findings = Findings("Nothing can be concluded.", {}, ())
            failures.append(("conclusion", reason_of(error)))
    return ScenarioResult(
        name=chosen.name,
        title=chosen.scenario.title,
        config=chosen.config,
        rows=tuple({"trial": trial.label, **outcome.values} for trial, outcome in well),
        findings=findings,
        scenes=tuple(TrialScene(trial.label, end.motions) for trial, end in well if end.motions),
        engine=_plain(chosen.scenario.engine(chosen.config)),
        failures=tuple(failures),
        busy_s=sum(one.busy_s for one in ran),
    )


def _plain(row: Row) -> Row:
    """With Python's own numbers. Raises SlamsimError for one that is not finite."""
    return {key: _plain_value(key, value) for key, value in row.items()}


def _plain_value(key: str, value: Value) -> Value:
    plain: Value = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, float) and not math.isfinite(plain):
        raise SlamsimError(f"{key} came out as {plain}")
    return plain
