"""A semantic map: which label was seen most often in each cell."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.codecs.raw import Kind
from slamsim.cameras.frames import EncodedFrame
from slamsim.core.layers import SemanticLayer
from slamsim.core.types import Float32Array, FloatArray, Grid, IntArray
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.numbers import BadNumbers
from slamsim.guard.pictures import require_size
from slamsim.io.cameras.base import Cameras, pairs_of
from slamsim.io.ros.bag import Bag, open_bag
from slamsim.io.ros.images import RAW, frame_of, stamp_of
from slamsim.io.ros.message_types import FRAME_TRUTH
from slamsim.perception.calibrated import CameraClock

ENCODINGS = {"mono8": "u1", "8UC1": "u1", "32SC1": "i4"}
WITHIN_NS = 20_000_000
FIRST_THING = 3
"""Of instances of a simulated camera: below are nothing, floor and wall (``world.parts``)."""
_LABELS = 1 << 32
_HELD = 1 << 22
"""So many votes wait until they are added up."""


@dataclass(frozen=True, slots=True)
class LabelTopic:
    """Images of labels, and the depths of the same pixels: topics, their common frame, and how many
    images of labels there are."""

    topic: str
    depth: str
    frame_id: str
    images: int


@dataclass(frozen=True, slots=True, eq=False)
class LabelBoxes:
    """Boxes about the pixels of each label in the image at stamp_ns: as ``boxes_of``."""

    stamp_ns: int
    labels: IntArray
    boxes_px: FloatArray


def label_topic(path: Path, topic: str, cameras: Cameras) -> LabelTopic:
    """cameras: of the recording at path, with its truth.

    Raises NotFound for a topic that is none of images, InputRefused for one whose images hold no
    labels, or where no depth is known of its pixels.
    """
    with open_bag(path) as bag:
        known = {each.topic: each.messages for each in bag.of_type(RAW)}
        if topic not in known:
            told = ", ".join(sorted(known)) or "none"
            raise NotFound(f"{path}: no images of labels on {topic}; raw images are on {told}")
        first = next(_frames(bag, path, {topic}, topic), None)
    if first is None:
        raise InputRefused(path, "has no image", f"topic {topic}")
    height, width = first.stored()[1].shape
    for depth in sorted(cameras.of_kind("depth"), key=lambda each: "ground_truth" in each.topic):
        if (depth.frame_id, depth.width, depth.height) == (first.frame_id, width, height):
            return LabelTopic(topic, depth.topic, first.frame_id, known[topic])
    reason = f"there is no depth of its pixels: {width} x {height} in {first.frame_id!r}"
    raise InputRefused(path, reason, f"topic {topic}")


def label_boxes(path: Path, topic: str, most: int) -> Iterator[LabelBoxes]:
    """What a topic of the recording shows of things, in at most so many of its images, evenly;
    nothing where there is no such topic.

    Raises as ``label_topic`` for images that hold no labels.
    """
    with open_bag(path) as bag:
        total = sum(each.messages for each in bag.of_type(RAW) if each.topic == topic)
        for frame in _frames(bag, path, {topic}, topic):
            if frame.number * most % total < most:
                labels, boxes_px = boxes_of(frame.stored()[1])
                yield LabelBoxes(frame.stamp_ns, labels, boxes_px)


def boxes_of(image: NDArray[np.int32]) -> tuple[IntArray, FloatArray]:
    """(k,) the labels of things in (h, w), and (k, 4) least and largest column and row of each."""
    rows, columns = np.nonzero(image >= FIRST_THING)
    labels, which = np.unique(image[rows, columns], return_inverse=True)
    least = np.full((len(labels), 2), np.inf)
    largest = -least
    pixels = np.column_stack([columns, rows]).astype(np.float64)
    np.minimum.at(least, which, pixels)
    np.maximum.at(largest, which, pixels)
    return labels.astype(np.int64), np.column_stack([least, largest])


def true_clock(path: Path, topic: str) -> CameraClock | None:
    """Of labels that a simulation made: as its first FrameTruth has rows and stamp; None of others,
    and where there is none."""
    frames = f"{topic.rpartition('/')[0]}/frame"
    with open_bag(path) as bag:
        if frames not in {each.topic for each in bag.of_type(FRAME_TRUTH)}:
            return None
        for _, _, data in bag.received({frames}):
            truth = bag.deserialize(frames, data)
            rows_ns = np.asarray(truth.row_instants_ns, dtype=np.int64)
            late_ns = stamp_of(truth) - int(rows_ns[0])
            return CameraClock(1e-9 * late_ns, 1e-9 * float(rows_ns[-1] - rows_ns[0]))
    return None


def labelled(path: Path, topic: LabelTopic) -> Iterator[tuple[EncodedFrame, EncodedFrame]]:
    """(labels, depth) with about the same stamp, one pair after the other."""
    with open_bag(path) as bag:
        frames = _frames(bag, path, {topic.topic, topic.depth}, topic.topic)
        yield from pairs_of(frames, topic.topic, WITHIN_NS)


def _frames(bag: Bag, path: Path, topics: Collection[str], labels: str) -> Iterator[EncodedFrame]:
    """Images of these topics, of which ``labels`` can have encodings that no camera has.

    Raises InputRefused where it has others."""
    numbers = dict.fromkeys(topics, 0)
    for topic, received_ns, data in bag.received(set(topics)):
        message = bag.deserialize(topic, data)
        frame = frame_of(path, topic, numbers[topic], received_ns, message)
        numbers[topic] += 1
        if topic != labels:
            yield frame
            continue
        if frame.encoding not in ENCODINGS:
            known = ", ".join(ENCODINGS)
            reason = f"images of {frame.encoding} hold no labels; {known} do"
            raise InputRefused(path, reason, f"topic {topic}")
        yield replace(frame, read=partial(_labels, message))


def _labels(message: Any) -> tuple[Kind, NDArray[Any]]:
    """(h, w) int32. Raises ValueError for an image that is cut off, Excessive beyond limits."""
    dtype = np.dtype((">" if message.is_bigendian else "<") + ENCODINGS[message.encoding])
    height, width, step = int(message.height), int(message.width), int(message.step)
    require_size(width, height, dtype.itemsize)
    data = np.asarray(message.data, np.uint8)
    if step < width * dtype.itemsize or data.size < step * height:
        raise ValueError(f"is cut off: {data.size:,} bytes for {height} rows of {step:,}")
    rows = data[: step * height].reshape(height, step)[:, : width * dtype.itemsize]
    return "grey", np.ascontiguousarray(rows).view(dtype).astype(np.int32)


class LabelVotes:
    """Votes in the cells of a map: each image has one in each cell for each label it shows there.

    grid: gives geometry alone.
    """

    def __init__(self, grid: Grid, max_depth_m: float, highest_m: float) -> None:
        self._grid, self._max_depth_m, self._highest_m = grid, max_depth_m, highest_m
        self._keys: IntArray = np.zeros(0, np.int64)
        self._votes: IntArray = np.zeros(0, np.int64)
        self._waiting: list[IntArray] = []
        self._images = 0

    def draw(
        self,
        labels: NDArray[np.int32],
        depth_m: Float32Array,
        K: FloatArray,
        T_map_camera: FloatArray,
    ) -> None:
        """Enter one image: (h, w) labels and depths of the same pixels, nan for none.

        T_map_camera: (4, 4) of the optical frame, z up, or (h, 4, 4) of each row. Labels below 0
        and what is higher than the robot's way do not count. Raises BadNumbers for labels of other
        pixels.
        """
        if labels.shape != depth_m.shape:
            raise BadNumbers(f"labels of {labels.shape} are not those of depths of {depth_m.shape}")
        v, u = np.nonzero(np.isfinite(depth_m) & (depth_m <= self._max_depth_m) & (labels >= 0))
        z = depth_m[v, u].astype(np.float64)
        x, y = (u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z
        points = _moved(np.column_stack([x, y, z]), T_map_camera, v)
        cells = np.floor((points[:, :2] - self._grid.origin_m) / self._grid.resolution_m)
        rows, columns = self._grid.occupancy.shape
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < columns) & (cells[:, 1] < rows)
        inside &= points[:, 2] <= self._highest_m
        column, row = cells[inside].astype(np.int64).T
        seen = labels[v[inside], u[inside]].astype(np.int64)
        self._waiting.append(np.unique((row * columns + column) * _LABELS + seen))
        self._images += 1
        if sum(each.size for each in self._waiting) > _HELD:
            self._add_up()

    def layer(self, topic: str) -> SemanticLayer:
        """Of equally many votes the smallest label counts."""
        self._add_up()
        shape = self._grid.occupancy.shape
        labels, shares = np.full(shape, -1, np.int32), np.zeros(shape, np.float32)
        cells, seen = self._keys // _LABELS, self._keys % _LABELS
        order = np.lexsort((seen, -self._votes, cells))
        first = order[np.unique(cells[order], return_index=True)[1]]
        totals = np.bincount(cells, self._votes, minlength=labels.size)
        labels.reshape(-1)[cells[first]] = seen[first]
        shares.reshape(-1)[cells[first]] = self._votes[first] / totals[cells[first]]
        return SemanticLayer(labels, shares, self._grid, topic, self._images)

    def _add_up(self) -> None:
        whole = np.concatenate([self._keys, *self._waiting])
        each = np.concatenate([self._votes, np.ones(whole.size - self._keys.size, np.int64)])
        self._keys, places = np.unique(whole, return_inverse=True)
        self._votes = np.bincount(places, each, minlength=self._keys.size).astype(np.int64)
        self._waiting = []


def _moved(points_m: FloatArray, T_map_camera: FloatArray, row: IntArray) -> FloatArray:
    """(n, 3) points of an image in the map; row: (n,) which of the image's rows shows each."""
    if T_map_camera.ndim == 2:
        return np.asarray(points_m @ T_map_camera[:3, :3].T + T_map_camera[:3, 3])
    turned = np.einsum("nij,nj->ni", T_map_camera[row, :3, :3], points_m)
    return np.asarray(turned + T_map_camera[row, :3, 3])
