"""Who subscribed to what; each message is encoded once for all that want it the same way."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from slamsim.guard.errors import shown
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.values import WrongMessage, cdr_of, known_type, plain_values
from slamsim.live.hub import Hub, Message
from slamsim.live.rosbridge import cbor_bytes, json_text, png_text
from slamsim.live.servers.rosbridge.client import Client, Frame, Kind, Options, Subscription

_LARGE = 128 << 10
"""Bytes of a message from which on it is encoded beside the event loop: below, even JSON takes no
longer than some milliseconds."""

MOST_TOPICS = 256
"""Topics that one client may subscribe to, or advertise."""
MOST_REQUESTS = 64
"""Requests of one client to subscribe to the same topic."""


def encoded(message: Message, kind: Kind) -> Frame:
    """As the operation ``publish``."""
    name, type_name = message.topic.name, message.topic.type_name
    operation: dict[str, Any] = {"op": "publish", "topic": name}
    if kind.compression == "cbor-raw":
        secs, nsecs = divmod(message.log_ns, 10**9)
        raw = {"secs": secs, "nsecs": nsecs, "bytes": message.data}
        return Frame(cbor_bytes(operation | {"msg": raw}), text=False)
    operation["msg"] = plain_values(type_name, message.data, kind.ros1)
    if kind.compression == "cbor":
        return Frame(cbor_bytes(operation), text=False)
    text = json_text(operation)
    if kind.compression == "png":
        text = b"".join((b'{"op":"png","data":"', png_text(text), b'"}'))
    return Frame(text, text=True)


class Topics:
    """Those of the robot and those of clients. All of it happens on the event loop, but for
    ``heard``."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._loop = asyncio.get_running_loop()
        self._subscribers: dict[str, dict[Client, Subscription]] = {}
        self._advertised: dict[str, tuple[TopicKind, set[Client]]] = {}
        self._encoder = ThreadPoolExecutor(1, "rosbridge-encoder")
        self._encoding: dict[tuple[str, Kind], Message | None] = {}
        self._last: dict[tuple[str, Kind], tuple[Message, Frame]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def heard(self, message: Message) -> None:
        """Of the hub, on any thread."""
        if message.topic.name in self._subscribers:
            self._loop.call_soon_threadsafe(self.publish, message)

    def close(self) -> None:
        """Encode nothing more."""
        self._encoder.shutdown(wait=False, cancel_futures=True)

    def kinds(self) -> Mapping[str, TopicKind]:
        """All topics by name."""
        clients = {name: kind for name, (kind, _) in self._advertised.items()}
        return clients | dict(self._hub.topics)

    def subscribers(self, topic: str) -> int:
        """How many clients subscribed to it."""
        return len(self._subscribers.get(topic, ()))

    def publish(self, message: Message) -> None:
        """To all that subscribed, as far as their limits let it through."""
        now_s = self._loop.time()
        subscribers = self._subscribers.get(message.topic.name, {})
        wanted = {s.options.kind for s in subscribers.values() if s.wants(message, now_s)}
        for kind in wanted:
            self._encode(message, kind)

    def _encode(self, message: Message, kind: Kind) -> None:
        key = message.topic.name, kind
        last, frame = self._last.get(key, (None, None))
        if last is message and frame is not None:
            self._deliver(message, kind, frame)
        elif len(message.data) < _LARGE:
            self._deliver(message, kind, encoded(message, kind))
        elif key in self._encoding:  # one that waits to be encoded gives way to a newer one
            self._encoding[key] = message
        else:
            self._encoding[key] = None
            task = self._loop.create_task(self._encode_large(message, kind))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _encode_large(self, first: Message, kind: Kind) -> None:
        key = first.topic.name, kind
        message: Message | None = first
        try:
            while message is not None:
                frame = await self._loop.run_in_executor(self._encoder, encoded, message, kind)
                self._deliver(message, kind, frame)
                message, self._encoding[key] = self._encoding[key], None
        finally:
            del self._encoding[key]

    def _deliver(self, message: Message, kind: Kind, frame: Frame) -> None:
        now_s, topic = self._loop.time(), message.topic
        subscribers = self._subscribers.get(topic.name, {})
        if topic.latched and subscribers:
            self._last[topic.name, kind] = message, frame
        for client, subscription in subscribers.items():
            if subscription.options.kind == kind and subscription.wants(message, now_s):
                client.offer(subscription, message, frame, now_s)

    def subscribe(
        self, client: Client, topic: str, type_name: str | None, key: str | int | None, to: Options
    ) -> None:
        """Raises WrongMessage for a topic that is not known, or of another type."""
        kind = self.kinds().get(topic)
        asked = known_type(type_name) if type_name else None
        if kind is None and asked is None:
            raise WrongMessage(f"there is no topic {shown(topic)}, and no type is given")
        if kind is not None and asked not in (None, kind.type_name):
            raise WrongMessage(f"{topic} is of type {kind.type_name}, not {type_name}")
        mine = client.subscriptions.get(topic)
        if mine is None and len(client.subscriptions) >= MOST_TOPICS:
            raise WrongMessage(f"a client may subscribe to {MOST_TOPICS} topics at most")
        if mine is not None and len(mine.requests) >= MOST_REQUESTS and key not in mine.requests:
            raise WrongMessage(f"{topic} was subscribed to {MOST_REQUESTS} times already")
        if mine is None:
            mine = client.subscriptions[topic] = Subscription(topic, {key: to}, to)
            self._subscribers.setdefault(topic, {})[client] = mine
        mine.requests.pop(key, None)
        mine.requests[key] = to
        mine.combine()
        latched = self._hub.latched.get(topic)
        if latched is not None and latched is not mine.seen:
            self._encode(latched, mine.options.kind)

    def unsubscribe(self, client: Client, topic: str, key: str | int | None) -> None:
        """One request, or all of them without an id. Raises WrongMessage if there is none."""
        mine = client.subscriptions.get(topic)
        if mine is None or (key is not None and key not in mine.requests):
            raise WrongMessage(f"there is no such subscription to {shown(topic)}")
        if key is not None:
            del mine.requests[key]
        if key is not None and mine.requests:
            mine.combine()
            return
        client.forget(client.subscriptions.pop(topic))
        others = self._subscribers[topic]
        del others[client]
        if not others:
            del self._subscribers[topic]
            self._last = {at: one for at, one in self._last.items() if at[0] != topic}

    def advertise(self, client: Client, topic: str, type_name: str) -> None:
        """A topic of a client's own. Raises WrongMessage for one of another type."""
        kind = self.kinds().get(topic)
        asked = known_type(type_name)
        if kind is not None and kind.type_name != asked:
            raise WrongMessage(f"{topic} is of type {kind.type_name}, not {type_name}")
        if len(client.advertised) >= MOST_TOPICS:
            raise WrongMessage(f"a client may advertise {MOST_TOPICS} topics at most")
        client.advertised.add(topic)
        if topic not in self._hub.topics:
            self._advertised.setdefault(topic, (TopicKind(topic, asked), set()))[1].add(client)

    def unadvertise(self, client: Client, topic: str) -> None:
        """Raises WrongMessage if the client did not advertise it."""
        if topic not in client.advertised:
            raise WrongMessage(f"{shown(topic)} was not advertised")
        client.advertised.discard(topic)
        if topic in self._advertised:
            clients = self._advertised[topic][1]
            clients.discard(client)
            if not clients:
                del self._advertised[topic]

    def publish_of_client(self, topic: str, values: object, now_ns: int) -> None:
        """A message that a client publishes, to the others. Raises WrongMessage."""
        if topic in self._hub.topics:
            raise WrongMessage(f"{topic} is published by the robot alone")
        if topic not in self._advertised:
            raise WrongMessage(f"{shown(topic)} was not advertised")
        kind = self._advertised[topic][0]
        self.publish(Message(kind, now_ns, cdr_of(kind.type_name, values, now_ns)))

    def leave(self, client: Client) -> None:
        """The client is gone."""
        for topic in tuple(client.subscriptions):
            self.unsubscribe(client, topic, None)
        for topic in tuple(client.advertised):
            self.unadvertise(client, topic)
