"""The ROS 2 node: parameters in, ``live_remote`` over the graph, map and recording on disk."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidTopicNameException, ParameterException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from slamsim.cli.common import loaded_config, selection
from slamsim.console.reporter import Reporter
from slamsim.console.summary import labelled
from slamsim.guard.errors import InputRefused, OverrideRefused, SlamsimError, shown
from slamsim.live.remote.received import PATIENCE_S
from slamsim.live.remote.robot import RemoteSetup
from slamsim.ros.parameters import NodeParameters
from slamsim.ros.source import POLL_S, RosSource
from slamsim.run.live.remote import live_remote
from slamsim.run.live.serving import Ports
from slamsim.run.naming import output_folder

NAME = "slamsim"


def run_node(arguments: Sequence[str]) -> None:
    """Until a signal comes. arguments: as of ``sys.argv``.

    Raises SlamsimError for wrong arguments and parameters, and as ``live_remote`` does.
    """
    with _node(arguments) as node:
        reporter, asked = _NodeReporter(node), _parameters(node)
        scan, odom, imu, map_topic = (
            _resolved(node, name, getattr(asked, name))
            for name in ("scan_topic", "odom_topic", "imu_topic", "map_topic")
        )
        loaded = loaded_config(None, asked.config or None, None, None)
        out = Path(asked.output_folder) if asked.output_folder else None
        with output_folder(
            out, "robot_live", overwrite=asked.overwrite, inputs=loaded.files
        ) as folder:
            setup = RemoteSetup(
                loaded.config,
                folder,
                selection([scan] if scan else None, odom, imu, ""),
                asked.record,
                map_topic=map_topic,
                publishes_transform=asked.publish_tf,
            )
            ports = Ports(page=0, rosbridge=0, foxglove=0)
            with RosSource(node, reporter.warn) as source:
                _await_topics(source, [name for name in (scan, odom, imu) if name], reporter)
                numbers = live_remote(source, setup, ports, reporter)
        told = ", ".join(f"{name} {value}" for name, value in labelled(numbers).items())
        reporter.say(f"Written to {folder}/: {told}")


class _NodeReporter(Reporter):
    """By the logger of the node: to the terminal, to ``/rosout`` and to the log files of ROS."""

    def __init__(self, node: Node) -> None:
        super().__init__(quiet=True)
        self._logger = node.get_logger()

    def note(self, sentence: str) -> None:
        """See ``Reporter``."""
        self._logger.info(sentence)

    def warn(self, sentence: str) -> None:
        """See ``Reporter``."""
        self._logger.warning(sentence)

    def say(self, sentence: str) -> None:
        """See ``Reporter``."""
        self._logger.info(sentence)


@contextmanager
def _node(arguments: Sequence[str]) -> Iterator[Node]:
    """Ctrl-C is not left to rclpy, which would end ROS before the last map is published."""
    unknown = remove_ros_args(arguments)[1:]
    if unknown:
        raise OverrideRefused(
            shown(unknown[0]),
            "settings of the node are ROS parameters, as in --ros-args -p scan_topic:=/scan",
        )
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node(NAME)
    except RuntimeError as error:  # all errors of rcl
        raise SlamsimError(f"ROS 2 does not start: {error}") from None
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _parameters(node: Node) -> NodeParameters:
    """As they were given; they cannot be changed later. Raises OverrideRefused."""
    values = {}
    for one in fields(NodeParameters):
        descriptor = ParameterDescriptor(description=one.metadata["help"], read_only=True)
        try:
            values[one.name] = node.declare_parameter(one.name, one.default, descriptor).value
        except ParameterException as error:
            raise OverrideRefused(f"parameter {one.name}", str(error)) from None
    return NodeParameters(**values)


def _resolved(node: Node, parameter: str, topic: str) -> str:
    """A topic with its namespace, remapped; empty as it is. Raises OverrideRefused."""
    try:
        return node.resolve_topic_name(topic) if topic else ""
    except (InvalidTopicNameException, RuntimeError) as error:
        reason = f"{shown(topic)} is no name of a topic: {error}"
        raise OverrideRefused(f"parameter {parameter}", reason) from None


def _await_topics(source: RosSource, names: Sequence[str], reporter: Reporter) -> None:
    """Until those that were named are there, for drivers that are launched together with this.

    Raises InputRefused where they do not appear.
    """
    begun_s, told = time.monotonic(), False
    while missing := sorted(set(names) - {one.name for one in source.topics()}):
        waited_s = time.monotonic() - begun_s
        if waited_s > PATIENCE_S:
            reason = f"nothing publishes {', '.join(missing)} within {PATIENCE_S:.0f} s"
            raise InputRefused(source.url, reason)
        if waited_s > 4 * POLL_S and not told:
            told = True
            reporter.note(f"Waiting for {', '.join(missing)}")
        time.sleep(POLL_S / 5)
