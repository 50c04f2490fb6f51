"""The page of calibrated cameras: its first line, and its figures."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from slamsim.perception.calibration.sightings import CornerMisfits
from slamsim.report.figures.run import Picture
from slamsim.report.pages import cameras
from slamsim.report.pages.cameras import CalibratedView, Misfits, write_calibration_report
from slamsim.run.cameras.calibration_files import write_calibration
from slamsim.run.cameras.calibration_report import Calibrated, CameraResult

SQUARE_PX = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 40.0], [10.0, 40.0]])


def misfits(tags: int) -> Misfits:
    corners_px = np.tile(SQUARE_PX, (tags, 1))
    at_s = np.repeat(0.1 * np.arange(tags), 4)
    return Misfits((64, 48), corners_px, np.full_like(corners_px, 0.1), at_s, "time [s]")


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ((("1", "ok"), ("2", "ok")), "all is as claimed."),
        ((("1", "fault"), ("2", "ok")), "1 of 2 numbers are not as claimed."),
        ((("1", "fault"), ("", "inconclusive")), "1 of 2 numbers are not as claimed, 1 inconclusi"),
        ((("1", "ok"), ("2", "inconclusive")), "1 of 2 numbers are as claimed, 1 inconclusive."),
        ((("1", "inconclusive"),), "0 of 1 numbers are as claimed, 1 inconclusive."),
        ((("", "measured"), ("", "inconclusive")), "nothing was claimed, 1 inconclusive."),
        ((), "nothing was claimed."),
    ],
)
def test_what_is_inconclusive_is_not_said_to_be_as_claimed(
    numbers: tuple[tuple[str, str], ...], told: str, tmp_path: Path
) -> None:
    rows = [("x", "1 mm", claimed, verdict, "") for claimed, verdict in numbers]
    page = tmp_path / "report.html"
    write_calibration_report(page, [CalibratedView("/camera", {}, rows, {})], {}, ())
    text = page.read_text()
    assert told in text
    assert ("all is as claimed" in text) == (told == "all is as claimed.")


@pytest.mark.long
@pytest.mark.parametrize("topic", ['/a"><b onclick="x">', "/front left/(a)\\d"])
def test_names_of_topics_are_no_html_of_figures(topic: str, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    view = CalibratedView(topic, {}, (), {"board": misfits(3), "tags": misfits(3)})
    write_calibration_report(page, [view, view], {}, ())
    text = page.read_text()
    assert "<b" not in text.replace("<body", "") and 'id="arrows-tags-1-' in text
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(set(ids)) == len(ids) and not any(set(" ()/\\") & set(one) for one in ids)


def test_arrows_of_many_tags_are_of_all_their_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[set[tuple[float, float]]] = []

    def kept(figure: Figure, key: str) -> str:
        (line,) = figure.axes[0].lines
        drawn.append({(x, y) for x, y in np.column_stack(line.get_data()).tolist()})
        return key

    monkeypatch.setattr(cameras, "svg", kept)
    monkeypatch.setattr(cameras, "_MOST_ARROWS", 30)
    assert isinstance(cameras._arrows("a", misfits(30)), Picture)
    assert drawn == [set(map(tuple, SQUARE_PX.tolist()))]


@pytest.mark.parametrize(("near", "shown"), [([True, True, False], True), ([False] * 3, False)])
def test_corners_that_the_fit_has_out_of_sight_are_not_drawn(
    near: list[bool], shown: bool, tmp_path: Path
) -> None:
    """They are off by the width of the image, which would be all that a plot shows."""
    off_px = np.where(np.array(near)[:, None], 0.25, 640.0) * np.ones(2)
    lens = CornerMisfits(np.full((3, 2), 100.0), off_px, np.array([0.0, 1.0, 2.0]))
    camera = CameraResult("/camera", "optical", {}, (), lens=lens, size=(640, 480))
    write_calibration(tmp_path, Calibrated((camera,), (), ()))
    page = (tmp_path / "report.html").read_text()
    assert ("Where corners of board are off" in page) == shown
    if shown:
        by = round(0.05 * 640 / np.hypot(0.25, 0.25))
        assert f"off, {by} times" in page
