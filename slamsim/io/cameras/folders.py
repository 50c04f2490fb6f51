"""Camera images in folders: lists of files with stamps, whatever layout they follow."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from slamsim.cameras.codecs.pictures import decode_picture
from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.frames import CameraClaim, EncodedFrame
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input
from slamsim.io.cameras.base import Cameras, CameraTopic
from slamsim.io.ros.images import of_picture


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
    first = next(_frames(images))
    kind, pixels = first.stored()
    height, width = pixels.shape[:2]
    return CameraTopic(
        images.topic, kind, len(images.files), width, height, first.encoding, images.topic
    )
