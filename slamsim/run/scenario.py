"""``slamsim scenario``: run, report, and write a folder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.text import Text

from slamsim.config.base import Config
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.loading import Seeded, parts_of
from slamsim.console.reporter import Cell, Reporter, TimeColumn
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import partial_folder
from slamsim.run.scenario_folder import told, write_results
from slamsim.scenarios.base import ScenarioResult
from slamsim.scenarios.registry import Entry
from slamsim.scenarios.run import Chosen, Listener, run_scenarios
from slamsim.sim.robot.model import build_robot

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
    reporter.rows(Text(f"{result.title}: {result.findings.lead}", "bold"), rows)
    for label, reason in result.failures:
        reporter.warn(f"{result.name}, {label}: {reason}")
