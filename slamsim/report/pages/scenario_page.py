"""Report of the scenarios as one self-contained HTML file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape

from slamsim.config.dump import dump_commented_yaml
from slamsim.report.figures.scenarios import DrawnSeries, SeriesStyle, chart_figure
from slamsim.report.pages.html import Table, details, page, section, table, warnings
from slamsim.scenarios.base import Chart, ResultTable, Row, ScenarioResult, Verdict

_FOOTER = (
    "Made by slamsim scenario. All numbers, under stable keys, are in report.json beside this "
    "file, the rows of all trials in the CSV files, the figures as PNG; slamsim view opens the "
    "recordings (.rrd)."
)


def scenario_page(results: Sequence[ScenarioResult], seed: int, versions: Mapping[str, str]) -> str:
    """The whole page: of several scenarios first what they say together."""
    several = len(results) > 1
    title = "The scenarios of the study" if several else results[0].title
    summary = _together(results) if several else results[0].findings.summary
    parts = [_summary(results)] if several else []
    parts += [_scenario(result, headed=several) for result in results]
    software = "\n".join(f"{name}: {version}" for name, version in versions.items())
    parts.append(section("Software", f"<p>Seed {seed}</p>" + details("Versions", software)))
    return page(title, summary, "".join(parts), _FOOTER, STYLE)


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
        f'<td class="dots">{"".join(mark(each.holds) for each in result.findings.verdicts)}</td>'
        f"<td>{_share(result.findings.verdicts)}</td><td>{escape(result.findings.summary)}</td></tr>"
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
    summary = f'<p class="lead">{escape(findings.summary)}</p>' if headed else ""
    body = (
        head
        + summary
        + warnings([f"{label}: {reason}" for label, reason in result.failures])
        + chart_rows(findings.charts, result.name)
        + (f"<h3>Verdicts</h3>{verdict_table(findings.verdicts)}" if findings.verdicts else "")
        + "".join(map(result_table, findings.tables))
        + number_list("Numbers", findings.numbers)
        + number_list("Physics engine", result.engine)
        + details("Parameters", dump_commented_yaml(result.config))
    )
    return f'<section id="{escape(result.name)}">{body}</section>'


def _share(verdicts: Sequence[Verdict]) -> str:
    return f"{sum(verdict.holds is True for verdict in verdicts)} of {len(verdicts)}"


STYLE = """
:root { --yes: #00785a; --no: #c2410c; }
@media (prefers-color-scheme: dark) { :root { --yes: #3cc79b; --no: #ff8f57; } }
main > section { margin-top: 3rem; padding-top: 0.5rem; border-top: 1px solid var(--line); }
main > section:first-child { border: 0; margin-top: 1rem; }
h2 { margin: 1rem 0 0.3rem; font-size: 1.4rem; letter-spacing: -0.01em; }
h3 { margin: 1.8rem 0 0.6rem; font-size: 0.95rem; }
section > .lead { margin: 0 0 1.2rem; max-width: 52rem; }
table.verdicts { width: 100%; }
.verdicts th, .verdicts td { text-align: left; white-space: normal; vertical-align: top; }
.verdicts td:nth-child(3) { color: var(--soft); white-space: nowrap; }
.verdicts .mark { width: 1.6rem; padding-right: 0.5rem; font-weight: 700; text-align: center; }
.yes { color: var(--yes); } .no { color: var(--no); } .open { color: var(--soft); }
.verdicts a { color: inherit; text-decoration-color: var(--line); text-underline-offset: 0.2em; }
main td:first-child { white-space: normal; min-width: 6.5rem; }
main .verdicts td.mark { min-width: 0; }
.dots { min-width: 4.5rem; overflow-wrap: anywhere; letter-spacing: 0.1em; }
.charts { display: grid; gap: 1rem; margin-top: 1rem; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(400px, 100%), 1fr)); }
.charts.small { grid-template-columns: repeat(auto-fill, minmax(min(320px, 100%), 1fr)); }
.charts figure:only-child { max-width: 720px; }
.legend svg { display: inline-block; width: 28px; height: 10px; margin-right: 0.35em;
  vertical-align: middle; }
"""
_MOST_ROWS = 12
_MARKS = {
    True: ("yes", "✓", "holds"),
    False: ("no", "✗", "does not hold"),
    None: ("open", "–", "cannot tell"),
}
_SOURCES = {"study": "study", "theory": "theory", "reality": "real robot", "target": "our target"}


def verdict_table(verdicts: Sequence[Verdict]) -> str:
    """Each with its mark, its source and the numbers it was judged by."""
    rows = "".join(
        f'<tr><td class="mark">{mark(verdict.holds)}</td><td>{escape(verdict.statement)}</td>'
        f"<td>{_SOURCES[verdict.source]}</td><td>{escape(verdict.numbers)}</td></tr>"
        for verdict in verdicts
    )
    head = '<th class="mark"></th><th>statement</th><th>source</th><th>here</th>'
    return wide_table(head, rows)


def wide_table(head: str, rows: str) -> str:
    """Of sentences. head, rows: HTML."""
    return (
        f'<div class="scroll"><table class="verdicts"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )


def mark(holds: bool | None) -> str:
    """A sign that is read aloud as words."""
    kind, sign, words = _MARKS[holds]
    return f'<span class="{kind}" role="img" aria-label="{words}" title="{words}">{sign}</span>'


def result_table(result: ResultTable) -> str:
    """With its title and note; a long one is folded away."""
    shown = table(Table(result.header, result.rows), result.note)
    if len(result.rows) <= _MOST_ROWS:
        return f"<h3>{escape(result.title)}</h3>{shown}"
    return f"<details><summary>{escape(result.title)}</summary>{shown}</details>"


def number_list(title: str, row: Row) -> str:
    """Folded away; nothing for an empty row."""
    return details(title, "\n".join(f"{key}: {value}" for key, value in row.items())) if row else ""


def chart_rows(charts: Sequence[Chart], key: str) -> str:
    """Figures side by side, maps smaller and below. key: unlike any other's in the page."""
    made = [
        (chart.grid is not None, _figure(chart, chart_figure(chart, f"{key}-{k}")))
        for k, chart in enumerate(charts, 1)
    ]
    rows = (
        ("charts", [figure for is_map, figure in made if not is_map]),
        ("charts small paper", [figure for is_map, figure in made if is_map]),
    )
    return "".join(f'<div class="{kind}">{"".join(row)}</div>' for kind, row in rows if row)


def _figure(chart: Chart, drawn: DrawnSeries) -> str:
    legend = "".join(f"<li>{_sample(look)}{escape(name)}</li>" for name, look in drawn.legend)
    note = f'<p class="note">{escape(chart.note)}</p>' if chart.note else ""
    return (
        f"<figure><figcaption>{escape(chart.title)}</figcaption>"
        f'<ul class="legend">{legend}</ul>{drawn.svg}{note}</figure>'
    )


def _sample(look: SeriesStyle) -> str:
    """A piece of the line with its marker."""
    colour = escape(look.page_colour)
    dash = " ".join(f"{part * 1.3:g}" for part in look.dash[1]) if look.dash else ""
    line = (
        f'<path d="M0 5H28" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"/>'
        if look.line
        else ""
    )
    shape = _SHAPES.get(look.marker, "")
    fill = "none" if look.hollow else colour
    marker = f'<path d="{shape}" fill="{fill}" stroke="{colour}"/>' if shape else ""
    return f'<svg viewBox="0 0 28 10" aria-hidden="true">{line}{marker}</svg>'


_SHAPES = {
    "o": "M14 1.5a3.5 3.5 0 1 0 .01 0z",
    "s": "M11 2h6v6h-6z",
    "^": "M14 1.5l3.8 6.8h-7.6z",
    "D": "M14 1l4 4-4 4-4-4z",
    "x": "M11 2l6 6M11 8l6-6",
    "v": "M14 8.5l3.8-6.8h-7.6z",
    "P": "M13 1.5h2v2.5h2.5v2h-2.5v2.5h-2v-2.5h-2.5v-2h2.5z",
    "X": "M11 2l6 6M11 8l6-6",
}
