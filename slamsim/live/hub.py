"""The messages of a live robot: from those that publish to those that listen."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock

from slamsim.io.bag2.writer import TopicKind


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One message. log_ns: true time of its arrival. data: CDR, as in the recording."""

    topic: TopicKind
    log_ns: int
    data: bytes


Listener = Callable[[Message], None]
"""Called for each message on the thread that publishes: it must return at once, and never raise.
What takes time belongs into a queue of the listener's own."""


class Hub:
    """Topics and who listens to them. Safe to use from any thread."""

    def __init__(self, topics: Iterable[TopicKind]) -> None:
        self._lock = Lock()
        self._topics = {topic.name: topic for topic in topics}
        self._latched: dict[str, Message] = {}
        self._listeners: tuple[Listener, ...] = ()

    @property
    def topics(self) -> Mapping[str, TopicKind]:
        """By name; all of them are known from the start."""
        return self._topics

    @property
    def latched(self) -> Mapping[str, Message]:
        """The last message of each latched topic that has one, by the topic's name."""
        with self._lock:
            return dict(self._latched)

    def publish(self, topic: str, log_ns: int, data: bytes) -> None:
        """Hand a message to all listeners. Raises KeyError for a topic that was not declared."""
        message = Message(self._topics[topic], log_ns, data)
        with self._lock:
            if message.topic.latched:
                self._latched[topic] = message
            listeners = self._listeners
        for listener in listeners:
            listener(message)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call it for each message from now on, until what this returns is called.

        It is given the last message of each latched topic first.
        """
        with self._lock:
            self._listeners = (*self._listeners, listener)
            latched = tuple(self._latched.values())
        for message in latched:
            listener(message)

        def leave() -> None:
            with self._lock:
                self._listeners = tuple(one for one in self._listeners if one is not listener)

        return leave


_log = logging.getLogger(__name__)


class Undrawn:
    """Told once for each topic, and left out."""

    def __init__(self) -> None:
        self._topics = set[str]()

    @contextmanager
    def told(self, message: Message) -> Iterator[None]:
        """Around what draws the message."""
        try:
            yield
        except Exception as error:  # of many types, for damage of any kind
            if message.topic.name not in self._topics:
                _log.warning("messages on %s cannot be shown: %s", message.topic.name, error)
            self._topics.add(message.topic.name)
