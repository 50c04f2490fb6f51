"""Command-line options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY.PATH=VALUE", help="Override one setting; may be repeated."),
]
ConfigFile = Annotated[
    str | None, typer.Option("--config", "-c", help="YAML with settings of robot, sensors, SLAM.")
]
Faults = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="NAME[:SIZE]",
        help="Fault to inject; may be repeated. slamsim fault --list names them.",
    ),
]
Jobs = Annotated[
    int | None, typer.Option("--jobs", "-j", help="Worker processes (default: all cores).", min=1)
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no table.")]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON on stdout.")]
ScanTopic = Annotated[
    list[str] | None,
    typer.Option(
        "--scan-topic",
        metavar="TOPIC",
        help="Scans to read, if there are several lidars; may be repeated. For map also depth "
        "images.",
    ),
]
OdomTopic = Annotated[
    str, typer.Option("--odom-topic", metavar="TOPIC", help="Odometry to read, if several.")
]
ImuTopic = Annotated[
    str, typer.Option("--imu-topic", metavar="TOPIC", help="IMU to read, if several.")
]
BaseFrame = Annotated[
    str,
    typer.Option(
        "--base-frame",
        metavar="FRAME",
        help="Frame of the robot (default: what the odometry moves).",
    ),
]
CloudHeight = Annotated[
    str,
    typer.Option(
        "--cloud-height",
        metavar="LOW,HIGH",
        help="Returns of point clouds that are read as scans, in metres above the base frame "
        "(default: a level ring, else the height of the sensor).",
    ),
]
Lossy = Annotated[
    bool,
    typer.Option(
        "--lossy", help="Continue even if the copy cannot hold everything in the recording."
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite", help="Replace an earlier run of this name when this one is complete."
    ),
]
OverwriteFile = Annotated[
    bool, typer.Option("--overwrite", help="Replace the output file if it exists.")
]
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder of the run; a new one under outputs/ by default."),
]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of all random numbers.", min=0)]
World = Annotated[
    str, typer.Argument(help="A world: YAML, map.yaml, image or mesh file, or a bundled name.")
]
DriveSeed = Annotated[
    int | None,
    typer.Option(
        "--drive-seed",
        help="Another drive through the world of --seed: random goals and noise of this seed.",
        min=0,
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Show every warning.")]
Relations = Annotated[
    Path | None,
    typer.Option("--relations", help="Relative poses to score against (Kümmerle et al. 2009)."),
]
