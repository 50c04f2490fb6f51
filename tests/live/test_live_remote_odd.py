"""Robots that run elsewhere: odd stamps, late topics, processes that end or stand still."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from played_robot import PlayedSource, is_living, mapping, recorded, simulated
from waiting import wait_for

from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter
from slamsim.core.types import PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.selection import Selection
from slamsim.live.hub import Message
from slamsim.live.live_map import LiveMap
from slamsim.live.mapping import MappingProcess
from slamsim.live.remote import checking
from slamsim.live.remote import robot as remote
from slamsim.live.remote.checking import KEPT_NS, PERIOD_NS, CheckingProcess
from slamsim.live.remote.checking_worker import _Kept
from slamsim.live.remote.controls import RemoteControls
from slamsim.live.remote.received import ScanOrder, read_topics
from slamsim.live.remote.robot import RemoteRobot, RemoteSetup
from slamsim.live.remote.teleop import Teleop
from slamsim.run.live import remote as run_remote
from slamsim.run.live.remote import live_remote
from slamsim.run.live.serving import Ports

pytestmark = pytest.mark.usefixtures("drives_here")

SCAN = TopicKind("/scan", "sensor_msgs/msg/LaserScan")
ODOM = TopicKind("/odom", "nav_msgs/msg/Odometry")
FIXED = TopicKind("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
TWIST = TopicKind("/cmd_vel", "geometry_msgs/msg/Twist")
SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    return simulated(tmp_path_factory.mktemp("odd") / "log", "drive.route.max_duration_s=6")


class Told:
    """A ``MessageLink`` that says nothing and keeps what it is told."""

    url, dropped = "ws://told", 0

    def __init__(self, *looks: Sequence[TopicKind]) -> None:
        self._looks = list(looks)
        self.sent: list[tuple[str, bytes]] = []

    def topics(self) -> Sequence[TopicKind]:
        return self._looks.pop(0) if len(self._looks) > 1 else self._looks[0]

    def subscribe(self, names: object) -> None:
        return

    def receive(self, timeout_s: float) -> Message | None:
        return None

    def publish(self, topic: str, type_name: str, data: bytes) -> None:
        self.sent.append((topic, data))


def test_a_driven_robot_stops_though_nothing_else_goes_on() -> None:
    """Neither a loop that waits for SLAM nor one that ended may let it drive on."""
    source = Told([TWIST])
    teleop = Teleop(source)
    teleop.drive(0.25, 0.0, 0.01)
    wait_for(lambda: len(source.sent) == 2)
    teleop.drive(0.25, 0.0, 60.0)
    teleop.close()
    assert len(source.sent) == 4 and source.sent[1] == source.sent[3] != source.sent[0]
    with pytest.raises(SlamsimError, match="has ended"):
        teleop.drive(0.1, 0.0)
    with pytest.raises(SlamsimError, match="has ended"):
        teleop.go_to(0.0, 0.0, None)
    assert len(source.sent) == 4


def test_a_topic_for_twists_that_disappears_ends_nothing() -> None:
    source = Told([TWIST], [])
    teleop = Teleop(source)
    teleop.drive(0.25, 0.0, 60.0)
    teleop.close()
    assert len(source.sent) == 1


def test_what_was_recorded_outlives_slam(
    drive: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also what clients ask for before the map is begun is answered."""
    monkeypatch.setattr(remote, "FIRST_S", 0.5)
    source = PlayedSource(drive, [TWIST])
    with (
        MappingProcess() as process,
        pytest.raises(SlamsimError, match="the SLAM process"),
        mapping(source, tmp_path, process) as (robot, _),
    ):
        controls = RemoteControls(robot)
        assert controls.record(True) == tmp_path / "drive_1"
        with pytest.raises(SlamsimError, match="not sent enough yet"):
            controls.reset()
        controls.drive(0.25, 0.0, 60.0)
        wait_for(lambda: robot.received > 100)
        os.kill(process._child.pid, signal.SIGKILL)
        wait_for(lambda: not is_living())
    assert len(recorded(tmp_path / "drive_1" / "log")) > 100
    assert len(source.of("/cmd_vel")) == 2, "it was told to stop"


