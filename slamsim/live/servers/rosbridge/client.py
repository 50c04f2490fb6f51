"""One client: what it subscribed to, and the queue of what it is still to be sent."""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from slamsim.live.hub import Message
from slamsim.live.rosbridge import Fragments, json_text, split

LARGEST_QUEUE = 60 << 20
"""Bytes that wait for one client; beyond, the oldest message is dropped. With what is being sent,
a client costs less than 64 MB."""
REPLIES = 1 << 20
"""Bytes of replies that wait for a client; beyond, nothing more is read from it."""
SILENCE_S = 60.0
"""A client that reads nothing for so long is dropped."""
_PING_EVERY_S = 15.0
_CLOSING_S = 1.0
_CHUNK = 64 << 10
"""Bytes of one WebSocket frame: so much memory a long message costs besides itself."""

LEVELS = ("none", "error", "warning", "info")


@dataclass(frozen=True, slots=True)
class Frame:
    """What is sent as one WebSocket message. data: of text, ASCII."""

    data: bytes
    text: bool


@dataclass(frozen=True, slots=True)
class Kind:
    """How messages are encoded. compression: none, png, cbor or cbor-raw."""

    compression: str = "none"
    ros1: bool = False


@dataclass(frozen=True, slots=True)
class Options:
    """Of one request to subscribe. queue_length: 0 for as many as memory allows."""

    kind: Kind
    throttle_s: float = 0.0
    queue_length: int = 0
    fragment_size: int | None = None


@dataclass(slots=True, eq=False)
class Subscription:
    """Of a client to a topic. requests: by the id that each came with, at least one."""

    topic: str
    requests: dict[str | int | None, Options]
    options: Options
    waiting: deque[tuple[int, Frame]] = field(default_factory=deque)
    due_s: float = 0.0
    seen: Message | None = None

    def combine(self) -> None:
        """Use what suits all requests: the lowest rate limit, the longest queue, the smallest
        fragments, and the compression that was asked for last."""
        asked = list(self.requests.values())
        sizes = [one.fragment_size for one in asked if one.fragment_size is not None]
        self.options = Options(
            asked[-1].kind,
            min(one.throttle_s for one in asked),
            max(one.queue_length for one in asked),
            min(sizes, default=None),
        )

    def wants(self, message: Message, now_s: float) -> bool:
        """Whether a message is to be sent or queued, by the rate limit."""
        waits = self.options.throttle_s > 0.0 and self.options.queue_length == 0
        return message is not self.seen and not (waits and now_s < self.due_s)


@dataclass(frozen=True, slots=True)
class _Begun:
    """A message of which fragments are still to be sent."""

    topic: str
    size: int
    parts: Iterator[bytes]


