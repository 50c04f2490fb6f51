"""Checks who opens a WebSocket before a server that cannot check it gets to see the request.

The server behind listens at a random address of 127/8 and a random port, which cannot be guessed,
for a page of a browser may try every port of 127.0.0.1.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import sys
from asyncio import StreamReader, StreamWriter
from contextlib import ExitStack, closing, suppress
from http import HTTPStatus
from threading import Thread
from typing import Self
from urllib.parse import parse_qs, urlsplit

from websockets.http11 import Request
from websockets.server import ServerProtocol

from slamsim.live.servers.access import LOOPBACK, Access
from slamsim.live.servers.frames import FrameQueue

HEAD_END, HEAD_BYTES = b"\r\n\r\n", 16_384
"""Longer requests are refused; browsers' have some 500 bytes, with cookies a few thousand."""
HEAD_S = 10.0
"""A client that has not sent its request by then is cut off."""
STALLED_S = 60.0
"""A client that takes nothing for so long is cut off."""
MOST_CLIENTS = 128
CHUNK_BYTES = 65_536


def hidden_address() -> str:
    """A loopback address that only those know who are told. Linux has all of 127/8."""
    if not sys.platform.startswith("linux"):
        return LOOPBACK
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


class Front:
    """Passes the bytes of admitted clients on to a server and back, from when it is made until its
    block ends.

    What a slow client does not take waits in a ``FrameQueue``. Raises OSError where the address
    cannot be listened at.
    """

    def __init__(self, access: Access, port: int, behind: tuple[str, int]) -> None:
        self._access, self._behind, self._clients = access, behind, 0
        self._closing = ExitStack()
        listener = listening(access.host, port)
        self.port = int(listener.getsockname()[1])
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._run, args=(listener,), daemon=True, name="front")
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._loop.call_soon_threadsafe(self._stop)
        self._thread.join()

    def _run(self, listener: socket.socket) -> None:
        with closing(self._loop), suppress(asyncio.CancelledError):
            self._serving = self._loop.create_task(self._serve(listener))
            self._loop.run_until_complete(self._serving)

    def _stop(self) -> None:
        self._serving.cancel()

    async def _serve(self, listener: socket.socket) -> None:
        server = await asyncio.start_server(self._client, sock=listener, limit=HEAD_BYTES)
        try:
            await server.serve_forever()
        finally:
            mine = asyncio.current_task()
            others = [task for task in asyncio.all_tasks() if task is not mine]
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

    async def _client(self, reader: StreamReader, writer: StreamWriter) -> None:
        """Ends quietly where the server does: asyncio would tell of a cancelled client."""
        self._clients += 1
        try:
            with suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._admit(reader, writer)
        finally:
            self._clients -= 1
            _hang_up(writer)

    async def _admit(self, reader: StreamReader, writer: StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(HEAD_END), HEAD_S)
        except (asyncio.LimitOverrunError, TimeoutError):
            return
        refused = self._refusal(head)
        if refused is not None:
            writer.write(refused)
            await writer.drain()
            return
        behind_reader, behind_writer = await asyncio.open_connection(*self._behind)
        with closing(behind_writer):
            behind_writer.write(head)
            writer.write(await behind_reader.readuntil(HEAD_END))
            frames = FrameQueue()
            ways = (
                _pass_on(reader, behind_writer),
                _collect(behind_reader, frames),
                _send(frames, writer),
            )
            tasks = [asyncio.create_task(way) for way in ways]
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for each in tasks:
                    each.cancel()

    def _refusal(self, head: bytes) -> bytes | None:
        """The response to a request that is not let through."""
        protocol = ServerProtocol()
        protocol.receive_data(head)
        requests = protocol.events_received()
        if not requests or not isinstance(requests[0], Request):
            return _response(protocol, HTTPStatus.BAD_REQUEST, "this is no request of HTTP")
        if self._clients > MOST_CLIENTS:
            full = f"{MOST_CLIENTS} clients are connected, more are not served"
            return _response(protocol, HTTPStatus.SERVICE_UNAVAILABLE, full)
        why = refusal(self._access, requests[0])
        return None if why is None else _response(protocol, HTTPStatus.FORBIDDEN, why)


def listening(host: str, port: int) -> socket.socket:
    """Raises OSError where that cannot be."""
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    return socket.create_server(address[:2], family=family, backlog=MOST_CLIENTS)


def refusal(access: Access, request: Request) -> str | None:
    """Why a request is refused; its token is in the URL (?token=) or an Authorization header."""
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    if len(hosts) != 1 or len(origins) > 1:
        return "a request has one Host and at most one Origin"
    return access.refusal(hosts[0], next(iter(origins), None), _token(request))


def _token(request: Request) -> str | None:
    for value in request.headers.get_all("Authorization"):
        kind, _, token = value.partition(" ")
        if kind.lower() == "bearer":
            return token.strip()
    return next(iter(parse_qs(urlsplit(request.path).query).get("token", [])), None)


def _response(protocol: ServerProtocol, status: HTTPStatus, why: str) -> bytes:
    protocol.send_response(protocol.reject(status, f"{why}\n"))
    return b"".join(protocol.data_to_send())


def _hang_up(writer: StreamWriter) -> None:
    """What is not sent by then never is: a peer that does not read would be waited for."""
    writer.close()
    if writer.transport.get_write_buffer_size():
        writer.transport.abort()


async def _pass_on(reader: StreamReader, writer: StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(CHUNK_BYTES):
            writer.write(data)
            await writer.drain()


async def _collect(reader: StreamReader, frames: FrameQueue) -> None:
    """What the server says is always taken, so that no client holds it up."""
    with suppress(OSError):
        while data := await reader.read(CHUNK_BYTES):
            frames.feed(data)


async def _send(frames: FrameQueue, writer: StreamWriter) -> None:
    """Until the client is gone, or has taken nothing for ``STALLED_S``."""
    with suppress(OSError):
        while True:
            data = memoryview(await frames.take())
            for begin in range(0, len(data), CHUNK_BYTES):
                writer.write(data[begin : begin + CHUNK_BYTES])
                async with asyncio.timeout(STALLED_S):
                    await writer.drain()
