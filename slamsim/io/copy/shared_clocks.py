"""Topics without a model that share the clock of a stream with corrected stamps."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import IntArray
from slamsim.io.copy.changes import RowChanges
from slamsim.io.ros.bag import Bag

_HEADER = ("header", "std_msgs/msg/Header")
_AT = 4
"""Byte of the stamp: behind the encapsulation of CDR, or the sequence number of ROS 1."""
_SAME_STEP_NS = 2
_FEWEST = 20
"""Stamps that coincide, and lengths of step between them that differ.

A clock that ticks evenly, as a simulator's does, has a handful of lengths of step, and two streams
on it coincide without one being made from the other. A stream of a real driver scatters by
microseconds at least: twenty of its stamps met to the nanosecond, with twenty different steps
between them, are no chance.
"""


@dataclass(frozen=True, slots=True, eq=False)
class StampMap:
    """From the stamps that a topic had, before_ns (n,) ascending, to those that it has now."""

    topic: str
    before_ns: IntArray
    after_ns: IntArray

    def __call__(self, stamp_ns: int) -> int:
        at = int(np.searchsorted(self.before_ns, stamp_ns))
        return int(self.after_ns[at])


def header_topics(bag: Bag, topics: Iterable[str]) -> list[str]:
    """Those of the topics whose messages begin with a header, and so with a stamp."""
    found = []
    for topic in topics:
        try:
            fields = bag.source.types.fields(topic)
        except Exception:  # a type that cannot be read has no stamp that could be moved
            continue
        is_ros = bag.source.types.encoding(topic) in ("cdr", "ros1")
        if is_ros and fields and fields[0] == _HEADER:
            found.append(topic)
    return found


def stamp_maps(
    bag: Bag, changes: Sequence[RowChanges], topics: Sequence[str]
) -> dict[str, StampMap]:
    """How the stamps of topics move with those of the streams that they were made from.

    topics: those that begin with a header. A topic is on a stream's clock if every one of its
    stamps is one of the stream's, and no chance. Raises InputRefused as ``Bag.received`` does.
    """
    maps = [_map_of(change) for change in changes if change.restamped]
    still = [change.read_stamps_ns for change in changes if not change.restamped]
    found: dict[str, StampMap] = {}
    for topic, stamps_ns in _stamps(bag, topics).items() if maps else ():
        candidates = [each for each in maps if _is_made_from(stamps_ns, each.before_ns)]
        if candidates and not any(_is_made_from(stamps_ns, other) for other in still):
            found[topic] = candidates[0]
    return found


def stamp_of(data: bytes, encoding: str) -> int:
    """Of a serialised message that begins with a header, in ns; struct.error if it is too short."""
    seconds, nanoseconds = struct.unpack_from(_format(data, encoding), data, _AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def with_stamp(data: bytes, encoding: str, stamp_ns: int) -> bytes:
    """The same message with another stamp; every other byte stays."""
    stamp = struct.pack(_format(data, encoding), *divmod(stamp_ns, 1_000_000_000))
    return data[:_AT] + stamp + data[_AT + len(stamp) :]


def _format(data: bytes, encoding: str) -> str:
    if encoding == "ros1":
        return "<II"
    return "<iI" if data[1:2] == b"\x01" else ">iI"


def _stamps(bag: Bag, topics: Sequence[str]) -> dict[str, IntArray]:
    """(n,) of each topic, left out where a message is too short to have one."""
    found: dict[str, list[int]] = {topic: [] for topic in topics}
    encodings = {topic: bag.source.types.encoding(topic) for topic in topics}
    for topic, _, data in bag.received(set(topics)) if topics else ():
        try:
            found.get(topic, []).append(stamp_of(data, encodings[topic]))
        except struct.error:
            found.pop(topic, None)
    return {topic: np.array(values, dtype=np.int64) for topic, values in found.items()}


def _map_of(change: RowChanges) -> StampMap:
    before_ns, first = np.unique(change.read_stamps_ns, return_index=True)
    return StampMap(change.topic, before_ns, change.stamps_ns[first])


def _is_made_from(stamps_ns: IntArray, others_ns: IntArray) -> bool:
    """Whether all stamps are among the others, and the others tick so unevenly that it tells."""
    if np.unique(stamps_ns).size < _FEWEST or not np.isin(stamps_ns, others_ns).all():
        return False
    steps_ns = np.sort(np.diff(np.unique(others_ns)))
    return int((np.diff(steps_ns) > _SAME_STEP_NS).sum()) + 1 >= _FEWEST
