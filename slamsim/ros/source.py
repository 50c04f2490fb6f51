"""A ROS 2 graph as a source of live messages.

Messages stay serialised (CDR) on their way in and out, so that no ROS message object is built.
Quality of service: https://docs.ros.org/en/jazzy/Concepts/Intermediate/About-Quality-of-Service-Settings.html
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from importlib import import_module
from threading import Event, Lock, Thread
from types import TracebackType
from typing import Any, Self

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.type_support import check_is_valid_msg_type

from slamsim.guard.errors import reason_of
from slamsim.io.bag2.writer import TopicKind
from slamsim.live.hub import Message
from slamsim.live.published import SLAM_TOPICS
from slamsim.live.sources.source import Inbox, Notices, Tell

POLL_S = 0.5
"""How often new topics are looked for."""
_SPIN_S = 0.1
_DEPTH = 100
"""Messages of a topic that wait in the middleware, as tf2 has it: half a second of an IMU at
200 Hz."""
_TF_STATIC = "/tf_static"
_LATCHED_TYPES = {topic.type_name for topic in SLAM_TOPICS if topic.latched}

_LATCHED = QoSProfile(
    depth=_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Asks for the last messages from before, and connects to publishers alone that keep them."""
_SENSOR = QoSProfile(
    depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
"""Asks for nothing, and so connects to every publisher."""
_LAST_KEPT = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
_RELIABLE = QoSProfile(
    depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE
)
"""Offers all that a subscription may ask for, but what was before it: as tf2 has it for /tf."""


class RosSource:
    """The graph that a node is part of, as a ``MessageLink``. The node stays the caller's.

    While the block lasts a thread spins the node. Messages arrive by the node's clock, which is
    that of the simulator where the parameter ``use_sim_time`` says so.
    """

    def __init__(self, node: Node, tell: Tell) -> None:
        self.url = f"ROS 2 node {node.get_fully_qualified_name()}"
        self._node, self._notice = node, Notices(self.url, tell)
        self._lock = Lock()
        self._wanted: dict[str, None] = {}
        self._kinds: Mapping[str, TopicKind] = {}
        self._settled: Mapping[str, TopicKind] = {}
        self._subscriptions: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._own: deque[tuple[str, bytes]] = deque(maxlen=_DEPTH)
        """What was published lately on topics that are read, too: it comes back."""
        self._inbox = Inbox()
        self._over, self._looked = Event(), Event()
        self._look_at_s = 0.0
        self._executor = SingleThreadedExecutor(context=node.context)
        self._thread = Thread(target=self._spin, name="ros-source", daemon=True)

    def __enter__(self) -> Self:
        self._executor.add_node(self._node)
        self._thread.start()
        self._looked.wait()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._lock:
            self._over.set()
        self._executor.wake()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._executor.shutdown()

    def topics(self) -> Sequence[TopicKind]:
        """Those that others publish. Latched are those whose publishers all keep their last
        message. They are discovered one by one: new ones are told when none came for ``POLL_S``."""
        return list(self._settled.values())

    def subscribe(self, names: Iterable[str]) -> None:
        """From now on; to one that is not there yet, once it is."""
        with self._lock:
            self._wanted |= dict.fromkeys(names)
        self._look_at_s = 0.0
        self._executor.wake()

    def receive(self, timeout_s: float) -> Message | None:
        """The next message, None if there was none in time."""
        return self._inbox.take(timeout_s)

    @property
    def dropped(self) -> int:
        """Messages that were not taken in time."""
        return self._inbox.dropped

    def publish(self, topic: str, type_name: str, data: bytes) -> None:
        """Publish a message (CDR); subscribers that come later still get the last map and path.
        Left out, and told, where ROS has no such type."""
        with self._lock:
            if self._over.is_set() or not self._node.context.ok():
                return
            if topic not in self._publishers:
                self._publishers[topic] = self._advertised(topic, type_name)
            publisher = self._publishers[topic]
            if publisher is not None:
                if topic in self._wanted:
                    self._own.append((topic, data))
                publisher.publish(data)

    def _spin(self) -> None:
        """Until the block or ROS ends."""
        try:
            while not self._over.is_set() and self._node.context.ok():
                if time.monotonic() >= self._look_at_s:
                    self._look_at_s = time.monotonic() + POLL_S
                    self._look()
                    self._looked.set()
                self._executor.spin_once(timeout_sec=_SPIN_S)
            why = "was shut down"
        except ExternalShutdownException:
            why = "was shut down"
        except Exception as error:  # of the middleware: other ones in each release
            why = f"failed ({reason_of(error)})"
        finally:
            self._looked.set()
        if not self._over.is_set():
            self._notice(f"ROS {why}; no more messages arrive")

    def _look(self) -> None:
        """See which topics there are, and subscribe to those that are wanted."""
        names = [name for name, _ in self._node.get_topic_names_and_types()]
        found = {name: kind for name in names if (kind := self._kind(name)) is not None}
        if found.keys() == self._kinds.keys():
            self._settled = found
        self._kinds = found
        with self._lock:
            new = [n for n in self._wanted if n in found and n not in self._subscriptions]
        for name in new:
            self._subscriptions[name] = self._subscribed(found[name])

    def _kind(self, name: str) -> TopicKind | None:
        """None where no other node publishes it, or not as one type."""
        own = (self._node.get_name(), self._node.get_namespace())
        publishers = [
            one
            for one in self._node.get_publishers_info_by_topic(name)
            if (one.node_name, one.node_namespace) != own
        ]
        types = sorted({one.topic_type for one in publishers})
        if len(types) > 1 and name in self._wanted:
            self._notice(f"messages of {name} are left out: it has the types {', '.join(types)}")
        if len(types) != 1:
            return None
        latched = all(_keeps_last(one.qos_profile) for one in publishers)
        return TopicKind(name, types[0], latched=latched or name == _TF_STATIC)

    def _subscribed(self, kind: TopicKind) -> Any:
        """A subscription, None where ROS has no such type."""
        message_type = self._message_type(kind.name, kind.type_name)
        if message_type is None:
            return None
        callback = partial(self._arrived, kind)
        qos = _LATCHED if kind.latched else _SENSOR
        return self._node.create_subscription(message_type, kind.name, callback, qos, raw=True)

    def _advertised(self, topic: str, type_name: str) -> Any:
        """A publisher, None where ROS has no such type."""
        message_type = self._message_type(topic, type_name)
        if message_type is None:
            return None
        qos = _LAST_KEPT if type_name in _LATCHED_TYPES else _RELIABLE
        return self._node.create_publisher(message_type, topic, qos)

    def _message_type(self, topic: str, type_name: str) -> Any:
        """The class of ``package/msg/Name``; None, which is told, where it cannot be loaded."""
        package, _, rest = type_name.partition("/")
        folder, _, name = rest.rpartition("/")
        try:
            message_type = getattr(import_module(f"{package}.{folder}"), name)
            check_is_valid_msg_type(message_type)
        except Exception as error:  # missing type supports have other exceptions in each release
            self._notice(
                f"messages of {topic} are left out: ROS cannot load their type {type_name} "
                f"({reason_of(error)}); install the package {package} and source its workspace"
            )
            return None
        return message_type

    def _arrived(self, kind: TopicKind, data: bytes) -> None:
        with self._lock:
            if (kind.name, data) in self._own:
                self._own.remove((kind.name, data))
                return
        now_ns = self._node.get_clock().now().nanoseconds
        if now_ns == 0:
            self._notice("messages are left out until /clock comes, as use_sim_time asks for")
        else:
            self._inbox.put(Message(kind, now_ns, data))


def _keeps_last(offered: QoSProfile) -> bool:
    """Whether a publisher gives late subscribers its last messages."""
    return bool(
        offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
        and offered.reliability == ReliabilityPolicy.RELIABLE
    )
