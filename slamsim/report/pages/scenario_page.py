"""Report of the scenarios as one self-contained HTML file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape

from slamsim.config.dump import dump_commented_yaml
from slamsim.report.pages.html import details, page, section, warnings
from slamsim.report.pages.scenario_parts import (
    STYLE,
    chart_rows,
    mark,
    number_list,
    sheet_table,
    verdict_table,
    wide_table,
)
from slamsim.scenarios.base import ScenarioResult, Verdict

_FOOTER = (
    "Made by slamsim scenario. All numbers, under stable keys, are in report.json beside this "
    "file, the rows of all trials in the CSV files, the figures as PNG; slamsim view opens the "
    "recordings (.rrd)."
)


def scenario_page(results: Sequence[ScenarioResult], seed: int, versions: Mapping[str, str]) -> str:
    """The whole page: of several scenarios first what they say together."""
    several = len(results) > 1
    title = "The scenarios of the study" if several else results[0].title
    lead = _together(results) if several else results[0].findings.lead
    parts = [_summary(results)] if several else []
    parts += [_scenario(result, headed=several) for result in results]
    software = "\n".join(f"{name}: {version}" for name, version in versions.items())
    parts.append(section("Software", f"<p>Seed {seed}</p>" + details("Versions", software)))
    return page(title, lead, "".join(parts), _FOOTER, STYLE)


def _together(results: Sequence[ScenarioResult]) -> str:
    counts = Counter(verdict.holds for one in results for verdict in one.findings.verdicts)
    told = (
        f"{counts[True]} of {counts.total()} statements of the study, of theory and of our own hold"
    )
    unsure = f"; {counts[None]} cannot be judged by this run" if counts[None] else ""
    return f"{told}{unsure}."


def _summary(results: Sequence[ScenarioResult]) -> str:
    """A row for each scenario, and every target with its number."""
    rows = "".join(
        f'<tr><td><a href="#{escape(result.name)}">{escape(result.title)}</a></td>'
        f'<td class="dots">{_dots(result.findings.verdicts)}</td>'
        f"<td>{_share(result.findings.verdicts)}</td><td>{escape(result.findings.lead)}</td></tr>"
        for result in results
    )
    head = "<th>scenario</th><th>statements</th><th>hold</th><th>result</th>"
    overview = wide_table(head, rows)
    targets = [v for one in results for v in one.findings.verdicts if v.source == "target"]
    reached = f"<h3>Targets</h3>{verdict_table(targets)}" if targets else ""
    return f"<section>{overview}{reached}</section>"


def _scenario(result: ScenarioResult, headed: bool) -> str:
    findings = result.findings
    head = f"<h2>{escape(result.title)}</h2>" if headed else ""
    lead = f'<p class="lead">{escape(findings.lead)}</p>' if headed else ""
    body = (
        head
        + lead
        + warnings([f"{label}: {reason}" for label, reason in result.failures])
        + chart_rows(findings.charts, result.name)
        + (f"<h3>Verdicts</h3>{verdict_table(findings.verdicts)}" if findings.verdicts else "")
        + "".join(map(sheet_table, findings.sheets))
        + number_list("Numbers", findings.numbers)
        + number_list("Physics engine", result.engine)
        + details("Parameters", dump_commented_yaml(result.config))
    )
    return f'<section id="{escape(result.name)}">{body}</section>'


def _dots(verdicts: Sequence[Verdict]) -> str:
    return "".join(mark(verdict.holds) for verdict in verdicts)


def _share(verdicts: Sequence[Verdict]) -> str:
    return f"{sum(verdict.holds is True for verdict in verdicts)} of {len(verdicts)}"
