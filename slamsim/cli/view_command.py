"""``slamsim view`` as it is typed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from slamsim.cli.common import selection
from slamsim.console.options import (
    BaseFrame,
    CloudHeight,
    ImuTopic,
    OdomTopic,
    OverwriteFile,
    ScanTopic,
)

if TYPE_CHECKING:
    from slamsim.cameras.frames import EncodedFrame
    from slamsim.io.selection import Selection

EPILOG = (
    "Examples: slamsim view outputs/labyrinth --screenshot map.png · slamsim view my_rosbag2/ --web"
)


def view(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, a .rrd file, or any recording, unmapped.")
    ],
    web: Annotated[bool, typer.Option("--web", help="Serve it to a browser.")] = False,
    screenshot: Annotated[
        Path | None,
        typer.Option("--screenshot", metavar="FILE", help="Render to this PNG, without a screen."),
    ] = None,
    scan_topic: ScanTopic = None,
    odom_topic: OdomTopic = "",
    imu_topic: ImuTopic = "",
    base_frame: BaseFrame = "",
    cloud_height: CloudHeight = "",
    overwrite: OverwriteFile = False,
) -> None:
    """View a run, or a recording as it is, in Rerun."""
    from slamsim.run.naming import output_file

    with output_file(screenshot, overwrite=overwrite, inputs=(run,)) as picture:
        from slamsim.report.viewer.show import view_run

        wanted = selection(scan_topic, odom_topic, imu_topic, base_frame, cloud_height)
        with _shown(run, wanted) as rerun:
            view_run(rerun, web=web, screenshot=picture)


@contextmanager
def _shown(run: Path, wanted: Selection) -> Iterator[Path]:
    """What Rerun opens: the run itself, or for the block what a recording shows without a map.

    Raises what ``open_recording`` raises for what is neither.
    """
    is_run = run.is_dir() and (any(run.glob("*.rrd")) or not _holds_recording(run))
    if is_run or run.suffix.lower() == ".rrd":
        yield run
        return
    from slamsim.io.cameras import open_cameras
    from slamsim.io.formats.ros import is_ros
    from slamsim.io.open import open_recording
    from slamsim.report.viewer.images import MOST_IMAGES
    from slamsim.report.viewer.run import write_recording
    from slamsim.report.viewer.unmapped import unmapped
    from slamsim.run.naming import log_of

    log = open_recording(log_of(run), wanted).log()
    with TemporaryDirectory(prefix="slamsim-view-") as folder, ExitStack() as opened:
        images: Iterable[EncodedFrame] = ()
        if is_ros(log_of(run)):
            images = opened.enter_context(open_cameras(log_of(run))).thinned(MOST_IMAGES)
        write_recording(Path(folder) / "recording.rrd", unmapped(log), images)
        yield Path(folder) / "recording.rrd"


def _holds_recording(folder: Path) -> bool:
    from slamsim.run.naming import is_recording

    return is_recording(str(folder))
