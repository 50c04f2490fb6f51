"""Checks who opens a WebSocket before a server that cannot check it gets to see the request.

The bytes of clients pass through a process of their own (``front_worker.py``): in this one they
would wait for Python's lock while the physics holds it, and clients for each other's bytes.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import socket
import sys
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock, Thread
from typing import Any, Self

from websockets.asyncio.server import Server, ServerConnection, serve

from slamsim.live.servers.access import LOOPBACK, Access, not_served
from slamsim.process.module_process import ModuleProcess
from slamsim.process.pipe import Ended, packed

_log = logging.getLogger(__name__)

STALLED_S = 60.0
"""A client that takes nothing for so long is cut off."""
MOST_CLIENTS = 128
MOST_DEATHS = 100
"""One that always dies at once is not begun for ever, and that is told."""


@dataclass(frozen=True, slots=True)
class FrontBegin:
    """What the process is told. listener: descriptor of the socket. behind: host and port of the
    server."""

    listener: int
    access: Access
    behind: tuple[str, int]
    stalled_s: float


def hidden_address() -> str:
    """A loopback address that only those know who are told. Linux has all of 127/8.

    A server listens there at a random port, which cannot be guessed, for a page of a browser may
    try every port of 127.0.0.1.
    """
    if not sys.platform.startswith("linux"):
        return LOOPBACK
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


class Front:
    """Passes the bytes of admitted clients on to a server and back, from when it is made until its
    block ends. port: at which it listens.

    Raises OSError where the address cannot be listened at.
    """

    def __init__(self, access: Access, port: int, behind: tuple[str, int]) -> None:
        self._listener = _listening(access.host, port)
        self.port = int(self._listener.getsockname()[1])
        self._begin = FrontBegin(self._listener.fileno(), access, behind, STALLED_S)
        self._lock, self._ended = Lock(), False
        self._child = self._begun()
        Thread(target=self._begin_again, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._ended = True
            self._child.end()
        self._listener.close()

    def _begun(self) -> ModuleProcess:
        listener = self._begin.listener
        child = ModuleProcess("slamsim.live.servers.front_worker", pass_fds=(listener,))
        with suppress(Ended):  # dead already: noticed as any later death is
            child.send(packed(self._begin))
        return child

    def _begin_again(self) -> None:
        """Whenever the process dies: clients lose their connection, and can connect again."""
        for _ in range(MOST_DEATHS):
            code = self._child.exit_code()
            with self._lock:
                if self._ended:
                    return
                self._child.end()
                self._child = self._begun()
            _log.warning(
                "the process that serves port %d ended (%d): a new one does", self.port, code
            )
        _log.error("port %d is served no longer: its process ended too often", self.port)


def _listening(host: str, port: int) -> socket.socket:
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    return socket.create_server(address[:2], family=family, backlog=MOST_CLIENTS)


MOST_UNREAD = 32 << 20
"""Bytes that wait in the buffer of a socket: twice the largest message, of which one is there at
most."""


MOST_HALF_OPEN = 64
"""Connections whose request is not there yet: the oldest gives way. A request takes milliseconds,
and those that never come need no token."""
_OPEN_S = 10.0
"""For a client to say what it wants."""


class Connection(ServerConnection):
    """Cut off where its request does not come, or where pongs fill its buffer, because it sends
    pings and reads nothing: the library answers each of them at once."""

    half_open: list[Connection]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.half_open[:] = [one for one in self.half_open if one.is_half_open]
        self.half_open.append(self)
        if len(self.half_open) > MOST_HALF_OPEN:
            self.half_open[0].transport.abort()

    @property
    def is_half_open(self) -> bool:
        """Whether its request may still come."""
        return not (self.request_rcvd.done() or self.transport.is_closing())

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.transport.get_write_buffer_size() > MOST_UNREAD:
            self.transport.abort()

    async def handshake(self, *options: Any) -> None:
        """The library's time limit would hold for a whole download: this one is for the request."""
        async with asyncio.timeout(_OPEN_S):
            waiting = [self.request_rcvd, self.connection_lost_waiter]
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        await super().handshake(*options)


class LoopThread:
    """Serves from ``_start`` until its block ends, when ``_ended`` is set.

    port: 0 for a free one; then ``_port`` is the one at which it listens.
    """

    _loop: asyncio.AbstractEventLoop
    _ended: asyncio.Event

    def __init__(self, access: Access, port: int) -> None:
        self._access, self._port = access, port

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._in_loop(self._ended.set)
        self._thread.join()

    def _start(self, name: str) -> None:
        """Returns as soon as it listens; raises what ``_serve`` raises before."""
        listening: Future[None] = Future()
        self._thread = Thread(target=self._run, args=(listening,), name=name, daemon=True)
        self._thread.start()
        listening.result()

    def _run(self, listening: Future[None]) -> None:
        try:
            asyncio.run(self._begin(lambda: listening.set_result(None)))
        except Exception as error:
            if listening.done():
                raise
            listening.set_exception(error)

    async def _begin(self, listens: Callable[[], None]) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        await self._serve(listens)

    async def _serve(self, listens: Callable[[], None]) -> None:
        """Until ``_ended`` is set; calls listens once clients may come."""
        raise NotImplementedError

    async def _listening(
        self, talk: Callable[[ServerConnection], Awaitable[None]], **options: Any
    ) -> Server:
        """A server of WebSockets, which listens. Raises OutputRefused where it cannot."""
        try:
            server = await serve(
                talk,
                self._access.host,
                self._port,
                # The connections of one server know of each other.
                create_connection=type("Connection", (Connection,), {"half_open": []}),
                open_timeout=None,  # see Connection
                compression=None,  # what is large is compressed once, not for each client
                logger=_silent_logger(),
                **options,
            )
        except OSError as error:
            raise not_served(self._access.host, self._port, error) from None
        self._port = next(iter(server.sockets)).getsockname()[1]
        return server

    def _in_loop(self, action: Callable[[], None]) -> None:
        """From any thread; nothing is done when the server has ended meanwhile."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(action)


def _silent_logger() -> logging.Logger:
    """Connections that break or speak another protocol are everyday, and told to their client."""
    logger = logging.Logger("sockets")
    logger.addHandler(logging.NullHandler())
    return logger
