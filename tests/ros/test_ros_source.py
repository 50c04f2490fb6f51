"""A ROS 2 graph as a source of messages, by the stub of rclpy: see ``stub/rclpy``."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Thread
from typing import TYPE_CHECKING, Any

import pytest
from live_data import MAP, ODOM, SCAN, grid, scan
from ros_stub import TIMEOUT_S, message_type, node, publisher, quality, stub  # noqa: F401
from waiting import first_of, wait_for

if TYPE_CHECKING:
    from slamsim.ros.source import RosSource

WORDS = "std_msgs/msg/String"


@contextmanager
def source(*arguments: str, told: list[str] | None = None) -> Iterator[RosSource]:
    from slamsim.ros.source import RosSource

    notices = [] if told is None else told
    with RosSource(node("slamsim", *arguments), notices.append) as opened:
        yield opened


def first(opened: RosSource, send: Callable[[int], None]) -> Any:
    return first_of(opened.receive, send)


@pytest.mark.parametrize("reliable", [True, False])
@pytest.mark.parametrize("kept", [True, False])
def test_publishers_of_any_quality_are_heard(reliable: bool, kept: bool) -> None:
    robot = node("robot")
    scans = publisher(robot, "/scan", SCAN.type_name, reliable=reliable, kept=kept)
    with source() as opened:
        wait_for(opened.topics)
        opened.subscribe(["/scan"])
        message = first(opened, lambda number: scans.publish(scan(number)))
        assert (message.topic.name, message.topic.type_name) == ("/scan", SCAN.type_name)
        assert message.data[:4] == b"\0\1\0\0" and len(message.data) == len(scan(0))
        assert abs(message.log_ns - time.time_ns()) < TIMEOUT_S * 1e9
        assert opened.dropped == 0


def test_a_reliable_subscription_would_not_have_been_heard() -> None:
    """The stub refuses what a network refuses, so the test above can fail."""
    robot, listener = node("robot"), node("listener")
    scans = publisher(robot, "/scan", SCAN.type_name, reliable=False)
    kind = __import__("sensor_msgs.msg", fromlist=["LaserScan"]).LaserScan
    heard: list[bytes] = []
    matched = [
        listener.create_subscription(
            kind, "/scan", heard.append, quality(reliable, False), raw=True
        )
        for reliable in (True, False)
    ]
    wait_for(lambda: (scans.publish(scan(1)), matched[1].matched)[1])
    assert not matched[0].matched


def test_the_last_message_of_a_latched_topic_arrives_late() -> None:
    robot = node("robot")
    transforms = publisher(robot, "/tf_static", "tf2_msgs/msg/TFMessage", kept=True)
    transforms.publish(b"\0\1\0\0static")
    with source() as opened:
        opened.subscribe(["/tf_static"])
        message = opened.receive(TIMEOUT_S)
        assert message is not None and message.data == b"\0\1\0\0static"
        assert message.topic.latched


def test_topics_that_come_later_are_found() -> None:
    with source() as opened:
        opened.subscribe(["/scan"])
        assert opened.topics() == []
        scans = publisher(node("robot"), "/scan", SCAN.type_name)
        message = first(opened, lambda number: scans.publish(scan(number)))
        assert message.topic.name == "/scan"
        wait_for(opened.topics)
        assert [one.name for one in opened.topics()] == ["/scan"]


def test_topics_that_are_discovered_one_by_one_are_told_together() -> None:
    """What looks for scans and then reads the topics there are would miss the odometry."""
    robot = node("robot")
    publisher(robot, "/scan", SCAN.type_name)
    with source() as opened:
        wait_for(lambda: opened._kinds)
        publisher(robot, "/odom", ODOM.type_name)
        wait_for(opened.topics)
        assert {one.name for one in opened.topics()} == {"/scan", "/odom"}


def test_only_what_others_publish_is_a_topic() -> None:
    """Neither what is subscribed to only, nor the own map."""
    from slamsim.ros.source import POLL_S

    robot = node("robot")
    robot.create_subscription(
        message_type(WORDS), "/cmd", lambda data: None, quality(True, False), raw=True
    )
    publisher(robot, "/odom", ODOM.type_name)
    with source() as opened:
        opened.publish("/map", MAP.type_name, grid(3))
        wait_for(opened.topics)
        time.sleep(2 * POLL_S)
        assert [one.name for one in opened.topics()] == ["/odom"]


def test_what_the_node_publishes_does_not_come_back_to_it() -> None:
    """On /tf, to which the robot publishes, too."""
    kind, robot = "tf2_msgs/msg/TFMessage", node("robot")
    transforms = publisher(robot, "/tf", kind)
    with source() as opened:
        opened.subscribe(["/tf"])
        first(opened, lambda number: transforms.publish(b"\0\1\0\0odom"))
        for number in range(20):
            opened.publish("/tf", kind, b"\0\1\0\0map%d" % number)
        opened.publish("/tf", kind, b"\0\1\0\0same")
        transforms.publish(b"\0\1\0\0same")
        transforms.publish(b"\0\1\0\0last")
        arrived = [first(opened, lambda number: None).data]
        while arrived[-1] != b"\0\1\0\0last":
            arrived.append(first(opened, lambda number: None).data)
    assert arrived[-2:] == [b"\0\1\0\0same", b"\0\1\0\0last"]
    assert not any(b"map" in data for data in arrived)


def test_what_is_published_reaches_others_and_a_map_also_those_that_come_later() -> None:
    import rclpy.graph
    from rclpy.executors import SingleThreadedExecutor

    with source("-r", "map:=/slam/map") as opened:
        opened.publish("/map", MAP.type_name, grid(3))
        opened.publish("/map", MAP.type_name, grid(5))
        opened.publish("/tf", "tf2_msgs/msg/TFMessage", b"\0\1\0\0early")
        qualities = {one.topic: one.qos for one in rclpy.graph.publishers}
        assert qualities["/slam/map"] == quality(True, True, depth=1)
        assert qualities["/tf"] == quality(True, False, depth=100)

        rviz, heard = node("rviz"), list[tuple[str, bytes]]()
        for topic, kind, kept in (
            ("/slam/map", "nav_msgs/msg/OccupancyGrid", True),
            ("/tf", "tf2_msgs/msg/TFMessage", False),
        ):
            rviz.create_subscription(
                message_type(kind),
                topic,
                lambda data, topic=topic: heard.append((topic, data)),
                quality(True, kept),
                raw=True,
            )
        executor = SingleThreadedExecutor(context=rviz.context)
        executor.add_node(rviz)
        since_s = time.monotonic()
        while ("/tf", b"\0\1\0\0late") not in heard:
            opened.publish("/tf", "tf2_msgs/msg/TFMessage", b"\0\1\0\0late")
            executor.spin_once(timeout_sec=0.02)
            assert time.monotonic() - since_s < TIMEOUT_S
        assert heard.count(("/slam/map", grid(5))) == 1
        assert {data for _, data in heard} == {grid(5), b"\0\1\0\0late"}


def test_types_that_ros_cannot_load_are_told_once_and_left_out() -> None:
    told: list[str] = []
    robot = node("robot")
    scans = publisher(robot, "/scan", SCAN.type_name)
    words = publisher(robot, "/both", WORDS)
    publisher(robot, "/both", SCAN.type_name)
    import rclpy.graph

    for name, kind in (("/odd", "half_built_msgs/msg/Thing"), ("/new", "no_such_msgs/msg/Thing")):
        rclpy.graph.publishers.append(
            rclpy.graph.Publisher(robot, kind, name, quality(True, False))
        )
    with source(told=told) as opened:
        wait_for(lambda: len(opened.topics()) == 3)
        opened.subscribe(["/odd", "/new", "/both", "/scan"])
        assert first(opened, lambda number: scans.publish(scan(number))).topic.name == "/scan"
        wait_for(lambda: len(told) == 3)
        words.publish(b"\0\1\0\0")
        opened.publish("/x", "no_such_msgs/msg/Other", b"\0\1\0\0")
        opened.publish("/x", "no_such_msgs/msg/Other", b"\0\1\0\0")
    assert all(text.startswith("ROS 2 node /slamsim: messages of /") for text in told)
    odd, new, both, own = (
        next(text for text in told if f"messages of {name} are" in text)
        for name in ("/odd", "/new", "/both", "/x")
    )
    assert "install the package half_built_msgs and source its workspace" in odd
    assert "No module named 'no_such_msgs'" in new and "no_such_msgs" in own
    assert "it has the types sensor_msgs/msg/LaserScan, std_msgs/msg/String" in both
    assert len(told) == 4


def test_the_clock_of_a_simulator_is_when_messages_arrive() -> None:
    told: list[str] = []
    robot = node("robot")
    scans = publisher(robot, "/scan", SCAN.type_name)
    clock = publisher(robot, "/clock", "rosgraph_msgs/msg/Clock")
    with source("-p", "use_sim_time:=true", told=told) as opened:
        opened.subscribe(["/scan"])
        wait_for(lambda: (scans.publish(scan(1)), told)[1])
        assert "messages are left out until /clock comes" in told[0]
        assert opened.receive(0.0) is None

        def both(number: int) -> None:
            clock.publish(b"\0\1\0\0" + struct.pack("<iI", 12, 500))
            scans.publish(scan(number))

        assert first(opened, both).log_ns == 12_000_000_500


def test_nothing_is_published_or_spun_after_the_end() -> None:
    before = threading.active_count()
    with source() as opened:
        opened.publish("/map", MAP.type_name, grid(3))
        assert threading.active_count() == before + 1
    assert threading.active_count() == before
    opened._node.destroy_node()
    opened.publish("/map", MAP.type_name, grid(4))
    assert opened.receive(0.0) is None


def test_ros_that_ends_meanwhile_does_no_harm() -> None:
    told: list[str] = []
    with source(told=told) as opened:
        opened._node.context.shutdown()
        opened.publish("/map", MAP.type_name, grid(3))
        wait_for(lambda: any("ROS was shut down" in text for text in told))
        assert opened.receive(0.0) is None


def publish_maps(opened: RosSource, topic: str) -> None:
    for _ in range(50):
        opened.publish(topic, MAP.type_name, grid(3))


def test_publishing_from_many_threads_while_messages_arrive() -> None:
    robot = node("robot")
    scans = publisher(robot, "/scan", SCAN.type_name)
    with source() as opened:
        opened.subscribe(["/scan"])
        wait_for(opened.topics)
        first(opened, lambda number: scans.publish(scan(number)))
        work = [Thread(target=publish_maps, args=(opened, f"/map{n}")) for n in range(4)]
        for one in work:
            one.start()
        numbers = range(1000, 1050)
        for number in numbers:
            scans.publish(scan(number))
        for one in work:
            one.join()
        wanted, got = {scan(number) for number in numbers}, set[bytes]()
        wait_for(lambda: got.add(m.data) if (m := opened.receive(0.05)) else wanted <= got)
    assert wanted <= got
