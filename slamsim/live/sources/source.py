"""A connection to a robot that runs elsewhere: what all protocols have in common.

A thread of its own receives. A connection that breaks is opened again after ``FIRST_WAIT_S``, and
each time without success after twice as long, up to ``LONGEST_WAIT_S``.
"""

from __future__ import annotations

import struct
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from socket import SO_SNDTIMEO, SOL_SOCKET
from threading import Condition, Event, Lock, Thread
from typing import ClassVar, Protocol, Self

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from slamsim.guard.errors import InputRefused, SlamsimError, reason_of, shown
from slamsim.guard.limits import LIMITS
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.values import WrongMessage
from slamsim.live.hub import Message

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 10.0
PATIENCE_S = 10.0
"""How long a server may take to answer, and to tell its topics."""
UNREAD_S = 5
"""A server that reads nothing for so long is left: sending would wait for it forever."""
_ENDING_S = 1.0
"""A connection that is just being opened is not waited for any longer."""
LARGEST_INBOX = 64 << 20
"""Bytes of messages that wait to be taken; beyond, the oldest is dropped."""
MOST_TOPICS = 10_000
MOST_NOTICES = 20
"""Kinds of trouble that are told, once each: a hostile server could make up any number."""

Tell = Callable[[str], None]
"""Gets a sentence for the user, on the thread that receives."""


class MessageLink(Protocol):
    """Where the messages of a robot that runs elsewhere come from and go to; see ``LiveSource``."""

    url: str

    def topics(self) -> Sequence[TopicKind]:
        """Those that can be subscribed to, as known until now; types by their ROS 2 names."""
        ...

    def subscribe(self, names: Iterable[str]) -> None:
        """From now on."""
        ...

    def receive(self, timeout_s: float) -> Message | None:
        """The next message, None if there was none in time."""
        ...

    @property
    def dropped(self) -> int:
        """Messages that were not taken in time."""
        ...

    def publish(self, topic: str, type_name: str, data: bytes) -> None:
        """Send a message (CDR); lost where there is no connection just now."""
        ...


