"""``slamsim convert`` as it is typed."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Overwrite

EPILOG = "Example: slamsim convert my_rosbag2/ images/ --to tum"


class Target(StrEnum):
    """Layouts of folders with images."""

    TUM = "tum"
    EUROC = "euroc"


def convert(
    reporter: Reporter,
    source: Annotated[
        Path,
        typer.Argument(help="A recording with camera images, or a folder of them."),
    ],
    out: Annotated[Path, typer.Argument(help="New folder.")],
    to: Annotated[
        Target, typer.Option("--to", help="TUM RGB-D (colour and depth) or EuRoC (cameras, IMU).")
    ] = Target.TUM,
    overwrite: Overwrite = False,
) -> None:
    """Write camera images as a folder of TUM RGB-D or EuRoC, with cameras and the true path."""
    from slamsim.run.naming import output_folder

    with output_folder(out, "", overwrite=overwrite, inputs=(source,)):
        from slamsim.io.cameras.converting import convert_images

        written = convert_images(source, out, to.value, overwrite=overwrite)
    for name, one in written.items():
        lost = f", {one.left_out:,} left out ({one.first_reason})" if one.left_out else ""
        reporter.say(f"{name}: {one.images:,} images of {one.topic}{lost}")
    reporter.say(f"Written to {out}/")
    reporter.result({"folder": str(out), "cameras": {n: asdict(w) for n, w in written.items()}})
