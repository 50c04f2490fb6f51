"""Options that several commands of the command line share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
Lossy = Annotated[
    bool,
    typer.Option("--lossy", help="Go on where the copy cannot hold all that the recording holds."),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite", help="Replace what an earlier run left under this name, once this is whole."
    ),
]
OverwriteFile = Annotated[
    bool, typer.Option("--overwrite", help="Replace the file that is to be written if it is there.")
]
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder of the run; a new one under outputs/ by default."),
]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of everything random.", min=0)]
