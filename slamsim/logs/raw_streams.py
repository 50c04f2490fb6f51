"""Odometry, IMU, wheels, joints, clock and transforms of a recording, as they were written.

A collector takes the messages of one topic batch by batch; those that ``opened`` gives None for
are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slamsim.logs.bag_columns import Alike, Opened, alike, stamp_ns_of, stamps_of
from slamsim.logs.bag_streams import imu_row, odometry_row, ticks_row
from slamsim.logs.cdr import CdrLayout
from slamsim.logs.frames import frame_name
from slamsim.logs.messages import (
    imu_layout,
    joints_layout,
    odometry_layout,
    ticks_layout,
    transforms_layout,
)
from slamsim.recording import Origin, RawImu, RawJoints, RawOdometry, RawTicks, TransformEdge
from slamsim.types import FloatArray, IntArray


@dataclass(slots=True, eq=False)
class _Gathered:
    """Rows that come in groups, put back into the order of the file.

    orders: (k, 2) of each group, as ``Origin`` has them.
    """

    orders: list[IntArray] = field(default_factory=list)
    stamps: list[IntArray] = field(default_factory=list)
    received: list[IntArray] = field(default_factory=list)
    rows: list[FloatArray] = field(default_factory=list)

    def add(self, order: IntArray, stamps: IntArray, received: IntArray, rows: FloatArray) -> None:
        self.orders.append(order)
        self.stamps.append(stamps)
        self.received.append(received)
        self.rows.append(rows)

    def joined(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """(messages (n, 2) as in ``Origin``, stamps (n,), when received (n,), rows (n, k))."""
        numbers = np.concatenate(self.orders)
        order = np.argsort(numbers[:, 0], kind="stable")
        return (
            numbers[order],
            np.concatenate(self.stamps)[order],
            np.concatenate(self.received)[order],
            np.concatenate(self.rows)[order],
        )


class Collector:
    """What all collectors do. taken: how many messages were; without any there is no stream."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        self.topic, self._opened, self._is_cdr = topic, opened, is_cdr
        self.taken = 0
        self._frames: dict[str, None] = {}
        self._seen = 0

    def add(self, received_ns: IntArray, batch: list[bytes]) -> None:
        """The next messages, and when each was received."""
        for group in self._groups(batch):
            self.taken += group.places.size
            numbers = self._seen + group.places
            order = np.column_stack([numbers, np.zeros_like(numbers)])
            self._take(group, order, received_ns[group.places])
        self._seen += len(batch)

    def _groups(self, batch: list[bytes]) -> Iterator[Alike]:
        return alike(batch, self._opened, self._layout_of, self._is_cdr)

    def _layout_of(self, message: Any) -> CdrLayout:
        raise NotImplementedError

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        """order: (k, 2) which messages of the topic these are, and 0, as ``Origin`` has them."""
        raise NotImplementedError


class _Columns(Collector):
    """Messages of a header and so many numbers."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._gathered = _Gathered()

    @staticmethod
    def _row_of(message: Any) -> tuple[float, ...]:
        raise NotImplementedError

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        self._frames.setdefault(frame_name(group.example.header.frame_id))
        self._gathered.add(order, group.stamps_ns(), received_ns, group.numbers(self._row_of))

    def _joined(
        self,
    ) -> tuple[tuple[str, tuple[str, ...], IntArray, IntArray], FloatArray, Origin]:
        """((topic, frames, stamps, when received), rows, which messages)."""
        places, stamps_ns, received_ns, rows = self._gathered.joined()
        common = self.topic, tuple(self._frames), stamps_ns, received_ns
        return common, rows, Origin(self.topic, places)


class ImuCollector(_Columns):
    """sensor_msgs/Imu."""

    _row_of = staticmethod(imu_row)

    def _layout_of(self, message: Any) -> CdrLayout:
        return imu_layout(message.header.frame_id)

    def stream(self) -> RawImu:
        common, rows, origin = self._joined()
        # A covariance that begins with -1 says that the message has no orientation.
        oriented = bool((rows[:, 4] != -1.0).any())
        read = rows[:, 13:16], rows[:, 16:19], rows[:, :4] if oriented else None
        return RawImu(*common, *read, origin=origin)


class OdometryCollector(_Columns):
    """nav_msgs/Odometry."""

    _row_of = staticmethod(odometry_row)

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._children: dict[str, None] = {}

    def _layout_of(self, message: Any) -> CdrLayout:
        return odometry_layout((message.header.frame_id, message.child_frame_id))

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        super()._take(group, order, received_ns)
        self._children.setdefault(frame_name(group.example.child_frame_id))

    def stream(self) -> RawOdometry:
        common, rows, origin = self._joined()
        parts = rows[:, :3], rows[:, 3:7], rows[:, 7:10], rows[:, 10:13]
        return RawOdometry(*common, tuple(self._children), *parts, origin=origin)


class TicksCollector(_Columns):
    """slamsim_msgs/EncoderTicks; the driver's numbers are those of the first message."""

    _row_of = staticmethod(ticks_row)

    def _layout_of(self, message: Any) -> CdrLayout:
        return ticks_layout(message.header.frame_id)

    def stream(self) -> RawTicks:
        common, rows, origin = self._joined()
        per_revolution, radius_m, track_m = rows[0, 2:].tolist()
        ticks = rows[:, :2].astype(np.int64)
        driver = int(per_revolution), radius_m, track_m
        return RawTicks(*common, ticks, *driver, origin=origin)


