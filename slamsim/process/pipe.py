"""Messages between two processes: length-prefixed pickles, non-blocking unless asked to wait."""

from __future__ import annotations

import os
import pickle
import struct
from collections import deque
from collections.abc import Iterator
from typing import IO

from slamsim.process.children import Patience

_LENGTH = struct.Struct("<Q")
_CHUNK = 1 << 20
_PROTOCOL = 4
"""Arrays of later ones lie on buffers of their own: a third more memory for a key frame."""


class Ended(Exception):
    """The process at the other end is gone."""


def packed(message: object) -> bytes:
    """A message as it travels, and as it lies in a journal."""
    data = pickle.dumps(message, protocol=_PROTOCOL)
    return _LENGTH.pack(len(data)) + data


def read_message(stream: IO[bytes]) -> object:
    """The next message of a blocking stream; raises EOFError at its end, be it within a message."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    size = _LENGTH.unpack(head)[0]
    body = stream.read(size)
    if len(body) < size:
        raise EOFError
    return pickle.loads(body)


def journal_messages(descriptor: int, end: int) -> Iterator[object]:
    """The messages in the first ``end`` bytes of a file that another process may still write."""
    at = 0
    while at < end:
        size = _LENGTH.unpack(os.pread(descriptor, _LENGTH.size, at))[0]
        yield pickle.loads(os.pread(descriptor, size, at + _LENGTH.size))
        at += _LENGTH.size + size


class Pipe:
    """The near ends of two pipes, to and from another process.

    Sending and receiving return at once; what the other side has not taken yet waits here.
    """

    def __init__(self, write_to: IO[bytes], read_from: IO[bytes]) -> None:
        self._to, self._from = write_to.fileno(), read_from.fileno()
        os.set_blocking(self._to, False)
        os.set_blocking(self._from, False)
        self._outgoing: deque[memoryview] = deque()
        self._incoming = bytearray()

    def send(self, data: bytes) -> None:
        """Hand on a packed message as soon as the other side takes it. Raises Ended."""
        self._outgoing.append(memoryview(data))
        self._flush()

    @property
    def unsent_bytes(self) -> int:
        """What the other side has not taken yet."""
        return sum(map(len, self._outgoing))

    def receive(self) -> list[object]:
        """All messages that are whole by now. Raises Ended."""
        self._flush()
        gone = self._fill()
        messages = list(self._whole())
        if gone and not messages:
            raise Ended
        return messages

    def wait(self, patience: Patience) -> None:
        """Until there is something to receive or to hand on. Raises Halted."""
        patience.wait((self._from,), (self._to,) if self._outgoing else ())

    def _flush(self) -> None:
        try:
            while self._outgoing:
                first = self._outgoing[0]
                written = os.write(self._to, first)
                if written < len(first):
                    self._outgoing[0] = first[written:]
                else:
                    self._outgoing.popleft()
        except BlockingIOError:
            return
        except BrokenPipeError:
            self._outgoing.clear()  # what the other side still said is read before it is missed

    def _fill(self) -> bool:
        """Take in what is there; whether the other end is closed."""
        try:
            while data := os.read(self._from, _CHUNK):
                self._incoming += data
        except BlockingIOError:
            return False
        return True

    def _whole(self) -> Iterator[object]:
        while len(self._incoming) >= _LENGTH.size:
            end = _LENGTH.size + _LENGTH.unpack_from(self._incoming)[0]
            if len(self._incoming) < end:
                return
            data = bytes(self._incoming[_LENGTH.size : end])
            del self._incoming[:end]
            yield pickle.loads(data)
