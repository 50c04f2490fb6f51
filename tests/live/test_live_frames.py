"""Frames on their way to a client: cut anywhere, left out where they must."""

from __future__ import annotations

import asyncio
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.frames import Frame, Opcode

from slamsim.live.servers import front_worker
from slamsim.live.servers.front_worker import FrameQueue


def written(payload: bytes, opcode: Opcode = Opcode.BINARY) -> bytes:
    """As ``websockets`` writes it for a server."""
    return Frame(opcode, payload).serialize(mask=False)


def message(number: int, size: int = 100) -> bytes:
    """A frame of message data of the Foxglove protocol."""
    return written(b"\x01" + number.to_bytes(4, "little") + bytes(size))


def taken(queue: FrameQueue) -> bytes:
    """All that waits now."""

    async def all_of_it() -> bytes:
        parts = []
        while queue.waiting_bytes:
            parts.append(await asyncio.wait_for(queue.take(), 1.0))
        return b"".join(parts)

    return asyncio.run(all_of_it())


def split(data: bytes) -> list[bytes]:
    """The payloads of frames, read by the rules of RFC 6455 byte by byte."""
    found, at = [], 0
    while at < len(data):
        length, head = data[at + 1], 2
        if length == 126:
            length, head = int.from_bytes(data[at + 2 : at + 4], "big"), 4
        elif length == 127:
            length, head = int.from_bytes(data[at + 2 : at + 10], "big"), 10
        found.append(data[at + head : at + head + length])
        at += head + length
    return found


@given(
    sizes=st.lists(st.sampled_from([0, 1, 125, 126, 127, 65_535, 65_536]), max_size=8),
    cuts=st.lists(st.integers(1, 70_000), max_size=30),
)
def test_frames_that_fit_pass_as_they_are_however_they_are_cut(
    sizes: list[int], cuts: list[int]
) -> None:
    data = b"".join(written(bytes([7]) * size) for size in sizes)
    queue, at = FrameQueue(), 0
    for cut in cuts:
        queue.feed(data[at : at + cut])
        at += cut
    queue.feed(data[at:])
    assert taken(queue) == data


def test_a_half_frame_waits_for_its_rest() -> None:
    queue = FrameQueue()
    whole, half = message(1), message(2)[:50]
    queue.feed(whole + half)
    assert asyncio.run(queue.take()) == whole
    assert queue.waiting_bytes == 50


def test_the_oldest_messages_are_left_out_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(front_worker, "MOST_BYTES", 20_000)
    queue = FrameQueue()
    told = written(b'{"op":"advertise"}', Opcode.TEXT)
    answer = written(b"\x03an answer of a service")
    queue.feed(told + answer)
    for number in range(1_000):
        queue.feed(message(number))
        assert queue.waiting_bytes <= 20_000 + 200
    payloads = split(taken(queue))
    numbers = [int.from_bytes(p[1:5], "little") for p in payloads if p[:1] == b"\x01"]
    assert numbers == list(range(numbers[0], 1_000))
    assert 80 < len(numbers) < 200
    assert payloads[:2] == [b'{"op":"advertise"}', b"\x03an answer of a service"]
    statuses = [json.loads(p) for p in payloads if b'"status"' in p]
    assert len(statuses) == 1
    assert "too slow" in statuses[0]["message"]


def test_replies_that_are_not_read_cost_little_and_stop_further_requests() -> None:
    """Pongs to 100,000 pings: each was compared with all that waited before it."""
    pong = written(bytes(10), Opcode.PONG)

    async def flood(queue: FrameQueue) -> None:
        for _ in range(100):
            queue.feed(pong * 1_000)
        assert queue.waiting_bytes == 100_000 * len(pong)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(queue.room(), 0.0)
        while queue.waiting_bytes:
            await queue.take()
        await asyncio.wait_for(queue.room(), 1.0)

    asyncio.run(flood(FrameQueue()))


def test_messages_do_not_stop_requests() -> None:
    """A twist shall not wait until a large map is read."""
    queue = FrameQueue()
    queue.feed(message(1, 2 * front_worker.REPLY_BYTES))
    asyncio.run(asyncio.wait_for(queue.room(), 1.0))


def test_so_many_frames_wait_and_no_more() -> None:
    queue = FrameQueue()
    for number in range(5_000):
        queue.feed(message(number, 0))
    payloads = split(taken(queue))
    assert len(payloads) <= front_worker.MOST_FRAMES + 1
    assert payloads[-1][1:5] == (4_999).to_bytes(4, "little")


def test_one_message_larger_than_all_room_is_kept_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front_worker, "MOST_BYTES", 20_000)
    queue = FrameQueue()
    for number in range(3):
        queue.feed(message(number, 50_000))
    payloads = [p for p in split(taken(queue)) if p[:1] == b"\x01"]
    assert [p[1] for p in payloads] == [2]
