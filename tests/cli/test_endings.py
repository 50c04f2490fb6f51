"""How runs end: one verdict, few warnings; a second drive; a map that continues nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner
from view_example import example_run

from slamsim.check.findings import Finding
from slamsim.check.wording import warning
from slamsim.cli.common import close_run
from slamsim.cli.main import app
from slamsim.config.loading import load_run_config, with_drive_seed
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between
from slamsim.core.result import Event, GraphEdge, PoseGraph
from slamsim.core.types import PlanarTrajectory
from slamsim.core.weighing import BY_WEIGHT, all_weighed, by_weight, weighed
from slamsim.io.text.tum import read_tum
from slamsim.recording.frames import laser_mounting_of, tree_of
from slamsim.run.scoring import positions_95_m, verdict
from slamsim.run.stages import Report
from slamsim.slam.frontend.odometry import ELSEWHERE

pytestmark = pytest.mark.usefixtures("drives_here", "undrawn_figures")
SHORT = ("--set", "drive.route.max_path_length_m=5", "--set", "sensors.lidar.rate_hz=10")
UNCALIBRATED = ("--set", "slam.calibrate_laser=false")
"""Half of what a short log costs is the calibration of its laser, which has tests of its own."""

EVENTS = st.lists(
    st.builds(
        lambda start, length, kind: Event(start, start + length, kind, kind),
        st.integers(0, 10**12),
        st.integers(0, 10**11),
        st.sampled_from(BY_WEIGHT),
    ),
    max_size=30,
)


@given(EVENTS)
def test_each_kind_is_told_once_the_gravest_first_by_its_longest(events: list[Event]) -> None:
    told = by_weight(events, 0)
    assert {kind for kind, _ in told} == {event.kind for event in events}
    assert all(BY_WEIGHT.index(a) < BY_WEIGHT.index(b) for (a, _), (b, _) in pairwise(told))
    for kind, words in told:
        alike = [event for event in events if event.kind == kind]
        more = f" ({len(alike) - 1} more like this)" if len(alike) > 1 else ""
        longest_s = max(event.end_ns - event.start_ns for event in alike) * 1e-9
        assert words.endswith(f": {kind}{more}")
        assert words.startswith("at ") == (longest_s < 0.1)


def test_a_robot_that_did_not_move_made_no_map() -> None:
    assert "did not move" in verdict(example_run().result, 0.0, None)


def test_a_verdict_says_how_good_and_how_sure() -> None:
    result = replace(example_run().result, events=())
    count = len(result.graph.keyframes)
    within_m = positions_95_m(result.graph, np.ones(count, dtype=np.bool_))
    worst = max(np.linalg.eigvalsh(one[:2, :2]).max() for one in result.graph.covariances)
    assert within_m.max() == pytest.approx(np.sqrt(5.991 * worst), rel=1e-3)
    told = verdict(result, 10.0, 0.01234)
    assert "12.3 mm from the truth" in told
    assert "every position is sure within 24.5 mm (95 %)" in told


def test_a_verdict_with_doubts_says_where_to_look_and_how_sure_the_rest_is() -> None:
    result = example_run().result
    stamps_ns, count = result.graph.keyframes.stamps_ns.tolist(), len(result.graph.keyframes)
    unsure = result.graph.covariances.copy()
    unsure[10:20] *= 1e6  # as where the scans fitted nothing
    unsure[20 : 20 + count // 2] *= 4.0
    torn = [
        Event(stamps_ns[2], stamps_ns[3], "torn", "torn"),
        Event(stamps_ns[10], stamps_ns[19], "torn", "torn"),
    ]
    graph = replace(result.graph, covariances=unsure)
    told = verdict(replace(result, graph=graph, events=tuple(torn)), 10.0, 0.01)
    x_m, y_m = graph.keyframes.poses[14, :2]
    assert f"2 where it may be torn, the longest near ({x_m:.1f}, {y_m:.1f}) m" in told
    rest = f"{100.0 * (count - 12) / count:.2g}"
    words = f"the rest of its path ({rest} %) is sure within 49 mm, half of that within 49 mm"
    assert words in told
    everywhere = Event(stamps_ns[0], stamps_ns[-1], "lost", "lost")
    assert "sure" not in verdict(replace(result, events=(everywhere,)), 10.0, 0.01)


def test_scans_that_fitted_nowhere_are_no_doubt_where_a_loop_that_passes_over_them_agrees() -> None:
    result = example_run().result
    poses, stamps_ns = result.graph.keyframes.poses, result.graph.keyframes.stamps_ns.tolist()
    spell = Event(stamps_ns[10] + 1, stamps_ns[14] + 1, "lost", "lost")
    sure = np.diag([1e-4, 1e-4, 1e-6])
    chain = [
        GraphEdge(k - 1, k, between(poses[k - 1], poses[k]), sure, "match")
        for k in range(1, len(poses))
    ]

    def told(*loops: tuple[int, int]) -> str:
        closures = [GraphEdge(a, b, between(poses[a], poses[b]), sure, "closure") for a, b in loops]
        graph = replace(result.graph, edges=(*chain, *closures))
        return verdict(replace(result, graph=graph, events=(spell,)), 10.0, 0.01)

    assert "A whole map" in told((10, 15))
    assert "scans fitted nowhere" in told((11, 20)) and "scans fitted nowhere" in told()


def test_a_map_of_one_key_frame_tells_nothing_of_how_sure_the_path_is() -> None:
    result = replace(example_run().result, events=())
    graph = result.graph
    first = PlanarTrajectory(graph.keyframes.stamps_ns[:1], graph.keyframes.poses[:1])
    alone = PoseGraph(keyframes=first, edges=(), covariances=np.zeros((1, 3, 3)))
    assert "sure within" not in verdict(replace(result, graph=alone), 10.0, None)


def test_how_sure_parts_are_that_nothing_joins_is_told_of_the_first() -> None:
    graph = example_run().result.graph
    count, half = len(graph.keyframes), len(graph.keyframes) // 2
    chain = [
        replace(edge, covariance=ELSEWHERE if edge.target == half else edge.covariance)
        for edge in graph.edges
        if edge.kind == "match"
    ]
    closure = GraphEdge(0, half, np.zeros(3), 1e-4 * np.eye(3), "closure")
    in_map, told = np.tile(100.0 * np.eye(3), (count, 1, 1)), np.ones(count, dtype=np.bool_)
    apart = replace(graph, edges=tuple(chain), in_map=in_map)
    assert positions_95_m(apart, told) == pytest.approx(np.full(half, 0.0245), rel=1e-2)
    joined = replace(apart, edges=(*chain, closure))
    assert positions_95_m(joined, told) == pytest.approx(np.full(count, 24.5), rel=1e-2)


def test_a_path_that_no_loop_checks_is_not_called_checked() -> None:
    result = replace(example_run().result, events=(), closures_accepted=1)
    assert "1 loop closure agrees and nothing needs a look" in verdict(result, 10.0, 0.01)
    open_ = replace(result, events=(Event(0, 1, "open loop", "no loop checks 159 m"),))
    told = verdict(open_, 10.0, 0.01)
    assert "nothing needs a look" not in told and "none checks a part of the path" in told


def test_a_map_by_a_laser_that_sits_no_one_knows_where_needs_a_look() -> None:
    result = replace(example_run().result, events=(), closures_accepted=1)
    warned: list[str] = []
    laser_mounting_of(tree_of(()), "base_link", "laser", warned)
    told = verdict(result, 10.0, 0.01, [*warned, "7 scans declare no range_max"])
    assert "nothing needs a look" not in told and "where the laser sits is not known" in told
    assert "nothing needs a look" in verdict(result, 10.0, 0.01, ["7 scans declare no range_max"])


def test_a_run_ends_with_its_verdict_and_three_warnings(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    warnings = tuple(f"warning {number}" for number in range(9))
    report = Report({"name": "run"}, warnings[::-1], weighed=warnings, verdict="A map.")
    close_run(Reporter(), report, tmp_path)
    told = capsys.readouterr()
    assert told.out.splitlines()[-1] == "A map."
    assert [line for line in told.err.splitlines() if line.startswith("! ")] == [
        f"! warning {number}" for number in range(3)
    ]
    assert "6 lesser warnings: --verbose" in told.err
    close_run(Reporter(), report, tmp_path, verbose=True)
    assert capsys.readouterr().err.count("! warning") == 9
    close_run(Reporter(), replace(report, weighed=warnings[:4]), tmp_path)
    assert "1 lesser warning: --verbose" in capsys.readouterr().err


def test_a_warning_says_nothing_twice() -> None:
    words = "its messages name 'hokuyo', which no transform knows"
    repeated = Finding("tf.frames", "/scan", "fault", words, fault="tf_unknown_frame")
    assert warning(repeated) == f"/scan: {words}"
    chain = "no chain of transforms leads from base to hokuyo, the frame of /scan"
    other = Finding("tf.links", "base -> hokuyo", "fault", chain, fault="tf_missing_link")
    assert warning(other) == f"frames that should be connected are not (base -> hokuyo): {chain}"


def test_another_drive_keeps_the_world_and_changes_everything_else() -> None:
    first = load_run_config("tiny", seed=4)
    second = with_drive_seed(first, 9)
    assert second.world.seed == 4 and second.seed == 9 and second.drive.route.seed == 9
    kept = load_run_config("tiny", overrides=["world.seed=2"], seed=4)
    assert with_drive_seed(kept, 9).world.seed == 2
    assert with_drive_seed(first, 9).sensors == first.sensors


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of one world, another drive through it, and a drive through another world."""
    folder = tmp_path_factory.mktemp("drives")
    for words in (
        ("map", "tiny", "--out", f"{folder}/first", *SHORT, *UNCALIBRATED),
        ("simulate", "tiny", "--drive-seed", "1", "--out", f"{folder}/second", *SHORT),
        ("simulate", "tiny", "--seed", "3", "--out", f"{folder}/elsewhere", *SHORT),
    ):
        assert CliRunner().invoke(app, [*words, "-q"]).exit_code == 0
    return folder


