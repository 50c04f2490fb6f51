"""What commands that take a configuration and make a run have in common."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

import typer

from slamsim.console.options import (
    BaseFrame,
    CloudHeight,
    ImuTopic,
    Json,
    OdomTopic,
    Quiet,
    ScanTopic,
)
from slamsim.guard.errors import OverrideRefused, SlamsimError, shown
from slamsim.guard.quantities import as_count

if TYPE_CHECKING:
    from slamsim.config.run import RunConfig
    from slamsim.console.reporter import Reporter
    from slamsim.io.selection import Selection
    from slamsim.run.naming import Loaded
    from slamsim.run.stages import Report
else:  # imported when a command runs, so that help is instant
    Reporter = Selection = object

__all__ = ("Reporter", "Selection")

Command = TypeVar("Command", bound=Callable[..., Any])

_TYPED: Mapping[str, Mapping[str, tuple[Any, object]]] = {
    "reporter": {"quiet": (Quiet, False), "as_json": (Json, False)},
    "wanted": {
        "scan_topics": (ScanTopic, None),
        "odom_topic": (OdomTopic, ""),
        "imu_topic": (ImuTopic, ""),
        "base_frame": (BaseFrame, ""),
        "cloud_height": (CloudHeight, ""),
    },
}
"""As which options, with their defaults, these parameters of commands are typed."""

WARNINGS_TOLD = 3
"""At the end of a run; the report and --verbose have all."""


class Commands(typer.Typer):
    """Commands of typer, whose ``wanted`` and ``reporter`` are each typed as several options."""

    def command(self, *args: Any, **named: Any) -> Callable[[Command], Command]:
        register = super().command(*args, **named)

        def add(function: Command) -> Command:
            register(_typed(function))
            return function

        return add


def _typed(function: Callable[..., Any]) -> Callable[..., Any]:
    hints, asked = get_type_hints(function, include_extras=True), signature(function).parameters
    bundled = [name for name in _TYPED if name in asked]
    taken = []
    for name in sorted(asked, key="reporter".__eq__):  # --quiet and --json come last
        options = _TYPED.get(name, {name: (hints[name], asked[name].default)})
        taken += [
            Parameter(option, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for option, (annotation, default) in options.items()
        ]

    @wraps(function)
    def called(**given: Any) -> object:
        for name in bundled:
            options = {option: given.pop(option) for option in _TYPED[name]}
            given[name] = (_reporter if name == "reporter" else selection)(**options)
        return function(**given)

    vars(called)["__signature__"] = Signature(taken)
    called.__annotations__ = {each.name: each.annotation for each in taken}
    return called


def _reporter(**options: bool) -> Reporter:
    from slamsim.console.reporter import Reporter

    return Reporter(**options)


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
    *,
    drive_seed: int | None = None,
) -> Loaded[RunConfig]:
    """The configuration with the files that it is read from and that it names."""
    from slamsim.config.loading import with_drive_seed
    from slamsim.run.naming import loaded

    def load() -> RunConfig:
        config_ = config_of(world, config, overrides, seed, faults)
        return config_ if drive_seed is None else with_drive_seed(config_, drive_seed)

    return loaded(load)


def selection(
    scan_topics: list[str] | None,
    odom_topic: str,
    imu_topic: str,
    base_frame: str,
    cloud_height: str = "",
) -> Selection:
    """The part of a recording that was asked for. Raises OverrideRefused."""
    from slamsim.io.selection import Selection

    topics = tuple(scan_topics or ())
    return Selection(topics, odom_topic, imu_topic, base_frame, _heights_m(cloud_height))


def _heights_m(typed: str) -> tuple[float, float] | None:
    """Of ``--cloud-height LOW,HIGH``."""
    if not typed:
        return None
    try:
        low, high = (float(part) for part in typed.split(","))
    except ValueError:
        low = high = math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        reason = "two heights in metres, the lower one first, as in 0.1,0.8"
        raise OverrideRefused(f"--cloud-height {shown(typed)}", reason)
    return low, high


def close_run(reporter: Reporter, report: Report, folder: Path, *, verbose: bool = False) -> None:
    """Show what a run came to: the numbers, the verdict, and the warnings that weigh most; with
    verbose all of them.

    Raises SlamsimError for one of which a stage failed, or that does not continue a map as asked.
    """
    from slamsim.console.summary import summary

    if verbose:
        for warning in report.warnings:
            reporter.warn(warning)
    reporter.table(str(report.numbers["name"]), summary(report.numbers))
    reporter.say(f"Written to {folder}/")
    if report.mapped:
        reporter.say(f"Look at {folder}/report.html, or: slamsim view {shlex.quote(str(folder))}")
    _tell_verdict(reporter, report, verbose)
    reporter.result({**report.numbers, "folder": str(folder)})
    if report.unjoined:
        raise SlamsimError(report.unjoined)
    if report.failed:
        raise SlamsimError(
            f"{'; '.join(map(str, report.failed))}; what the stages before made is in {folder}/"
        )


def _tell_verdict(reporter: Reporter, report: Report, verbose: bool) -> None:
    if report.verdict:
        reporter.say(report.verdict)
    told = report.weighed or report.warnings
    if verbose or not told:
        return
    for warning in told[:WARNINGS_TOLD]:
        reporter.warn(warning)
    if len(told) > WARNINGS_TOLD:
        page = ", report.html" if report.mapped else ""
        more = as_count(len(told) - WARNINGS_TOLD, "lesser warning")
        reporter.note(f"{more}: --verbose{page}")
