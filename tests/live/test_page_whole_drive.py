"""A person's part: headless Chromium drives the simulated robot by its keys through a labyrinth,
looking at the page alone, while SLAM maps it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browsed_page import CONNECTED, Page
from chromium import browser, needs_chromium
from waiting import wait_for

from slamsim.config.loading import load_run_config
from slamsim.core.geometry import wrap_angle
from slamsim.core.types import FloatArray
from slamsim.live.controls import LiveOptions
from slamsim.live.hub import Hub
from slamsim.live.loop import LiveLoop, LiveSetup
from slamsim.live.loop_controls import LoopControls
from slamsim.live.mapping import MappingProcess
from slamsim.live.servers.access import Access
from slamsim.live.servers.page import PageServer
from slamsim.run.live.world import live_config
from slamsim.sim.drive.route import plan_route

pytestmark = [needs_chromium, pytest.mark.slow]

AHEAD_M, STRAIGHT_RAD, TURNS_ONLY_RAD, ARRIVED_M = 0.35, 0.08, 0.4, 0.25
KEYS = {"ahead": ("w", "KeyW"), "left": ("a", "KeyA"), "right": ("d", "KeyD")}
SEEN = """["place", "heading", "area"].map(id => document.getElementById(id).textContent)"""


@pytest.fixture(params=["tiny", "labyrinth"])
def loop(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Iterator[tuple[LiveLoop, Hub, FloatArray]]:
    """The robot in its world, and the points of a tour through it."""
    config = live_config(load_run_config(request.param, None, ("sensors.lidar=lds_01",)))
    setup = LiveSetup.built(config, tmp_path, LiveOptions())
    legs = plan_route(setup.world, setup.robot, config.drive).legs
    points_m = np.concatenate([leg.points_m for leg in legs])
    with MappingProcess() as process:
        loop = LiveLoop(setup, process)
        thread = threading.Thread(target=loop.run)
        thread.start()
        try:
            yield loop, loop.hub, points_m
        finally:
            loop.stop()
            thread.join()


def press(page: Page, wanted: set[str], held: set[str]) -> None:
    for name in sorted(wanted ^ held):
        page.key("keyDown" if name in wanted else "keyUp", *KEYS[name])
    held.clear()
    held.update(wanted)


def seen(page: Page) -> tuple[FloatArray, float, float]:
    """(place (2,), heading, mapped m2) as the page tells them."""
    place, heading, area = page.value(SEEN)
    x_m, y_m = (float(word) for word in place.removesuffix(" m").split(","))
    yaw_rad = np.radians(float(heading.removesuffix("°")))
    return np.array([x_m, y_m]), float(yaw_rad), float(area.removesuffix(" m²"))


def test_keys_drive_through_a_whole_labyrinth(
    loop: tuple[LiveLoop, Hub, FloatArray], tmp_path: Path
) -> None:
    live, hub, points_m = loop
    areas, held, at = [], set[str](), 0
    place_m = points_m[0]
    with (
        PageServer(hub, LoopControls(live), Access(), 0) as server,
        browser(tmp_path / "profile") as call,
    ):
        page = Page(call)
        page.open(server.address)
        page.wait(CONNECTED)
        wait_for(lambda: "," in page.value(SEEN)[0])
        end_s = time.monotonic() + 1200.0
        while at < len(points_m) - 1 or np.hypot(*(points_m[-1] - place_m)) > ARRIVED_M:
            assert time.monotonic() < end_s, f"point {at} of {len(points_m)} was reached"
            place_m, yaw_rad, area_m2 = seen(page)
            areas.append(area_m2)
            while at < len(points_m) - 1 and np.hypot(*(points_m[at] - place_m)) < AHEAD_M:
                at += 1
            x_m, y_m = points_m[at] - place_m
            off_rad = float(wrap_angle(np.arctan2(y_m, x_m) - yaw_rad))
            wanted = {"ahead"} if abs(off_rad) < TURNS_ONLY_RAD else set()
            if abs(off_rad) > STRAIGHT_RAD:
                wanted.add("left" if off_rad > 0.0 else "right")
            press(page, wanted, held)
            time.sleep(0.03)
        press(page, set(), held)
        truth, believed = live.true_pose, live.known.pose()
    assert believed is not None
    assert np.hypot(*(believed - truth)[:2]) < 0.1, "as well mapped as by the tour"
    assert areas[-1] > 1.5 * areas[0] and areas[-1] > 20.0, "the map grew"
