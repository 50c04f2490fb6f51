"""``slamsim verify`` as it is typed."""

from __future__ import annotations

from typing import Annotated

import typer

from slamsim.console.options import Json, Quiet
from slamsim.guard.errors import DataDamaged

EPILOG = (
    "Exit code: 0 all files are unchanged, 4 some are not, 10 nothing to compare. "
    "Examples: slamsim verify outputs/labyrinth · slamsim verify my_data · slamsim verify a.mcap"
)


def verify(
    place: Annotated[
        str,
        typer.Argument(
            metavar="FOLDER",
            help="A folder that slamsim wrote or something in it, a data set, or a recording.",
            show_default=False,
        ),
    ],
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare files with their checksums, and list files without one."""
    from slamsim.console.reporter import Reporter
    from slamsim.run.verifying import verify_and_tell

    whole = verify_and_tell(place, Reporter(quiet=quiet, as_json=as_json))
    raise typer.Exit(0 if whole else DataDamaged.exit_code)
