"""``slamsim verify`` as it is typed."""

from __future__ import annotations

from typing import Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.guard.errors import DataDamaged

EPILOG = (
    "Exit code: 0 all files are unchanged, 4 some are not, 10 nothing to compare. "
    "Examples: slamsim verify outputs/labyrinth · slamsim verify my_data · slamsim verify a.mcap"
)


def verify(
    reporter: Reporter,
    place: Annotated[
        str,
        typer.Argument(
            metavar="FOLDER",
            help="A folder that slamsim wrote or something in it, a data set, or a recording.",
            show_default=False,
        ),
    ],
) -> None:
    """Compare files with their checksums, and list files without one."""
    from slamsim.run.verifying import verify_and_tell

    whole = verify_and_tell(place, reporter)
    raise typer.Exit(0 if whole else DataDamaged.exit_code)
