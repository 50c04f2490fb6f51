"""``slamsim dataset make``: makes a data set from a recipe and reports progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.console.reporter import Reporter
from slamsim.dataset.catalogue.manifest import MANIFEST
from slamsim.dataset.make.engines.base import WorkEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.make.production import DatasetSummary
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import NotFound, SlamsimError, shown
from slamsim.guard.quantities import as_size, as_time
from slamsim.run.dataset.watch import ConsoleWatch


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
