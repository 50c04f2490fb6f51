"""Output folder of a scenario run: rows, numbers, figures, recordings, the page."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from io import StringIO
from pathlib import Path

from slamsim.config.base import Config
from slamsim.config.dump import dump_commented_yaml
from slamsim.core.types import FloatArray
from slamsim.dataset.make.versions import versions
from slamsim.guard.output import write_atomic
from slamsim.report.figures.scenarios import pictures
from slamsim.report.pages.scenario_page import scenario_page
from slamsim.report.viewer.scenarios import write_scenes
from slamsim.run.folder import REPORT, REPORT_JSON
from slamsim.scenarios.base import Row, ScenarioResult, Series
from slamsim.simulation.own_files import CONFIG, with_own_files


def write_results(
    folder: Path, results: Sequence[ScenarioResult], whole: Config, seed: int
) -> None:
    """All files of a run. whole: its parameters, as they were loaded."""
    write_atomic(folder / CONFIG, dump_commented_yaml(with_own_files(folder, whole)).encode())
    for result in results:
        write_atomic(folder / f"{result.name}.csv", rows_as_csv(result.rows).encode())
        for name, picture in pictures(result.findings.charts, result.name).items():
            write_atomic(folder / name, picture)
        if result.scenes:
            write_scenes(folder / f"{result.name}.rrd", result)
    numbers = json.dumps(told(results, seed), indent=1, allow_nan=False)
    write_atomic(folder / REPORT_JSON, f"{numbers}\n".encode())
    write_atomic(folder / REPORT, scenario_page(results, seed, versions()).encode())


def rows_as_csv(rows: Sequence[Row]) -> str:
    """With a column for every key that any row has; nothing where a row has none."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = StringIO()
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def told(
    results: Sequence[ScenarioResult], seed: int, *, with_rows: bool = True
) -> dict[str, object]:
    """The contents of ``report.json``, under stable keys."""
    return {
        "seed": seed,
        "versions": dict(versions()),
        "verdicts": _counts(results),
        "trials_failed": sum(len(result.failures) for result in results),
        "scenarios": {result.name: _told(result, with_rows) for result in results},
    }


def _told(result: ScenarioResult, with_rows: bool) -> dict[str, object]:
    findings = result.findings
    return {
        "title": result.title,
        "lead": findings.lead,
        "numbers": dict(findings.numbers),
        "verdicts": [
            {
                "statement": verdict.statement,
                "source": verdict.source,
                "holds": verdict.holds,
                "numbers": verdict.numbers,
            }
            for verdict in findings.verdicts
        ],
        "failures": [{"trial": label, "reason": reason} for label, reason in result.failures],
        "engine": dict(result.engine),
        "config": result.config.model_dump(mode="json"),
        "busy_s": result.busy_s,
        **(_raw(result) if with_rows else {}),
    }


def _raw(result: ScenarioResult) -> dict[str, object]:
    """What stands in the file alone: rows of trials, tables and curves of the page."""
    findings = result.findings
    return {
        "rows": [dict(row) for row in result.rows],
        "sheets": [asdict(sheet) for sheet in findings.sheets],
        "charts": [
            {
                "title": chart.title,
                "x_label": chart.x_label,
                "y_label": chart.y_label,
                "series": [_curve(series) for series in chart.series],
            }
            for chart in findings.charts
        ],
    }


def _curve(series: Series) -> dict[str, object]:
    return {
        "name": series.name,
        "who": series.who,
        "x": _finite(series.x),
        "y": _finite(series.y),
        "spread": None if series.spread is None else [_finite(five) for five in series.spread],
    }


def _finite(values: FloatArray) -> list[float | None]:
    """Seven digits, which any drawing is content with; nothing where a line breaks."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values.tolist()]


def _counts(results: Sequence[ScenarioResult]) -> dict[str, int]:
    counts = Counter(verdict.holds for result in results for verdict in result.findings.verdicts)
    return {"hold": counts[True], "do_not_hold": counts[False], "cannot_tell": counts[None]}
