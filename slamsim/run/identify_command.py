"""``slamsim identify`` as it is typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.options import Jobs, Json, Out, Overwrite, Quiet, Set, local_path

EPILOG = (
    "Examples: slamsim identify turtlebot2_study · slamsim identify my_robot.yaml "
    "--robot-file my_robot_identified.yaml"
)


def identify(
    measurements: Annotated[
        str,
        typer.Argument(
            help="Figures measured on a robot: YAML, or a bundled name.", show_default=False
        ),
    ],
    out: Out = None,
    robot_file: Annotated[
        Path | None,
        typer.Option(
            "--robot-file",
            metavar="FILE",
            parser=local_path,
            help="Write the robot to this file too.",
        ),
    ] = None,
    set_: Set = None,
    jobs: Jobs = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Fit a robot to figures measured on a real one, and say what they leave open."""
    from slamsim.config.measurements import load_measurements
    from slamsim.console import Reporter
    from slamsim.run.naming import output_folder

    reporter = Reporter(quiet=quiet, as_json=as_json)
    config = load_measurements(measurements, set_ or ())
    typed = " ".join(["slamsim identify", measurements, *(f"--set {text}" for text in set_ or ())])
    with output_folder(out, f"{config.name}_identified", overwrite=overwrite) as folder:
        from slamsim.run.identifying import identify_and_report

        identify_and_report(
            config, typed, folder, reporter, robot_file=robot_file, jobs=jobs, overwrite=overwrite
        )
