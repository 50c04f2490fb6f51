"""``slamsim bench``: which part measures what, and its options."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamsim.options import ConfigFile, Json, Quiet, Set

if TYPE_CHECKING:
    from slamsim.config.run import RunConfig
    from slamsim.console import Reporter

SPEED_SECONDS = 120.0
STANDARD = "labyrinth_10hz"
"""The setting of the accuracy bench when neither a world nor a configuration is named."""


def bench(
    part: Annotated[
        str, typer.Argument(help="sense, drive, simulate, slam, all (speed); accuracy.")
    ] = "all",
    world: Annotated[
        str | None,
        typer.Option(help=f"World to measure in: labyrinth; accuracy: the preset {STANDARD}."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help=f"Simulated time; speed: {SPEED_SECONDS:g} s.", min=5)
    ] = None,
    repeats: Annotated[int, typer.Option(help="Speed: best of so many.", min=1)] = 3,
    seeds: Annotated[int, typer.Option(help="Accuracy: how many seeds.", min=1)] = 20,
    first_seed: Annotated[int, typer.Option(help="Accuracy: the first of them.", min=0)] = 1,
    path: Annotated[
        float | None, typer.Option(help="Accuracy: end after so many metres.", min=1)
    ] = None,
    workers: Annotated[int, typer.Option(help="Accuracy: runs at a time.", min=1, max=64)] = 1,
    logs: Annotated[
        Path | None, typer.Option(help="Accuracy: keep simulated logs here, and use them again.")
    ] = None,
    set_: Set = None,
    config: ConfigFile = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure speed, as ratios taken in one run on this machine; or accuracy over many seeds."""
    from slamsim.console import Reporter

    reporter = Reporter(quiet=quiet, as_json=as_json)
    limits = _limits(seconds, path)
    if part == "accuracy":
        from slamsim.bench.accuracy import Campaign, run_accuracy

        resolved = _accuracy_config(world, config, [*limits, *(set_ or ())])
        wanted = range(first_seed, first_seed + seeds)
        reporter.result(run_accuracy(Campaign(resolved, wanted, workers, logs), reporter))
        return
    _speed(part, world or "labyrinth", seconds or SPEED_SECONDS, repeats, reporter)


def _limits(seconds: float | None, path_m: float | None) -> list[str]:
    """Where a drive ends, as overrides."""
    limits = []
    if seconds is not None:
        limits.append(f"drive.route.max_duration_s={float(seconds)}")
    if path_m is not None:
        limits.append(f"drive.route.max_path_length_m={float(path_m)}")
    return limits


def _accuracy_config(world: str | None, config: str | None, overrides: list[str]) -> RunConfig:
    from slamsim.config.loading import load_run_config

    standard = world is None and config is None
    return load_run_config(world, STANDARD if standard else config, overrides)


def _speed(part: str, world: str, seconds: float, repeats: int, reporter: Reporter) -> None:
    from slamsim.bench.speed import run_bench
    from slamsim.summary import flat

    figures = run_bench(part, world, seconds, repeats, reporter)
    reporter.table("Bench", flat(figures))
    reporter.result(figures)
