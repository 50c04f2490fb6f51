from __future__ import annotations

import re
import struct
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor

from rclpy import graph
from rclpy.context import Context, default_context
from rclpy.exceptions import InvalidParameterTypeException, InvalidTopicNameException
from rclpy.graph import Publisher, Subscription
from rclpy.qos import QoSProfile
from rclpy.type_support import check_is_valid_msg_type


@dataclass(frozen=True)
class Parameter:
    name: str
    value: Any


@dataclass(frozen=True)
class Time:
    nanoseconds: int


@dataclass(frozen=True)
class TopicEndpointInfo:
    node_name: str
    node_namespace: str
    topic_type: str
    qos_profile: QoSProfile


class Clock:
    def __init__(self) -> None:
        self.sim_ns: int | None = None

    def now(self) -> Time:
        return Time(time.time_ns() if self.sim_ns is None else self.sim_ns)

    def simulated(self, data: bytes) -> None:
        """data: rosgraph_msgs/Clock."""
        sec, nanosec = struct.unpack_from("<iI", data, 4)
        self.sim_ns = sec * 10**9 + nanosec


class Logger:
    def info(self, message: str) -> None:
        sys.stderr.write(f"[INFO] {message}\n")

    def warning(self, message: str) -> None:
        sys.stderr.write(f"[WARN] {message}\n")


class Node:
    def __init__(self, name: str, *, context: Context | None = None, namespace: str = "") -> None:
        self.context = context or default_context()
        if not self.context.ok():
            raise RuntimeError("rclpy.init() has not been called")
        self._name, self._namespace = name, f"/{namespace.strip('/')}"
        self._clock = Clock()
        self.descriptors: dict[str, ParameterDescriptor] = {}
        if self.declare_parameter("use_sim_time", False).value:
            self._clock.sim_ns = 0
            clock = getattr(sys.modules["rosgraph_msgs.msg"], "Clock")  # noqa: B009
            self.create_subscription(clock, "/clock", self._clock.simulated, QoSProfile(depth=1))

    def get_name(self) -> str:
        return self._name

    def get_namespace(self) -> str:
        return self._namespace

    def get_fully_qualified_name(self) -> str:
        return f"{self._namespace.rstrip('/')}/{self._name}"

    def get_clock(self) -> Clock:
        return self._clock

    def get_logger(self) -> Logger:
        return Logger()

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: ParameterDescriptor | None = None
    ) -> Parameter:
        given = self.context.parameters.get(name, value)
        if type(given) is not type(value):
            wanted = type(value).__name__
            raise InvalidParameterTypeException(
                f"Trying to set parameter '{name}' to '{given}', expecting type '{wanted}'"
            )
        self.descriptors[name] = descriptor or ParameterDescriptor()
        return Parameter(name, given)

    def resolve_topic_name(self, topic: str) -> str:
        if re.fullmatch(r"(~?/)?[A-Za-z_][\w/]*", topic) is None or topic.endswith("/"):
            raise InvalidTopicNameException(f"Invalid topic name: {topic!r}")
        remaps = self.context.remaps
        if topic.startswith("~/"):
            topic = f"{self.get_fully_qualified_name()}/{topic[2:]}"
        elif not topic.startswith("/"):
            topic = f"{self._namespace.rstrip('/')}/{topic}"
        whole = {self._absolute(one): self._absolute(other) for one, other in remaps.items()}
        return whole.get(topic, topic)

    def _absolute(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._namespace.rstrip('/')}/{name}"

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile) -> Publisher:
        check_is_valid_msg_type(msg_type)
        name = self.resolve_topic_name(topic)
        made = Publisher(self, msg_type.ros_name, name, qos_profile, msg_type=msg_type)
        with graph.changed:
            graph.publishers.append(made)
        return made

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: QoSProfile, *, raw: bool = True
    ) -> Subscription:
        check_is_valid_msg_type(msg_type)
        assert raw, "the stub has no message objects"
        made = Subscription(
            self,
            msg_type.ros_name,
            self.resolve_topic_name(topic),
            qos_profile,
            callback=callback,
            queue=deque(maxlen=qos_profile.depth),
        )
        with graph.changed:
            graph.subscriptions.append(made)
        return made

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        with graph.changed:
            found: dict[str, set[str]] = {}
            for one in (*graph.publishers, *graph.subscriptions):
                if one.known_to(self):
                    found.setdefault(one.topic, set()).add(one.ros_type)
        return [(name, sorted(types)) for name, types in sorted(found.items())]

    def get_publishers_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        with graph.changed:
            return [
                TopicEndpointInfo(
                    one.node.get_name(), one.node.get_namespace(), one.ros_type, one.qos
                )
                for one in graph.publishers
                if one.topic == topic_name and one.known_to(self)
            ]

    def destroy_node(self) -> None:
        with graph.changed:
            for one in (*graph.publishers, *graph.subscriptions):
                one.is_destroyed = one.is_destroyed or one.node is self
