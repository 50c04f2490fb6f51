"""Detection rates over all drives, as a table."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import cast

import numpy as np

from slamsim.bench.check.outcome import CheckOutcome, Json, Measured
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN

MOST_SIGMAS = 1.96
"""Of a normal error 95 % lie within so many."""


def coverage(outcomes: Iterable[CheckOutcome]) -> dict[str, Json]:
    """By check: how often the truth lies inside the 95 % interval, errors, sigmas, bounds.

    ratio: error over sigma, 1 for honest ones, and error: both as standard deviations by their
    medians, so that single wild ones show in ``inside`` alone. over_bound: median of sigma over
    the least one possible. An inconclusive answer counts: its interval is stated too.
    """
    return coverage_of(pair for outcome in outcomes for pair in outcome.with_truth())


def coverage_of(pairs: Iterable[tuple[Measured, float]]) -> dict[str, Json]:
    """The same of measurements, each with its truth."""
    by_check: dict[str, list[tuple[Measured, float]]] = defaultdict(list)
    for measured, truth in pairs:
        by_check[measured.check].append((measured, truth))
    return {check: _figures(found) for check, found in sorted(by_check.items())}


def coverage_row(figures: Json) -> str:
    """What a person sees of one check."""
    unit, over_bound = figures["unit"], figures["over_bound"]
    told = (
        f"{100.0 * cast(float, figures['inside']):.1f} % of {figures['count']} inside; "
        f"error/sigma {figures['ratio']:.2f}; sigma {figures['sigma']:.3g} {unit}, "
        f"error {figures['error']:.3g} {unit}"
    )
    return told if over_bound is None else f"{told}; {over_bound:.2f} x the bound"


def _error(measured: Measured, truth: float) -> float:
    error = measured.value - truth
    return (error + 180.0) % 360.0 - 180.0 if measured.unit == "deg" else error


def _figures(pairs: list[tuple[Measured, float]]) -> Json:
    errors = np.array([_error(measured, truth) for measured, truth in pairs])
    sigmas = np.maximum([measured.sigma for measured, _ in pairs], 1e-300)
    bounds = [m.sigma / m.bound for m, _ in pairs if m.bound is not None and m.bound > 0.0]
    return {
        "count": len(pairs),
        "inside": float(np.mean(np.abs(errors) <= MOST_SIGMAS * sigmas)),
        "ratio": SIGMAS_PER_MEDIAN * float(np.median(np.abs(errors / sigmas))),
        "sigma": float(np.median(sigmas)),
        "error": SIGMAS_PER_MEDIAN * float(np.median(np.abs(errors))),
        "unit": pairs[0][0].unit,
        "over_bound": float(np.median(bounds)) if bounds else None,
    }


Rows = dict[str, str]

MOST_NAMES = 4


def summarise(runs: Sequence[Json]) -> Json:
    """Per fault, pair and size how often it was named; alarms for nothing; seconds."""
    outcomes = [outcome for run in runs for outcome in _outcomes(run)]
    done = [outcome for outcome in outcomes if not outcome.skipped]
    by_sort: dict[str, list[CheckOutcome]] = defaultdict(list)
    for outcome in done:
        by_sort[outcome.sort].append(outcome)
    seconds = [outcome.seconds for outcome in done]
    return {
        "drives": len(runs),
        "failed": sum("error" in run for run in runs),
        "clean": _alarms(by_sort["clean"]),
        "real": _alarms(by_sort["real"]),
        "faults": _by_name(by_sort["fault"]),
        "pairs": _rates(by_sort["pair"]),
        "curves": _by_name(by_sort["curve"]),
        "coverage": coverage(done),
        "skipped": dict(Counter(outcome.trial for outcome in outcomes if outcome.skipped)),
        "seconds": {
            "median": float(np.median(seconds)) if seconds else None,
            "worst": max(seconds, default=None),
        },
    }


def run_line(run: Json) -> str:
    """One drive in a line: what was missed in it and what was invented."""
    if "error" in run:
        return f"{run['drive']}: failed: {run['error']}"
    outcomes = [outcome for outcome in _outcomes(run) if not outcome.skipped]
    missed = [o.trial for o in outcomes if o.sort in ("fault", "pair") and not o.named]
    told = f"{run['drive']}: {run['world']}, {run['lidar']}, {len(outcomes)} checked"
    if alarms := [name for o in outcomes if o.sort == "clean" for name in o.said]:
        told += f"; clean, yet {_few(alarms)}"
    if has := [name for o in outcomes if o.sort == "real" for name in o.said]:
        told += f"; has {_few(has)}"
    return told + (f"; missed {_few(missed)}" if missed else "")


def summary_tables(summary: Json) -> dict[str, Rows]:
    """Title and rows of each table."""
    clean, seconds = cast(Json, summary["clean"]), cast(Json, summary["seconds"])
    overall = {
        "drives": f"{summary['drives']}, {summary['failed']} failed",
        "clean runs with an alarm": f"{clean['alarmed']} of {clean['trials']}",
        **{f"  {name}": f"{count} times" for name, count in _items(clean["names"])},
        "faults named": _share(_total(summary["faults"])),
        "pairs, both named": _share(cast(Json, summary["pairs"])),
    }
    if seconds["median"] is not None:
        overall["seconds a check"] = f"{seconds['median']:.2f} median, {seconds['worst']:.2f} worst"
    tables = {
        "Checker": overall,
        "Faults": {name: _row(rates) for name, rates in _items(summary["faults"])},
    }
    if summary["curves"]:
        tables["Named, by size"] = _curve_rows(_items(summary["curves"]))
    if summary["coverage"]:
        rows = {check: coverage_row(figures) for check, figures in _items(summary["coverage"])}
        tables["Stated 95 % intervals"] = rows
    return tables


def _outcomes(run: Json) -> list[CheckOutcome]:
    return [CheckOutcome.from_json(data) for data in cast(list[Json], run["outcomes"])]


def _by_name(outcomes: Sequence[CheckOutcome]) -> dict[str, Json]:
    names = dict.fromkeys(outcome.trial for outcome in outcomes)
    return {name: _rates([o for o in outcomes if o.trial == name]) for name in names}


def _rates(outcomes: Sequence[CheckOutcome]) -> Json:
    instead = Counter(name for o in outcomes if not o.named for name in o.invented or ("nothing",))
    besides = Counter(name for o in outcomes if o.named for name in o.invented)
    return {
        "trials": len(outcomes),
        "named": sum(outcome.named for outcome in outcomes),
        "alone": sum(outcome.named and not outcome.invented for outcome in outcomes),
        "instead": dict(instead.most_common()),
        "besides": dict(besides.most_common()),
    }


def _alarms(outcomes: Sequence[CheckOutcome]) -> Json:
    names = Counter(name for outcome in outcomes for name in outcome.said)
    return {
        "trials": len(outcomes),
        "alarmed": sum(bool(outcome.said) for outcome in outcomes),
        "names": dict(names.most_common()),
    }


def _total(rates: object) -> Json:
    every = list(cast(Mapping[str, Json], rates).values())
    return {key: sum(cast(int, one[key]) for one in every) for key in ("trials", "named", "alone")}


def _share(rates: Json) -> str:
    named, trials = cast(int, rates["named"]), cast(int, rates["trials"])
    share = f" ({100.0 * named / trials:.1f} %)" if trials else ""
    return f"{named} of {trials}{share}, {rates['alone']} of them and nothing else"


def _row(rates: Json) -> str:
    told = f"{rates['named']}/{rates['trials']}"
    instead, besides = (
        cast(Mapping[str, int], rates["instead"]),
        cast(Mapping[str, int], rates["besides"]),
    )
    if instead:
        told += f"; instead {_counts(instead)}"
    if besides:
        told += f"; besides {_counts(besides)}"
    return told


def _curve_rows(rates: Sequence[tuple[str, Json]]) -> Rows:
    """By fault: every size, and how often it was named."""
    rows: dict[str, list[str]] = defaultdict(list)
    for trial, rate in rates:
        name, _, size = trial.rpartition(":")
        rows[name].append(f"{size}: {rate['named']}/{rate['trials']}")
    return {name: ", ".join(sizes) for name, sizes in rows.items()}


def _counts(names: Mapping[str, int]) -> str:
    shown = [f"{name} {count}" for name, count in list(names.items())[:MOST_NAMES]]
    return ", ".join(shown) + (", ..." if len(names) > MOST_NAMES else "")


def _few(names: Iterable[str]) -> str:
    every = list(names)
    return ", ".join(every[:MOST_NAMES]) + (
        f" and {len(every) - MOST_NAMES} more" if len(every) > MOST_NAMES else ""
    )


def _items(names: object) -> list[tuple[str, Json]]:
    return list(cast(Mapping[str, Json], names).items())
