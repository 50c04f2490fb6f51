"""``slamsim recover`` as it is typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Overwrite

EPILOG = "Example: slamsim recover my_rosbag2/ --out whole/"


def recover(
    reporter: Reporter,
    source: Annotated[
        Path,
        typer.Argument(
            help="A truncated or damaged recording: rosbag2, MCAP, .db3, ROS 1, CARMEN, Parquet, "
            "also packed (.gz, .bz2, .zst); or the output folder of a killed run.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FOLDER",
            help="New folder for it; one under outputs/ by default.",
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Recover all intact messages of a truncated or damaged recording."""
    from slamsim.io.salvage.source import damaged_recording
    from slamsim.run.naming import output_folder, recording_name

    damaged = damaged_recording(source)
    inputs = (damaged.path, source if source.exists() else None)
    name = f"{recording_name(str(source))}_recovered"
    with output_folder(out, name, overwrite=overwrite, inputs=inputs) as folder:
        from slamsim.run.recovering import recover_log

        recover_log(damaged, folder, reporter, overwrite=overwrite)
