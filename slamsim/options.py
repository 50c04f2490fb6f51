"""Options that several commands of the command line share."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from slamsim.safe.errors import OverrideRefused, shown
from slamsim.safe.output import claimed_folder

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")


def local_path(text: str) -> Path:
    """Where a command writes that knows this machine only. Raises OverrideRefused for a URL.

    As a path it would be a folder of the name ``s3:``.
    """
    if _URL.match(text):
        reason = "is a URL, and this command writes to folders of this machine alone"
        raise OverrideRefused(shown(text, 200), reason)
    return Path(text)


def _refuse_taken(context: typer.Context, out: Path | None) -> Path | None:
    """Refuse a folder that is taken before anything else is done."""
    if out is not None and not context.resilient_parsing:
        with claimed_folder(out, context.params.get("overwrite", False)):
            pass
    return out


Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY.PATH=VALUE", help="Override one setting; may be repeated."),
]
ConfigFile = Annotated[
    str | None, typer.Option("--config", "-c", help="YAML with settings for robot, sensors, slam.")
]
Faults = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="NAME[:SIZE]",
        help="What shall be wrong; may be repeated. slamsim fault --list tells what there is.",
    ),
]
Jobs = Annotated[
    int | None, typer.Option("--jobs", "-j", help="How many processes; all cores.", min=1)
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no table.")]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON on stdout.")]
ScanTopic = Annotated[
    str | None, typer.Option("--scan-topic", help="Which laser, if a recording has several.")
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        is_eager=True,  # known when --out is looked at
        help="Replace the folder of an earlier run once this is whole.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FOLDER",
        parser=local_path,
        callback=_refuse_taken,
        help="Folder of the run; a new one under outputs/ by default.",
    ),
]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of everything random.", min=0)]
