"""Headless Chromium, which lays pages out and is sent keys, over its DevTools protocol."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.sync.client import connect

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")

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
  const cut = td => {
    const range = document.createRange();
    const nodes = [...td.childNodes].filter(node => node.nodeType == 3);
    return nodes.some(node => [...node.textContent.matchAll(/[^\\s/-]+/g)].some(word => {
      range.setStart(node, word.index); range.setEnd(node, word.index + word[0].length);
      return new Set([...range.getClientRects()].map(box => box.top)).size > 1; })); };
  const inked = [...document.querySelectorAll("figure svg text")];
  return JSON.stringify({
    wide: document.documentElement.scrollWidth, screen: innerWidth,
    pale: contrast.filter(([c]) => c < 4.5),
    clipped: words.filter(one => !one.closest("svg, .scroll, pre")
      && one.scrollWidth > one.clientWidth + 1 && one.clientWidth).map(o => o.textContent),
    cut: [...document.querySelectorAll(".words td")].filter(cut).map(td => td.textContent),
    sizes: inked.map(text => parseFloat(getComputedStyle(text).fontSize)
      * text.ownerSVGElement.getBoundingClientRect().width
      / text.ownerSVGElement.viewBox.baseVal.width),
    outside: inked.filter(text => { const box = text.getBoundingClientRect();
      return box.left < 0 || box.right > innerWidth; }).map(text => text.textContent)});
})()
"""
"""What is wrong with the layout of a page, as JSON."""


@contextmanager
def browser(profile: Path) -> Iterator[Any]:
    """Calls of the DevTools protocol of a page of its own."""
    assert CHROMIUM is not None
    words = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "about:blank"]
    words += ["--remote-debugging-port=0", f"--user-data-dir={profile}"]
    with (
        subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process,
        ExitStack() as opened,
    ):
        opened.callback(process.terminate)  # else a test that fails would wait for it
        assert process.stderr is not None
        told = next(line for line in process.stderr if "DevTools listening" in line)
        port = told.split(":")[-1].split("/")[0]
        with urlopen(f"http://127.0.0.1:{port}/json") as answer:
            page = next(one for one in json.load(answer) if one["type"] == "page")
        socket = opened.enter_context(connect(page["webSocketDebuggerUrl"], max_size=None))

        def call(method: str, **parameters: object) -> Any:
            socket.send(json.dumps({"id": 1, "method": method, "params": parameters}))
            while (answer := json.loads(socket.recv(timeout=60))).get("id") != 1:
                pass
            return answer["result"]

        yield call
