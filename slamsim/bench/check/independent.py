"""The checker on recordings of another generator, which shares no code with this package.

It lies in the folder ``tests/independent`` of a checkout, and is no part of the installed package.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

import slamsim
from slamsim.bench.check.outcome import Json, Measured, measured_in, pairs_with_truth
from slamsim.bench.check.repaired import fixed_words, repaired, summarise_repaired
from slamsim.bench.check.summary import coverage_of, coverage_row
from slamsim.bench.logs import Children, each_done, keep_lines, require_none_failed
from slamsim.check.check import check_recording
from slamsim.check.registry import CHECKER_ERROR
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import NotFound, SlamsimError, nearest_name, shown
from slamsim.io.open import read_recording

PLACE = Path("tests") / "independent"

MOST_AT_ONCE = 7
"""Cases of one drive that one process works through; after them their rows are shown."""


@dataclass(frozen=True, slots=True)
class IndependentCampaign:
    """What to run. seeds: for each every fault, so many pairs of faults, and random mutations.
    clean: number of drives without a fault. only: these cases alone, by name. seconds: length of a
    drive. kept: folder for the rows as they come, one line of JSON for each case. fix: repair each
    recording, too."""

    folder: Path
    seeds: Sequence[int]
    clean: int = 0
    pairs: int = 0
    mutations: int = 0
    only: Sequence[str] | None = None
    seconds: float = 60.0
    workers: int = 1
    kept: Path | None = None
    fix: bool = False


def generator_folder() -> Path:
    """Where the generator lies. Raises NotFound, for an installed package does not hold it."""
    for beside in (Path.cwd(), Path(slamsim.__file__).parents[1]):
        if (beside / PLACE / "__init__.py").is_file():
            return beside / PLACE
    raise NotFound(
        f"{PLACE}: the independent generator is part of a checkout, not of the installed package; "
        "run this command in the folder that holds pyproject.toml"
    )


def run_independent(campaign: IndependentCampaign, reporter: Reporter) -> None:
    """Show every miss and alarm as it is found, how many are right after each group, and figures of
    all that was done, also if stopped. Raises SlamsimError for a fault that the generator does not
    know."""
    jobs = _jobs(campaign)
    rows: list[Json] = []
    count = sum(map(len, jobs))
    with (
        reporter.stage("check") as progress,
        each_done([partial(_rows, campaign, job) for job in jobs], campaign.workers) as done,
    ):
        try:
            for group in done:
                rows += group
                keep_lines(campaign.kept, "independent.jsonl", rows)
                for row in group:
                    if not row["right"]:
                        reporter.say(row_line(row))
                reporter.note(f"{len(rows)} of {count} cases, right: {_right(rows)}")
                progress(len(rows), count)
        finally:  # A bench that is stopped is killed before its processes have ended.
            figures = summarise_independent(rows)
            reporter.table("Recordings of the independent generator", _table(figures))
            reporter.result(figures)
    require_none_failed(sum("error" in row for row in rows if row["sort"] != "mutation"))


def _jobs(campaign: IndependentCampaign) -> list[list[Any]]:
    """Cases by drive, a few at a time, for those of one drive share what takes long to make."""
    generator = _load(campaign.folder)
    try:
        cases = generator.cases(
            campaign.seeds, campaign.clean, campaign.pairs, campaign.only, campaign.mutations
        )
    except KeyError as error:
        unknown = str(error.args[0])
        near = nearest_name(unknown, generator.fault_names(), 0.0)
        raise SlamsimError(
            f"the generator makes no fault {shown(unknown)}; the nearest is {near!r}"
        ) from None
    drives: dict[int, list[Any]] = {}
    for case in cases:
        drives.setdefault(case.drive, []).append(case)
    return [
        every[begin : begin + MOST_AT_ONCE]
        for every in drives.values()
        for begin in range(0, len(every), MOST_AT_ONCE)
    ]


def _load(folder: Path) -> Any:
    """The generator: a package with ``cases``, ``fault_names`` and ``make``."""
    if str(folder.parent) not in sys.path:
        sys.path.insert(0, str(folder.parent))
    return import_module(folder.name)


def _rows(campaign: IndependentCampaign, job: Sequence[Any], children: Children) -> list[Json]:
    try:
        return children.run(run_cases, campaign.folder, job, campaign.seconds, campaign.fix)
    except SlamsimError as error:
        return [_failed(case, str(error)) for case in job]


def run_cases(folder: Path, cases: Iterable[Any], seconds: float, fix: bool = False) -> list[Json]:
    """Make, read and check each recording, in this process; one that fails costs no other.

    fix: repair it too, and measure what came of it.
    """
    generator = _load(folder)
    rows: list[Json] = []
    for case in cases:
        try:
            rows.append(_run_case(generator, case, seconds, fix))
        except Exception as error:
            rows.append(_failed(case, f"{type(error).__name__}: {error}"))
    return rows


def _run_case(generator: Any, case: Any, seconds: float, fix: bool) -> Json:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording"
        expected = generator.make(case, path, seconds)
        recording = read_recording(path)
        begun_s = time.perf_counter()
        report = check_recording(recording)
        taken_s = time.perf_counter() - begun_s
        figures = {"fix": repaired(generator, case, seconds, recording, report)} if fix else {}
    said = {str(finding.fault) for finding in report.faults}
    pairs = pairs_with_truth(measured_in(report), expected.truth)
    return {
        **_about(case),
        "lidar": expected.about,
        **judged(said, list(expected.right), expected.also),
        "said": [f"{each.fault} {each.subject}: {each.words}" for each in report.faults],
        "measured": [{**asdict(measured), "truth": truth} for measured, truth in pairs],
        "seconds": taken_s,
        **figures,
    }


Names = frozenset[str] | None


def judged(said: set[str], wanted: list[Names], also: Names) -> Json:
    """Whether each fault was named, and nothing false beside; where no checker has a name for a
    fault (None), or anything may be said besides (also is None), nothing can be false but an error
    of the checker's own."""
    broken = said & {CHECKER_ERROR.name}
    named = all(bool(said - broken if one is None else said & one) for one in wanted)
    if also is None or None in wanted:
        invented = broken
    else:
        invented = said - also.union(*(one for one in wanted if one is not None))
    return {
        "expected": [None if one is None else sorted(one) for one in wanted],
        "named": named,
        "invented": sorted(invented),
        "right": named and not invented,
    }


