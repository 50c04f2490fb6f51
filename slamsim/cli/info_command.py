"""``slamsim info`` as it is typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter, selection
from slamsim.console.options import (
    BaseFrame,
    CloudHeight,
    ImuTopic,
    OdomTopic,
    OverwriteFile,
    ScanTopic,
)
from slamsim.guard.errors import OutputRefused

EPILOG = "Examples: slamsim info my_rosbag2/ · slamsim info my.mcap --out frames.svg"


def info(
    reporter: Reporter,
    source: Annotated[
        Path,
        typer.Argument(
            help="A recording: rosbag2, MCAP, ROS 1, CARMEN, Parquet.", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Draw the transform tree: .svg or .png."),
    ] = None,
    scan_topic: ScanTopic = None,
    odom_topic: OdomTopic = "",
    imu_topic: ImuTopic = "",
    base_frame: BaseFrame = "",
    cloud_height: CloudHeight = "",
    overwrite: OverwriteFile = False,
) -> None:
    """Show what is in a recording, what slamsim would use of it, and what is missing."""
    from slamsim.run.naming import output_file

    if out is not None and out.suffix.lower() not in (".svg", ".png"):
        raise OutputRefused(f"--out {out}: the picture is an .svg or a .png")
    named = (
        ("--odom-topic", odom_topic),
        ("--imu-topic", imu_topic),
        ("--base-frame", base_frame),
        ("--cloud-height", cloud_height),
    )
    options = [word for topic in scan_topic or () for word in ("--scan-topic", topic)]
    options += [word for option, value in named if value for word in (option, value)]
    with output_file(out, overwrite=overwrite, inputs=(source,)) as picture:
        from slamsim.run.info import tell_info

        tell_info(
            source,
            reporter,
            wanted=selection(scan_topic, odom_topic, imu_topic, base_frame, cloud_height),
            options=options,
            picture=picture,
            picture_format="svg" if out is None else out.suffix.lower()[1:],
        )
    if out is not None:
        reporter.say(f"Written to {out}")
