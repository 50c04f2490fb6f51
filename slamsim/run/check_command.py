"""``slamsim check`` and ``slamsim fix`` as they are typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.options import Json, Overwrite, Quiet, ScanTopic, local_path

CHECK_EPILOG = (
    "Exit code: 0 nothing is bad, 1 something is; 2, 3, 4 and 10 the check could not run. "
    "Example: slamsim check my_rosbag2/ --html verdict.html"
)
FIX_EPILOG = (
    "Exit code: 0 nothing bad is left, 1 something is. "
    "Example: slamsim fix my_rosbag2/ mended/ --apply all"
)

Source = Annotated[
    Path, typer.Argument(help="A recording: rosbag2, MCAP, ROS 1, CARMEN.", show_default=False)
]


def check(
    source: Source,
    scan_topic: ScanTopic = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html",
            metavar="FILE",
            parser=local_path,
            help="Write verdicts and plots to this file.",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Leave out what compares scans with one another.")
    ] = False,
    show_all: Annotated[bool, typer.Option("--all", help="Show also what is fine.")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Say what is wrong with a recording: stamps, frames, laser, wheels, gyroscope."""
    from slamsim.console import Reporter
    from slamsim.run.checking import check_log

    report = check_log(
        source,
        Reporter(quiet=quiet, as_json=as_json),
        scan_topic=scan_topic,
        quick=quick,
        html=html,
        show_all=show_all,
    )
    raise typer.Exit(1 if report.bad else 0)


def fix(
    source: Source,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            parser=local_path,
            help="Folder of the corrected copy (rosbag2, MCAP).",
            show_default=False,
        ),
    ],
    apply: Annotated[
        str,
        typer.Option(
            "--apply", metavar="all|NAME[,NAME...]", help="Which of the mends that check proposes."
        ),
    ] = "all",
    scan_topic: ScanTopic = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Write a corrected copy of a recording, and check it again."""
    from slamsim.console import Reporter
    from slamsim.safe.output import claimed_folder

    reporter = Reporter(quiet=quiet, as_json=as_json)
    with claimed_folder(out, overwrite):
        from slamsim.run.fixing import fix_log

        report = fix_log(source, out, apply, reporter, scan_topic=scan_topic, overwrite=overwrite)
    raise typer.Exit(1 if report.bad else 0)
