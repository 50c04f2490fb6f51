"""``slamsim dataset plan``, ``preview``, ``verify`` and ``stats``: estimates before it is made,
reports afterwards."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from slamsim.console.reporter import Reporter
from slamsim.dataset.catalogue.statistics import read_manifest, statistics
from slamsim.dataset.catalogue.verify import Verification, verify
from slamsim.dataset.make.identity import IDENTITY, RECIPE
from slamsim.dataset.make.sequence_check import EXTRA, SequenceFinding
from slamsim.dataset.make.shard import shard_path
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.plan import Plan, plan
from slamsim.dataset.recipe.preview import contact_sheet
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import InputRefused, SlamsimError, shown
from slamsim.guard.quantities import as_number, as_size, as_time, with_unit
from slamsim.guard.yaml import parse_yaml
from slamsim.run.naming import loaded, output_file

SHARD_KEY = "shard_sequences"
_REMOVE_HERE = ("rm", "-r")
_REMOVE_THERE = (
    "python",
    "-c",
    "import sys, fsspec; [f.rm(p, True) for f, p in map(fsspec.url_to_fs, sys.argv[1:])]",
)
_ANY = "RECIPE"
_MOST_TOLD = 20


@dataclass(frozen=True, slots=True)
class RepairPlan:
    """remove: paths in the data set. commands: remove them, and make what is then missing."""

    remove: tuple[str, ...]
    commands: tuple[str, ...]


def run_verify(
    address: str,
    reporter: Reporter,
    *,
    subset: str = "100%",
    again: int = 0,
    workers: int | None = None,
) -> bool:
    """Check a data set and tell what is wrong with it; whether nothing is.

    Raises what ``verify`` raises, and SlamsimError for a subset that is no percentage.
    """
    share = _share(subset)
    with reporter.stage("verify", "sequences/s") as progress:
        found = verify(address, share=share, again=again, workers=workers, progress=progress)
    plan = None if found.whole else repair_plan(found)
    _tell(found, plan, reporter)
    told = {"whole": found.whole, "plan": plan and asdict(plan)}
    reporter.result({**asdict(found), **told})
    return found.whole


def run_stats(address: str, reporter: Reporter) -> None:
    """Tell what a data set holds, from its manifest. Raises NotFound, InputRefused."""
    told = statistics(read_manifest(Location(address)))
    totals = {
        "sequences": f"{told['sequences']:,}, {told['failed']:,} of them could not be made",
        "worlds": f"{told['worlds']:,}",
        "simulated": f"{as_time(told['simulated_h'] * 3600.0)}, {as_number(told['path_km'])} km, "
        f"{told['scans']:,} scans, {told['loop_closures']:,} loop closures",
        "disk": f"{as_size(told['size_bytes'])} in {told['files']:,} files",
    }
    splits = {
        f"split {split}": f"{part['sequences']:,} in {part['worlds']:,} worlds, "
        f"{as_time(part['simulated_h'] * 3600.0)}, {as_number(part['path_km'])} km"
        for split, part in told["splits"].items()
    }
    drawn = {name: counted(counts) for name, counts in told["drawn"].items()}
    numbers = dict(
        _spread(name.removeprefix("quality."), of) for name, of in told["numbers"].items()
    )
    faults = {"faults": counted(told["faults"])}
    reporter.table(f"Data set {address}", {**totals, **splits, **drawn, **faults, **numbers})
    reporter.result(told)


def _spread(key: str, of: Mapping[str, float]) -> tuple[str, str]:
    """The words of a key, and how its values are spread."""
    median, least, most = (with_unit(key, of[name])[1] for name in ("median", "least", "most"))
    return with_unit(key, 0.0)[0], f"{median} in the median, {least} to {most}"


def repair_plan(found: Verification) -> RepairPlan:
    """How everything that is not as it was made is made again."""
    place = Location(found.address)
    damaged = [finding for finding in found.findings if finding.reason != EXTRA]
    paths = {_at(finding) for finding in damaged}
    indices = {finding.index for finding in damaged if finding.index is not None}
    paths |= _shards_of(place, indices, paths)
    there = sorted(path for path in paths if place.names(path) or place.digest(path))
    is_sound = RECIPE not in paths and place.digest(RECIPE)
    recipe = f"{found.address}/{RECIPE}" if is_sound else _ANY
    words = ["slamsim", "dataset", "make", recipe, "-n", str(found.sequences)]
    commands = [[*words, "--out", found.address]]
    if there:
        removal = _REMOVE_THERE if "://" in found.address else _REMOVE_HERE
        commands.insert(0, [*removal, *(f"{found.address}/{path}" for path in there)])
    return RepairPlan(tuple(there), tuple(map(shlex.join, commands)))


def _shards_of(place: Location, indices: Collection[int], damaged: Collection[str]) -> set[str]:
    """The files whose rows say that these sequences are there."""
    if not indices:
        return set()
    for path, keys in ((IDENTITY, ("recipe", SHARD_KEY)), (RECIPE, (SHARD_KEY,))):
        if path not in damaged and (size := _whole_number(place.read(path), keys)):
            return {shard_path(index // size) for index in indices}
    return {f"shards/{name}" for name in place.names("shards")}


def _whole_number(data: bytes | None, keys: Collection[str]) -> int | None:
    """What YAML says under one key below the other, if it can be read."""
    try:
        told: Any = parse_yaml((data or b"").decode("utf-8", "replace"), Path(RECIPE)).data
        return int(reduce(getitem, keys, told))
    except (InputRefused, KeyError, TypeError, ValueError):
        return None


def _at(finding: SequenceFinding) -> str:
    """What is made again as a whole: a sequence, or a file beside them."""
    if finding.index is None:
        return finding.path
    return "/".join(finding.path.split("/")[:2])


def _share(subset: str) -> float:
    try:
        share = float(subset.removesuffix("%")) / 100.0
    except ValueError:
        share = 0.0
    if not 0.0 < share <= 1.0:
        raise SlamsimError(f"--subset {shown(subset)}: give a share of the sequences, such as 5%")
    return share


def _tell(found: Verification, plan: RepairPlan | None, reporter: Reporter) -> None:
    rows = {
        "sequences": f"{found.sequences:,}, {found.failed:,} of them could not be made",
        "read": f"{found.checked:,} sequences, {found.files:,} files, {as_size(found.size_bytes)}",
        "made again": ", ".join(map(str, found.again)) or "none",
        "not as it was made": f"{len(found.findings):,} of the files" if plan else "nothing",
    }
    reporter.table(f"Data set {found.address}", rows)
    for finding in found.findings[:_MOST_TOLD]:
        reporter.say(f"{finding.path}: {finding.reason}")
    if len(found.findings) > _MOST_TOLD:
        reporter.say(f"and {len(found.findings) - _MOST_TOLD:,} more; --json lists all")
    if any(finding.reason == EXTRA for finding in found.findings):
        reporter.say("Move files that are not part of the data set elsewhere.")
    if plan is None or all(finding.reason == EXTRA for finding in found.findings):
        return
    which = ", RECIPE being what it was made of:" if _ANY in plan.commands[-1].split() else ":"
    reporter.say(f"This makes the same bytes again{which}")
    for command in plan.commands:
        reporter.say(f"  {command}")


_MOST_COUNTED = 12


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
    more = [f"{len(told) - _MOST_COUNTED} more"] if len(told) > _MOST_COUNTED else []
    return ", ".join([*told[:_MOST_COUNTED], *more])
