"""``slamsim dataset make``: makes a data set from a recipe and reports progress."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from rich.progress import BarColumn, TextColumn

from slamsim.console.reporter import Reporter
from slamsim.dataset.catalogue.statistics import MANIFEST
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.make.production import DatasetSummary
from slamsim.dataset.make.shard import Tried
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import NotFound, SlamsimError, shown
from slamsim.guard.quantities import as_number, as_size, as_time


def run_make(
    recipe_name: str,
    count: int,
    out: str,
    reporter: Reporter,
    *,
    engine: str = "local",
    workers: int | None = None,
    scheduler: str | None = None,
    only: Sequence[int] | None = None,
) -> None:
    """Make it, or what is missing of it.

    Raises SlamsimError as ``make_dataset`` does, and, when all that can be made is there, if there
    are sequences that were given up.
    """
    recipe = _recipe(recipe_name)
    maker = _engine(engine, workers, scheduler, recipe.shard_sequences)
    with ConsoleWatch(reporter) as watch:
        summary = make_dataset(recipe, count, out, maker, watch, only=only, source=recipe_name)
    _tell(summary, reporter)


def _recipe(name: str) -> Recipe:
    """Raises what ``load_recipe`` raises; a URL is fetched first."""
    if "://" not in name:
        return load_recipe(name)
    address, _, file = name.rpartition("/")
    data = Location(address).read(file)
    if data is None:
        raise NotFound(f"{name} does not exist")
    with TemporaryDirectory(prefix="slamsim-recipe-") as folder:
        path = Path(folder) / file
        path.write_bytes(data)
        return load_recipe(str(path))


def _engine(
    name: str, workers: int | None, scheduler: str | None, shard_sequences: int
) -> WorkEngine:
    if name == "local":
        from slamsim.dataset.make.engines.local import LocalEngine

        if scheduler is not None:
            raise SlamsimError("--scheduler needs --engine dask")
        return LocalEngine(workers)
    if name == "dask":
        from slamsim.dataset.make.engines.dask import DaskEngine

        if scheduler is None or workers is not None:
            raise SlamsimError(
                "--engine dask needs --scheduler tcp://HOST:PORT and uses all of its workers"
            )
        return DaskEngine(scheduler, shard_sequences)
    raise SlamsimError(f"--engine {shown(name)}: choose local or dask")


def _tell(summary: DatasetSummary, reporter: Reporter) -> None:
    reporter.table(
        f"Data set {summary.address}",
        {
            "sequences": f"{summary.sequences}, {summary.made} made now",
            "simulated": f"{as_time(summary.simulated_s)} in {as_time(summary.wall_s)}",
            "written": as_size(summary.size_bytes),
            "failed": str(len(summary.failures)),
        },
    )
    for failure in summary.failures:
        reporter.warn(f"sequence {failure.index}: {failure.reason}; see it by: {failure.command}")
    reporter.result(asdict(summary))
    if summary.failures:
        raise SlamsimError(
            f"{len(summary.failures):,} of {summary.sequences:,} sequences could not be made: "
            f"reasons in {summary.address}/{MANIFEST}, traces in {summary.address}/logs; "
            "the same command tries them again"
        )


class ConsoleWatch:
    """A bar with sequences, simulated hours per hour, MB/s, time to go and failures.

    Rates are those of what this run made: sequences that were there before do not count.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self._shown = ExitStack()
        self._begun_s = 0.0
        self._total = self._done = self._made = self._failed = 0
        self._simulated_s = self._megabytes = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """What is stopped before it begins leaves nothing to go on from."""
        self._shown.close()
        if kind is not None and self._begun_s:
            self._reporter.note("Finished sequences stay; run the same command to resume.")

    def begin(self, total: int, already: int) -> None:
        self._total, self._done = total, already
        self._begun_s = time.monotonic()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[count]}"),
            TextColumn("{task.fields[told]}", style="cyan"),
        )
        self._bars = self._shown.enter_context(self._reporter.bars(*columns))
        self._task = self._bars.add_task("sequences", total=1, count="", told="")
        if already:
            self._reporter.note(f"{already} of {total} sequences are there already")
        self._show()

    def made(self, tried: Tried) -> None:
        row = tried.row or {}
        self._done += 1
        if tried.old:
            return
        self._made += 1
        self._simulated_s += float(str(row.get("quality.duration_s") or 0.0))
        self._megabytes += int(str(row.get("size_bytes") or 0)) * 1e-6
        self._show()

    def tried(self, index: int, reason: str, tries: int) -> None:
        self._reporter.warn(f"sequence {index}, try {tries}: {reason}")

    def failed(self, index: int, reason: str, command: str) -> None:
        self._failed += 1
        self._done += 1
        self._reporter.warn(f"sequence {index} failed for good: {reason}; see it by: {command}")
        self._show()

    def still(self) -> None:
        self._show()

    def catalogue(self) -> None:
        self._show()
        self._bars.add_task("catalogue", total=None, count="", told="manifest, card, figures, sums")

    def _show(self) -> None:
        elapsed_s = max(time.monotonic() - self._begun_s, 1e-3)
        told = [
            f"{as_number(self._simulated_s / elapsed_s, 3)} × real time",
            f"{as_number(self._megabytes / elapsed_s, 3)} MB/s",
            f"{as_time(elapsed_s)} gone",
        ]
        if self._made:
            to_go_s = (self._total - self._done) * elapsed_s / (self._made + self._failed)
            told.append(f"{as_time(to_go_s)} to go")
        if self._failed:
            told.append(f"{self._failed} failed")
        self._bars.update(
            self._task,
            completed=self._done,
            total=self._total,
            count=f"{self._done} of {self._total}",
            told=" · ".join(told),
        )
