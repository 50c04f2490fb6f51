"""``slamsim fault``: its options."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter, Selection
from slamsim.console.options import (
    Faults,
    Lossy,
    Overwrite,
)

Source = Annotated[Path | None, typer.Argument(help="A recording: rosbag2, MCAP, ROS 1, CARMEN.")]
List = Annotated[bool, typer.Option("--list", help="List the faults that come with the package.")]


def fault(
    reporter: Reporter,
    source: Source = None,
    out: Annotated[Path | None, typer.Argument(help="Folder for the copy.")] = None,
    faults: Faults = None,
    list_: List = False,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the random numbers.", min=0)] = 0,
    *,
    wanted: Selection,
    lossy: Lossy = False,
    overwrite: Overwrite = False,
) -> None:
    """Copy a recording and inject known faults, to test a checker or a SLAM system.

    What the faults do not touch is copied byte for byte.
    """
    from slamsim.config.faults import typed_choices
    from slamsim.run.naming import output_folder

    if list_:
        from slamsim.run.fixing import fault_facts, fault_table

        reporter.table("Faults", fault_table())
        reporter.result({"faults": fault_facts()})
        return
    if source is None or out is None or not faults:
        raise typer.BadParameter("give a recording, a folder and at least one --fault, or --list")
    choices = typed_choices(faults)
    own = (Path(choice.name) for choice in choices if Path(choice.name).is_file())
    with output_folder(out, "", overwrite=overwrite, inputs=(source, *own)):
        from slamsim.run.fixing import inject_faults

        injected, copied = inject_faults(
            source,
            out,
            choices,
            seed=seed,
            wanted=wanted,
            lossy=lossy,
            overwrite=overwrite,
        )
    reporter.table(str(out), {one.name: one.title for one in injected})
    for sentence in copied.sentences():
        reporter.say(sentence)
    facts = [one.model_dump(mode="json") for one in injected]
    reporter.result({"folder": str(out), "faults": facts, "copied": asdict(copied)})
