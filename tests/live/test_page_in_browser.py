"""The page in headless Chromium: it draws the map as it grows and drives by keys, stick and tap;
skipped without Chromium."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from browsed_page import CONNECTED, Page
from chromium import LAYOUT, browser, needs_chromium
from fake_robot import FakeRobot
from waiting import wait_for

from slamsim.live.servers.access import Access
from slamsim.live.servers.page import PageServer

pytestmark = needs_chromium

DRAWN = """(() => {
  const map = document.getElementById("map"), pen = map.getContext("2d");
  const wanted = %s, {data} = pen.getImageData(0, 0, map.width, map.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4)
    count += data[i + 3] === 255 && wanted.every((c, k) => Math.abs(data[i + k] - c) < 3);
  return count; })()"""
FREE, SCAN, PATH = [255, 255, 255], [0xD1, 0x48, 0x0A], [0x3D, 0x8F, 0xC4]
"""Colours of the light scheme in ``page.css``."""
SMALL = """JSON.stringify([...document.querySelectorAll("button, select, .download, input")]
  .filter(one => one.getClientRects().length && Math.min(one.offsetWidth, one.offsetHeight) < 44)
  .map(one => one.id || one.textContent))"""
NAMELESS = """JSON.stringify([...document.querySelectorAll("button, select, input, canvas, #stick")]
  .filter(one => !(one.textContent.trim() || one.getAttribute("aria-label") || one.labels?.length))
  .map(one => one.id))"""


@contextlib.contextmanager
def living(robot: FakeRobot) -> Iterator[None]:
    ended = threading.Event()
    thread = threading.Thread(target=robot.run, args=(0.05, lambda: not ended.is_set()))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[FakeRobot]:
    robot = FakeRobot(tmp_path)
    with living(robot):
        yield robot


@pytest.fixture
def server(robot: FakeRobot) -> Iterator[PageServer]:
    with PageServer(robot.hub, robot, Access(), 0) as server:
        yield server


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("profile")) as call:
        yield Page(call)


def twists(robot: FakeRobot) -> list[tuple[float, float, float]]:
    return [given for name, given in robot.calls if name == "drive"]


def test_a_key_drives_and_the_drawn_map_grows(
    page: Page, server: PageServer, robot: FakeRobot
) -> None:
    page.open(server.address)
    page.wait(CONNECTED)
    page.wait(f"{DRAWN % SCAN} > 50")
    began = page.value(DRAWN % FREE)
    assert began > 1000 and page.value(DRAWN % PATH) < 20
    page.key("keyDown", "w", "KeyW")
    wait_for(lambda: len(robot.path) > 8)
    held = twists(robot)
    assert len(held) > 10 and set(held) == {(0.5, 0.0, 0.25)}, "repeated while it is held"
    page.key("keyUp", "w", "KeyW")
    wait_for(lambda: twists(robot)[-1][:2] == (0.0, 0.0))
    page.wait(f"{DRAWN % PATH} > 30")
    page.wait(f"{DRAWN % FREE} > {began} * 1.02")
    assert page.value("document.getElementById('place').textContent").startswith(
        f"{robot.pose[0]:.2f}"
    )


def test_the_robot_stops_when_the_page_loses_the_keyboard(
    page: Page, server: PageServer, robot: FakeRobot
) -> None:
    page.open(server.address)
    page.wait(CONNECTED)
    for end in (
        lambda: page.value("dispatchEvent(new Event('blur'))"),
        lambda: page.value(HIDE),
        lambda: page.key("keyDown", " ", "Space"),
        lambda: page.click("stop"),
    ):
        page.key("keyDown", "ArrowUp", "ArrowUp")
        wait_for(lambda: robot.calls and twists(robot)[-1][0] == 0.5)
        end()
        wait_for(lambda: twists(robot)[-1][0] == 0.0)
        count = len(robot.calls)
        time.sleep(0.3)
        assert len(robot.calls) == count, "nothing is sent by itself"
        page.key("keyUp", "ArrowUp", "ArrowUp")


def test_the_stick_drives_while_it_is_held(
    page: Page, server: PageServer, robot: FakeRobot
) -> None:
    page.open(server.address)
    page.wait(CONNECTED)
    x, y = page.middle("stick")
    page.mouse("mousePressed", x, y)
    page.mouse("mouseMoved", x - 22, y - 22)
    speed, yaw_rate, _ = wait_for(lambda: next((t for t in twists(robot) if t[0] > 0.1), None))
    assert 0.0 < speed < 0.5 and yaw_rate == pytest.approx(2.0 * speed), "left and ahead"
    page.mouse("mouseReleased", x - 22, y - 22)
    wait_for(lambda: twists(robot)[-1][:2] == (0.0, 0.0))


def test_fingers_drive_pan_and_zoom(page: Page, server: PageServer, robot: FakeRobot) -> None:
    page.open(server.address, 390)
    page.wait(CONNECTED)
    x, y = page.middle("stick")
    page.touch("touchStart", (x, y))
    page.touch("touchMove", (x, y - 44))
    wait_for(lambda: twists(robot) and twists(robot)[-1] == (0.5, 0.0, 0.25))
    page.touch("touchEnd")
    wait_for(lambda: twists(robot)[-1][:2] == (0.0, 0.0))
    x, y = page.middle("map")
    scale = page.value("document.getElementById('scale-text').textContent")
    page.touch("touchStart", (x - 20, y - 60), (x + 20, y - 60))
    page.touch("touchMove", (x - 70, y - 60), (x + 70, y - 60))
    page.touch("touchEnd")
    page.wait(f"document.getElementById('scale-text').textContent !== '{scale}'")
    page.touch("touchStart", (x, y - 60))
    page.touch("touchMove", (x + 60, y - 60))
    page.touch("touchEnd")
    assert page.value("document.getElementById('follow').ariaPressed") == "false"
    assert page.value("scrollX") == page.value("scrollY") == 0, "the page stays where it is"


HIDE = """Object.defineProperty(document, "hidden", {value: true, configurable: true});
  document.dispatchEvent(new Event("visibilitychange"));
  Object.defineProperty(document, "hidden", {value: false, configurable: true}); 0"""
GAMEPAD = """navigator.getGamepads = () =>
  [{connected: true, id: "pad", axes: [0.05, -0.5, 0.25, 0], buttons: []}]"""


def test_a_gamepad_drives(page: Page, server: PageServer, robot: FakeRobot) -> None:
    page.open(server.address)
    page.wait(CONNECTED)
    page.value(f"{GAMEPAD}; 0")
    wait_for(lambda: twists(robot))
    assert twists(robot)[-1] == (0.25, -0.25, 0.25)
    page.value("navigator.getGamepads = () => [null]; 0")
    wait_for(lambda: twists(robot)[-1][:2] == (0.0, 0.0))


def test_a_tap_sends_the_robot_there(page: Page, server: PageServer, robot: FakeRobot) -> None:
    page.open(server.address)
    page.wait(CONNECTED)
    x, y = page.middle("map")
    page.mouse("mousePressed", x + 48, y - 96)
    page.mouse("mouseReleased", x + 48, y - 96)
    page.click("go")
    page.mouse("mousePressed", x + 48, y - 96)
    page.mouse("mouseReleased", x + 48, y - 96)
    (goal,) = wait_for(lambda: [given for name, given in robot.calls if name == "go_to"])
    assert goal[:2] == pytest.approx((robot.pose[0] + 1.0, robot.pose[1] + 2.0), abs=0.05)


def test_buttons_do_what_they_say(page: Page, server: PageServer, robot: FakeRobot) -> None:
    page.open(server.address)
    page.wait(CONNECTED)
    page.value("document.querySelector('[data-mode=explore]').click()")
    page.wait("document.querySelector('[data-mode=explore]').ariaPressed === 'true'")
    page.click("pause")
    page.wait("!document.getElementById('step').disabled")
    page.click("step")
    page.value(
        "document.getElementById('rate').value = '5';"
        "document.getElementById('rate').dispatchEvent(new Event('change'))"
    )
    page.click("record")
    page.wait("document.getElementById('record').textContent === 'Stop recording'")
    page.click("record")
    link = page.wait("document.querySelector('.download')?.getAttribute('href')")
    assert link.startswith("/recording/")
    page.click("save")
    page.wait("document.getElementById('toast').textContent.startsWith('Map saved in maps')")
    page.click("reset")
    page.wait("document.getElementById('sure').open")
    page.value("document.querySelector('#sure [value=yes]').click()")
    calls = wait_for(lambda: robot.calls[-1] == ("reset", ()) and robot.calls)
    assert [name for name, _ in calls] == [
        "set_mode", "pause", "step", "set_rate", "record", "record", "save_map", "reset"
    ]  # fmt: skip


def test_it_connects_again_by_itself(page: Page, robot: FakeRobot) -> None:
    with PageServer(robot.hub, robot, Access(), 0) as server:
        port = int(server.address.split(":")[2].strip("/"))
        page.open(server.address)
        page.wait(CONNECTED)
    page.wait("document.body.dataset.link === 'lost'")
    assert "lost" in page.value("document.getElementById('banner').textContent")
    assert page.value("document.getElementById('panel').disabled")
    with PageServer(robot.hub, robot, Access(), port):
        page.wait("document.body.dataset.link === 'open'")
        assert page.value("document.getElementById('banner').hidden")


@pytest.mark.long
def test_a_token_is_taken_once_and_kept(page: Page, robot: FakeRobot) -> None:
    with PageServer(robot.hub, robot, Access("127.0.0.1", "secret-token"), 0) as server:
        page.open(server.address)
        page.wait(CONNECTED)
        assert page.value("location.search") == "" and page.value("document.cookie") == ""
        page.call("Page.reload")
        page.wait(CONNECTED)
        page.call("Network.clearBrowserCookies")
        page.call("Page.reload")
        page.wait("document.getElementById('token') !== null")
        page.value("document.getElementById('token').value = 'secret-token'")
        page.value("document.querySelector('form button').click()")
        page.wait(CONNECTED)


@pytest.mark.long
@pytest.mark.parametrize(
    ("width", "scheme"), [(390, "light"), (390, "dark"), (1300, "light"), (1440, "dark")]
)
def test_it_is_readable(
    width: int, scheme: str, page: Page, server: PageServer, robot: FakeRobot
) -> None:
    robot.record(True)
    time.sleep(0.3)
    robot.record(False)
    page.open(server.address, width, scheme)
    page.wait(CONNECTED)
    page.wait("document.querySelector('.download') !== null")
    page.click("pause")
    page.wait("!document.getElementById('paused').hidden")
    found = json.loads(page.value(LAYOUT))
    assert found["wide"] <= found["screen"] == width
    assert found["pale"] == [] and found["clipped"] == []
    assert json.loads(page.value(NAMELESS)) == []
    if width < 500:
        assert json.loads(page.value(SMALL)) == []
