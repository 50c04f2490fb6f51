"""``slamsim identify`` as it is typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Jobs, Out, Overwrite, Set

EPILOG = (
    "Examples: slamsim identify turtlebot2_study · slamsim identify my_robot.yaml "
    "--robot-file my_robot_identified.yaml"
)


Measurements = Annotated[
    str,
    typer.Argument(
        help="Figures measured on a robot: YAML, or a bundled name.", show_default=False
    ),
]
RobotFile = Annotated[
    Path | None,
    typer.Option(
        "--robot-file",
        metavar="FILE",
        help="Also write the robot to this file.",
    ),
]


def identify(
    reporter: Reporter,
    measurements: Measurements,
    out: Out = None,
    robot_file: RobotFile = None,
    set_: Set = None,
    jobs: Jobs = None,
    overwrite: Overwrite = False,
) -> None:
    """Fit a robot's parameters to figures measured on a real one, with intervals."""
    from slamsim.config.measurements import load_measurements
    from slamsim.run.naming import loaded, output_file, output_folder

    read = loaded(lambda: load_measurements(measurements, set_ or ()))
    config = read.config
    typed = " ".join(["slamsim identify", measurements, *(f"--set {text}" for text in set_ or ())])
    name = f"{config.name}_identified"
    with (
        output_file(robot_file, overwrite=overwrite, inputs=read.files, beside=out) as copy,
        output_folder(out, name, overwrite=overwrite, inputs=read.files) as folder,
    ):
        from slamsim.run.scenario import identify_and_report

        identify_and_report(
            config, typed, folder, reporter, robot_file=copy, jobs=jobs, overwrite=overwrite
        )
    if robot_file is not None:
        reporter.say(f"The robot, too: {robot_file}")
