"""Trials side by side: the same whatever their number of workers, and none that harms another."""

from __future__ import annotations

import json
from typing import Any

import pytest
from scenario_stub import SCENARIO, StubConfig, Way

from slamsim.scenarios.base import ScenarioResult
from slamsim.scenarios.run import Chosen, run_scenarios


def run(jobs: int = 1, limit_s: float = 60.0, **settings: Any) -> ScenarioResult:
    (result,) = run_scenarios(
        [Chosen("stub", SCENARIO, StubConfig.model_validate(settings))],
        seed=3,
        jobs=jobs,
        limit_s=limit_s,
    )
    return result


def test_rows_are_the_same_bytes_for_any_number_of_workers_and_in_the_order_of_the_trials() -> None:
    one, two = run(jobs=1, trials=7), run(jobs=2, trials=7)

    assert json.dumps([dict(row) for row in one.rows]) == json.dumps([dict(r) for r in two.rows])
    assert [row["trial"] for row in one.rows] == [f"number {k}" for k in range(7)]
    assert one.findings.numbers == two.findings.numbers == {"largest": 36.0}
    assert [type(value) for value in one.rows[0].values()] == [str, int, float, float, bool]


@pytest.mark.long
def test_trials_that_fail_die_or_hang_are_told_of_and_the_others_go_on() -> None:
    ways: dict[str, Way] = {"0": "raises", "1": "dies", "2": "not finite", "4": "hangs"}
    result = run(jobs=2, limit_s=3.0, trials=6, ways=ways)

    failures = dict(result.failures)
    assert list(failures) == ["number 0", "number 1", "number 2", "number 4"]
    assert failures["number 0"] == "ValueError: no such square"
    assert failures["number 1"] == "its process was ended by SIGABRT"
    assert failures["number 2"] == "square came out as nan"
    assert failures["number 4"] == "it took longer than 3 s"
    assert [row["number"] for row in result.rows] == [3, 5]
    assert result.findings.numbers == {"largest": 25.0}


@pytest.mark.parametrize(
    ("settings", "summary"),
    [
        ({"trials": 1, "ways": {"0": "raises"}}, "No trial came to an end."),
        ({"trials": 1, "conclusive": False}, "Nothing can be concluded."),
    ],
)
def test_without_a_conclusion_what_was_found_is_still_there(
    settings: dict[str, Any], summary: str
) -> None:
    result = run(**settings)

    assert result.findings.summary == summary
    assert result.failures
    assert result.engine["time_step_s"] == 0.01
