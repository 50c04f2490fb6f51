"""``slamsim fault``: its options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.options import Faults, Json, Overwrite, Quiet, ScanTopic, local_path


def fault(
    source: Annotated[
        Path | None, typer.Argument(help="A recording: rosbag2, MCAP, ROS 1, CARMEN.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT", parser=local_path, help="Folder for the spoilt copy."),
    ] = None,
    faults: Faults = None,
    list_: Annotated[
        bool, typer.Option("--list", help="Tell all faults that come with the package.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", help="Seed of what is random.", min=0)] = 0,
    scan_topic: ScanTopic = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Copy a recording and spoil it with known faults, to try a checker or a SLAM on them."""
    from slamsim.config.faults import typed_choices
    from slamsim.console import Reporter
    from slamsim.safe.output import claimed_folder

    reporter = Reporter(quiet=quiet, as_json=as_json)
    if list_:
        from slamsim.run.faulting import fault_facts, fault_table

        reporter.table("Faults", fault_table())
        reporter.result({"faults": fault_facts()})
        return
    if source is None or out is None or not faults:
        raise typer.BadParameter("give a recording, a folder and at least one --fault, or --list")
    choices = typed_choices(faults)
    with claimed_folder(out, overwrite):
        from slamsim.run.faulting import spoil_recording

        spoilt = spoil_recording(
            source, out, choices, seed=seed, scan_topic=scan_topic, overwrite=overwrite
        )
    reporter.table(str(out), {one.name: one.title for one in spoilt})
    reporter.result({"folder": str(out), "faults": [one.model_dump(mode="json") for one in spoilt]})
