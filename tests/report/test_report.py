"""The report: numbers under stable keys, and a page that needs nothing and hides nothing."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from view_example import Scans, example_run

from slamsim.check.findings import CheckReport, Finding
from slamsim.core.result import Calibrated, PoseGraph, SlamResult
from slamsim.core.types import Grid, PlanarTrajectory
from slamsim.evaluate.relations import RelationScores, RelationStatistics
from slamsim.report.pages.run import headline, report_html, write_report
from slamsim.report.run_view import RunView, path_length_m, report_json

KEYS = {
    *("ate_rmse_m", "ate_max_m", "rpe_trans_percent", "rpe_rot_deg_per_m"),
    *("odometry_ate_rmse_m", "map_wall_recall", "map_wall_precision", "map_free_iou"),
    *("path_length_m", "duration_s", "scans", "loop_closures", "loop_closures_rejected"),
    *("realtime_factor", "peak_memory_mb", "checks"),
}
VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """Collects what is on a page and checks that every element is closed."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.text: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.handle_attributes(attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.handle_attributes(attrs)

    def handle_attributes(self, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]
        linking = ("href", "src", "xlink:href")
        self.references += [value or "" for name, value in attrs if name in linking]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


@pytest.fixture(scope="module")
def run() -> RunView:
    return example_run()


@pytest.fixture(scope="module")
def html(run: RunView) -> str:
    return report_html(run)


def nothing(run: RunView) -> RunView:
    none = PlanarTrajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    graph, empty = PoseGraph(none, np.zeros((0, 3, 3)), ()), np.zeros(0)
    result = SlamResult(none, none, graph, empty, empty.astype(np.bool_), 0, 0)
    log = replace(run.log, scans=Scans(()), odometry=None, imu=None, encoders=None)
    cells = np.full((1, 1), np.nan, dtype=np.float32)
    return RunView(log=log, result=result, grid=Grid(cells, 0.05, (0.0, 0.0)))


def test_the_numbers_stand_under_their_stable_keys(run: RunView) -> None:
    numbers = report_json(run)
    assert set(numbers) >= KEYS
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert numbers["scans"] == 400
    assert numbers["duration_s"] == pytest.approx(39.9)
    assert numbers["realtime_factor"] == {
        "simulate": pytest.approx(39.9 / 1.4),
        "slam": pytest.approx(39.9),
        "total": pytest.approx(39.9 / 2.9),
    }
    assert (numbers["loop_closures"], numbers["loop_closures_rejected"]) == (3, 1)


def test_without_truth_the_same_keys_are_there_and_unknown(run: RunView) -> None:
    numbers = report_json(example_run(with_truth=False))
    assert set(numbers) == set(report_json(run))
    assert numbers["ate_rmse_m"] is None
    assert numbers["map_wall_recall"] is None


def test_what_is_not_finite_is_unknown_in_json(run: RunView) -> None:
    numbers = report_json(replace(run, peak_memory_mb=float("nan"), seconds={"slam": np.inf}))
    assert numbers["peak_memory_mb"] is None
    json.dumps(numbers, allow_nan=False)


def test_noise_at_rest_does_not_lengthen_a_path() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([np.linspace(0, 10, 1000), np.full(5000, 10.0)])
    poses = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    poses[:, :2] += rng.normal(0, 0.005, (6000, 2))
    trajectory = PlanarTrajectory(np.arange(6000, dtype=np.int64), poses)
    assert path_length_m(trajectory) == pytest.approx(10.0, abs=0.15)


def test_the_page_is_well_formed_and_fetches_nothing(html: str) -> None:
    page = Page(html)
    assert page.open == []
    assert "script" not in page.tags
    assert all(link.startswith(("#", "data:")) for link in page.references)
    assert not re.search(r"@import|url\((?!#)", html)
    assert "default-src 'none'" in html
    assert len(page.ids) == len(set(page.ids))
    own = {link[1:] for link in page.references if link.startswith("#")}
    own |= set(re.findall(r"url\(#([^)]+)\)", html))
    assert own <= set(page.ids)


def test_every_part_is_on_the_page(html: str, run: RunView) -> None:
    text = " ".join(Page(html).text)
    for part in (
        *("Map", "Over time", "Trajectory", "Time spent", "Reproduce"),
        *("Position error", "Heading error", "Wheel speed", "Turn rate", "inliers"),
        *("ATE RMSE", "Wall recall", "Free-space IoU", "Loop closures", "SLAM speed"),
        *run.log.warnings,
        *run.result.warnings,
        run.command,
    ):
        assert part in text, part
    assert html.count("<svg") == 7


