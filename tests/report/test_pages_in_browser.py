"""Pages as a browser lays them out: no sideways scroll, one type size, contrast; skipped without
Chromium."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from view_example import example_run
from websockets.sync.client import connect

from slamsim.check.findings import CheckReport, Curve, Finding, Measurement, Plot
from slamsim.report.pages.check import write_check_page
from slamsim.report.pages.run import write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")

LAYOUT = """
(() => {
  const shade = colour => {
    const [r, g, b] = colour.match(/[0-9.]+/g).slice(0, 3).map(v => {
      v /= 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = one => {
    for (; one; one = one.parentElement) {
      const colour = getComputedStyle(one).backgroundColor;
      if (!/, 0\\)$/.test(colour)) return colour; }
    return getComputedStyle(document.body).backgroundColor; };
  const words = [...document.querySelectorAll("body *")].filter(
    one => [...one.childNodes].some(n => n.nodeType == 3 && n.textContent.trim())
      && one.getBoundingClientRect().width);
  const contrast = words.map(one => {
    const style = getComputedStyle(one), svg = one.closest("svg");
    const a = shade(svg ? style.fill : style.color), b = shade(ground(svg || one));
    return [(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), one.textContent.trim()]; });
  const inked = [...document.querySelectorAll("figure svg text")];
  return JSON.stringify({
    wide: document.documentElement.scrollWidth, screen: innerWidth,
    pale: contrast.filter(([c]) => c < 4.5),
    clipped: words.filter(one => !one.closest("svg, .scroll, pre")
      && one.scrollWidth > one.clientWidth + 1 && one.clientWidth).map(o => o.textContent),
    sizes: inked.map(text => parseFloat(getComputedStyle(text).fontSize)
      * text.ownerSVGElement.getBoundingClientRect().width
      / text.ownerSVGElement.viewBox.baseVal.width),
    outside: inked.filter(text => { const box = text.getBoundingClientRect();
      return box.left < 0 || box.right > innerWidth; }).map(text => text.textContent)});
})()
"""


@contextmanager
def browser(profile: Path) -> Iterator[Any]:
    """Calls of the DevTools protocol of a page of its own."""
    assert CHROMIUM is not None
    words = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "about:blank"]
    words += ["--remote-debugging-port=0", f"--user-data-dir={profile}"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        told = next(line for line in process.stderr if "DevTools listening" in line)
        port = told.split(":")[-1].split("/")[0]
        with urlopen(f"http://127.0.0.1:{port}/json") as answer:
            page = next(one for one in json.load(answer) if one["type"] == "page")
        with connect(page["webSocketDebuggerUrl"], max_size=None) as socket:

            def call(method: str, **parameters: object) -> Any:
                socket.send(json.dumps({"id": 1, "method": method, "params": parameters}))
                while (answer := json.loads(socket.recv(timeout=60))).get("id") != 1:
                    pass
                return answer["result"]

            yield call
        process.terminate()


def layout(folder: Path, page: Path, width: int, scheme: str) -> dict[str, Any]:
    with browser(folder / "profile") as call:
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
    size = Measurement(4.0, 0.01, "deg")
    finding = Finding(
        "laser.yaw", "/a_long_name_of_a_topic/scan", "fault", "it looks to the left", estimate=size,
        fault="laser_yaw", advice="Turn its transform.", limit=0.3, plots=(plot,),
    )  # fmt: skip
    write_check_page(folder / "check.html", CheckReport("recording", (finding,), {"all": 1.0}))
    return {name: folder / f"{name}.html" for name in ("run", "check")}


@pytest.mark.parametrize("name", ["run", "check"])
@pytest.mark.parametrize(
    ("width", "scheme"), [(390, "light"), (390, "dark"), (1300, "light"), (1440, "dark")]
)
def test_a_page_is_readable(
    name: str, width: int, scheme: str, pages: dict[str, Path], tmp_path: Path
) -> None:
    found = layout(tmp_path, pages[name], width, scheme)
    assert found["wide"] <= found["screen"] == width
    assert found["pale"] == [] and found["clipped"] == [] and found["outside"] == []
    assert found["sizes"] and min(found["sizes"]) > 9.0
    assert max(found["sizes"]) < 1.25 * min(found["sizes"]), "charts in one type size"
