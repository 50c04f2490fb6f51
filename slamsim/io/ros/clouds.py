"""Reads the point clouds of a recording (sensor_msgs/PointCloud2) as planar scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Trajectory
from slamsim.guard.errors import InputRefused
from slamsim.io.ros.bag import Bag, open_bag
from slamsim.recording import RawOdometry, RawScans, RecordedTopic, Recording
from slamsim.recording.choice import ranked
from slamsim.recording.cleaning.rising_stamps import epoch_of
from slamsim.recording.cleaning.streams import chain_of, trajectory_of
from slamsim.recording.clouds import CloudSlicer, CloudsWanted, Place
from slamsim.recording.frames import (
    FrameTree,
    frame_name,
    known_mounting,
    likely_base,
    odometry_chain,
)
from slamsim.recording.sweeps import Points

_BATCH_BYTES = 16 << 20
_KINDS = ("", "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""By the number that a PointField gives its datatype."""
_RINGS, _TIMES = ("ring", "channel"), ("t", "time", "timestamp", "time_stamp", "offset_time")


class UnusableClouds(ValueError):
    """Clouds of a layout that holds no places."""


def with_slices(path: Path, recording: Recording, wanted: CloudsWanted) -> Recording:
    """A recording that was read from path, with scans cut out of its clouds.

    Where clouds cannot be used their topic says why. Raises InputRefused as ``open_bag`` does.
    """
    base = wanted.base_frame or next(iter(recording.base_frames), "")
    with open_bag(path, is_sampled=wanted.is_sampled) as bag:
        topics = {name: _Topic(bag, name, recording, base, wanted) for name in wanted.topics}
        for name, received_ns, data in _messages(bag, set(topics), is_sampled=wanted.is_sampled):
            topics[name].add(received_ns, data)
    scans = [(topic.name, topic.finished()) for topic in topics.values()]
    streams = tuple(stream for _, stream in scans if stream is not None)
    is_read = {name for name, stream in scans if stream is not None}
    damage = {topic.name: topic.trouble for topic in topics.values()}
    odd = tuple(topic.anomaly for topic in topics.values() if topic.anomaly)
    epoch = recording.epoch
    if epoch == "unknown" and streams:
        epoch = epoch_of(int(np.median(streams[0].stamps_ns)))
    return replace(
        recording,
        streams=(*streams, *recording.streams),
        transforms=(*recording.transforms, *(e for t in topics.values() for e in t.edges())),
        unread=tuple(each for each in recording.unread if each.topic not in is_read),
        anomalies=(*recording.anomalies, *odd),
        topics=tuple(_with_damage(each, damage.get(each.topic, "")) for each in recording.topics),
        epoch=epoch,
    )


def _with_damage(topic: RecordedTopic, damage: str) -> RecordedTopic:
    return replace(topic, damage=damage) if damage else topic


def _messages(bag: Bag, topics: set[str], *, is_sampled: bool) -> Iterator[tuple[str, int, bytes]]:
    if not is_sampled:
        yield from bag.received(topics)
        return
    declared = bag.source.declarations
    mine = {number: each for number, each in declared.items() if each.topic in topics}
    for number, received_ns, _, _, data in bag.source.received(mine):
        yield declared[number].topic, received_ns, data


class _Topic:
    """One topic of clouds being read. trouble: why nothing can be made of it."""

    def __init__(
        self, bag: Bag, name: str, recording: Recording, base_frame: str, wanted: CloudsWanted
    ) -> None:
        self.name, self._bag, self._recording = name, bag, recording
        self._base_frame, self._wanted = base_frame, wanted
        self._slicer: CloudSlicer | None = None
        self._held: list[Points] = []
        self._held_bytes = self._damaged = self._seen = 0
        self._first_damage = self.trouble = ""

    def add(self, received_ns: int, data: bytes) -> None:
        """The next message; one that is damaged is counted."""
        self._seen += 1
        if self.trouble:
            return
        try:
            message = self._bag.deserialize(self.name, data)
            if self._slicer is None:
                frame = frame_name(message.header.frame_id)
                place, path = self._place(frame)
                self._slicer = CloudSlicer(self.name, place, self._wanted.heights_m, path)
            self._held.append(points_of(message, received_ns))
        except UnusableClouds as error:
            self.trouble = str(error)
        except InputRefused as refusal:
            self._note(refusal.reason)
        except ValueError as error:
            self._note(str(error))
        self._held_bytes += len(data)
        if self._held_bytes >= _BATCH_BYTES:
            self._flush()

    def _note(self, reason: str) -> None:
        self._damaged += 1
        self._first_damage = self._first_damage or reason

    def _place(self, frame: str) -> tuple[Place, Trajectory | None]:
        """(where the sensor sits by transforms that never move, how its base moved)."""
        edges = self._recording.transforms
        tree = FrameTree()
        for is_static in (True, False):
            tree.add(edge for edge in edges if edge.is_static == is_static)
            known = known_mounting(tree, self._base_frame or likely_base(tree), frame)
            if known is not None:
                place = Place(frame, known[1], known[0])
                return place, _path(self._recording, tree, place)
        return Place(frame, "", np.eye(4)), None

    def _flush(self) -> None:
        try:
            if self._slicer is not None and not self.trouble:
                self._slicer.add(self._held)
        except ValueError as error:
            self.trouble = str(error)
        self._held, self._held_bytes = [], 0

    def finished(self) -> RawScans | None:
        """The scans, if there are any."""
        self._flush()
        if not self.trouble and self._damaged == self._seen:
            self.trouble = self._first_damage
        if self.trouble or self._slicer is None:
            self._slicer = None
            return None
        return self._slicer.stream()

    def edges(self) -> Iterable[Any]:
        """To the frames of the scans, after ``finished``."""
        return () if self._slicer is None else self._slicer.edges()

    @property
    def anomaly(self) -> str:
        """What was wrong with some clouds, in words."""
        if not self._damaged or self.trouble:
            return ""
        counts = f"{self._damaged:,} of {self._seen:,} clouds"
        return f"{self.name}: {counts} cannot be used ({self._first_damage})"


