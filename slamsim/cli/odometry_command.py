"""``slamsim odometry`` as it is typed."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Out, Overwrite

if TYPE_CHECKING:
    from slamsim.run.cameras.odometry import CameraPath

EPILOG = (
    "Examples: slamsim odometry my_rosbag2/ \u00b7 "
    "slamsim odometry rgbd_dataset_freiburg1_desk/ --truth groundtruth.txt"
)

Source = Annotated[
    Path,
    typer.Argument(
        help="A recording with registered depth and colour or grey images, or a folder of "
        "them (TUM RGB-D, Open3D)."
    ),
]
Truth = Annotated[
    Path | None,
    typer.Option("--truth", help="True path of the camera's optical frame (TUM file)."),
]
DepthTopic = Annotated[
    str, typer.Option("--depth-topic", metavar="TOPIC", help="Depth to read, if several.")
]
Intrinsics = Annotated[
    str,
    typer.Option(
        "--intrinsics",
        metavar="FX,FY,CX,CY",
        help="Camera matrix in pixels, where the images come without one or with a wrong one.",
    ),
]


def odometry(
    reporter: Reporter,
    source: Source,
    out: Out = None,
    truth: Truth = None,
    depth: DepthTopic = "",
    intrinsics: Intrinsics = "",
    overwrite: Overwrite = False,
) -> None:
    """Follow a depth camera by its images alone, without lidar, wheels and IMU."""
    from slamsim.run.naming import output_folder, recording_name

    name = f"{recording_name(str(source))}_odometry"
    with output_folder(out, name, overwrite=overwrite, inputs=(source, truth)) as folder:
        from slamsim.run.cameras.odometry import camera_odometry

        figures = camera_odometry(
            source,
            folder,
            reporter,
            truth=truth,
            depth=depth,
            intrinsics=intrinsics,
            overwrite=overwrite,
        )
    reporter.table(f"Path of {figures.picture_topic}", _rows(figures))
    reporter.say(f"Written to {folder}/")
    reporter.result({"folder": str(folder), **asdict(figures)})


def _rows(figures: CameraPath) -> dict[str, str]:
    found = {
        "images": f"{figures.frames:,}, {figures.lost_frames:,} lost",
        "key frames": f"{figures.keyframes:,}",
        "path": f"{figures.path_m:.2f} m",
    }
    errors = figures.errors
    if errors is not None:
        found |= {
            "drift": f"{errors.drift_percent:.2f} % of the true path at its end",
            "error": f"{1e3 * errors.ate_rmse_m:.1f} mm RMSE once aligned (ATE)",
        }
    return found
