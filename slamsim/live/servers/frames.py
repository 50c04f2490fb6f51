"""WebSocket frames on their way to one client, of which a slow one loses the oldest messages."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque

MOST_BYTES, MOST_FRAMES = 16_000_000, 512
"""What waits for one client, or a single larger frame: 0.7 s of all messages of a robot with a scan
at 40 Hz, 2 s of the clouds of an OS1-32. With the largest map, 4096 x 4096 cells, a client costs
three times that map: one is sent, one waits, one comes in. The kernel's buffers are on top."""
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
        self._bytes, self._left_out = 0, 0
        self._told_s = -TOLD_S
        self._arrived = asyncio.Event()

    @property
    def waiting_bytes(self) -> int:
        """Of all that was not taken yet."""
        return self._bytes + len(self._partial)

    def feed(self, data: bytes) -> None:
        """What the server sent next, cut anywhere."""
        self._partial += data
        begin = 0
        while (end := _end(self._partial, begin)) <= len(self._partial):
            with memoryview(self._partial) as view:
                self._add(bytes(view[begin:end]))
            begin = end
        del self._partial[:begin]

    async def take(self) -> bytes:
        """Whole frames, some ``WRITTEN_BYTES`` of them or a larger one; waits for the first."""
        await self._arrived.wait()
        taken = [self._frames.popleft()]
        size = len(taken[0])
        while self._frames and size + len(self._frames[0]) <= WRITTEN_BYTES:
            taken.append(self._frames.popleft())
            size += len(taken[-1])
        self._bytes -= size
        if not self._frames:
            self._arrived.clear()
        return b"".join(taken)

    def _add(self, frame: bytes) -> None:
        self._frames.append(frame)
        self._bytes += len(frame)
        if self._bytes > MOST_BYTES or len(self._frames) > MOST_FRAMES:
            self._leave_out(len(frame))
        self._arrived.set()

    def _leave_out(self, newest_bytes: int) -> None:
        """The oldest messages, until half of the room is free or the newest is alone."""
        kept: deque[bytes] = deque()
        count = len(self._frames)
        for number, frame in enumerate(self._frames, start=1):
            full = self._bytes > max(MOST_BYTES // 2, newest_bytes)
            many = len(kept) + count - number >= MOST_FRAMES // 2
            if (full or many) and number < count and _may_be_left_out(frame):
                self._bytes -= len(frame)
                self._left_out += 1
            else:
                kept.append(frame)
        self._frames = kept
        now_s = time.monotonic()
        if now_s - self._told_s >= TOLD_S:
            self._told_s = now_s
            self._frames.append(_status(self._left_out))
            self._bytes += len(self._frames[-1])


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
