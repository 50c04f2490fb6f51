"""``slamsim demo`` as it is typed."""

from __future__ import annotations

import shlex
from enum import StrEnum
from typing import Annotated

import typer

from slamsim.cli.common import Reporter
from slamsim.console.options import Out, Overwrite, Seed

EPILOG = "Example: slamsim demo rotation-bug --out outputs/rotation_bug"
_SETTINGS = (
    "sensors.lidar.rate_hz=10",
    "drive.route.max_path_length_m=40",
)
"""A short drive: what the bug does shows at the first turn."""


class Demo(StrEnum):
    ROTATION_BUG = "rotation-bug"


def demo(
    reporter: Reporter,
    name: Annotated[Demo, typer.Argument(help="Demonstration to run.")] = Demo.ROTATION_BUG,
    out: Out = None,
    seed: Seed = None,
    overwrite: Overwrite = False,
) -> None:
    """Demonstrate a fault and its repair: the torn map, the verdict, and the repaired map."""
    from slamsim.config.loading import load_run_config
    from slamsim.console.summary import labelled
    from slamsim.run.naming import output_folder

    config = load_run_config("labyrinth", overrides=_SETTINGS, seed=seed)
    with output_folder(out, name.value.replace("-", "_"), overwrite=overwrite) as folder:
        from slamsim.run.demo import rotation_bug

        numbers = rotation_bug(config, folder, reporter, overwrite=overwrite)
    reporter.table(name.value, labelled(numbers))
    reporter.say(f"Look at {folder}/report.html, or: slamsim view {shlex.quote(str(folder))}")
    reporter.result({**numbers, "folder": str(folder)})
