"""Messages that arrived, as a recording, and which of its streams SLAM reads."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slamsim.core.types import IntArray, Log
from slamsim.guard.errors import InputRefused
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.bag import Bag
from slamsim.io.ros.message_types import ros2_types
from slamsim.io.ros.reader import is_read, read_bag
from slamsim.io.ros.sources import HeldSource
from slamsim.io.selection import Selection, selected
from slamsim.live.hub import Message
from slamsim.live.slam_feed import Arrived
from slamsim.live.sources.source import MessageLink
from slamsim.recording import RawImu, RawOdometry, RawScans, RawTicks, Recording
from slamsim.recording.choice import choices, in_words, odometry_edges, ranked
from slamsim.recording.cleaning.log import clean
from slamsim.recording.cleaning.no_return import RangeLimit
from slamsim.recording.cleaning.scans import RecordedScans
from slamsim.recording.cleaning.streams import chain_of
from slamsim.recording.schemas import TRANSFORMS

PATIENCE_S = 60.0
"""How long a robot may take until something can be mapped: drivers start within a minute."""
_LOOK_S = 0.25
"""Topics are told one by one by some servers: they are complete when none came for so long."""
BACK_NS = 1_000_000_000
"""Scans that are so much earlier than those before them belong to another drive."""
_EARLIER = 3
"""So many of them, one after the other."""
_LATCHED = ("tf_static", "robot_description")


def read_topics(source: MessageLink) -> list[TopicKind]:
    """Those that are mapped, checked and recorded, once there are scans among them.

    Raises InputRefused where none appear.
    """
    until_s, before = time.monotonic() + PATIENCE_S, list[TopicKind]()
    while True:
        there = source.topics()
        found = [
            TopicKind(one.name, one.type_name, one.name.endswith(_LATCHED))
            for one in there
            if is_read(one.name, one.type_name)
        ]
        has_scans = any(one.type_name == RawScans.schema.type_name for one in found)
        if has_scans and found == before:
            return found
        if not has_scans and time.monotonic() > until_s:
            told = ", ".join(sorted(one.name for one in there)[:9]) or "no topic at all"
            reason = f"no topic of {RawScans.schema.type_name} in {PATIENCE_S:.0f} s, only {told}"
            raise InputRefused(source.url, reason)
        before = found
        time.sleep(_LOOK_S)


def recording_of(name: str, messages: Iterable[Message]) -> Recording:
    """name: of the robot, for messages to the user."""
    source = HeldSource((m.topic.name, m.topic.type_name, m.log_ns, m.data) for m in messages)
    return read_bag(Bag(Path(name), source, tuple(source.channels()))).recording


class FixedTransforms:
    """Each publisher tells its own: a late client is given the last message of a topic alone."""

    def __init__(self) -> None:
        self._types = ros2_types()
        self._by_child: dict[str, Any] = {}

    def with_all(self, message: Message) -> Message:
        """A tf2_msgs/TFMessage with all that was told before; a damaged one as it is."""
        try:
            told: Any = self._types.deserialize_cdr(message.data, TRANSFORMS)
        except Exception:  # of many types, for damage of any kind
            return message
        self._by_child |= {one.child_frame_id: one for one in told.transforms}
        told.transforms = list(self._by_child.values())
        data = bytes(self._types.serialize_cdr(told, TRANSFORMS))
        return Message(message.topic, message.log_ns, data)


def is_fixed(topic: TopicKind) -> bool:
    """Whether its messages are fixed transforms, which each publisher says once."""
    return topic.latched and topic.type_name == TRANSFORMS


class ScanOrder:
    """Finds where another drive begins: a simulation was begun anew, or a recording is played
    again."""

    def __init__(self) -> None:
        self._newest_ns = self._earlier = 0

    def is_another_drive(self, stamps_ns: IntArray) -> bool:
        """stamps_ns: (n,) of the scans that arrived next.

        Single ones that are far too early, such as stamps of 0, are a driver's fault and begin
        nothing.
        """
        for stamp_ns in stamps_ns.tolist():
            self._earlier = self._earlier + 1 if stamp_ns < self._newest_ns - BACK_NS else 0
            self._newest_ns = max(self._newest_ns, stamp_ns)
            if self._earlier == _EARLIER:
                return True
        return False


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What SLAM reads of a robot, found in its first seconds.

    log: those seconds, cleaned. limit: beyond which a reading is no return. topics: one of each
    kind of stream at most. odometry_edges: (parent, child) of the transforms that are the odometry
    where no topic has any. odom_frame: in which the odometry is, empty without one. has_map_frame:
    whether the robot tells where that frame is in a map.
    """

    log: Log
    limit: RangeLimit
    topics: frozenset[str]
    odometry_edges: Sequence[tuple[str, str]]
    odom_frame: str
    has_map_frame: bool
    words: str

    def of(self, recording: Recording) -> list[Arrived]:
        """The streams that SLAM reads."""
        found: list[Arrived] = [one for one in recording.streams if one.topic in self.topics]
        path = chain_of(recording.transforms, self.odometry_edges)
        return found if path is None else [*found, path.planar()]


def find_inputs(first: Recording, wanted: Selection, name: str) -> Inputs:
    """Raises InputRefused while nothing can be mapped of what has come, OverrideRefused for wanted
    topics that are not there."""
    path = Path(name)
    chosen = selected(first, wanted, path)
    chosen = chosen.with_streams(RawScans, chosen.scans[:1])
    log = clean(chosen, path)
    assert isinstance(log.scans, RecordedScans), "of one lidar"
    kinds = RawScans, RawOdometry, RawImu, RawTicks
    topics = [one.topic for kind in kinds for one in ranked(chosen, kind)[:1]]
    edges: Sequence[tuple[str, str]] = ()
    odometry = [one for one in chosen.odometries if one.topic in topics]
    frames = [one.frame_ids[0] for one in odometry]
    if not odometry:
        edges = odometry_edges(chosen)
        frames = [parent for parent, _ in edges]
    odom_frame = frames[0] if frames else ""
    has_map = any(odom_frame == edge.child for edge in chosen.transforms)
    words = in_words(choices(chosen))
    return Inputs(log, log.scans.limit, frozenset(topics), edges, odom_frame, has_map, words)
