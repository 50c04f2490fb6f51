"""A live robot in the Rerun viewer: what it shows, and that it never holds up the robot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from threading import Event
from typing import Any

import numpy as np
import pytest
from served_robot import live_hub, short_drive
from waiting import wait_for

from slamsim.core.types import Grid
from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import TopicKind
from slamsim.live.hub import Hub
from slamsim.live.published import SLAM_TOPICS, SlamMessages
from slamsim.live.servers import rerun
from slamsim.live.servers.rerun import Showing
from slamsim.report.viewer.process import headless_viewer, live_viewer


@pytest.fixture(scope="module")
def driven() -> list[tuple[str, int, bytes]]:
    """All messages of a second of a drive."""
    return short_drive("tiny")


def publish_map(hub: Hub, at_ns: int, size: int = 40) -> None:
    slam = SlamMessages()
    occupancy = np.full((size, size), np.nan, dtype=np.float32)
    occupancy[5:-5, 5:-5] = 0.0
    hub.publish("/tf", at_ns, slam.map_odom(at_ns, np.array([1.0, 1.0, 0.5])))
    hub.publish("/map", at_ns, slam.grid(at_ns, Grid(occupancy, 0.1, (-2.0, -2.0))))
    hub.publish("/path", at_ns, slam.path(at_ns, np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0]])))


def test_a_viewer_shows_it_without_an_error(driven: list[tuple[str, int, bytes]]) -> None:
    hub, frames = live_hub(), {"laser_link", "odom", "base_footprint"}
    with ExitStack() as opened:
        try:
            client = opened.enter_context(headless_viewer(None, 800, 500))
        except SlamsimError as error:
            pytest.skip(str(error))
        opened.enter_context(Showing(hub, client.url))
        publish_map(hub, driven[-1][1])
        for message in driven:
            hub.publish(*message)
        wait_for(lambda: frames <= parents_of(client).keys())
        client.take_screenshot(max_size=64)
        parents, state = parents_of(client), client.get_state()
    assert {view.name for view in state.views} == {"Map", "Speed [m/s]", "Turn rate [rad/s]"}
    assert [report.summary for view in state.views for report in view.reports] == []
    assert parents["odom"] == "map"
    assert parents["base_footprint"] == "odom"


def parents_of(client: Any) -> dict[str, str]:
    """Of all frames that are known by now, by child; none before the recording is there."""
    try:
        graph = client.get_transform_graph(frame_filter="named")
    except ConnectionError:
        return {}
    return {edge["child"]: edge["parent"] for edge in graph.get("edges", [])}


class NotedScene:
    """In the place of a viewer: notes what is drawn, as slowly as it is let."""

    scenes: list[NotedScene] = []  # noqa: RUF012
    go_on = Event()

    def __init__(self, url: str) -> None:
        self.drawn: list[tuple[str, Any]] = []
        NotedScene.scenes.append(self)

    def __getattr__(self, name: str) -> Any:
        def note(*given: Any) -> None:
            self.drawn.append((name, given))
            NotedScene.go_on.wait()

        return note


@pytest.fixture
def scenes(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[NotedScene]]:
    NotedScene.scenes, NotedScene.go_on = [], Event()
    monkeypatch.setattr(rerun, "LiveScene", NotedScene)
    yield NotedScene.scenes
    NotedScene.go_on.set()


def test_only_the_newest_is_sent_to_a_viewer_that_hangs(
    driven: list[tuple[str, int, bytes]], scenes: list[NotedScene]
) -> None:
    """The hub's thread passes all of them on before the viewer takes the first."""
    hub = live_hub()
    scans = [message for message in driven if message[0] == "/scan"]
    static = [message for message in driven if message[0] == "/tf_static"]
    with Showing(hub, "nowhere"):
        hub.publish(*static[0])
        wait_for(lambda: bool(scenes) and bool(scenes[0].drawn))
        for number in range(2_000):
            hub.publish(*scans[number % len(scans)][:1], 10**12 + number, scans[-1][2])
        NotedScene.go_on.set()
    drawn = [given for name, given in scenes[0].drawn if name == "scan"]
    assert len(drawn) == 1
    assert ("at", (10**12 + 1_999,)) in scenes[0].drawn


def test_a_drive_that_begins_anew_is_another_recording(
    driven: list[tuple[str, int, bytes]], scenes: list[NotedScene]
) -> None:
    hub = live_hub()
    NotedScene.go_on.set()
    with Showing(hub, "nowhere"):
        for begin in range(2):
            for message in driven:
                hub.publish(*message)
            wait_for(lambda: len(scenes) > begin and "scan" in dict(scenes[begin].drawn))  # noqa: B023
            hub.publish("/clock", driven[-1][1] + 2 * 10**9, b"")
    first, second = scenes
    assert ("close", ()) in first.drawn
    assert [given[1] for name, given in second.drawn if name == "transform"]


def test_without_a_screen_a_page_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with live_viewer() as (url, shown):
        assert url.startswith("rerun+http://127.0.0.1:")
        assert shown.startswith("http://127.0.0.1:")


def test_a_viewer_that_is_closed_ends_nothing_else(driven: list[tuple[str, int, bytes]]) -> None:
    hub = live_hub()
    with live_viewer() as (url, _):
        showing = Showing(hub, url).__enter__()
        hub.publish(*driven[0])
    for message in driven:
        hub.publish(*message)
    showing.__exit__()


def test_topics_of_a_robot_elsewhere_are_shown_by_type() -> None:
    kinds = {
        "/front/tf_static": ("tf2_msgs/msg/TFMessage", True),
        "/tf": ("tf2_msgs/msg/TFMessage", False),
        "/base_scan": ("sensor_msgs/msg/LaserScan", False),
        "/rear_scan": ("sensor_msgs/msg/LaserScan", False),
        "/ground_truth/odom": ("nav_msgs/msg/Odometry", False),
        "/odom": ("nav_msgs/msg/Odometry", False),
        "/map": ("nav_msgs/msg/OccupancyGrid", True),
    }
    topics = [TopicKind(name, kind, latched) for name, (kind, latched) in kinds.items()]
    assert list(rerun.shown_topics(topics).items()) == [
        ("/front/tf_static", "mounts"),
        ("/base_scan", "scan"),
        ("/odom", "odometry"),
        ("/map", "map"),
    ]


def test_what_cannot_be_shown_is_told_once(
    scenes: list[NotedScene], caplog: pytest.LogCaptureFixture
) -> None:
    NotedScene.go_on.set()
    scan = TopicKind("/base_scan", "sensor_msgs/msg/LaserScan")
    hub = Hub([scan, *SLAM_TOPICS])
    with Showing(hub, "nowhere"):
        hub.publish("/base_scan", 1, b"damaged")
        wait_for(lambda: "/base_scan cannot be shown" in caplog.text)
        hub.publish("/base_scan", 2, b"damaged again")
        hub.publish("/path", 3, SlamMessages().path(3, np.array([[1.0, 1.0, 0.0]])))
        wait_for(lambda: any(name == "path" for name, _ in scenes[0].drawn))
    assert caplog.text.count("cannot be shown") == 1
