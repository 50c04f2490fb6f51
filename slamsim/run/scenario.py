"""``slamsim scenario`` and ``slamsim identify``: run or fit, report, and write a folder."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.text import Text

from slamsim.config.base import Config
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.measurements import MeasurementsConfig
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.loading import Seeded, parts_of
from slamsim.config.scenarios.robots import SCENARIO_PHYSICS
from slamsim.console.reporter import Cell, Reporter, TimeColumn
from slamsim.core.types import FloatArray
from slamsim.dataset.make.identity import versions
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import partial_folder, write_atomic
from slamsim.report.figures.scenarios import pictures
from slamsim.report.pages.scenario_page import scenario_page
from slamsim.report.viewer.scenarios import write_scenes
from slamsim.run.folder import REPORT, REPORT_JSON
from slamsim.scenarios.base import Row, ScenarioResult, Series
from slamsim.scenarios.identify.findings import identification_found
from slamsim.scenarios.identify.findings import robot_file as written
from slamsim.scenarios.identify.identify import Identified
from slamsim.scenarios.identify.identify import identify as identified
from slamsim.scenarios.registry import Entry
from slamsim.scenarios.run import Chosen, Listener, run_scenarios
from slamsim.sim.engine import engine_parameters
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.own_files import CONFIG, with_own_files

_MARKS = {True: ("✓", "green"), False: ("✗", "red"), None: ("–", "dim")}


def run_and_report(
    entries: Sequence[Entry],
    whole: Seeded,
    folder: Path,
    reporter: Reporter,
    *,
    jobs: int | None = None,
    overwrite: bool = False,
) -> None:
    """Run these scenarios and leave a folder with report, figures and rows.

    whole: as ``load_scenarios`` gives it. Raises InputRefused for a robot, and SlamsimError, once
    everything is written, if trials failed.
    """
    types = {entry.key: entry.config_type() for entry in entries}
    parts = parts_of(types, whole)
    chosen = [Chosen(entry.key, entry.scenario(), parts[entry.key]) for entry in entries]
    _refuse_robots(parts.values())
    with partial_folder(folder, overwrite) as partial:
        with _bars(reporter, entries) as listen:
            results = run_scenarios(chosen, whole.seed, jobs=jobs, listen=listen)
        write_results(partial, results, whole, whole.seed)
    for result in results:
        tell(result, reporter)
    shown = [
        f", or: slamsim view {folder}/{result.name}.rrd" for result in results if result.scenes
    ]
    reporter.say(f"Look at {folder}/report.html{''.join(shown[:1])}")
    reporter.result({**told(results, whole.seed, with_rows=False), "folder": str(folder)})
    if failed := sum(len(result.failures) for result in results):
        raise SlamsimError(f"{failed} trials failed: reasons in {folder}/report.json")


def _refuse_robots(parts: Iterable[Config]) -> None:
    """A robot that cannot be built is told of once, not by each of its trials."""
    for part in parts:
        robot = getattr(part, "robot", None)
        if isinstance(robot, RobotConfig):
            build_robot(robot)


@contextmanager
def _bars(reporter: Reporter, entries: Sequence[Entry]) -> Iterator[Listener]:
    """A bar for each scenario."""
    columns = (
        TextColumn("{task.description:<14}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("trials"),
        TimeColumn(),
    )
    with reporter.bars(*columns) as bars:
        tasks: dict[str, Any] = {
            entry.key: bars.add_task(entry.name, total=None) for entry in entries
        }

        def listen(name: str, done: int, total: int) -> None:
            bars.update(tasks[name], completed=done, total=total)

        yield listen


def tell(result: ScenarioResult, reporter: Reporter) -> None:
    """The verdicts, each with its mark and its numbers."""
    rows: list[tuple[Cell, ...]] = []
    for verdict in result.findings.verdicts:
        mark, style = _MARKS[verdict.holds]
        rows.append((((mark, style),), ((verdict.statement, ""),), ((verdict.numbers, "dim"),)))
    reporter.rows(Text(f"{result.title}: {result.findings.summary}", "bold"), rows)
    for label, reason in result.failures:
        reporter.warn(f"{result.name}, {label}: {reason}")


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
        "lead": findings.summary,
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
        "sheets": [asdict(table) for table in findings.tables],
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
        "who": series.source,
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


SEED = 0
"""All random numbers of an identification are always the same."""


def identify_and_report(
    config: MeasurementsConfig,
    command: str,
    folder: Path,
    reporter: Reporter,
    *,
    robot_file: Path | None = None,
    jobs: int | None = None,
    overwrite: bool = False,
) -> None:
    """Raises SlamsimError. command: what was typed; robot_file: where else the robot is to go."""
    with partial_folder(folder, overwrite) as partial:
        found = _identified(config, reporter, jobs)
        result = ScenarioResult(
            name="identify",
            title=f"Identification of {config.name}",
            config=config,
            rows=found.rows,
            findings=identification_found(found),
            scenes=(),
            engine=engine_parameters(SCENARIO_PHYSICS),
        )
        robot = written(found, command).encode()
        write_results(partial, [result], config, SEED)
        write_atomic(partial / f"{found.robot.name}.yaml", robot)
        if robot_file is not None:
            write_atomic(robot_file, robot)
    tell(result, reporter)
    reporter.say(f"The robot: {folder / f'{found.robot.name}.yaml'}")
    reporter.say(f"Look at {folder}/report.html")
    reporter.result({**told([result], SEED, with_rows=False), "folder": str(folder)})


def _identified(config: MeasurementsConfig, reporter: Reporter, jobs: int | None) -> Identified:
    columns = (TextColumn("{task.description:<14}"), BarColumn(bar_width=30), TimeColumn())
    with reporter.bars(*columns) as bars:
        task = bars.add_task("fit", total=1.0)

        def listen(stage: str, share: float) -> None:
            bars.update(task, description=stage, completed=share)

        return identified(config, jobs=jobs, listen=listen)
