"""``slamsim scenario`` as it is typed."""

from __future__ import annotations

from typing import Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Jobs, Out, Overwrite, Seed, Set
from slamsim.scenarios.registry import ALL, ENTRIES

_LINES = "\n".join(f"[bold]{entry.name}[/bold]: {entry.asks}" for entry in ENTRIES)
HELP = (
    "Run scenarios of the reference study, and compare with Unity, Gazebo, a real robot and theory."
    f"\n\n\b\n{_LINES}\n[bold]{ALL}[/bold]: the nine in one report"
)
EPILOG = (
    "Exit code: 0 all trials ran, whatever their results; 1 a trial failed. "
    "Examples: slamsim scenario all · slamsim scenario stacking --set max_boxes=12 · "
    "slamsim scenario all --set ramp.robot=sturdy"
)


def scenario(
    reporter: Reporter,
    name: Annotated[
        str,
        typer.Argument(metavar="NAME|all", help="Name of a scenario, or all.", show_default=False),
    ],
    out: Out = None,
    seed: Seed = None,
    set_: Set = None,
    config: Annotated[
        str | None,
        typer.Option("--config", "-c", help="YAML with parameters of the scenario."),
    ] = None,
    jobs: Jobs = None,
    overwrite: Overwrite = False,
) -> None:
    from slamsim.config.scenarios.loading import load_scenarios
    from slamsim.run.naming import loaded, output_folder
    from slamsim.scenarios.registry import find_entries

    entries = find_entries(name)
    types = {entry.key: entry.config_type() for entry in entries}
    read = loaded(lambda: load_scenarios(types, config, set_ or (), seed))
    key = entries[0].key if len(entries) == 1 else ALL
    name = f"scenario_{key}"
    with output_folder(out, name, overwrite=overwrite, inputs=read.files) as folder:
        from slamsim.run.scenario import run_and_report

        run_and_report(entries, read.config, folder, reporter, jobs=jobs, overwrite=overwrite)