@pytest.mark.long
def test_a_second_drive_goes_another_way_through_the_same_world(drives: Path) -> None:
    worlds = [(drives / name / "world.yaml").read_text() for name in ("first", "second")]
    assert worlds[0] == worlds[1] != (drives / "elsewhere" / "world.yaml").read_text()
    first, second = (
        read_tum(drives / n / "ground_truth.tum").planar() for n in ("first", "second")
    )
    count = min(len(first), len(second))
    apart = first.poses[:count, :2] - second.poses[:count, :2]
    assert np.hypot(*apart.T).max() > 0.5


def test_a_second_drive_is_localised_and_continues_the_map(drives: Path, tmp_path: Path) -> None:
    words = ["localise", f"{drives}/second", "--in", f"{drives}/first", "--out", f"{tmp_path}/in"]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["in_map_max_m"] < 0.05
    words = ["map", f"{drives}/second", "--continue", f"{drives}/first", "--out", f"{tmp_path}/on"]
    assert CliRunner().invoke(app, [*words, *UNCALIBRATED, "-q"]).exit_code == 0
    assert (tmp_path / "on" / "keyframes.csv").is_file()


@pytest.mark.long
def test_a_map_that_continues_nothing_fails_and_claims_no_covariance(
    drives: Path, tmp_path: Path
) -> None:
    words = ["map", f"{drives}/elsewhere", "--continue", f"{drives}/first"]
    done = CliRunner().invoke(app, [*words, "--out", f"{tmp_path}/on", *UNCALIBRATED, "--json"])
    assert "nothing of" in str(done.exception) and "--drive-seed" in str(done.exception)
    assert getattr(done.exception, "exit_code", 0) == 1
    report = json.loads(done.stdout)
    assert report["nees_mean"] is None and "95 %" not in report["verdict"]
    assert (tmp_path / "on" / "map.yaml").is_file()
    assert not (tmp_path / "on" / "keyframes.csv").exists()