@pytest.mark.long
def test_the_map_outlives_a_failure(
    drive: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "FIRST_S", 0.5)

    def fail_once_mapped(robot: RemoteRobot, look: Callable[[], None]) -> bool:
        thread = Thread(target=robot.run)
        thread.start()
        try:
            wait_for(lambda: robot.known.grid is not None)
        finally:
            robot.stop()
            thread.join()
        raise SlamsimError("SLAM failed")

    monkeypatch.setattr(run_remote, "run_until_signal", fail_once_mapped)
    setup, ports = RemoteSetup(load_run_config("tiny"), tmp_path), Ports("", 0, 0, 0)
    with pytest.raises(SlamsimError, match="SLAM failed"):
        live_remote(PlayedSource(drive), setup, ports, Reporter(quiet=True), check=False)
    assert (tmp_path / "map" / "map.yaml").is_file()


@pytest.mark.parametrize(
    ("stamps_s", "begins"),
    [
        ([100, 101, 102, 103], False),
        ([100, 0, 101, 0, 0, 102], False),
        ([100, 99.5, 101, 100.5, 100.6, 100.7], False),
        ([100, 101, 5, 6, 7], True),
        ([100, 2e9, 101, 102, 103], True),
    ],
)
def test_single_stamps_begin_no_new_map(stamps_s: list[float], begins: bool) -> None:
    order = ScanOrder()
    stamps_ns = (np.array(stamps_s) * 1e9).astype(np.int64)
    assert any(order.is_another_drive(part) for part in stamps_ns[:, None]) is begins
    assert ScanOrder().is_another_drive(stamps_ns) is begins


def test_odometry_with_an_odd_stamp_is_got_over() -> None:
    """One stamp years ahead, or of 0, and the speed is right again with the next poses."""
    known = LiveMap(None)
    for n in range(200):
        stamp_ns = {50: 10**18, 120: 0}.get(n, 10**11 + n * 50_000_000)
        pose = np.array([[0.01 * n, 0.0, 0.0]])
        known.take([PlanarTrajectory(np.array([stamp_ns]), pose)])
        assert np.all(np.diff(known._odometry.stamps_ns) > 0)
    assert known.twist() == pytest.approx((0.2, 0.0))


def test_topics_that_are_told_one_by_one_are_all_read() -> None:
    source = Told([], [SCAN], [SCAN, FIXED], [SCAN, FIXED, ODOM])
    assert [one.name for one in read_topics(source)] == ["/scan", "/tf_static", "/odom"]


@pytest.mark.long
def test_a_checker_that_stands_still_costs_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checking, "LARGEST_BACKLOG", 1 << 20)
    with CheckingProcess("ws://played", Selection()) as checker:
        child = checker._child
        os.kill(child.pid, signal.SIGSTOP)
        for n in range(100):
            checker.take([Message(SCAN, n, bytes(100_000))])
        assert child.unsent_bytes < 2 << 20
        os.kill(child.pid, signal.SIGCONT)
        wait_for(lambda: checker.news() or not child.unsent_bytes)
        checker.take([Message(SCAN, 1, bytes(10))])
        assert not checker._has_gap


def message(topic: TopicKind, log_s: float, data: bytes = b"") -> Message:
    return Message(topic, round(log_s * SECOND_NS), data)


def test_the_checker_keeps_the_newest_and_begins_anew_after_a_gap() -> None:
    kept, fixed = _Kept(), message(FIXED, 1, b"new")
    kept.take((message(FIXED, 0, b"old"), fixed))
    end_s = 1 + 2 * KEPT_NS // SECOND_NS
    kept.take(tuple(message(SCAN, second) for second in range(1, end_s)))
    due = kept.due()
    assert due[0] is fixed and len(due) == 2 + KEPT_NS // SECOND_NS
    assert not kept._is_due(), "a period has to pass before the next"
    kept.take(())
    kept.take((message(SCAN, end_s), message(SCAN, end_s + PERIOD_NS / SECOND_NS)))
    assert len(kept.due()) == 3
    kept.take((message(SCAN, 5),))
    assert [one.log_ns for one in kept._messages] == [5 * SECOND_NS], "the clock was set back"
