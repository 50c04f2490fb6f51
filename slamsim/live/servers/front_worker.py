"""The process that passes bytes on: ``python -m slamsim.live.servers.front_worker``.

What a slow client does not take waits in a ``FrameQueue``. When its parent is gone, standard input
ends, and so does it.
"""

from __future__ import annotations

import asyncio
import json
import socket
import time
from asyncio import StreamReader, StreamWriter
from collections import deque
from contextlib import closing, suppress
from http import HTTPStatus
from typing import cast

from websockets.http11 import Request
from websockets.server import ServerProtocol

from slamsim.live.servers.access import refusal
from slamsim.live.servers.front import MOST_CLIENTS, MOST_HALF_OPEN, FrontBegin
from slamsim.process.module_process import listen, requests
from slamsim.process.pipe import read_message

MOST_BYTES, MOST_FRAMES = 16_000_000, 512
"""What waits for one client, or a single larger frame: 0.7 s of all messages of a robot with a scan
at 40 Hz, 2 s of the clouds of an OS1-32. With the largest map, 4096 x 4096 cells, a client costs
three times that map: one is sent, one waits, one comes in. The kernel's buffers are on top."""
REPLY_BYTES = 1 << 20
"""Of frames that wait and may not be left out, answers and pongs; beyond, nothing more is read from
the client. What was read before, ``CHUNK_BYTES`` of requests, is answered besides."""
TOLD_S = 5.0
"""A client is told that it is too slow once in that time."""
WRITTEN_BYTES = 65_536

_BINARY, _TEXT = 0x82, 0x81
_MESSAGE_DATA = (0x01, 0x02)
"""Opcodes of the Foxglove protocol whose frames may be left out: a message, the time."""


class FrameQueue:
    """Frames (RFC 6455) in their order. Belongs to one event loop."""

    def __init__(self) -> None:
        self._partial = bytearray()
        self._frames: deque[bytes] = deque()
        self._messages = self._message_bytes = self._reply_bytes = self._left_out = 0
        self._told_s = -TOLD_S
        self._arrived, self._room = asyncio.Event(), asyncio.Event()
        self._room.set()

    @property
    def waiting_bytes(self) -> int:
        """Of all that was not taken yet."""
        return self._message_bytes + self._reply_bytes + len(self._partial)

    async def room(self) -> None:
        """Wait until not too much waits that may not be left out: who does not read its replies is
        not listened to."""
        await self._room.wait()

    def feed(self, data: bytes) -> None:
        """What the server sent next, cut anywhere."""
        self._partial += data
        begin = 0
        while (end := _end(self._partial, begin)) <= len(self._partial):
            with memoryview(self._partial) as view:
                self._add(bytes(view[begin:end]))
            begin = end
        del self._partial[:begin]
        if self._messages > MOST_FRAMES or self._message_bytes > MOST_BYTES:
            self._leave_out()

    async def take(self) -> bytes:
        """Whole frames, some ``WRITTEN_BYTES`` of them or a larger one; waits for the first."""
        await self._arrived.wait()
        taken = [self._frames.popleft()]
        size = len(taken[0])
        while self._frames and size + len(self._frames[0]) <= WRITTEN_BYTES:
            taken.append(self._frames.popleft())
            size += len(taken[-1])
        for frame in taken:
            self._count(frame, -1)
        if not self._frames:
            self._arrived.clear()
        return b"".join(taken)

    def _add(self, frame: bytes) -> None:
        self._frames.append(frame)
        self._count(frame, 1)
        self._arrived.set()

    def _count(self, frame: bytes, times: int) -> None:
        if _may_be_left_out(frame):
            self._messages += times
            self._message_bytes += times * len(frame)
            return
        self._reply_bytes += times * len(frame)
        if self._reply_bytes > REPLY_BYTES:
            self._room.clear()
        else:
            self._room.set()

    def _leave_out(self) -> None:
        """The oldest messages, until half of the room is free or the newest is alone."""
        kept: deque[bytes] = deque()
        for frame in self._frames:
            much = self._message_bytes > MOST_BYTES // 2 or self._messages > MOST_FRAMES // 2
            if much and self._messages > 1 and _may_be_left_out(frame):
                self._count(frame, -1)
                self._left_out += 1
            else:
                kept.append(frame)
        self._frames = kept
        now_s = time.monotonic()
        if now_s - self._told_s >= TOLD_S:
            self._told_s = now_s
            self._add(_status(self._left_out))