class JointCollector(Collector):
    """sensor_msgs/JointState, whose messages may each name other joints."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._by_names: dict[tuple[str, ...], _Gathered] = {}

    def _layout_of(self, message: Any) -> CdrLayout:
        counts = len(message.position), len(message.velocity), len(message.effort)
        return joints_layout(message.header.frame_id, message.name, *counts)

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        message = group.example
        self._frames.setdefault(frame_name(message.header.frame_id))
        numbers = np.full((group.places.size, 2, len(message.name)), np.nan)
        for i, name in enumerate(("position", "velocity")):
            if len(getattr(message, name)) == len(message.name) > 0:
                numbers[:, i] = getattr(message, name) if group.rows is None else group.rows[name]
        gathered = self._by_names.setdefault(tuple(message.name), _Gathered())
        gathered.add(order, group.stamps_ns(), received_ns, numbers.reshape(len(order), -1))

    def stream(self) -> RawJoints:
        names = list(dict.fromkeys(name for names in self._by_names for name in names))
        whole = _Gathered()
        for mine, gathered in self._by_names.items():
            order, stamps_ns, received_ns, rows = gathered.joined()
            numbers = np.full((stamps_ns.size, 2, len(names)), np.nan)
            columns = [names.index(name) for name in mine]
            numbers[:, :, columns] = rows.reshape(stamps_ns.size, 2, len(mine))
            whole.add(order, stamps_ns, received_ns, numbers.reshape(stamps_ns.size, -1))
        order, stamps_ns, received_ns, rows = whole.joined()
        common = self.topic, tuple(self._frames), stamps_ns, received_ns
        read = rows[:, : len(names)], rows[:, len(names) :]
        return RawJoints(*common, tuple(names), *read, origin=Origin(self.topic, order))


class TransformCollector(Collector):
    """tf2_msgs/TFMessage, taken apart into edges."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._edges: dict[tuple[str, str], _Gathered] = {}

    def _layout_of(self, message: Any) -> CdrLayout:
        edges = [(edge.header.frame_id, edge.child_frame_id) for edge in message.transforms]
        return transforms_layout(edges)

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        for i, edge in enumerate(group.example.transforms):
            name = frame_name(edge.header.frame_id), frame_name(edge.child_frame_id)
            if group.rows is None:
                t, q = edge.transform.translation, edge.transform.rotation
                stamps_ns = np.array([stamp_ns_of(edge.header)], dtype=np.int64)
                rows = np.array([[t.x, t.y, t.z, q.x, q.y, q.z, q.w]])
            else:
                stamps_ns = stamps_of(group.rows, f"stamp{i}")
                rows = np.column_stack([group.rows[f"translation{i}"], group.rows[f"rotation{i}"]])
            places = order + np.array([0, i])
            self._edges.setdefault(name, _Gathered()).add(places, stamps_ns, received_ns, rows)

    def edges(self) -> list[TransformEdge]:
        """In the order of their first appearance in a batch."""
        is_static = self.topic.endswith("tf_static")
        found = []
        for (parent, child), gathered in self._edges.items():
            places, stamps_ns, received_ns, rows = gathered.joined()
            which = self.topic, parent, child, is_static, stamps_ns, received_ns
            edge = TransformEdge(*which, rows[:, :3], rows[:, 3:], Origin(self.topic, places))
            found.append(edge)
        return found


class ClockCollector(Collector):
    """rosgraph_msgs/Clock."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr)
        self._gathered = _Gathered()

    def _layout_of(self, message: Any) -> CdrLayout:
        return CdrLayout().stamp()

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        shown = group.example.clock
        stamps_ns = np.array([int(shown.sec) * 1_000_000_000 + int(shown.nanosec)], dtype=np.int64)
        if group.rows is not None:
            stamps_ns = stamps_of(group.rows)
        self._gathered.add(order, stamps_ns, received_ns, np.zeros((len(order), 0)))

    def instants_ns(self) -> IntArray:
        """(n, 2) simulated time and when it was received."""
        return np.column_stack(self._gathered.joined()[1:3])


class TextCollector(Collector):
    """std_msgs/String."""

    def __init__(self, topic: str, opened: Opened, is_cdr: bool) -> None:
        super().__init__(topic, opened, is_cdr=False)
        self.text = ""

    def _take(self, group: Alike, order: IntArray, received_ns: IntArray) -> None:
        self.text = str(group.example.data)
