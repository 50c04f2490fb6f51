"""``slamsim dataset``: its subcommands as they are typed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamsim.cli.common import Commands, Reporter
from slamsim.console.options import OverwriteFile
from slamsim.guard.errors import DataDamaged, OverrideRefused, shown

dataset = Commands(
    name="dataset",
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Make data sets of simulated recordings from a recipe, by the thousand.",
    epilog="Start with: [bold]slamsim dataset make tiny -n 4 --out my_data[/bold]",
)

RecipeName = Annotated[
    str,
    typer.Argument(
        metavar="RECIPE",
        help="A recipe: YAML file or bundled name (tiny, labyrinths, diverse, faults, "
        "diverse_rgbd, stereo_imu).",
        show_default=False,
    ),
]
Count = Annotated[
    int, typer.Option("-n", "--count", help="Number of sequences.", min=1, max=10_000_000)
]


def _refuse_fleeting(out: str) -> str:
    """Refuse what fsspec writes to as if it were a disk, though it ends with the process."""
    if "memory://" in out or out.startswith("data:"):
        reason = "is gone when this command ends; name a folder, or a URL of a place that stays"
        raise OverrideRefused(f"--out {shown(out, 200)}", reason)
    return out


Place = Annotated[
    str, typer.Argument(metavar="DIR", help="Folder or URL of a data set.", show_default=False)
]


Out = Annotated[
    str,
    typer.Option(
        "--out",
        "-o",
        callback=_refuse_fleeting,
        help="Folder, or URL such as s3://bucket/path, sftp://...",
    ),
]
Engine = Annotated[str, typer.Option(help="local: the cores of this machine. dask: a cluster.")]
Workers = Annotated[
    int | None, typer.Option(help="Local: worker processes (default: all cores).", min=1)
]
Processes = Annotated[
    int | None, typer.Option(help="Worker processes (default: all cores).", min=1)
]
Scheduler = Annotated[
    str | None, typer.Option(help="Dask: address of the scheduler, tcp://HOST:PORT.")
]
Only = Annotated[
    list[int] | None,
    typer.Option("--only", metavar="INDEX", help="Only this sequence; may be repeated.", min=0),
]


@dataset.command(
    epilog="Exit code: 0 all sequences are there, 1 some could not be made (all "
    "others are there), 75 the disk is full, 130 stopped. "
    "Examples: slamsim dataset make labyrinths -n 1000 --out my_data · the same command resumes "
    "where it was stopped · slamsim dataset make my_recipe.yaml -n 10000 --out s3://bucket/set "
    "--engine dask --scheduler tcp://10.0.0.1:8786"
)
def make(
    reporter: Reporter,
    recipe: RecipeName,
    out: Out,
    count: Count = 100,
    engine: Engine = "local",
    workers: Workers = None,
    scheduler: Scheduler = None,
    only: Only = None,
) -> None:
    """Make a data set, or the missing part of it."""
    from slamsim.dataset.store.store import claimed_place

    if "://" not in out:
        _require_place(out, recipe)
    with claimed_place(out):
        from slamsim.run.dataset.making import run_make

        run_make(
            recipe,
            count,
            out,
            reporter,
            engine=engine,
            workers=workers,
            scheduler=scheduler,
            only=only,
        )


def _require_place(out: str, recipe: str) -> None:
    """Raises SlamsimError for a folder that cannot be a data set's, and what ``require_apart``
    raises, but for the recipe that a data set itself holds: by that it is made again, and nothing
    in it is replaced by other bytes.
    """
    from slamsim.config.bundled import find_input
    from slamsim.dataset.make.identity import IDENTITY, RECIPE, require_empty
    from slamsim.dataset.store.store import open_store
    from slamsim.guard.replaceable import require_apart
    from slamsim.guard.seal import SUMS

    store = open_store(out)
    is_dataset = not store.names("").isdisjoint((IDENTITY, SUMS))
    own = Path(store.address) / RECIPE
    if "://" not in recipe:
        file = find_input("configs/datasets", recipe)
        if not (is_dataset and own.is_file() and own.samefile(file)):
            require_apart((Path(out),), (file,))
    if not is_dataset:
        require_empty(store)


@dataset.command(epilog="Example: slamsim dataset plan labyrinths -n 10000")
def plan(
    reporter: Reporter,
    recipe: RecipeName,
    count: Count = 100,
    workers: Processes = None,
) -> None:
    """Estimate what a recipe will make, its time and its disk space."""
    from slamsim.run.dataset.telling import tell_plan

    tell_plan(recipe, count, reporter, workers=workers)


@dataset.command(epilog="Example: slamsim dataset preview diverse -n 24 --out sheet.png")
def preview(
    reporter: Reporter,
    recipe: RecipeName,
    count: Annotated[
        int, typer.Option("-n", "--count", help="Number of worlds to draw.", min=1, max=100)
    ] = 12,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="PNG file; RECIPE.png by default.",
        ),
    ] = None,
    overwrite: OverwriteFile = False,
) -> None:
    """Draw worlds of a recipe and the routes planned through them on one contact sheet."""
    from slamsim.run.dataset.telling import draw_preview

    draw_preview(recipe, count, out, reporter, overwrite=overwrite)


@dataset.command(
    epilog="Exit code: 0 complete and unchanged, 4 not. "
    "Examples: slamsim dataset verify my_data --again 3 · slamsim dataset verify s3://bucket/set "
    "--subset 5%"
)
def verify(
    reporter: Reporter,
    place: Place,
    subset: Annotated[
        str, typer.Option(metavar="PERCENT", help="Share of the sequences to read.")
    ] = "100%",
    again: Annotated[
        int, typer.Option(help="Number of sequences to make again and compare.", min=0)
    ] = 0,
    workers: Processes = None,
) -> None:
    """Check that a data set is complete and unchanged, by its checksums."""
    from slamsim.run.dataset.telling import run_verify

    whole = run_verify(place, reporter, subset=subset, again=again, workers=workers)
    raise typer.Exit(0 if whole else DataDamaged.exit_code)


@dataset.command(epilog="Example: slamsim dataset stats my_data --json")
def stats(reporter: Reporter, place: Place) -> None:
    """Summarise a data set: splits, worlds, sensors, faults, lengths, sizes."""
    from slamsim.run.dataset.telling import run_stats

    run_stats(place, reporter)
