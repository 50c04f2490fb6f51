"""What every source of camera images offers, whichever layout its files have; lists of files with
stamps."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import decode_picture
from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.frames import CameraClaim, CameraFrame, EncodedFrame
from slamsim.cameras.lens import CameraModel
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.files import read_input
from slamsim.guard.numbers import BadNumbers
from slamsim.io.ros.images import of_picture, without_transport

MOST_TRIED = 10
"""Images of a topic that cannot be read, until it is given up."""
MOST_WAITING = 64
"""Frames of one topic that wait for a partner; beyond them the oldest has none."""


@dataclass(frozen=True, slots=True)
class CameraTopic:
    """Images of one camera. messages: how many. width, height, encoding, frame_id: of the first."""

    topic: str
    kind: Kind
    messages: int
    width: int
    height: int
    encoding: str
    frame_id: str


class Cameras(ABC):
    """The camera images of one recording or folder; a context manager, in which they are read.

    topics: by name, those of which the first image can be read. unread: why others cannot. infos:
    what is claimed of the camera of each topic. Nothing is held but one image at a time.
    """

    def __init__(
        self,
        path: Path,
        topics: Mapping[str, CameraTopic],
        infos: Mapping[str, CameraClaim],
        unread: Mapping[str, str],
    ) -> None:
        self.path, self.topics, self.infos, self.unread = path, topics, infos, unread

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    @abstractmethod
    def encoded(self, topics: Collection[str] | None = None) -> Iterator[EncodedFrame]:
        """Images of these topics, of all by default, in the order in which they were received.

        Raises NotFound for a topic that is not there, InputRefused for a damaged file.
        """

    def frames(self, topics: Collection[str] | None = None) -> Iterator[CameraFrame]:
        """The same, decoded; raises InputRefused for one that cannot be."""
        return (each.decoded() for each in self.encoded(topics))

    def thinned(self, most: int) -> Iterator[EncodedFrame]:
        """At most so many images of each topic, evenly spread; raises as ``encoded``."""
        every = {name: -(-topic.messages // most) for name, topic in self.topics.items()}
        return (each for each in self.encoded() if each.number % every[each.topic] == 0)

    def of_kind(self, kind: Kind) -> list[CameraTopic]:
        """The topics of a kind, the one with the most images first."""
        found = [each for each in self.topics.values() if each.kind == kind]
        return sorted(found, key=lambda each: (-each.messages, each.topic))

    def pictures(self) -> list[CameraTopic]:
        """Topics of colour and then of grey images; of what was recorded raw and packed, one."""
        found: dict[str, CameraTopic] = {}
        for each in (*self.of_kind("colour"), *self.of_kind("grey")):
            found.setdefault(without_transport(each.topic), each)
        return list(found.values())

    def model(self, topic: str) -> CameraModel:
        """The camera of a topic as it is claimed.

        Raises NotFound for a topic without images or claim, InputRefused for a claim that no camera
        can be: a singular camera matrix, an unknown distortion or one that folds inside the image,
        images of another size.
        """
        about = self.topics[self._known(topic)]
        if topic not in self.infos:
            raise NotFound(f"{self.path}: nothing says which camera took {topic} (a CameraInfo)")
        claim = self.infos[topic]
        size = about.width, about.height
        if claim.image_size != size:
            told = "{} x {}".format(*claim.image_size)
            reason = f"says {told}, but images of {topic} are {size[0]} x {size[1]}"
            raise InputRefused(self.path, reason, claim.source)
        try:
            return claim.model()
        except BadNumbers as error:
            raise InputRefused(self.path, str(error), claim.source) from None

    def depth_partners(self) -> dict[str, str]:
        """The colour (or else grey) topic of each depth topic, where there is one.

        The best is one in the same frame and of the same size: each pixel then has both. Else
        that whose name begins most alike.
        """
        others = self.of_kind("colour") or self.of_kind("grey")
        if not others:
            return {}

        def likeness(depth: CameraTopic, other: CameraTopic) -> tuple[bool, int]:
            same = (depth.frame_id, depth.width, depth.height)
            is_aligned = same == (other.frame_id, other.width, other.height)
            return is_aligned, _common(depth.topic, other.topic)

        depths = self.of_kind("depth")
        return {d.topic: max(others, key=lambda o: likeness(d, o)).topic for d in depths}

    def pairs(
        self, first: str, second: str, within_ns: int = 20_000_000
    ) -> Iterator[tuple[CameraFrame, CameraFrame]]:
        """Frames of two topics whose stamps lie within so many ns, each used once.

        A pair is decoded when it is given; of several candidates the nearest in time is taken.
        Raises as ``frames``.
        """
        for one, other in pairs_of(self.encoded({first, second}), first, within_ns):
            yield one.decoded(), other.decoded()

    def refused(self, reason: str) -> InputRefused:
        """The error for images that are not there, with what made those of other topics unread."""
        unread = "".join(f"; {topic}: {why}" for topic, why in self.unread.items())
        return InputRefused(self.path, reason + unread)

    def _known(self, topic: str) -> str:
        if topic not in self.topics:
            if topic in self.unread:
                raise InputRefused(self.path, self.unread[topic], f"topic {topic}")
            known = ", ".join(sorted(self.topics)) or "none"
            raise NotFound(f"{self.path}: no images on {topic}; there are {known}")
        return topic

    def _wanted(self, topics: Collection[str] | None) -> set[str]:
        return set(self.topics) if topics is None else {self._known(topic) for topic in topics}


def pairs_of(
    frames: Iterator[EncodedFrame], first: str, within_ns: int
) -> Iterator[tuple[EncodedFrame, EncodedFrame]]:
    """(frame of first, frame of the other topic) in the order of the stamps of first.

    A frame of first waits until the other topic has gone beyond it.
    """
    ours, theirs = deque[EncodedFrame](), deque[EncodedFrame]()
    for frame in frames:
        (ours if frame.topic == first else theirs).append(frame)
        yield from _settled(ours, theirs, within_ns, is_over=False)
        for waiting in (ours, theirs):
            if len(waiting) > MOST_WAITING:
                waiting.popleft()
    yield from _settled(ours, theirs, within_ns, is_over=True)


def _settled(
    ours: deque[EncodedFrame], theirs: deque[EncodedFrame], within_ns: int, *, is_over: bool
) -> Iterator[tuple[EncodedFrame, EncodedFrame]]:
    """Pairs to which no later frame can be nearer."""
    while ours and theirs and (is_over or theirs[-1].stamp_ns >= ours[0].stamp_ns):
        frame = ours.popleft()
        nearest = min(theirs, key=lambda other: abs(other.stamp_ns - frame.stamp_ns))
        if abs(nearest.stamp_ns - frame.stamp_ns) <= within_ns:
            while theirs.popleft() is not nearest:
                pass
            yield frame, nearest


def _common(one: str, other: str) -> int:
    """How many letters two names have in common from the beginning."""
    count = 0
    for a, b in zip(one, other, strict=False):
        if a != b:
            break
        count += 1
    return count


@dataclass(frozen=True, slots=True, eq=False)
class ImageList:
    """Files of one camera in the order of their stamps, ns. unit_m: of integer depths."""

    topic: str
    stamps_ns: Sequence[int]
    files: Sequence[Path]
    claim: CameraClaim | None = None
    unit_m: float = 1e-3


class FolderCameras(Cameras):
    """Raises InputRefused for a folder without any image that can be read."""

    def __init__(self, path: Path, lists: Sequence[ImageList]) -> None:
        self._lists = {each.topic: each for each in lists if each.files}
        topics, unread = dict[str, CameraTopic](), dict[str, str]()
        for name, images in self._lists.items():
            try:
                topics[name] = _about(images)
            except InputRefused as refusal:
                unread[name] = str(refusal)
        if not topics:
            reasons = "; ".join(unread.values()) or "its lists name no image"
            raise InputRefused(path, f"no image of it can be read: {reasons}")
        claims = {n: each.claim for n, each in self._lists.items() if each.claim is not None}
        super().__init__(path, topics, _of_these(claims, topics), unread)

    def encoded(self, topics: Collection[str] | None = None) -> Iterator[EncodedFrame]:
        wanted = [self._lists[name] for name in sorted(self._wanted(topics))]
        sizes = [(self.topics[each.topic].width, self.topics[each.topic].height) for each in wanted]
        streams = map(_frames, wanted, sizes)
        yield from heapq.merge(*streams, key=lambda frame: frame.stamp_ns)


def _of_these(
    claims: Mapping[str, CameraClaim], topics: Mapping[str, CameraTopic]
) -> dict[str, CameraClaim]:
    return {name: claim for name, claim in claims.items() if name in topics}


def _frames(images: ImageList, size: tuple[int, int] | None = None) -> Iterator[EncodedFrame]:
    for number, (stamp_ns, file) in enumerate(zip(images.stamps_ns, images.files, strict=True)):
        yield EncodedFrame(
            file,
            images.topic,
            number,
            stamp_ns,
            stamp_ns,
            images.topic,
            file.suffix.lstrip(".").lower(),
            partial(_read, file),
            partial(read_input, file, "image_file_bytes"),
            partial(read_input, file, "image_file_bytes"),
            size,
            images.unit_m,
        )


def _read(file: Path) -> tuple[Kind, NDArray[Any]]:
    return of_picture(decode_picture(read_input(file, "image_file_bytes")))


def _about(images: ImageList) -> CameraTopic:
    """By the first image that can be read; raises InputRefused, of the last that was tried."""
    refusal: InputRefused | None = None
    for frame in islice(_frames(images), MOST_TRIED):
        try:
            kind, pixels = frame.stored()
        except InputRefused as reason:
            refusal = reason
            continue
        height, width = pixels.shape[:2]
        return CameraTopic(
            images.topic, kind, len(images.files), width, height, frame.encoding, images.topic
        )
    assert refusal is not None
    raise refusal
