"""What the scenarios came to, as one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slamsim.scenarios.base import ScenarioResult
from slamsim.view.page import Table, page, section, table

_FOOTER = "Made by slamsim scenario. All numbers, under stable keys, are in report.json."


def scenario_page(results: Sequence[ScenarioResult], seed: int, versions: Mapping[str, str]) -> str:
    """The whole page."""
    body = "".join(
        section(
            result.title,
            table(
                Table(
                    ("", "statement", "numbers"),
                    [(str(v.holds), v.statement, v.numbers) for v in result.findings.verdicts],
                )
            ),
        )
        for result in results
    )
    return page("Scenarios", f"Seed {seed}", body, _FOOTER)