def test_strings_from_files_stay_text(run: RunView) -> None:
    evil = "<script>alert('x')</script>&\"'"
    log = replace(run.log, name=evil, warnings=(evil,))
    result = replace(run.result, warnings=(evil,), seconds={evil: 1.0})
    page = report_html(
        replace(
            run,
            log=log,
            result=result,
            command=evil,
            config_yaml=evil,
            seconds={evil: 1.0},
            checked=CheckReport(evil, (Finding(evil, evil, "fault", evil, "laser_yaw", evil),)),
        )
    )
    assert "<script" not in page
    assert " ".join(Page(page).text).count(evil) >= 9


def test_what_reading_told_and_mended_is_not_told_again(run: RunView) -> None:
    faults = [
        Finding("time.step", "FLASER", "fault", f"{words} stamps lie before", "stamps_backward")
        for words in ("631 of 13,631", "9 of 13,631")
    ]
    read = "FLASER: 631 of 13,631 scans are stamped before the one above: sorted"
    view = replace(
        run,
        log=replace(run.log, warnings=(read,)),
        checked=CheckReport("intel", tuple(faults)),
    )
    assert [words.count("of 13,631") for words in view.doubts] == [1]
    assert "9 of 13,631" in view.doubts[0]
    assert sum("631 of 13,631 " in words for words in view.warnings) == 1


def test_relations_are_shown_with_their_spread(run: RunView) -> None:
    part = RelationStatistics(1234, 0.0456, 0.0123, 0.789, 0.456)
    relations = RelationScores(all=part, near=part, far=None, skipped=7)
    scores = replace(run.scores, relations=relations, odometry_relations=relations)
    text = " ".join(Page(report_html(replace(run, scores=scores))).text)
    assert "0.0456 ± 0.0123" in text
    assert "under 5 s" in text
    assert "over 60 s" not in text
    assert "7 relations outside" in text
    assert "45.6 mm" in text


def test_the_calibration_of_further_lidars_is_told_by_their_topics(run: RunView) -> None:
    assert "calibration_beside" not in report_json(run)
    yaw = {"laser_yaw_rad": Calibrated(math.radians(2.0), math.radians(0.1), observed=True)}
    of_two = replace(run, result=replace(run.result, calibration_beside={"/<rear>": yaw}))
    told = {"value": math.radians(2.0), "sigma": math.radians(0.1), "observed": True}
    assert report_json(of_two)["calibration_beside"] == {"/<rear>": {"laser_yaw_rad": told}}
    text = " ".join(Page(report_html(of_two)).text)
    assert "/<rear>: laser, turned to the left 2 ± 0.1 ° drive" in text


def test_a_run_without_truth_or_of_nothing_has_a_report_too(run: RunView) -> None:
    bare = report_html(example_run(with_truth=False))
    assert "against the true ones" not in bare
    assert "Position error" not in bare
    assert Page(report_html(nothing(run))).open == []


def test_the_same_run_gives_the_same_page(run: RunView, html: str) -> None:
    assert report_html(run) == html


def test_the_headline_is_a_sentence(run: RunView) -> None:
    assert re.fullmatch(
        r"53 m driven in 40 s, 400 scans mapped at 39\.9 × real time; "
        r"odometry alone would be 0\.193 m off\.",
        headline(run),
    )


def test_a_large_map_and_a_long_run_make_a_small_page(run: RunView, tmp_path: Path) -> None:
    count, side = 40_000, 1600
    rng = np.random.default_rng(0)
    cells = np.full((side, side), np.nan, dtype=np.float32)
    cells[100:-100, 100:-100] = rng.choice([0.1, 0.9], (side - 200, side - 200), p=[0.9, 0.1])
    stamps_ns = np.arange(count, dtype=np.int64) * 25_000_000
    poses = np.column_stack([rng.normal(0, 5, (count, 2)), np.zeros(count)])
    path = PlanarTrajectory(stamps_ns, poses)
    result = replace(
        run.result,
        trajectory=path,
        odometry=path,
        match_quality=rng.uniform(0, 1, count),
        degenerate=np.zeros(count, dtype=np.bool_),
    )
    large = replace(
        example_run(duration_s=4.0, with_truth=False),
        result=result,
        grid=Grid(cells, 0.05, (-40.0, -40.0)),
    )
    write_report(tmp_path / "report.html", large)
    assert (tmp_path / "report.html").stat().st_size < 4_000_000
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
