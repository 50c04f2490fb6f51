"""``slamsim dataset plan`` and ``preview``: estimates for a data set before it is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from slamsim.console.reporter import Reporter
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.plan import Plan, plan
from slamsim.dataset.recipe.preview import contact_sheet
from slamsim.guard.quantities import as_number, as_size, as_time
from slamsim.run.naming import loaded, output_file

_MOST_TOLD = 12


def tell_plan(recipe: str, count: int, reporter: Reporter, workers: int | None = None) -> None:
    """Print the plan, and give it as JSON. Raises what loading and planning raise."""
    chosen = load_recipe(recipe)
    reporter.note(f"Trying out {chosen.name}: a few short sequences are made and thrown away")
    found = plan(chosen, count, workers)
    reporter.table(f"{chosen.name}: {chosen.title}", plan_rows(found))
    derived = {"total_bytes": found.total_bytes, "realtime_factor": found.realtime_factor}
    reporter.result({**asdict(found), **derived})


def draw_preview(
    recipe: str, count: int, out: Path | None, reporter: Reporter, *, overwrite: bool = False
) -> None:
    """Write the contact sheet. Raises SlamsimError if the file is there and not to be replaced."""
    read = loaded(lambda: load_recipe(recipe))
    path = out or Path(f"{read.config.name}.png")
    with output_file(path, overwrite=overwrite, inputs=read.files) as unfinished:
        assert unfinished is not None
        with reporter.stage("preview", "worlds/s") as progress:
            unfinished.write_bytes(contact_sheet(read.config, count, progress))
    reporter.say(f"Written to {path}")
    reporter.result({"file": str(path), "worlds": count})


def plan_rows(found: Plan) -> dict[str, str]:
    """The plan as a table."""
    splits = ", ".join(f"{split} {number}" for split, number in found.splits.items())
    sizes = ", ".join(f"{name} {as_size(size)}" for name, size in found.disk_bytes.items())
    about = "" if found.drawn == found.sequences else f" (from the first {found.drawn})"
    drawn = {f"by {what}{about}": counted(numbers) for what, numbers in found.counts.items()}
    return {
        "sequences": f"{found.sequences} in {found.worlds} worlds: {splits}",
        **drawn,
        "simulated": as_time(found.simulated_s),
        "expected time": f"{as_time(found.seconds)} with {found.workers} workers, "
        f"{as_number(found.realtime_factor, 3)} × real time on each core",
        "disk": f"{as_size(found.total_bytes)}: {sizes}",
        "memory": f"{as_size(found.memory_bytes)} a worker",
    }


def counted(numbers: Mapping[str, int]) -> str:
    """The most frequent first; a hundred faults are not all told."""
    told = [f"{name} {number}" for name, number in numbers.items()]
    more = [f"{len(told) - _MOST_TOLD} more"] if len(told) > _MOST_TOLD else []
    return ", ".join([*told[:_MOST_TOLD], *more])
