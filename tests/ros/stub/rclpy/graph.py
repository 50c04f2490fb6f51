"""The network: publishers, subscriptions, and what each has discovered of the others."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from threading import Condition
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import InvalidHandle
from rclpy.qos import DurabilityPolicy, QoSProfile, compatible

if TYPE_CHECKING:
    from rclpy.node import Node

DISCOVERY_S = [0.05]
"""How long it takes until others know of a new endpoint."""
changed = Condition()
publishers: list[Publisher] = []
subscriptions: list[Subscription] = []


@dataclass(eq=False)
class Endpoint:
    node: Node
    ros_type: str
    topic: str
    qos: QoSProfile
    since_s: float = field(default_factory=time.monotonic)
    is_destroyed: bool = False

    def known_to(self, node: Node) -> bool:
        if self.is_destroyed or not self.node.context.ok():
            return False
        return node is self.node or time.monotonic() > self.since_s + DISCOVERY_S[0]


@dataclass(eq=False)
class Publisher(Endpoint):
    msg_type: Any = None
    kept: deque[bytes] = field(default_factory=deque)

    def publish(self, msg: object) -> None:
        if self.is_destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")
        if not self.node.context.ok():
            raise RuntimeError("Failed to publish: publisher's context is invalid")
        if not isinstance(msg, bytes):
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")
        with changed:
            match_all()
            if self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                self.kept = deque([*self.kept, msg], maxlen=self.qos.depth)
            for one in subscriptions:
                if self in one.matched:
                    one.queue.append(msg)
            changed.notify_all()


@dataclass(eq=False)
class Subscription(Endpoint):
    callback: Callable[[bytes], None] = lambda data: None
    matched: list[Publisher] = field(default_factory=list)
    queue: deque[bytes] = field(default_factory=deque)


def match_all() -> None:
    """Connect what has found each other by now; late subscriptions may get what was kept."""
    for one, other in _pairs():
        is_new = other not in one.matched and compatible(other.qos, one.qos)
        if is_new and one.known_to(other.node) and other.known_to(one.node):
            one.matched.append(other)
            if one.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                one.queue.extend(other.kept)


def _pairs() -> Iterator[tuple[Subscription, Publisher]]:
    for one in subscriptions:
        for other in publishers:
            same = (one.topic, one.ros_type) == (other.topic, other.ros_type)
            if same and not other.is_destroyed:
                yield one, other


def clear() -> None:
    """For the next test."""
    publishers.clear()
    subscriptions.clear()
    DISCOVERY_S[0] = 0.05
