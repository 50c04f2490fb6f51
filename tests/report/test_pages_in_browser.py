"""Pages as a browser lays them out: no sideways scroll, one type size, contrast; skipped without
Chromium."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import LAYOUT, browser, needs_chromium
from view_example import example_run

from slamsim.check.findings import CheckReport, Curve, Finding, Measurement, Plot
from slamsim.recording.frame_graph import FramePlace
from slamsim.report.pages.check import write_check_page
from slamsim.report.pages.run import write_report

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def call(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One browser that shows a page after the other."""
    with browser(tmp_path_factory.mktemp("browser") / "profile") as call:
        yield call


def layout(call: Any, page: Path, width: int, scheme: str) -> dict[str, Any]:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    call("Emulation.setDeviceMetricsOverride", **size)
    feature = {"name": "prefers-color-scheme", "value": scheme}
    call("Emulation.setEmulatedMedia", features=[feature])
    call("Page.navigate", url=page.as_uri())
    ready = "new Promise(done => document.readyState == 'complete' ? done() : onload = done)"
    call("Runtime.evaluate", expression=ready, awaitPromise=True)
    found: dict[str, Any] = json.loads(
        call("Runtime.evaluate", expression=LAYOUT)["result"]["value"]
    )
    return found


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    write_report(folder / "run.html", example_run())
    x = np.linspace(0.0, 10.0, 50)
    plot = Plot("a plot", "time, s", "offset, ms", (Curve("seen", x, np.sin(x)),), limits=(0.5,))
    names = ("delay of the gyroscope", "curvature of the path")
    reached = (Curve("reached", np.array([0.2, 1.4]), np.arange(2.0)),)
    named = Plot("how sharp", "over that wanted", "", reached, row_names=names)
    size = Measurement(4.0, 0.01, "deg")
    finding = Finding(
        "laser.yaw", "/a_long_name_of_a_topic/scan", "fault", "it looks to the left", estimate=size,
        fault="laser_yaw", advice="Turn its transform.", limit=0.3, plots=(plot, named),
    )  # fmt: skip
    frames = tuple(
        FramePlace(
            f"frame_{depth}", f"frame_{depth - 1}" if depth else "", depth, about, depth != 1
        )
        for depth, about in enumerate(("", "moves, /tf", "fixed, x -0.06 m, z 0.122 m", "fixed"))
    )
    open_one = Finding(
        "time.receipt_drift", "/encoder_ticks", "inconclusive", 9 * "some words ", estimate=size,
        limit=5.0,
    )  # fmt: skip
    report = CheckReport("recording", (finding, open_one), {"all": 1.0}, frames=frames)
    write_check_page(folder / "check.html", report)
    return {name: folder / f"{name}.html" for name in ("run", "check")}


@pytest.mark.parametrize("name", ["run", "check"])
@pytest.mark.parametrize(
    ("width", "scheme"),
    [
        (390, "light"),
        (390, "dark"),
        (800, "light"),
        (1000, "dark"),
        (1300, "light"),
        (1440, "dark"),
    ],
)
def test_a_page_is_readable(
    name: str, width: int, scheme: str, pages: dict[str, Path], call: Any
) -> None:
    found = layout(call, pages[name], width, scheme)
    assert found["wide"] <= found["screen"] == width
    assert found["pale"] == [] and found["clipped"] == [] and found["outside"] == []
    assert found["sizes"] and min(found["sizes"]) > 9.0
    assert found["cut"] == [] and (name == "run" or max(found["sizes"]) < 15.0)
    assert max(found["sizes"]) < 1.25 * min(found["sizes"]), "charts in one type size"
