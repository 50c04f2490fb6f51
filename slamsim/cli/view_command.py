"""``slamsim view`` as it is typed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from slamsim.cli.common import Selection
from slamsim.console.options import (
    OverwriteFile,
)

if TYPE_CHECKING:
    from slamsim.io.selection import Selection

EPILOG = (
    "Examples: slamsim view outputs/labyrinth --screenshot map.png · slamsim view my_rosbag2/ --web"
)


def view(
    run: Annotated[
        Path,
        typer.Argument(
            help="Folder of a run, a .rrd file, or any recording or folder of images, unmapped."
        ),
    ],
    web: Annotated[bool, typer.Option("--web", help="Serve it to a browser.")] = False,
    screenshot: Annotated[
        Path | None,
        typer.Option("--screenshot", metavar="FILE", help="Render to this PNG, without a screen."),
    ] = None,
    *,
    wanted: Selection,
    overwrite: OverwriteFile = False,
) -> None:
    """View a run, or a recording as it is, in Rerun."""
    from slamsim.run.naming import output_file

    with output_file(screenshot, overwrite=overwrite, inputs=(run,)) as picture:
        from slamsim.report.viewer.show import view_run

        with _shown(run, wanted) as rerun:
            view_run(rerun, web=web, screenshot=picture)


@contextmanager
def _shown(run: Path, wanted: Selection) -> Iterator[Path]:
    """What Rerun opens: the run itself, or for the block what a recording shows without a map.

    Raises what ``open_recording`` raises for what is neither.
    """
    is_drawn = run.is_dir() and any(run.glob("*.rrd"))
    is_run = run.is_dir() and not _holds_recording(run) and not _holds_images(run)
    if is_drawn or is_run or run.suffix.lower() == ".rrd":
        yield run
        return
    from slamsim.run.cameras.viewing import write_unmapped

    with TemporaryDirectory(prefix="slamsim-view-") as folder:
        write_unmapped(run, wanted, Path(folder) / "recording.rrd")
        yield Path(folder) / "recording.rrd"


def _holds_images(folder: Path) -> bool:
    from slamsim.io.cameras import is_image_folder

    return is_image_folder(folder)


def _holds_recording(folder: Path) -> bool:
    from slamsim.run.naming import is_recording

    return is_recording(str(folder))
