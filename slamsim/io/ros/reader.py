"""Reads a ROS recording as written, in one pass over its messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.core.types import Epoch
from slamsim.guard.errors import InputRefused
from slamsim.guard.unpacking import PACKINGS
from slamsim.io import LOG
from slamsim.io.bag2.writer import METADATA_RECORD
from slamsim.io.formats import Contents, Survey, TopicFacts, Truth
from slamsim.io.input_errors import as_input_errors
from slamsim.io.ros.bag import Bag, open_bag
from slamsim.io.ros.collectors import (
    ClockCollector,
    JointCollector,
    NumberCollector,
    TextCollector,
    TransformCollector,
)
from slamsim.io.ros.columns import Opened
from slamsim.io.ros.scan_collector import EchoCollector, ScanCollector
from slamsim.io.ros.sources import Channel
from slamsim.recording import (
    KINDS,
    RawJoints,
    RawOdometry,
    RawScans,
    RawStream,
    RecordedTopic,
    Recording,
    UnreadTopic,
)
from slamsim.recording.choice import ECHOES
from slamsim.recording.cleaning.rising_stamps import epoch_of
from slamsim.recording.frames import frame_name
from slamsim.recording.schemas import CLOCK, TRANSFORMS

_BATCH, _BATCH_BYTES = 4096, 16 << 20
_DESCRIPTION, _TEXT = "robot_description", "std_msgs/msg/String"
ODOMETRY = RawOdometry.schema.type_name
TRANSFORM_TYPES = (TRANSFORMS, "tf/msg/tfMessage")
_TRUTH_WORDS = ("ground_truth", "groundtruth")
_COLLECTORS: dict[str, Callable[[str, Opened, bool], Any]] = {
    **{kind.schema.type_name: partial(NumberCollector, kind) for kind in KINDS},
    RawScans.schema.type_name: ScanCollector,
    ECHOES: EchoCollector,
    RawJoints.schema.type_name: JointCollector,
    TRANSFORM_TYPES[0]: TransformCollector,
    TRANSFORM_TYPES[1]: TransformCollector,
    CLOCK.type_name: ClockCollector,
}


def read_ros(path: Path, truth: Truth = "without") -> Contents:
    """What is in a ROS recording, in one pass over its messages.

    Of a message that cannot be decoded a count is kept, and the others are read. Raises
    InputRefused as ``open_bag`` does.
    """
    with open_bag(path) as bag:
        return read_bag(bag, truth)


def read_bag(bag: Bag, truth: Truth = "without") -> Contents:
    """As ``read_ros``, of an open recording."""
    wanted = [] if truth == "only" else _wanted(bag)
    if truth != "without":
        wanted += [channel for channel in bag.of_type(ODOMETRY) if is_truth(channel)][:1]
    topics = {channel.topic: _Topic(bag, channel) for channel in wanted}
    for name, received_ns, data in bag.received(set(topics)) if topics else ():
        topics[name].add(received_ns, data)
    for topic in topics.values():
        topic.finish()
    true = next((topics.pop(name) for name in list(topics) if is_truth(topics[name].channel)), None)
    recording = _assembled(bag, topics)
    if true is None:
        return Contents(recording)
    if true.damage:
        return Contents(recording, truth_damage=(f"topic {true.channel.topic}", true.damage))
    return Contents(recording, true.collector.stream())


def survey_ros(path: Path) -> Survey:
    """What is in a ROS recording, by its index and by some messages of each topic.

    Raises InputRefused as ``open_bag`` does.
    """
    with open_bag(path, is_sampled=True) as bag:
        declared = bag.source.declarations
        topics = {channel.topic: _Topic(bag, channel) for channel in _wanted(bag)}
        times: dict[str, list[int]] = {}
        frames: dict[str, tuple[str, ...]] = {}
        with as_input_errors(path, "its messages"):
            for number, received_ns, _, _, data in bag.source.received(declared):
                name = declared[number].topic
                seen = times.setdefault(name, [received_ns, received_ns])
                seen[:] = min(seen[0], received_ns), max(seen[1], received_ns)
                if name in topics:
                    topics[name].add(received_ns, data)
                elif name not in frames:
                    frames[name] = _frame(bag, name, data)
    for topic in topics.values():
        topic.finish()
    recording = _assembled(bag, topics)
    frames |= {stream.topic: stream.frame_ids for stream in recording.streams}
    facts = [
        TopicFacts(c.topic, c.type_name, c.messages, *times.get(c.topic, ())) for c in bag.channels
    ]
    return Survey(tuple(replace(one, frames=frames.get(one.topic, ())) for one in facts), recording)


def _frame(bag: Bag, topic: str, data: bytes) -> tuple[str, ...]:
    """Of a message of any type that has a header."""
    with suppress(InputRefused):
        header = getattr(bag.deserialize(topic, data), "header", None)
        frame = getattr(header, "frame_id", "")
        return (frame_name(frame),) if isinstance(frame, str) and frame else ()
    return ()


def is_truth(channel: Channel) -> bool:
    """Whether a topic holds what no sensor measured."""
    return any(word in channel.topic for word in _TRUTH_WORDS)


class _Topic:
    """One topic being read: its messages wait until there are enough to decode them together.

    collector is None, and trouble says why, where nothing can be made of the topic.
    """

    def __init__(self, bag: Bag, channel: Channel) -> None:
        self.channel, self._bag = channel, bag
        self.collector: Any = None
        self.trouble = self.first_damage = ""
        self.damaged = 0
        self._received: list[int] = []
        self._held: list[bytes] = []
        self._held_bytes = 0
        with self._given_up():
            is_cdr = bag.is_cdr(channel.topic)
            make = _COLLECTORS.get(channel.type_name, TextCollector)
            self.collector = make(channel.topic, self._opened, is_cdr)

    def add(self, received_ns: int, data: bytes) -> None:
        self._received.append(received_ns)
        self._held.append(bytes(data))
        self._held_bytes += len(data)
        if len(self._held) == _BATCH or self._held_bytes >= _BATCH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Decode what waits; a type without the fields that its name promises is given up."""
        if self.collector is not None and self._held:
            with self._given_up():
                self.collector.add(np.array(self._received, dtype=np.int64), self._held)
        self._received, self._held, self._held_bytes = [], [], 0

    def finish(self) -> None:
        """Decode the rest."""
        self.flush()
        if self.collector is not None and not self.collector.taken:
            self.collector, self.trouble = None, self.first_damage

    @contextmanager
    def _given_up(self) -> Iterator[None]:
        try:
            with as_input_errors(self._bag.path, f"topic {self.channel.topic}"):
                yield
        except InputRefused as refusal:
            self.collector, self.trouble = None, refusal.reason

    def _opened(self, data: bytes) -> Any:
        try:
            return self._bag.deserialize(self.channel.topic, data)
        except InputRefused as refusal:
            self.damaged += 1
            self.first_damage = self.first_damage or refusal.reason
            return None

    @property
    def damage(self) -> str:
        """Why some messages, or all, cannot be decoded."""
        return self.trouble or self.first_damage

    @property
    def anomaly(self) -> str:
        """What was wrong with some messages, in words."""
        if not self.damaged:
            return ""
        counts = f"{self.damaged:,} of {self.channel.messages:,} messages"
        return f"{self.channel.topic}: {counts} cannot be decoded ({self.first_damage})"