def _end(data: bytearray, begin: int) -> int:
    """Where the frame ends that begins there; beyond the data if it is not whole."""
    if len(data) < begin + 2:
        return begin + 2
    length = data[begin + 1] & 0x7F
    head = _head(length)
    if length >= 126:
        if len(data) < begin + head:
            return begin + head
        length = int.from_bytes(data[begin + 2 : begin + head], "big")
    return begin + head + length


def _head(length: int) -> int:
    """Bytes before the payload of a frame that is not masked."""
    return {126: 4, 127: 10}.get(length, 2)


def _may_be_left_out(frame: bytes) -> bool:
    head = _head(frame[1])
    return frame[0] == _BINARY and len(frame) > head and frame[head] in _MESSAGE_DATA


def _status(left_out: int) -> bytes:
    words = f"this connection is too slow: {left_out} messages were left out"
    text = json.dumps({"op": "status", "level": 1, "message": words}).encode()
    return bytes([_TEXT, len(text)]) + text


HEAD_END, HEAD_BYTES = b"\r\n\r\n", 16_384
"""Longer requests are refused; browsers' have some 500 bytes, with cookies a few thousand."""
HEAD_S = 10.0
"""A client that has not sent its request by then is cut off."""
CHUNK_BYTES = 65_536


class _Passing:
    """Passes the bytes of admitted clients on to the server and back."""

    def __init__(self, begin: FrontBegin) -> None:
        self._begin, self._clients = begin, 0
        self._half_open: dict[StreamWriter, None] = {}

    async def serve(self) -> None:
        """Until the process ends."""
        listener = socket.socket(fileno=self._begin.listener)
        server = await asyncio.start_server(self._client, sock=listener, limit=HEAD_BYTES)
        await server.serve_forever()

    async def _client(self, reader: StreamReader, writer: StreamWriter) -> None:
        self._half_open[writer] = None
        if len(self._half_open) > MOST_HALF_OPEN:
            next(iter(self._half_open)).transport.abort()
        try:
            with suppress(OSError, asyncio.IncompleteReadError):
                await self._admit(reader, writer)
        finally:
            self._half_open.pop(writer, None)
            _hang_up(writer)

    async def _admit(self, reader: StreamReader, writer: StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(HEAD_END), HEAD_S)
        except (asyncio.LimitOverrunError, TimeoutError):
            return
        del self._half_open[writer]
        refused = self._refusal(head)
        if refused is not None:
            writer.write(refused)
            await writer.drain()
            return
        self._clients += 1
        try:
            await self._pass(head, reader, writer)
        finally:
            self._clients -= 1

    async def _pass(self, head: bytes, reader: StreamReader, writer: StreamWriter) -> None:
        behind_reader, behind_writer = await asyncio.open_connection(*self._begin.behind)
        with closing(behind_writer):
            behind_writer.write(head)
            writer.write(await behind_reader.readuntil(HEAD_END))
            frames = FrameQueue()
            ways = (
                _pass_on(reader, behind_writer, frames),
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
        if self._clients >= MOST_CLIENTS:
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


async def _pass_on(reader: StreamReader, writer: StreamWriter, replies: FrameQueue) -> None:
    with suppress(OSError):
        while data := await reader.read(CHUNK_BYTES):
            await replies.room()
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
    listen(incoming, lambda message: None)  # there is none: this process ends with its parent
    asyncio.run(_Passing(begin).serve())


if __name__ == "__main__":
    main()