class LiveSource(ABC):
    """A ``MessageLink`` over a WebSocket, connected from when its block begins until it ends; safe
    to use from any thread.

    url: ``ws://`` or ``wss://``, where the server asks for it with ``?token=``. The block raises
    InputRefused where nothing answers, or not in this protocol.
    """

    subprotocols: ClassVar[Sequence[Subprotocol]] = ()

    def __init__(self, url: str, tell: Tell) -> None:
        self.url = url
        self._tell, self._notice = tell, Notices(url, tell)
        self._lock = Lock()
        self._kinds: Mapping[str, TopicKind] = {}
        self._wanted: dict[str, None] = {}
        self._inbox = Inbox()
        self._connection: ClientConnection | None = None
        self._ready, self._over = Event(), Event()
        self._failure = ""
        self._thread = Thread(target=self._run, name="live-source", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        if not self._ready.wait(2 * PATIENCE_S):
            self._failure = f"it did not tell its topics within {2 * PATIENCE_S:.0f} s"
        if self._failure:
            self._close()
            raise InputRefused(self.url, self._failure)
        return self

    def __exit__(self, *error: object) -> None:
        self._close()

    def topics(self) -> Sequence[TopicKind]:
        """Those that can be subscribed to, as told until now; types by their ROS 2 names."""
        return list(self._kinds.values())

    def subscribe(self, names: Iterable[str]) -> None:
        """From now on, and after each reconnection; one that is not there yet, once it is."""
        with self._lock:
            new = [name for name in names if name not in self._wanted]
            self._wanted |= dict.fromkeys(new)
            connection = self._connection
        if connection is not None:
            self._try(lambda: self._ask_for(connection, new))

    def receive(self, timeout_s: float) -> Message | None:
        """The next message, None if there was none in time. Its ``log_ns`` is when it arrived, by
        the clock of this machine (UNIX time)."""
        return self._inbox.take(timeout_s)

    @property
    def dropped(self) -> int:
        """Messages that were not taken in time."""
        return self._inbox.dropped

    def publish(self, topic: str, type_name: str, data: bytes) -> None:
        """Send a message (CDR) to the server; lost where the connection is down just now."""
        connection = self._connection
        if connection is not None:
            self._try(lambda: self._send(connection, TopicKind(topic, type_name), data))

    @abstractmethod
    def _greet(self, connection: ClientConnection) -> None:
        """Begin a new connection."""

    @abstractmethod
    def _heard(self, connection: ClientConnection, frame: str | bytes) -> None:
        """A frame of the server; raises SlamsimError for what cannot be used."""

    @abstractmethod
    def _ask_for(self, connection: ClientConnection, names: Iterable[str]) -> None:
        """Subscribe to those of the topics that are there."""

    @abstractmethod
    def _send(self, connection: ClientConnection, topic: TopicKind, data: bytes) -> None:
        """Publish a message."""

    def _has_topics(self, connection: ClientConnection, kinds: Mapping[str, TopicKind]) -> None:
        """To be called once the server has told its topics, and when they change."""
        if len(kinds) > MOST_TOPICS:
            raise WrongMessage(f"the server has more than {MOST_TOPICS} topics")
        with self._lock:
            self._kinds = kinds
            wanted = tuple(self._wanted)
        self._ask_for(connection, wanted)
        self._ready.set()

    def _fail(self, reason: str) -> None:
        """The server cannot be used; the block does not begin, or goes on without it."""
        if self._ready.is_set():
            self._notice(reason)
        else:
            self._failure = reason
            self._ready.set()

    def _arrived(self, topic: TopicKind, data: bytes) -> None:
        self._inbox.put(Message(topic, time.time_ns(), data))

    def _try(self, work: Callable[[], None]) -> None:
        """A connection that breaks meanwhile is opened again by the thread that receives."""
        try:
            work()
        except (WebSocketException, OSError):
            return
        except SlamsimError as error:
            self._notice(str(error))

    def _run(self) -> None:
        wait_s = FIRST_WAIT_S
        while not self._over.is_set():
            was_ready = self._ready.is_set()
            since_s = time.monotonic()
            reason = self._talk()
            self._connection = None
            if not was_ready and not self._ready.is_set():
                self._fail(reason)
                return
            if self._over.is_set():
                return
            if time.monotonic() - since_s > LONGEST_WAIT_S:
                wait_s = FIRST_WAIT_S
            self._tell(f"{self.url}: {reason}; the connection is tried again in {wait_s:g} s")
            self._over.wait(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _talk(self) -> str:
        """Receive until the connection ends, and why it did."""
        try:
            with connected(self.url, self.subprotocols) as connection:
                self._connection = connection
                if self._over.is_set():  # it did not close this one
                    return ""
                self._greet(connection)
                for frame in connection:
                    self._try(lambda frame=frame: self._heard(connection, frame))  # type: ignore[misc]
            return "the server closed the connection"
        except (WebSocketException, OSError, EOFError) as error:
            return reason_of(error)
        except SlamsimError as error:
            return str(error)

    def _close(self) -> None:
        self._over.set()
        connection = self._connection
        if connection is not None:
            connection.close()
        if self._thread is not threading.current_thread():
            self._thread.join(_ENDING_S)


def connected(url: str, subprotocols: Sequence[Subprotocol]) -> ClientConnection:
    """A connection whose limits are those of a recording's messages, to be used in a block."""
    connection: ClientConnection = connect(
        url,
        subprotocols=list(subprotocols) or None,
        max_size=LIMITS.bag_record_bytes,
        open_timeout=PATIENCE_S,
        close_timeout=1.0,
        compression=None,
        proxy=None,
    )
    connection.socket.setsockopt(SOL_SOCKET, SO_SNDTIMEO, struct.pack("ll", UNREAD_S, 0))
    return connection


class Notices:
    """Tells each kind of trouble once, with the URL before it."""

    def __init__(self, url: str, tell: Tell) -> None:
        self._url, self._tell, self._told = url, tell, set[str]()

    def __call__(self, text: str) -> None:
        if text not in self._told and len(self._told) < MOST_NOTICES:
            self._told.add(text)
            self._tell(f"{self._url}: {text}")


class Inbox:
    """Messages that wait to be taken."""

    def __init__(self) -> None:
        self._messages: deque[Message] = deque()
        self._bytes = 0
        self._changed = Condition()
        self.dropped = 0

    def put(self, message: Message) -> None:
        with self._changed:
            self._messages.append(message)
            self._bytes += len(message.data)
            while self._bytes > LARGEST_INBOX:
                self._bytes -= len(self._messages.popleft().data)
                self.dropped += 1
            self._changed.notify()

    def take(self, timeout_s: float) -> Message | None:
        with self._changed:
            if not self._changed.wait_for(lambda: bool(self._messages), timeout_s):
                return None
            message = self._messages.popleft()
            self._bytes -= len(message.data)
            return message


def text_of(fields: Mapping[str, object], name: str) -> str:
    """A field that must be a string; raises WrongMessage."""
    value = fields.get(name)
    if not isinstance(value, str):
        raise WrongMessage(f"{name} must be a string, not {shown(value)}")
    return value


def objects_of(fields: Mapping[str, object], name: str) -> list[Mapping[str, object]]:
    """A field that must be a list of objects; raises WrongMessage."""
    value = fields.get(name)
    if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
        raise WrongMessage(f"{name} must be a list of objects, not {shown(value)}")
    return value
