"""What commands that take a configuration and make a run have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from slamsim.guard.errors import SlamsimError

if TYPE_CHECKING:
    from slamsim.config.run import RunConfig
    from slamsim.console.reporter import Reporter
    from slamsim.io.selection import Selection
    from slamsim.run.naming import Loaded
    from slamsim.run.stages import Report


def config_of(
    world: str | None,
    config: str | None,
    overrides: list[str] | None,
    seed: int | None,
    faults: list[str] | None = None,
) -> RunConfig:
    """The configuration that was asked for. Raises SlamsimError for one that cannot be."""
    from slamsim.config.faults import typed_choices
    from slamsim.config.loading import load_run_config

    loaded = load_run_config(world, config, overrides or (), seed)
    return loaded.model_copy(update={"faults": (*loaded.faults, *typed_choices(faults or ()))})


def loaded_config(
    world: str | None,
    config: str | None,
    overrides: list[str] | None,
    seed: int | None,
    faults: list[str] | None = None,
) -> Loaded[RunConfig]:
    """The configuration with the files that it is read from and that it names."""
    from slamsim.run.naming import loaded

    return loaded(lambda: config_of(world, config, overrides, seed, faults))


def selection(
    scan_topics: list[str] | None, odom_topic: str, imu_topic: str, base_frame: str
) -> Selection:
    """The part of a recording that was asked for."""
    from slamsim.io.selection import Selection

    return Selection(tuple(scan_topics or ()), odom_topic, imu_topic, base_frame)


def close_run(reporter: Reporter, report: Report, folder: Path) -> None:
    """Show what a run came to. Raises SlamsimError for one of which a stage failed."""
    from slamsim.console.summary import summary

    for warning in report.warnings:
        reporter.warn(warning)
    reporter.table(str(report.numbers["name"]), summary(report.numbers))
    reporter.say(f"Written to {folder}/")
    if report.mapped:
        reporter.say(f"Look at {folder}/report.html, or: slamsim view {folder}")
    reporter.result({**report.numbers, "folder": str(folder)})
    if report.failed:
        raise SlamsimError(
            f"{'; '.join(map(str, report.failed))}; what the stages before made is in {folder}/"
        )