def _path(recording: Recording, tree: FrameTree, place: Place) -> Trajectory | None:
    """T_odom_base of the sensor's base by the odometry that SLAM reads, or else by transforms."""
    for topic in ranked(recording, RawOdometry):
        for raw in recording.odometries:
            if raw.topic == topic.topic and place.base_frame in raw.child_frame_ids[:1]:
                return trajectory_of(raw)
    tree.add(edge for edge in recording.transforms if not edge.is_static)
    edges = odometry_chain(tree, place.frame)
    if not edges or edges[-1][1] != place.base_frame:
        return None
    return chain_of(recording.transforms, edges)


def points_of(message: Any, received_ns: int) -> Points:
    """The points of a sensor_msgs/PointCloud2 that have a place: finite, and not the sensor's own.

    Organised clouds (with rows), rows with padding, and either order of bytes. Raises
    UnusableClouds for fields that hold no places, ValueError for too few bytes.
    """
    rows = _rows(message)
    xyz_m = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64)
    is_there = np.flatnonzero(np.isfinite(xyz_m).all(axis=1) & xyz_m.any(axis=1))
    stamp = message.header.stamp
    return Points(
        int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec),
        received_ns,
        xyz_m[is_there],
        _column(rows, _RINGS, is_there, np.int64),
        _column(rows, _TIMES, is_there, np.float64),
    )


def _rows(message: Any) -> NDArray[Any]:
    """(n,) of a structured type with one member for each field that is wanted."""
    point, width, height = int(message.point_step), int(message.width), int(message.height)
    wanted = {"x", "y", "z", *_RINGS, *_TIMES}
    fields = {f.name: f for f in message.fields if f.name in wanted}
    if not fields.keys() >= {"x", "y", "z"}:
        names = ", ".join(f.name[:30] for f in message.fields[:12]) or "none"
        raise UnusableClouds(f"a point cloud without x, y and z: its fields are {names}")
    order = ">" if message.is_bigendian else "<"
    for name, field in fields.items():
        kind = _KINDS[field.datatype] if 0 < field.datatype < len(_KINDS) else ""
        if not kind or (name in "xyz" and kind[0] != "f"):
            raise UnusableClouds(
                f"field {name} of its points is of datatype {field.datatype}; "
                "x, y and z are FLOAT32 (7) or FLOAT64 (8)"
            )
        if int(field.offset) + int(kind[1]) > point:
            raise UnusableClouds(
                f"field {name} ends at byte {int(field.offset) + int(kind[1])} of points of {point}"
            )
    dtype = np.dtype(
        {
            "names": list(fields),
            "formats": [order + _KINDS[field.datatype] for field in fields.values()],
            "offsets": [int(field.offset) for field in fields.values()],
            "itemsize": point,
        }
    )
    return _data(message, point, width, height).view(dtype).reshape(-1)


def _data(message: Any, point: int, width: int, height: int) -> NDArray[np.uint8]:
    """(points, bytes of each) without the padding of the rows."""
    row = int(message.row_step) if height > 1 else point * width
    data = np.asarray(message.data, dtype=np.uint8)
    needed = row * (height - 1) + point * width if height else 0
    if row < point * width or data.size < needed:
        raise ValueError(
            f"a cloud of {height:,} x {width:,} points of {point} bytes in {data.size:,} bytes"
        )
    if not width or not height:
        return np.zeros((0, point), dtype=np.uint8)
    if row == point * width:
        return data[:needed].reshape(-1, point)
    apart = np.lib.stride_tricks.as_strided(data, (height, point * width), (row, 1))
    return np.ascontiguousarray(apart).reshape(-1, point)


def _column(
    rows: NDArray[Any], names: Sequence[str], is_there: NDArray[np.int64], dtype: type
) -> Any:
    """(n,) of the first of these fields that there is; None without any."""
    found = next((name for name in names if name in (rows.dtype.names or ())), None)
    return None if found is None else rows[found][is_there].astype(dtype)
