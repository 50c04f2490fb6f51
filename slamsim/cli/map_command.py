"""``slamsim map`` and ``slamsim localise`` as they are typed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter, Selection, close_run, loaded_config
from slamsim.console.options import (
    ConfigFile,
    DriveSeed,
    Out,
    Overwrite,
    Relations,
    Seed,
    Set,
    Verbose,
)
from slamsim.guard.errors import OverrideRefused

MAP_EPILOG = (
    "Examples: slamsim map labyrinth · slamsim map worlds/rooms.yaml --seed 7 · "
    "slamsim map intel.clf.bz2 --relations intel.relations · slamsim map my_rosbag2/ · "
    "slamsim map my_rosbag2/ --without lidar --tags apriltag_36h11:0.2"
)
LOCALISE_EPILOG = "Example: slamsim localise my_second_drive/ --in outputs/labyrinth"

Start = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="X,Y,YAW_DEG",
        help="Start pose in the map (default: searched for).",
    ),
]
Tags = Annotated[
    str,
    typer.Option(
        "--tags",
        metavar="FAMILY:SIZE_M",
        help="Tags in the images as landmarks, as apriltag_36h11:0.2 (slam.landmarks.tags).",
    ),
]
Without = Annotated[
    str,
    typer.Option(
        "--without",
        metavar="lidar",
        help="Map by camera, wheels and gyroscope alone, and compare with the lidar's map.",
    ),
]
Intrinsics = Annotated[
    str,
    typer.Option(
        "--intrinsics",
        metavar="FX,FY,CX,CY",
        help="Camera matrix in pixels, for maps by images that come without one.",
    ),
]
Obstacles = Annotated[
    bool,
    typer.Option(
        "--obstacles",
        help="Also map what depth images show in the robot's way (mapping.layers.obstacles).",
    ),
]
Places = Annotated[
    bool,
    typer.Option(
        "--places",
        help="Also look for loops where a depth camera sees a place again "
        "(slam.back_end.closures.images).",
    ),
]
Labels = Annotated[
    str,
    typer.Option(
        "--labels",
        metavar="TOPIC",
        help="Also map which label of this topic's images is seen where (mapping.layers.labels).",
    ),
]
Calibration = Annotated[
    str,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="Cameras as slamsim calibrate found them, calibration.yaml (slam.camera_calibration).",
    ),
]
Source = Annotated[
    str,
    typer.Argument(help="A world to simulate, or a recording: rosbag2, MCAP, ROS 1, CARMEN."),
]
Earlier = Annotated[
    Path | None,
    typer.Option("--continue", metavar="RUN", help="Continue the map of an earlier run."),
]


def map_(
    reporter: Reporter,
    source: Source = "labyrinth",
    out: Out = None,
    seed: Seed = None,
    drive_seed: DriveSeed = None,
    set_: Set = None,
    config: ConfigFile = None,
    relations: Relations = None,
    *,
    wanted: Selection,
    tags: Tags = "",
    without: Without = "",
    intrinsics: Intrinsics = "",
    places: Places = False,
    obstacles: Obstacles = False,
    labels: Labels = "",
    calibration: Calibration = "",
    earlier: Earlier = None,
    start: Start = None,
    overwrite: Overwrite = False,
    verbose: Verbose = False,
) -> Path:
    """Map a world or a recording, and evaluate the map."""
    from slamsim.run.naming import is_recording, output_folder, recording_name

    recorded = is_recording(source)
    set_ = [*(set_ or ()), *_asked(tags, labels, calibration, places=places, obstacles=obstacles)]
    loaded = loaded_config(None if recorded else source, config, set_, seed, drive_seed=drive_seed)
    resolved = loaded.config
    name = recording_name(source) if recorded else resolved.world.name
    beside = (relations, earlier, Path(calibration) if calibration else None)
    inputs = (Path(source) if recorded else None, *beside, *loaded.files)
    with output_folder(out, name, overwrite=overwrite, inputs=inputs) as folder:
        from slamsim.run.continuing import chosen_earlier, refuse_earlier
        from slamsim.run.mapping import map_world, require_used

        if recorded:
            from slamsim.run.cameras.choosing import map_by_lidar_or_camera

            reporter.note(f"Mapping the recording {source}")
            report = map_by_lidar_or_camera(
                Path(source),
                resolved,
                folder,
                reporter,
                without=without,
                intrinsics=intrinsics,
                relations=relations,
                wanted=wanted,
                earlier=chosen_earlier(earlier, start),
                overwrite=overwrite,
            )
        else:
            refuse_earlier(earlier, start)
            _refuse_images(without, intrinsics)
            reporter.note(f"Simulating and mapping the world {source}")
            report = map_world(resolved, folder, reporter, relations=relations, overwrite=overwrite)
    close_run(reporter, report, folder, verbose=verbose)
    require_used(report, folder)
    return folder


def _refuse_images(without: str, intrinsics: str) -> None:
    """Raises OverrideRefused for options that only maps of recordings have."""
    for option, given in (("--without", without), ("--intrinsics", intrinsics)):
        if given:
            raise OverrideRefused(option, "needs a recording, not a world")


def _asked(
    tags: str, labels: str, calibration: str, *, places: bool, obstacles: bool
) -> Iterator[str]:
    """What options of images set."""
    if tags:
        yield f"slam.landmarks.tags={tags}"
    if labels:
        yield f"mapping.layers.labels={labels}"
    if calibration:
        yield f"slam.camera_calibration={calibration}"
    if places:
        yield "slam.back_end.closures.images=true"
    if obstacles:
        yield "mapping.layers.obstacles=true"


def localise(
    reporter: Reporter,
    source: Annotated[Path, typer.Argument(help="A recording.")],
    known: Annotated[
        Path, typer.Option("--in", help="The map: folder of a mapped run, or a ROS map.yaml.")
    ],
    start: Start = None,
    out: Out = None,
    set_: Set = None,
    config: ConfigFile = None,
    *,
    wanted: Selection,
    overwrite: Overwrite = False,
    verbose: Verbose = False,
) -> Path:
    """Localise a recording in a finished map."""
    from slamsim.run.naming import output_folder, recording_name

    loaded = loaded_config(None, config, set_, None)
    name = f"{recording_name(str(source))}_in_{known.resolve().name}"
    inputs = (source, known, *loaded.files)
    with output_folder(out, name, overwrite=overwrite, inputs=inputs) as folder:
        from slamsim.run.continuing import start_pose
        from slamsim.run.localising import localise_recording

        report = localise_recording(
            source,
            known,
            loaded.config,
            folder,
            reporter,
            start=start_pose(start),
            wanted=wanted,
            overwrite=overwrite,
        )
    close_run(reporter, report, folder, verbose=verbose)
    return folder
