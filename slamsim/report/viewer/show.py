"""``slamsim view``: a run in a window, in a browser, or in a picture."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rerun.experimental import Recording, Timeline, ViewerClient, ViewerState

from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.guard.output import write_atomic
from slamsim.report.viewer.process import headless_viewer, open_viewer, recording_of, serve_web
from slamsim.report.viewer.stage import RECORDED_TIME, SIMULATED_TIME


def view_run(
    run: Path,
    web: bool = False,
    screenshot: Path | None = None,
) -> None:
    """Show a run's folder or recording: in a window, in a browser (web), or into a PNG file.

    Blocks until the viewer is closed; the address for the browser goes to standard error. Raises
    NotFound without a recording, InputRefused for what is none, and SlamsimError if the viewer
    cannot be shown here.
    """
    if screenshot is not None:
        render_screenshot(run, screenshot)
    elif web:
        serve_web(recording_of(run), _tell)
    else:
        open_viewer(recording_of(run))


def _tell(address: str) -> None:
    sys.stderr.write(f"Serving {address} until Ctrl-C\n")


_WINDOW = 1600, 1000
"""Pixels of the window that is drawn, width and height."""

LOAD_TIMEOUT_S = 120.0
SETTLE_TIMEOUT_S = 20.0
TIMELINES = SIMULATED_TIME, RECORDED_TIME
_CALM_S = 1.0
"""Views report missing frames while a recording still arrives: what stays this long is meant."""


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """What a person would see on opening a recording.

    errors: what views and viewer report, each with its view's name. views: names of the views.
    parents: the parent of each named frame at the end of the recording. duration_s: of its time
    line.
    """

    errors: tuple[str, ...]
    views: tuple[str, ...]
    parents: dict[str, str]
    duration_s: float


def render_screenshot(
    run: Path,
    png: Path,
    view_name: str | None = None,
) -> None:
    """Draw a recording's last instant into a PNG file: the whole viewer, or one of its views.

    run: its folder or recording. view_name: a view that is not behind another tab. Raises
    SlamsimError for a view that is not there.
    """
    with headless_viewer(recording_of(run), *_WINDOW) as client:
        state = _settled(client, run)
        view_id = None
        if view_name is not None:
            ids = {view.name: view.view_id for view in state.views}
            if view_name not in ids:
                raise SlamsimError(f"there is no view {view_name!r}, but {', '.join(ids)}")
            view_id = ids[view_name]
        picture = client.take_screenshot(view_id)
    write_atomic(png, picture)


def check_recording(run: Path) -> RecordingCheck:
    """Open a recording without a screen and tell what the viewer makes of it."""
    with headless_viewer(recording_of(run), *_WINDOW) as client:
        state = _settled(client, run)
        graph = client.get_transform_graph(frame_filter="named")
        logged = [entry for entry in client.get_logs() if entry.level == "ERROR"]
    timeline = _simulated_time(state)
    return RecordingCheck(
        errors=(*_view_errors(state), *(f"viewer: {entry.message}" for entry in logged)),
        views=tuple(view.name for view in state.views),
        parents={edge["child"]: edge["parent"] for edge in graph.get("edges", [])},
        duration_s=0.0 if timeline is None else timeline / 1e9,
    )


def _settled(client: ViewerClient, recording: Path) -> ViewerState:
    """The viewer's state once the recording is loaded, at its end, and drawn without change."""
    _wait_until_loaded(client, recording)
    shown = _shown(client.get_state())
    for timeline in shown.timelines if shown else []:
        if timeline.name in TIMELINES and timeline.end is not None:
            _go_to(client, timeline)
    deadline = time.monotonic() + SETTLE_TIMEOUT_S
    calm_since = time.monotonic()
    while True:
        is_drawn = _is_drawn(client)
        state, now = client.get_state(), time.monotonic()
        if not is_drawn or _view_errors(state):
            calm_since = now
        if now - calm_since >= _CALM_S or now >= deadline:
            return state
        time.sleep(0.1)


def _is_drawn(client: ViewerClient) -> bool:
    """Whether the viewer draws in the time that its client waits. The first picture, for which a
    graphics driver without its cache compiles shaders, may take longer on a busy machine."""
    try:
        client.take_screenshot(max_size=64)
    except TimeoutError:
        return False
    return True


def _go_to(client: ViewerClient, timeline: Timeline) -> None:
    """To the end of a time line."""
    end_ns = timeline.end or 0
    if timeline.time_type == "timestamp":
        end = np.datetime64(end_ns, "ns")
        client.set_time(timeline.name, timestamp=end, play_state="paused")
    else:
        client.set_time(timeline.name, duration=end_ns / 1e9, play_state="paused")


def _wait_until_loaded(client: ViewerClient, recording: Path) -> None:
    deadline = time.monotonic() + LOAD_TIMEOUT_S
    while time.monotonic() < deadline:
        state = client.get_state()
        shown = _shown(state)
        if not state.loading and shown is not None and shown.timelines and state.views:
            return
        errors = [entry.message for entry in client.get_logs() if entry.level == "ERROR"]
        if errors and shown is None:
            raise InputRefused(recording, f"the Rerun viewer cannot open it: {errors[0]}")
        time.sleep(0.1)
    raise SlamsimError(f"{recording}: not loaded by the Rerun viewer within {LOAD_TIMEOUT_S:.0f} s")


def _shown(state: ViewerState) -> Recording | None:
    active = [r for r in state.recordings if r.store_id == state.active_recording]
    return active[0] if active else None


def _simulated_time(state: ViewerState) -> int | None:
    """Length of the time line in nanoseconds."""
    shown = _shown(state)
    for timeline in shown.timelines if shown else []:
        start, end = timeline.start, timeline.end
        if timeline.name in TIMELINES and start is not None and end is not None:
            return end - start
    return None


def _view_errors(state: ViewerState) -> tuple[str, ...]:
    return tuple(
        f"{view.name}: {report.summary}"
        for view in state.views
        for report in view.reports
        if report.severity == "error"
    )
