"""Report of the checker as one self-contained HTML file: findings, numbers, plots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape
from itertools import cycle
from pathlib import Path
from textwrap import fill

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from slamsim.check.findings import CheckReport, Curve, Finding, Plot, Verdict
from slamsim.check.registry import fault_meaning
from slamsim.check.wording import headline, shown
from slamsim.core.types import FloatArray
from slamsim.guard.output import write_atomic
from slamsim.report.figures.frames import frames_figure
from slamsim.report.figures.palette import ESTIMATE, NEUTRAL, ODOMETRY, SCAN, TRUTH, WITHDRAWN
from slamsim.report.figures.run import CHART_IN, PAGE_INK, STYLE, Picture, svg
from slamsim.report.pages.html import Card, Table, cards, figure, gauge, page, pair, section, table

_COLOURS = (ESTIMATE, ODOMETRY, TRUTH, SCAN)
_CURVE_POINTS = 1500
_LABEL_LETTERS = 22
"""Of a line beside an upright axis, which is no longer than that."""
_MOST_FRAMES = 60
"""Of a tree with more, `slamsim info --out` draws the picture."""
_FOOTER = "Made by slamsim check. Every number, under stable keys, comes with --json."


def write_check_page(path: Path, report: CheckReport) -> None:
    """Raises what write_atomic raises."""
    write_atomic(path, check_page(report).encode())


def check_page(report: CheckReport) -> str:
    """The whole page: faults with their evidence, what is inconclusive and why, what is fine."""
    parts = [
        cards(_counts(report)),
        section("Faults", "".join(map(wrong, report.faults))),
        section("Inconclusive", _listed(report, "inconclusive")),
        section("Passed", _listed(report, "ok")),
        section("Evidence", _evidence(report)),
    ]
    return page(report.name, headline(report), "".join(parts), _FOOTER)


def _counts(report: CheckReport) -> list[Card]:
    counts = Counter(finding.verdict for finding in report.findings)
    return [
        Card("Faults", str(counts["fault"]), "findings"),
        Card("Inconclusive", str(counts["inconclusive"]), "questions without a clear answer"),
        Card("Fine", str(counts["ok"]), "questions"),
        Card("Checked in", f"{sum(report.seconds.values()):.1f} s", "all parts"),
    ]


def wrong(finding: Finding) -> str:
    """A fault with its number, its advice and its plots."""
    number = shown(finding.estimate, finding.limit)
    measured = f'<p class="note">{escape(number)}{_gauge(finding)}</p>' if number else ""
    return (
        f'<div class="warnings"><strong>{escape(fault_meaning(finding.fault or ""))}</strong> '
        f"({escape(finding.fault or '')}, {escape(finding.subject)})<br>{escape(finding.words)}."
        f"<br>{escape(finding.advice)}{measured}</div>{_plots(finding)}"
    )


def _listed(report: CheckReport, verdict: Verdict) -> str:
    rows = [
        (f.check, f.subject, Markup(escape(shown(f.estimate, f.limit))) + _gauge(f), f.words)
        for f in report.findings
        if f.verdict == verdict
    ]
    header = ("question", "about", "number", "in words")
    return table(Table(header, rows, words=True)) if rows else ""


def _gauge(finding: Finding) -> str:
    """The size beside its limit, of a finding that no plot shows."""
    if finding.plots or finding.estimate is None:
        return Markup("")
    return gauge(finding.estimate.interval, finding.limit)


def _evidence(report: CheckReport) -> str:
    plain = [one for one in report.findings if one.verdict != "fault"]
    drawn = [_tree(report), *(picture for finding in plain for picture in _pictures(finding))]
    return pair([one for one in drawn if one])


def _tree(report: CheckReport) -> str:
    """The transform tree, frames that a fault names in another colour."""
    if not report.frames or len(report.frames) > _MOST_FRAMES:
        return ""
    named = {word for one in report.faults for word in one.subject.split()}
    legend = [("fixed", NEUTRAL), ("moving", ESTIMATE)]
    if any(frame.name in named for frame in report.frames):
        legend.append(("named by a fault", WITHDRAWN))
    with rc_context(STYLE):
        drawn = svg(frames_figure(report.frames, PAGE_INK, named, CHART_IN), "frames")
    return figure(Picture(drawn, tuple(legend)), "Transform tree")


def _plots(finding: Finding) -> str:
    return pair(_pictures(finding))


def _pictures(finding: Finding) -> list[str]:
    return [
        figure(
            plot_picture(plot, f"{finding.check}-{finding.subject}-{number}"),
            plot.title[:1].upper() + plot.title[1:],
        )
        for number, plot in enumerate(finding.plots)
    ]


def plot_picture(plot: Plot, key: str) -> Picture:
    """One plot of a finding; key is unique in its page."""
    with rc_context(STYLE):
        drawn = Figure(figsize=(CHART_IN, 2.2), layout="constrained")
        axes = drawn.add_subplot()
        legend = []
        for curve, colour in zip(plot.curves, cycle(_COLOURS), strict=False):
            x, y = _thinned(curve)
            if curve.style == "line":
                axes.plot(x, y, color=colour, linewidth=0.9)
            else:
                size, alpha = (6.0, 1.0) if plot.row_names else (2.5, 0.6)
                axes.plot(x, y, ".", color=colour, markersize=size, alpha=alpha)
            legend.append((curve.label, colour))
        for begin, end in plot.spans:
            axes.axvspan(begin, end, color=NEUTRAL, alpha=0.3, linewidth=0.0)
        for limit in plot.limits:
            axes.axhline(limit, color=WITHDRAWN, linewidth=0.8, linestyle="--")
        if plot.limits:
            legend.append(("limit", WITHDRAWN))
        axes.grid(color=NEUTRAL, alpha=0.25, linewidth=0.5)
        if plot.row_names:
            axes.set_yticks(range(len(plot.row_names)), plot.row_names)
            axes.set_ylim(len(plot.row_names) - 0.5, -0.5)
            axes.set_xlim(left=0.0)
        else:
            axes.margins(x=0.0)
        axes.set_xlabel(plot.x_label)
        axes.set_ylabel(fill(plot.y_label, _LABEL_LETTERS))
        return Picture(svg(drawn, "".join(c if c.isalnum() else "-" for c in key)), tuple(legend))


def _thinned(curve: Curve) -> tuple[FloatArray, FloatArray]:
    """At most so many points as a plot can show, and only finite ones."""
    finite = np.flatnonzero(np.isfinite(curve.x) & np.isfinite(curve.y))
    every = max(finite.size // _CURVE_POINTS, 1)
    chosen = finite[::every]
    return curve.x[chosen], curve.y[chosen]


def verdicts(findings: Sequence[Finding]) -> str:
    """The table of findings in the report of a run."""
    rows = [
        (f.verdict, f.fault or f.check, f.subject, shown(f.estimate, f.limit), f.words)
        for f in findings
        if f.verdict != "ok"
    ]
    if not rows:
        return ""
    note = "A quick look at the recording itself; slamsim check takes a thorough one."
    header = ("verdict", "what", "about", "number", "in words")
    return table(Table(header, rows, words=True), note)
