"""``slamsim check`` and ``slamsim fix`` as they are typed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Reporter, Selection
from slamsim.console.options import (
    Lossy,
    Overwrite,
    OverwriteFile,
)
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import disk_full

CHECK_EPILOG = (
    "Exit code: 0 no fault, 1 a fault or a question that failed; 2, 3, 4 and 10 the check could "
    "not run. "
    "Example: slamsim check my_rosbag2/ --html verdict.html"
)
FIX_EPILOG = (
    "Exit code: 0 no fault is left, 1 faults are left or nothing made it better. "
    "Example: slamsim fix my_rosbag2/ fixed/ --apply all"
)


class NotChecked(SlamsimError):
    """The check itself could not run, though its code 1 would be taken for a verdict."""

    exit_code = 2


Source = Annotated[
    Path, typer.Argument(help="A recording: rosbag2, MCAP, ROS 1, CARMEN.", show_default=False)
]


CheckSource = Annotated[
    Path | None, typer.Argument(help="A recording: rosbag2, MCAP, ROS 1, CARMEN.")
]
Html = Annotated[
    Path | None,
    typer.Option(
        "--html",
        metavar="FILE",
        help="Write findings and plots to this file.",
    ),
]
Quick = Annotated[
    bool,
    typer.Option("--quick", help="Skip the questions that compare scans with one another."),
]
List = Annotated[
    bool, typer.Option("--list", help="List all questions, their limits and their faults.")
]


def check(
    reporter: Reporter,
    source: CheckSource = None,
    *,
    wanted: Selection,
    html: Html = None,
    quick: Quick = False,
    show_all: Annotated[bool, typer.Option("--all", help="Also show answers that are ok.")] = False,
    list_: List = False,
    overwrite: OverwriteFile = False,
) -> None:
    """Find faults in a recording: stamps, frames, laser, wheels, gyroscope."""
    from slamsim.run.naming import output_file

    if list_:
        from slamsim.run.checking import question_facts, question_table

        reporter.table("Questions", question_table())
        reporter.result({"questions": question_facts()})
        return
    if source is None:
        raise typer.BadParameter("give a recording, or --list")
    with _not_checked(), output_file(html, overwrite=overwrite, inputs=(source,)) as page:
        from slamsim.run.checking import check_log

        report = check_log(
            source,
            reporter,
            wanted=wanted,
            quick=quick,
            html=page,
            show_all=show_all,
        )
    if html is not None:
        reporter.say(f"Written to {html}")
    raise typer.Exit(1 if report.faults else 0)


@contextmanager
def _not_checked() -> Iterator[None]:
    try:
        yield
    except SlamsimError as error:
        if error.exit_code != SlamsimError.exit_code:
            raise
        raise NotChecked(str(error)) from error
    except OSError as error:
        if isinstance(error, BrokenPipeError) or disk_full(error):
            raise  # of standard output, which has codes of its own
        raise NotChecked(
            f"{error.filename or 'input/output'}: {error.strerror or error}"
        ) from error


Out = Annotated[
    Path,
    typer.Argument(
        help="Folder of the corrected copy: rosbag2 (MCAP); a ROS 1 bag stays one.",
        show_default=False,
    ),
]
Apply = Annotated[
    str,
    typer.Option(
        "--apply",
        metavar="all|none|NAME[,NAME...]",
        help="Repairs to apply, among those proposed by check; none: a plain copy.",
    ),
]


def fix(
    reporter: Reporter,
    source: Source,
    out: Out,
    apply: Apply = "all",
    *,
    wanted: Selection,
    lossy: Lossy = False,
    overwrite: Overwrite = False,
) -> None:
    """Write a corrected copy of a recording, and check it again.

    A repair that does not let scans, placed as recorded, fit each other better, or removes no
    fault, is taken back. What a repair does not touch is copied byte for byte: other topics,
    covariances, attachments.
    """
    from slamsim.run.naming import output_folder

    with output_folder(out, "", overwrite=overwrite, inputs=(source,)):
        from slamsim.run.fixing import fix_log

        report = fix_log(
            source,
            out,
            apply,
            reporter,
            wanted=wanted,
            lossy=lossy,
            overwrite=overwrite,
        )
    reporter.say(f"Written to {out}/")
    raise typer.Exit(1 if report.faults else 0)
