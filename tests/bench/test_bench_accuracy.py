"""The accuracy bench: what counts as a false closure, a missed revisit, a failed seed."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_work import work

from slamsim.bench.accuracy import (
    COUNTED,
    SEED_HEADER,
    AccuracyCampaign,
    run_accuracy,
    seed_line,
    summarise,
    summary_rows,
)
from slamsim.bench.logs import Arguments, Children, Result
from slamsim.bench.truth import false_closures, revisits_closed
from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose
from slamsim.core.result import GraphEdge, PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import SlamsimError

QUIET = Reporter(quiet=True)
SHORT = ("drive.route.max_duration_s=6", "sensors.lidar.rate_hz=5")


def there_and_back(length_m: float = 12.0, step_m: float = 0.5) -> PlanarTrajectory:
    """Along x, and back by the same way."""
    out = np.arange(0.0, length_m, step_m)
    x = np.concatenate([out, out[::-1]])
    yaw = np.concatenate([np.zeros(out.size), np.full(out.size, np.pi)])
    stamps_ns = np.arange(x.size, dtype=np.int64) * 1_000_000_000
    return PlanarTrajectory(stamps_ns, np.column_stack([x, np.zeros(x.size), yaw]))


def closure(truth: PlanarTrajectory, source: int, target: int, off: FloatArray) -> GraphEdge:
    measured = compose(between(truth.poses[source], truth.poses[target]), off)
    covariance = np.diag(np.square([0.01, 0.01, 0.002]))
    return GraphEdge(source, target, measured, covariance, "closure")


def graph(truth: PlanarTrajectory, *edges: GraphEdge) -> PoseGraph:
    """The estimate is far off: only the truth may count."""
    bent = PlanarTrajectory(truth.stamps_ns, truth.poses * [1.1, 1.0, 0.9])
    return PoseGraph(bent, np.zeros((len(truth), 3, 3)), edges)


@pytest.mark.parametrize(
    ("off", "false"),
    [
        ([0.0, 0.0, 0.0], False),
        ([0.09, 0.0, 0.0], False),  # nine sigmas, but harmless
        ([0.12, 0.0, 0.0], True),
        ([0.0, 0.0, np.deg2rad(2.5)], False),
        ([0.0, 0.0, np.deg2rad(-3.5)], True),
    ],
)
def test_a_closure_is_false_that_is_both_far_off_and_sure_of_itself(
    off: list[float], false: bool
) -> None:
    truth = there_and_back()
    said = closure(truth, 3, 40, np.array(off))
    assert bool(false_closures(graph(truth, said), truth)) == false
    unsure = replace(said, covariance=said.covariance * 1e4)
    assert false_closures(graph(truth, unsure), truth) == []


def test_a_false_closure_is_told_with_its_place_and_whether_it_was_withdrawn() -> None:
    truth = there_and_back()
    said = closure(truth, 3, 40, np.array([0.3, 0.4, 0.0]))
    true = closure(truth, 5, 41, np.zeros(3))
    (found,) = false_closures(graph(truth, true, replace(said, weight=0.0)), truth)
    assert (found.source, found.target, found.believed) == (3, 40, False)
    assert found.target_ns == 40_000_000_000
    assert found.off_m == pytest.approx(0.5) and found.off_sigmas == pytest.approx(50.0)


def test_edges_of_the_chain_are_no_closures() -> None:
    truth = there_and_back()
    match = replace(closure(truth, 3, 4, np.array([1.0, 0.0, 0.0])), kind="match")
    assert false_closures(graph(truth, match), truth) == []


def test_a_revisit_counts_as_closed_near_a_believed_closure_only() -> None:
    truth = there_and_back()
    revisits, closed = revisits_closed(graph(truth), truth)
    # On the way back the first 10 m of path lie too near behind: 24 poses less those.
    assert 0 < revisits < 24 and closed == 0
    last = len(truth) - 1
    said = closure(truth, 0, last, np.zeros(3))
    assert revisits_closed(graph(truth, said), truth) == (revisits, 5)  # 2 m in steps of 0.5 m
    assert revisits_closed(graph(truth, replace(said, weight=0.0)), truth) == (revisits, 0)


@pytest.mark.long
def test_work_is_done_in_another_process() -> None:
    with Children() as children:
        assert children.run(work, "live") != os.getpid()


@pytest.mark.long
@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("die", "code 7"),
        ("stumble", "ValueError: over a stone"),
        pytest.param("refuse", "no such thing", marks=pytest.mark.slow),
    ],
)
def test_how_a_process_ended_is_told(what: str, words: str) -> None:
    with Children() as children, pytest.raises(SlamsimError, match=words):
        children.run(work, what)


class Here(Children):
    """What children do, in this process, which has loaded its libraries."""

    def run(
        self,
        work: Callable[Arguments, Result],
        *arguments: Arguments.args,
        **keywords: Arguments.kwargs,
    ) -> Result:
        return work(*arguments, **keywords)


@pytest.mark.long
@pytest.mark.usefixtures("drives_here")
def test_seeds_are_run_kept_and_summarised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamsim.bench.logs.Children", Here)
    config = load_run_config("tiny", overrides=SHORT)
    campaign = AccuracyCampaign(config, (2,), 1, tmp_path)
    figures = run_accuracy(campaign, QUIET)
    runs, summary = figures["runs"], figures["summary"]
    assert isinstance(runs, list) and isinstance(summary, dict)
    assert [run["seed"] for run in runs] == [2]
    assert "error" not in runs[0], runs[0]
    assert (tmp_path / "tiny_2" / "log" / "metadata.yaml").is_file()
    assert summary["ate_rmse_m"]["worst"] == runs[0]["ate_rmse_m"] < 0.1
    assert summary["failed"] == 0 and summary["scans"] == runs[0]["scans"] > 20
    assert str(summary["closures"]) in summary_rows(summary)["closures"]

    other = load_run_config("tiny", overrides=(*SHORT, "sensors.lidar.noise.constant_m=0.02"))
    again = run_accuracy(replace(campaign, config=other), QUIET)["runs"]
    assert isinstance(again, list)
    assert "another sensors.lidar.noise.constant_m" in again[0]["error"]


def test_the_verdict_on_consistency_is_that_of_the_band() -> None:
    for mean, verdict in ((3.1, "inside"), (4.5, "too sure"), (1.5, "too unsure")):
        counted = dict.fromkeys(COUNTED, 0)
        runs: list[dict[str, object]] = [
            {"seed": seed, "nees_mean": mean, **counted} for seed in range(20)
        ]
        told = summarise(runs)["nees"]
        assert isinstance(told, dict)
        low, high = told["band"]
        assert told["verdict"] == verdict and low < 3.0 < high
        assert verdict in summary_rows(summarise(runs))["NEES over the seeds"]


def test_a_failed_seed_is_told_and_left_out_of_the_summary() -> None:
    failed: dict[str, object] = {"seed": 3, "error": "the drive ended early"}
    summary = summarise([failed])
    assert summary["failed"] == 1 and "ate_rmse_m" not in summary
    assert seed_line(failed) == "   3  failed: the drive ended early"
    assert summary_rows(summary)["failed seeds"] == "1 of 1"


def test_a_line_fits_under_its_header_and_into_a_terminal() -> None:
    line = seed_line({"seed": 7, "ate_rmse_m": 0.00123, "closures": 120, "peak_memory_mb": 312.4})
    assert len(line) == len(SEED_HEADER) <= 80
    assert line.split()[:2] == ["7", "1.23"] and "120" in line
