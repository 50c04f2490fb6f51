"""``slamsim calibrate`` as it is typed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Out, Overwrite

if TYPE_CHECKING:
    from slamsim.run.cameras.calibration_report import Calibrated

EPILOG = (
    "Examples: slamsim calibrate my_rosbag2/ --tags apriltag_36h11:0.16 \u00b7 "
    "slamsim calibrate images/ --board chessboard:9x6:0.03"
)

Source = Annotated[
    Path,
    typer.Argument(help="A recording with cameras, or a folder of images (EuRoC, TUM, Open3D)."),
]
Board = Annotated[
    str,
    typer.Option(
        "--board",
        metavar="BOARD",
        help="Lenses from a board: chessboard:9x6:0.03 (inner corners, side of a square in "
        "metres) or charuco:9x6:0.03:0.022:aruco_5x5_100 (squares).",
    ),
]
Tags = Annotated[
    str,
    typer.Option(
        "--tags",
        metavar="FAMILY:SIZE_M",
        help="Mounts, clocks and lenses from tags on a drive, as apriltag_36h11:0.16.",
    ),
]
Surveyed = Annotated[
    Path | None,
    typer.Option("--surveyed", help="Places of these tags (tags.yaml): tells the height."),
]
Trajectory = Annotated[
    Path | None,
    typer.Option("--trajectory", help="Path of the robot's base (TUM file), instead of mapping."),
]
Distortion = Annotated[
    str,
    typer.Option(
        "--distortion",
        metavar="MODEL",
        help="plumb_bob, rational_polynomial or equidistant (default: as CameraInfo has it).",
    ),
]
ReadoutMs = Annotated[
    float | None,
    typer.Option(
        "--readout-ms",
        help="From the first row to the last, where it is known (0: global shutter).",
        min=0.0,
        max=1000.0,
    ),
]
ImageTopics = Annotated[
    list[str] | None,
    typer.Option("--image-topic", metavar="TOPIC", help="Only this camera; may be repeated."),
]


def calibrate(
    reporter: Reporter,
    source: Source,
    out: Out = None,
    board: Board = "",
    tags: Tags = "",
    surveyed: Surveyed = None,
    trajectory: Trajectory = None,
    distortion: Distortion = "",
    readout_ms: ReadoutMs = None,
    topic: ImageTopics = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate cameras: lens, place on the robot, clock and shutter, with intervals."""
    from slamsim.run.naming import output_folder, recording_name

    name = f"{recording_name(str(source))}_calibration"
    inputs = (source, surveyed, trajectory)
    with output_folder(out, name, overwrite=overwrite, inputs=inputs) as folder:
        from slamsim.run.cameras.calibrating import Wanted, calibrate_cameras

        readout_s = None if readout_ms is None else 1e-3 * readout_ms
        wanted = Wanted(
            *(board, tags, surveyed, trajectory, distortion, readout_s, tuple(topic or ()))
        )
        found = calibrate_cameras(source, folder, wanted, reporter, overwrite=overwrite)
    _show(found, folder, reporter)


def _show(found: Calibrated, folder: Path, reporter: Reporter) -> None:
    from slamsim.run.cameras.calibration_report import pair_rows, table_rows

    for words in found.notes:
        reporter.note(words)
    for each in found.cameras:
        reporter.table(f"Camera {each.topic}", table_rows(each))
    for pair in found.pairs:
        reporter.table(f"{pair['first']} and {pair['second']}", pair_rows(pair))
    reporter.say(f"Written to {folder}/")
    reporter.result({"folder": str(folder), **found.as_dict()})
