"""``slamsim view``: a run in a window, in a browser, or in a picture."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from slamsim.report.viewer.process import open_viewer, recording_of, serve_web
from slamsim.report.viewer.screenshot import render_screenshot


def view_run(
    run: Path,
    web: bool = False,
    screenshot: Path | None = None,
    tell: Callable[[str], None] | None = None,
) -> None:
    """Show a run's folder or recording: in a window, in a browser (web), or into a PNG file.

    Blocks until the viewer is closed. tell is given the address for the browser; without it,
    standard error is. Raises NotFound without a recording, InputRefused for what is none, and
    SlamsimError if the viewer cannot be shown here.
    """
    if screenshot is not None:
        render_screenshot(run, screenshot)
    elif web:
        serve_web(recording_of(run), tell or _tell)
    else:
        open_viewer(recording_of(run))


def _tell(address: str) -> None:
    sys.stderr.write(f"Serving {address} until Ctrl-C\n")