@pytest.mark.long
def test_a_drive_that_is_placed_nowhere_is_told_of_the_second_drive(
    drives: Path, tmp_path: Path
) -> None:
    words = ["localise", f"{drives}/elsewhere", "--in", f"{drives}/first"]
    done = CliRunner().invoke(app, [*words, "--out", f"{tmp_path}/in", "-q"])
    assert "could be placed" in str(done.exception) and "--drive-seed 1" in str(done.exception)


@given(EVENTS)
def test_all_warnings_stand_in_the_order_of_those_that_weigh_most(events: list[Event]) -> None:
    """A kind after the other as at the end of ``map``, and nothing is left out."""
    result = replace(example_run().result, events=tuple(events), warnings=("a note", "2 scans"))
    told, short = (tell(result, ("a clock is off",)) for tell in (all_weighed, weighed))
    assert told[-2:] == ("a note", "2 scans") and "a clock is off" in told
    kinds = [words.split(": ")[-1].split(" (")[0] for words in short]
    listed = [words.split(": ")[-1] for words in told[:-2] if "more like the last" not in words]
    assert list(dict.fromkeys(listed)) == kinds
    more = (int(words.split()[0]) for words in told if "more like the last" in words)
    assert sum(": " in words for words in told) + sum(more) == len(events)
