"""Camera images of ROS 1 and ROS 2 recordings, one message at a time."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from slamsim.cameras.frames import CameraClaim, EncodedFrame
from slamsim.guard.errors import InputRefused
from slamsim.io.cameras.base import MOST_TRIED, Cameras, CameraTopic
from slamsim.io.formats import Truth
from slamsim.io.input_errors import as_input_errors
from slamsim.io.ros.bag import Bag, custom_data, open_bag
from slamsim.io.ros.images import (
    INFO,
    PACKED,
    RAW,
    claim_of,
    frame_of,
    info_topic,
    told_readout,
)
from slamsim.io.ros.reader import is_truth
from slamsim.io.ros.sources import Channel


class RecordedCameras(Cameras):
    """Those of a recording, which must be left when done: packed files lie in a temporary folder.

    Raises InputRefused as ``open_bag`` does.
    """

    def __init__(self, path: Path, truth: Truth = "without") -> None:
        self._bag = open_bag(path)
        try:
            images, infos = _wanted(self._bag, truth, RAW, PACKED), _wanted(self._bag, truth, INFO)
            look = _FirstLook(self._bag, (*images, *infos))
            claims, unread = _by_image(look.topics, look.claims), dict(look.unread)
            claims = _with_shutters(claims, custom_data(self._bag), unread)
            super().__init__(path, look.topics, claims, unread)
        except BaseException:
            self._bag.__exit__()
            raise

    def __exit__(self, *_: object) -> None:
        self._bag.__exit__()

    def encoded(self, topics: Collection[str] | None = None) -> Iterator[EncodedFrame]:
        wanted = self._wanted(topics)
        seen = dict.fromkeys(wanted, 0)
        for topic, received_ns, data in self._bag.received(wanted) if wanted else ():
            about = self.topics[topic]
            frame = _frame(self._bag, topic, seen[topic], received_ns, data)
            seen[topic] += 1
            yield replace(frame, size=(about.width, about.height))


def _wanted(bag: Bag, truth: Truth, *types: str) -> list[Channel]:
    """Topics of these types; those of the truth only if they are asked for."""
    asked = {"without": (False,), "with": (False, True), "only": (True,)}[truth]
    return [channel for channel in bag.of_type(*types) if is_truth(channel) in asked]


def _frame(bag: Bag, topic: str, number: int, received_ns: int, data: bytes) -> EncodedFrame:
    """One that is no message says so when it is read; it has the stamp of its reception."""
    try:
        message = bag.deserialize(topic, data)
        with as_input_errors(bag.path, f"topic {topic}"):
            return frame_of(bag.path, topic, number, received_ns, message)
    except InputRefused as refusal:
        reason = refusal.reason

    def read() -> NoReturn:
        raise ValueError(reason)

    return EncodedFrame(bag.path, topic, number, received_ns, received_ns, "", "", read)


class _FirstLook:
    """The first readable message of each topic; the file is read as far as that takes.

    topics, unread: as ``Cameras`` has them. claims: of CameraInfo topics.
    """

    def __init__(self, bag: Bag, channels: Iterable[Channel]) -> None:
        self.topics: dict[str, CameraTopic] = {}
        self.claims: dict[str, CameraClaim] = {}
        self.unread: dict[str, str] = {}
        self._bag = bag
        waiting = {channel.topic: channel for channel in channels}
        tried = dict.fromkeys(waiting, 0)
        for topic, received_ns, data in bag.received(set(waiting)) if waiting else ():
            if topic in waiting:
                tried[topic] += 1
                if self._look(waiting[topic], received_ns, data) or tried[topic] == MOST_TRIED:
                    del waiting[topic]
                if not waiting:
                    break

    def _look(self, channel: Channel, received_ns: int, data: bytes) -> bool:
        """Whether this message could be read."""
        try:
            if channel.type_name == INFO:
                message = self._bag.deserialize(channel.topic, data)
                with as_input_errors(self._bag.path, f"topic {channel.topic}"):
                    self.claims[channel.topic] = claim_of(channel.topic, message)
            else:
                frame = _frame(self._bag, channel.topic, 0, received_ns, data)
                self.topics[channel.topic] = _about(channel, frame)
        except InputRefused as refusal:
            self.unread[channel.topic] = refusal.reason
            return False
        self.unread.pop(channel.topic, None)
        return True


def _about(channel: Channel, frame: EncodedFrame) -> CameraTopic:
    kind, pixels = frame.stored()
    height, width = pixels.shape[:2]
    told = frame.encoding, frame.frame_id
    return CameraTopic(channel.topic, kind, channel.messages, width, height, *told)


def _with_shutters(
    infos: Mapping[str, CameraClaim], custom: Mapping[str, str], unread: dict[str, str]
) -> dict[str, CameraClaim]:
    """By the topic of images, with what the recording says of their shutters; unread: gets what it
    says in vain, by the topic of CameraInfo."""
    found = dict(infos)
    for topic, claim in infos.items():
        try:
            found[topic] = replace(claim, readout_s=told_readout(custom, topic))
        except ValueError as error:
            unread[claim.source.removeprefix("topic ")] = str(error)
    return found


def _by_image(
    topics: Mapping[str, CameraTopic], claims: Mapping[str, CameraClaim]
) -> dict[str, CameraClaim]:
    """By the topic of images: the claim beside it, or else the only one of the same frame."""
    found = {}
    for name, topic in topics.items():
        same = [each for each in claims.values() if each.frame_id == topic.frame_id]
        beside = claims.get(info_topic(name), same[0] if len(same) == 1 else None)
        if beside is not None:
            found[name] = beside
    return found
