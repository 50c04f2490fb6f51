"""The process that passes bytes on: ``python -m slamsim.live.servers.front_worker``.

What a slow client does not take waits in a ``FrameQueue``. When its parent is gone, standard input
ends, and so does it.
"""

from __future__ import annotations

import asyncio
import os
import socket
from asyncio import StreamReader, StreamWriter
from contextlib import closing, suppress
from http import HTTPStatus
from threading import Thread
from typing import BinaryIO, cast

from websockets.http11 import Request
from websockets.server import ServerProtocol

from slamsim.live.servers.access import refusal
from slamsim.live.servers.frames import FrameQueue
from slamsim.live.servers.front import MOST_CLIENTS, FrontBegin
from slamsim.process.module_process import requests
from slamsim.process.pipe import read_message

HEAD_END, HEAD_BYTES = b"\r\n\r\n", 16_384
"""Longer requests are refused; browsers' have some 500 bytes, with cookies a few thousand."""
HEAD_S = 10.0
"""A client that has not sent its request by then is cut off."""
CHUNK_BYTES = 65_536


class _Passing:
    """Passes the bytes of admitted clients on to the server and back."""

    def __init__(self, begin: FrontBegin) -> None:
        self._begin, self._clients = begin, 0

    async def serve(self) -> None:
        """Until the process ends."""
        listener = socket.socket(fileno=self._begin.listener)
        server = await asyncio.start_server(self._client, sock=listener, limit=HEAD_BYTES)
        await server.serve_forever()

    async def _client(self, reader: StreamReader, writer: StreamWriter) -> None:
        self._clients += 1
        try:
            with suppress(OSError, asyncio.IncompleteReadError):
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
        behind_reader, behind_writer = await asyncio.open_connection(*self._begin.behind)
        with closing(behind_writer):
            behind_writer.write(head)
            writer.write(await behind_reader.readuntil(HEAD_END))
            frames = FrameQueue()
            ways = (
                _pass_on(reader, behind_writer),
                _collect(behind_reader, frames),
                _send(frames, writer, self._begin.stalled_s),
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
        asked = protocol.events_received()
        if not asked or not isinstance(asked[0], Request):
            return _response(protocol, HTTPStatus.BAD_REQUEST, "this is no request of HTTP")
        if self._clients > MOST_CLIENTS:
            full = f"{MOST_CLIENTS} clients are connected, more are not served"
            return _response(protocol, HTTPStatus.SERVICE_UNAVAILABLE, full)
        why = refusal(self._begin.access, asked[0])
        return None if why is None else _response(protocol, HTTPStatus.FORBIDDEN, why)


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


async def _send(frames: FrameQueue, writer: StreamWriter, stalled_s: float) -> None:
    """Until the client is gone, or has taken nothing for so long."""
    with suppress(OSError):
        while True:
            data = memoryview(await frames.take())
            for begin in range(0, len(data), CHUNK_BYTES):
                writer.write(data[begin : begin + CHUNK_BYTES])
                async with asyncio.timeout(stalled_s):
                    await writer.drain()


def main() -> None:
    """Until standard input ends."""
    incoming = requests()
    begin = cast(FrontBegin, read_message(incoming))
    Thread(target=_end_with_parent, args=(incoming,), daemon=True).start()
    asyncio.run(_Passing(begin).serve())


def _end_with_parent(incoming: BinaryIO) -> None:
    incoming.read(1)
    os._exit(0)


if __name__ == "__main__":
    main()