def description_topic(bag: Bag) -> str | None:
    """Where the robot description is read."""
    topics = (channel.topic for channel in bag.of_type(_TEXT))
    return next((topic for topic in topics if topic.endswith(_DESCRIPTION)), None)


def _wanted(bag: Bag) -> list[Channel]:
    found = []
    for channel in bag.of_type(*_COLLECTORS, _TEXT):
        if is_read(channel.topic, channel.type_name) and not is_truth(channel):
            found.append(channel)
    return found


def is_read(topic: str, type_name: str) -> bool:
    """Whether messages of a topic are read: of sensors, transforms, and the robot's description."""
    return type_name in _COLLECTORS or (type_name == _TEXT and topic.endswith(_DESCRIPTION))


def _recorded(
    bag: Bag, topics: Mapping[str, _Topic]
) -> tuple[tuple[RecordedTopic, ...], tuple[UnreadTopic, ...]]:
    """(what the file holds but the truth, what no check looks at)"""
    recorded, unread = [], []
    for channel in bag.channels:
        topic = topics.get(channel.topic)
        if is_truth(channel) or not channel.messages:
            continue
        about = channel.topic, channel.type_name, channel.messages
        recorded.append(RecordedTopic(*about, "" if topic is None else topic.damage))
        reason = "no check looks at this type" if topic is None else topic.trouble
        if reason:
            unread.append(UnreadTopic(*about, reason))
    return tuple(recorded), tuple(unread)


def _assembled(bag: Bag, topics: Mapping[str, _Topic]) -> Recording:
    read = [topic for topic in topics.values() if topic.collector is not None]
    collectors = [topic.collector for topic in read]
    clocks = [c.instants_ns() for c in collectors if isinstance(c, ClockCollector)]
    texts = [c.text for c in collectors if isinstance(c, TextCollector)]
    recorded, unread = _recorded(bag, topics)
    recording = Recording(
        name=recorded_name(bag.path),
        format=_format(bag.path),
        streams=tuple(_stream(bag, c) for kind in KINDS for c in collectors if c.kind is kind),
        transforms=tuple(
            edge
            for c in collectors
            if isinstance(c, TransformCollector)
            for edge in c.edges(is_latched=bag.source.is_latched(c.topic))
        ),
        robot_description=texts[0] if texts else None,
        clock_ns=clocks[0] if clocks else None,
        unread=unread,
        anomalies=tuple(topic.anomaly for topic in read if topic.anomaly),
        topics=recorded,
    )
    return replace(recording, epoch=_epoch(bag, recording))


def _stream(bag: Bag, collector: Any) -> RawStream:
    """Only in ROS 2 a leading slash means anything."""
    stream: RawStream = collector.stream()
    return stream if bag.source.is_ros2(stream.topic) else replace(stream, slashed=())


def _epoch(bag: Bag, recording: Recording) -> Epoch:
    """As our own metadata say; else UNIX by the size of the stamps; else a clock tells."""
    if bag.metadata.get(METADATA_RECORD, {}).get("epoch") == "simulation":
        return "simulation"
    streams = (*recording.scans, *recording.imus, *recording.odometries)
    guessed = epoch_of(int(np.median(streams[0].stamps_ns)) if streams else 0)
    return "simulation" if guessed == "unknown" and bag.of_type(CLOCK.type_name) else guessed


def recorded_name(path: Path) -> str:
    """What a recording is called after its file, or after the folder of its run."""
    if path.name == LOG:
        return path.resolve().parent.name
    return Path(path.stem).stem if path.suffix.lower() in PACKINGS else path.stem


def _format(path: Path) -> str:
    formats = {".mcap": "mcap", ".bag": "rosbag1"}
    known = (formats[s.lower()] for s in reversed(path.suffixes) if s.lower() in formats)
    return "rosbag2" if path.is_dir() else next(known, "rosbag2")