def _about(case: Any) -> Json:
    return {
        "case": case.name,
        "sort": case.sort,
        "harsh": case.harsh,
        "repeat": f"slamsim bench check --independent --faults '{case.name}'",
    }


def _failed(case: Any, error: str) -> Json:
    """A recording that could not be made, read or checked: a miss, which is told."""
    return {**_about(case), "right": False, "error": error}


def row_line(row: Json) -> str:
    """One case that is not as it should be."""
    if "error" in row:
        return f"{row['case']}: failed: {row['error']}"
    said = "; ".join(cast(list[str], row["said"])) or "nothing"
    if row["sort"] == "clean":
        return f"{row['case']} ({row['lidar']}, {row['harsh'] or 'usual'}): clean, yet {said}"
    wanted = " and ".join(
        "any fault" if one is None else " or ".join(one)
        for one in cast(list[list[str] | None], row["expected"])
    )
    return f"{row['case']} ({row['lidar']}): expected {wanted}; said {said}"


def _right(rows: Sequence[Json]) -> str:
    """How many of each sort are as they should be."""
    count = Counter(str(row["sort"]) for row in rows)
    right = Counter(str(row["sort"]) for row in rows if row["right"])
    return ", ".join(f"{sort} {right[sort]} of {of}" for sort, of in count.items())


def summarise_independent(rows: Sequence[Json]) -> Json:
    """Shares over all rows; a case that failed is one that was not named."""
    of = {
        sort: [row for row in rows if row["sort"] == sort]
        for sort in ("fault", "pair", "clean", "mutation")
    }
    harmful = [row for row in of["mutation"] if row.get("expected") or "error" in row]
    coverage = coverage_of(
        _pair(pair) for row in rows for pair in cast(list[Json], row.get("measured") or [])
    )
    stated = sum(cast(int, one["count"]) for one in coverage.values())
    held = sum(cast(int, one["count"]) * cast(float, one["inside"]) for one in coverage.values())
    return {
        "faults": len(of["fault"]),
        "kinds": len({str(row["case"]).partition("@")[0] for row in of["fault"]}),
        "named_share": _share(of["fault"]),
        "pairs": len(of["pair"]),
        "pairs_named_share": _share(of["pair"]),
        "mutations": len(of["mutation"]),
        "harmful": len(harmful),
        "harmful_told_share": _share(harmful),
        "clean": len(of["clean"]),
        "false_alarms": sum(not row["right"] for row in of["clean"]),
        "intervals_held": held / stated if stated else None,
        "intervals": coverage,
        **summarise_repaired(rows),
        "missed": dict(
            Counter(
                str(row["case"]).partition("@")[0] for row in of["fault"] if not row["right"]
            ).most_common()
        ),
        "rows": sorted(rows, key=lambda row: str(row["case"])),
    }


def _pair(stored: Json) -> tuple[Measured, float]:
    fields = {**stored}
    truth = cast(float, fields.pop("truth"))
    return Measured(**cast(Any, fields)), truth


def _share(rows: Sequence[Json]) -> float | None:
    return float(np.mean([bool(row["right"]) for row in rows])) if rows else None


def _table(figures: Json) -> dict[str, str]:
    """What a person sees."""
    rows = {
        "faults": _told(figures, "faults", "named_share"),
        "pairs of faults": _told(figures, "pairs", "pairs_named_share"),
        "harmful mutations": _told(figures, "harmful", "harmful_told_share"),
        "clean": f"{figures['clean']}, {figures['false_alarms']} with a false alarm",
        "repaired": fixed_words(figures),
    }
    for check, one in cast(Mapping[str, Json], figures["intervals"]).items():
        rows[f"  interval of {check}"] = coverage_row(one)
    return rows


def _told(figures: Json, count: str, share: str) -> str:
    if not figures[count]:
        return "none"
    return (
        f"{figures[count]}, {100.0 * cast(float, figures[share]):.1f} % named, nothing false beside"
    )
