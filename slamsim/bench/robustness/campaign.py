"""Many random cases on several cores; each result is written at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import cast

from slamsim.bench import Figures
from slamsim.bench.logs import keep_lines
from slamsim.bench.robustness.case import LIMIT_S, run_case
from slamsim.bench.robustness.conditions import Conditions, draw_conditions
from slamsim.console.reporter import Reporter
from slamsim.process.worker import Unworkable, WorkerDied, Workers

COUNTED = ("false_closures", "false_kidnappings", "kidnappings", "kidnappings_told")


@dataclass(frozen=True, slots=True)
class RobustnessCampaign:
    """What to run. numbers: of the cases. workers: cases at a time. kept: a folder for the results
    as they come, one line of JSON for each case."""

    seed: int
    numbers: Sequence[int]
    workers: int = 1
    kept: Path | None = None


def run_robustness(
    campaign: RobustnessCampaign,
    reporter: Reporter,
    draw: Callable[[int, int], Conditions] = draw_conditions,
) -> None:
    """Show every case, and a summary of them all; when stopped, of those that were done."""
    runs: list[Figures] = []
    reporter.say(HEADER)
    with (
        reporter.stage("robustness") as progress,
        closing(_all_cases(campaign, draw)) as done,
    ):
        try:
            for figures in done:
                runs.append(figures)
                reporter.say(case_line(figures))
                keep_lines(campaign.kept, f"robustness_{campaign.seed}.jsonl", runs)
                progress(len(runs), len(campaign.numbers))
        finally:  # A bench that is stopped is killed before its processes have ended.
            _show(sorted(runs, key=lambda figures: cast(int, figures["number"])), reporter)


def _show(runs: Sequence[Figures], reporter: Reporter) -> None:
    summary = summarise(runs)
    reporter.table(f"Robustness over {len(runs)} cases", _rows(summary))
    for figures in runs:
        if figures.get("outcome") == "silently wrong":
            reporter.say(f"silently wrong: {figures['repeat']}")
    reporter.result({**summary, "runs": list(runs)})


def summarise(runs: Sequence[Figures]) -> Figures:
    """Shares of the cases that could be simulated; sums of closures and kidnappings."""
    done = [run for run in runs if "outcome" in run]
    outcomes = Counter(cast(str, run["outcome"]) for run in done)
    of = max(len(done), 1)
    return {
        "cases": len(done),
        "not_simulated": len(runs) - len(done),
        "tracked_share": outcomes["tracked"] / of,
        "told_share": outcomes["told"] / of,
        "silently_wrong": outcomes["silently wrong"],
        "worse_than_wheels": sum(map(_worse_than_wheels, done)),
        **{key: sum(cast(int, run.get(key, 0)) for run in done) for key in COUNTED},
    }


def _worse_than_wheels(run: Figures) -> bool:
    """Whether a run that says nothing of it has an error larger than that of the wheels alone."""
    if run["outcome"] != "silently wrong":
        return False
    return cast(float, run["ate_m"]) > cast(float, run["odometry_ate_m"])


def _all_cases(
    campaign: RobustnessCampaign, draw: Callable[[int, int], Conditions]
) -> Generator[Figures]:
    """In the order in which they are done."""
    with Workers(campaign.workers) as workers:
        cases: dict[Future[Figures], Conditions] = {}
        for number in campaign.numbers:
            conditions = draw(campaign.seed, number)
            cases[workers.submit(partial(run_case, conditions), LIMIT_S)] = conditions
        for future in as_completed(cases):
            yield _figures(future, cases[future])


def _figures(future: Future[Figures], conditions: Conditions) -> Figures:
    """Those of a case, also of one in which something failed: SLAM tells that it failed when its
    process dies, as ``slamsim map`` would."""
    known: Figures = {**asdict(conditions), "repeat": conditions.repeat}
    try:
        return future.result()
    except Unworkable:
        raise
    except WorkerDied as died:
        return {**known, "outcome": "told", "why": died.reason}
    except Exception as error:
        return {**known, "outcome": "told", "why": f"{type(error).__name__}: {error}"}


HEADER = "case  beams  range    Hz  path  world       outcome            ATE   wheels  disturbed by"


def case_line(figures: Figures) -> str:
    """One case under ``HEADER``."""
    of = figures
    told = (
        f"{of['number']:4d} {of['beams']:6d} {of['range_m']:6.1f} {of['rate_hz']:5.1f} "
        f"{of['path_m']:5.0f}  {of['world']:<11}"
    )
    if "error" in of:
        return f"{told} not simulated: {of['error']}"
    ate, wheels = (
        f"{cast(float, of[key]):8.3f}" if key in of else "       -"
        for key in ("ate_m", "odometry_ate_m")
    )
    return f"{told} {of['outcome']:<14} {ate} {wheels}  {disturbances(of)}"


def disturbances(of: Mapping[str, object]) -> str:
    """What is not as it should be in a case, in short."""
    wheels = max(abs(cast(float, of["radius_error"])), abs(cast(float, of["track_error"])))
    there = (
        (not of["gyroscope"], "no gyroscope"),
        (not of["ticks"], "no ticks"),
        (wheels, f"wheels {wheels:.1%}"),
        (of["curve_deg_per_m"], f"curve {of['curve_deg_per_m']:.2g} deg/m"),
        (of["lost_share"], f"lost {cast(float, of['lost_share']):.0%}"),
        (cast(float, of["step_m"]) > 0.001, f"steps {of['step_m']} m"),
        (of["offset_m"], f"offset {of['offset_m']} m"),
        (of["people"], f"{of['people']} people"),
        (of["glass_share"], f"glass {cast(float, of['glass_share']):.0%}"),
        (of["kidnapped"], "kidnapped"),
    )
    return ", ".join(words for is_there, words in there if is_there)


def _rows(summary: Figures) -> dict[str, str]:
    return {
        "cases": f"{summary['cases']}, {summary['not_simulated']} could not be simulated",
        "tracked": f"{summary['tracked_share']:.1%}",
        "failed and told": f"{summary['told_share']:.1%}",
        "silently wrong": f"{summary['silently_wrong']}",
        "  worse than the wheels alone": f"{summary['worse_than_wheels']}",
        "false closures": f"{summary['false_closures']}",
        "false kidnappings": f"{summary['false_kidnappings']}",
        "real kidnappings told": f"{summary['kidnappings_told']} of {summary['kidnappings']}",
    }