class Client:
    """One connection. All of it happens on the server's event loop."""

    def __init__(self, connection: ServerConnection | None) -> None:
        self._connection = connection
        self.fragments = Fragments()
        self.subscriptions: dict[str, Subscription] = {}
        self.advertised: set[str] = set()
        self.calls = 0
        self.dropped = 0
        self.queued_bytes = 0
        self._level = LEVELS.index("error")
        self._replies: deque[Frame] = deque()
        self._reply_bytes = 0
        self._numbers = itertools.count()
        self._begun: deque[_Begun] = deque()
        self._passed: asyncio.Future[float] | None = None
        self._wake, self._room = asyncio.Event(), asyncio.Event()
        self._room.set()

    def set_level(self, level: str) -> None:
        """How much it is told by ``tell``: up to this of ``LEVELS``."""
        self._level = LEVELS.index(level)

    def tell(self, level: str, text: str, key: str | int | None = None) -> None:
        """A status message."""
        if LEVELS.index(level) <= self._level:
            about = {} if key is None else {"id": key}
            self.reply({"op": "status", "level": level, "msg": text, **about})

    def reply(self, operation: Mapping[str, Any]) -> None:
        """Send an operation before all messages that wait. Raises WrongMessage for what JSON
        cannot hold."""
        frame = Frame(json_text(operation), text=True)
        self._replies.append(frame)
        self._reply_bytes += len(frame.data)
        if self._reply_bytes > REPLIES:
            self._room.clear()
        self._wake.set()

    @property
    def reads(self) -> bool:
        """Whether there is room for replies."""
        return self._room.is_set()

    async def room(self) -> None:
        """Wait until not too many replies wait: who does not read is not listened to."""
        await self._room.wait()

    def offer(self, to: Subscription, message: Message, frame: Frame, now_s: float) -> None:
        """Queue a message; what does not fit any more is dropped, the oldest first."""
        to.seen = message
        if to.options.queue_length == 0:
            to.due_s = now_s + to.options.throttle_s
        elif len(to.waiting) >= to.options.queue_length:
            self._drop(to)
        if len(frame.data) > LARGEST_QUEUE:
            size = f"{len(frame.data):,} bytes"
            self.tell("error", f"a message of {to.topic} of {size} is too large; try cbor")
            return
        to.waiting.append((next(self._numbers), frame))
        self.queued_bytes += len(frame.data)
        while self.queued_bytes > LARGEST_QUEUE:
            filled = [one for one in self.subscriptions.values() if one.waiting]
            if not filled:  # the rest is what is being sent
                break
            self._drop(min(filled, key=lambda one: one.waiting[0][0]))
        self._wake.set()

    def _drop(self, subscription: Subscription) -> None:
        _, frame = subscription.waiting.popleft()
        self.queued_bytes -= len(frame.data)
        if self.dropped == 0:
            self.tell("warning", f"messages of {subscription.topic} are dropped: too slow a reader")
        self.dropped += 1

    def forget(self, subscription: Subscription) -> None:
        """Drop what waits of a subscription that has ended."""
        self.queued_bytes -= sum(len(frame.data) for _, frame in subscription.waiting)
        subscription.waiting.clear()

    async def write(self) -> None:
        """Send what waits, until the connection is closed. Between two fragments of a message go
        those of other topics: a map delays no scan."""
        loop = asyncio.get_running_loop()
        while True:
            await self._send_replies()
            now_s = loop.time()
            subscription = self._next(now_s)
            if subscription is not None:
                await self._send_next(subscription, now_s)
            if self._begun and (self._passed is None or self._passed.done()):
                await self._send_fragments()
            elif subscription is None:
                self._wake.clear()
                dues = [one.due_s for one in self.subscriptions.values() if one.waiting]
                timer = loop.call_at(min(dues), self._wake.set) if dues else None
                await self._wake.wait()
                if timer is not None:
                    timer.cancel()

    def _next(self, now_s: float) -> Subscription | None:
        """The one with the oldest message of those that are not limited at present."""
        begun = [one.topic for one in self._begun]
        ready = [
            one
            for name, one in self.subscriptions.items()
            if one.waiting and self._is_due(one, now_s) and name not in begun
        ]
        return min(ready, key=lambda one: one.waiting[0][0], default=None)

    @staticmethod
    def _is_due(subscription: Subscription, now_s: float) -> bool:
        return subscription.options.queue_length == 0 or subscription.due_s <= now_s

    async def _send_next(self, subscription: Subscription, now_s: float) -> None:
        number, frame = subscription.waiting.popleft()
        options = subscription.options
        if options.queue_length > 0:
            subscription.due_s = now_s + options.throttle_s
        if options.fragment_size is not None and frame.text:
            parts = split(frame.data, options.fragment_size, f"{subscription.topic}#{number}")
            self._begun.append(_Begun(subscription.topic, len(frame.data), parts))
            return
        try:
            await self._send(frame)
        finally:
            self.queued_bytes -= len(frame.data)

    async def _send_fragments(self) -> None:
        """Some, of each message that is begun in turn; the next once the client has read these, or
        what comes meanwhile would wait behind megabytes in the buffers of two kernels."""
        assert self._connection is not None
        sent = 0
        while self._begun and sent < _CHUNK:
            begun = self._begun.popleft()
            part = next(begun.parts, None)
            if part is None:
                self.queued_bytes -= begun.size
                continue
            self._begun.append(begun)
            await self._send(Frame(part, text=True))
            sent += len(part)
        if self._begun:
            self._passed = asyncio.ensure_future(await self._connection.ping())
            self._passed.add_done_callback(lambda _: self._wake.set())

    async def _send_replies(self) -> None:
        while self._replies:
            frame = self._replies.popleft()
            await self._send(frame)
            self._reply_bytes -= len(frame.data)
            if self._reply_bytes <= REPLIES:
                self._room.set()

    async def _send(self, frame: Frame) -> None:
        assert self._connection is not None
        if len(frame.data) <= _CHUNK:
            await self._connection.send(frame.data, text=frame.text)
        else:
            await self._connection.send(_chunks(frame.data), text=frame.text)

    async def watch(self) -> None:
        """Drop the client once it has read nothing for ``SILENCE_S``: a ping waits behind what it
        was sent, and a client that reads answers."""
        assert self._connection is not None
        try:
            while True:
                async with asyncio.timeout(SILENCE_S):
                    await (await self._connection.ping())
                await asyncio.sleep(_PING_EVERY_S)
        except TimeoutError:
            await self.end(f"nothing was read for {SILENCE_S:.0f} s")
        except ConnectionClosed:
            return

    async def end(self, reason: str) -> None:
        """Close the connection with a reason; at once if the other side does not answer."""
        assert self._connection is not None
        try:
            async with asyncio.timeout(_CLOSING_S):
                await self._connection.close(CloseCode.POLICY_VIOLATION, reason)
        except TimeoutError:
            self._connection.transport.abort()


def _chunks(data: bytes) -> Iterator[memoryview]:
    view = memoryview(data)
    return (view[start : start + _CHUNK] for start in range(0, len(data), _CHUNK))
