"""What a page shows of a live robot: the newest state, scan, path and map, ready to be sent, with
scans drawn where they were measured.

A frame for the page is text (JSON) or binary: the length of its head in 4 bytes, little-endian,
the head as JSON, padded so that what follows is aligned to 4 bytes, and numbers.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slamsim.core.geometry import (
    compose,
    matrix_from_xyzw,
    se2_from_se3,
    se3_from_parts,
    transform_points,
    yaw_from_xyzw,
)
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import require_angle, require_finite, require_number
from slamsim.io.ros.message_types import ros2_types
from slamsim.live.hub import Hub, Message, Undrawn
from slamsim.recording.schemas import TRANSFORMS

SCAN_STEP_M = 0.005
"""Points of a scan are sent in steps of this size from its centre, in 16 bits: up to 163 m."""

MOST_CELLS = 4096
"""Cells along a side of a map that is sent: what a canvas of a phone holds (iOS: 2^24 pixels)."""

MOST_POINTS = 4000
"""Points of a path that is sent: more than a screen has pixels along it."""

LONGEST_S = 60.0
"""No beam comes so long after the one before it."""

_MOST_TRANSFORMS = 4096
"""Messages that wait: what comes within seconds."""

_SCAN, _MAP, _PATH = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Path"


def binary_frame(head: Mapping[str, Any], body: bytes) -> bytes:
    """As the module describes it."""
    text = json.dumps(head, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + body


class View:
    """Listens to a hub and turns what is newest into frames.

    on_news: called, on the thread that publishes, when there is something to show. All else is for
    one thread at a time; ``maps`` may run beside ``fast_frames``.
    """

    def __init__(self, hub: Hub, on_news: Callable[[], None]) -> None:
        self._kinds = {name: topic.type_name for name, topic in hub.topics.items()}
        self._on_news = on_news
        self._newest: dict[str, Message] = {}
        self._waiting: deque[Message] = deque(maxlen=_MOST_TRANSFORMS)
        self._shown: dict[str, Message] = {}
        self._transforms = LiveTransforms()
        self._base: str | None = None
        self._undrawn = Undrawn()
        self._types = ros2_types()
        self.leave = hub.listen(self._hear)

    def _hear(self, message: Message) -> None:
        kind = self._kinds[message.topic.name]
        if kind == TRANSFORMS:
            self._waiting.append(message)
        elif kind in (_SCAN, _MAP, _PATH):
            self._newest[message.topic.name] = message
            if kind == _SCAN:
                self._on_news()

    def follow(self) -> None:
        """Take the transforms that have come since; to be called every second or so at least."""
        while self._waiting:
            message = self._waiting.popleft()
            with self._undrawn.told(message):
                moving = message.topic.name != "/tf_static"
                self._transforms.add(self._decoded(message), moving=moving)

    def scans(self) -> Iterator[tuple[str, bytes]]:
        """(kind, frame) of each new scan."""
        return self._new(_SCAN, self._scan_frame)

    def maps(self) -> Iterator[tuple[str, bytes]]:
        """(kind, frame) of path and map, if they are new."""
        yield from self._new(_PATH, _path_frame)
        yield from self._new(_MAP, _map_frame)

    def pose(self) -> tuple[str, list[float]] | None:
        """(frame, [x_m, y_m, yaw_rad]) of the robot; None until a scan told which frame it is."""
        if self._base is None:
            return None
        root, pose = self._transforms.newest_pose(self._base)
        return (root, pose.round(4).tolist()) if np.isfinite(pose).all() else None

    def _new(self, kind: str, made: Callable[[Any], bytes]) -> Iterator[tuple[str, bytes]]:
        for topic, message in tuple(self._newest.items()):
            if self._kinds[topic] == kind and self._shown.get(topic) is not message:
                self._shown[topic] = message
                with self._undrawn.told(message):
                    yield topic, made(self._decoded(message))

    def _decoded(self, message: Message) -> Any:
        return self._types.deserialize_cdr(message.data, message.topic.type_name)

    def _scan_frame(self, scan: Any) -> bytes:
        self._base = self._transforms.base_above(scan.header.frame_id)
        require_angle("the first angle", scan.angle_min)
        require_angle("the angle between beams", scan.angle_increment)
        require_number("the time between beams", scan.time_increment, -LONGEST_S, LONGEST_S)
        ranges_m = np.asarray(scan.ranges, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            (beams,) = np.nonzero((ranges_m >= scan.range_min) & (ranges_m <= scan.range_max))
        angles_rad = scan.angle_min + beams * scan.angle_increment
        points_m = np.zeros((len(beams), 3))
        points_m[:, 0] = ranges_m[beams] * np.cos(angles_rad)
        points_m[:, 1] = ranges_m[beams] * np.sin(angles_rad)
        stamp = scan.header.stamp
        stamps_ns = (beams * (scan.time_increment * 1e9)).astype(np.int64)
        stamps_ns += stamp.sec * 1_000_000_000 + stamp.nanosec
        placed_m = self._transforms.to_root(scan.header.frame_id, points_m, stamps_ns)
        center_m = placed_m.mean(axis=0) if len(beams) else np.zeros(2)
        steps = np.rint((placed_m - center_m) / SCAN_STEP_M)
        steps = steps[np.abs(steps).max(axis=1, initial=0.0) < 2**15].astype("<i2")
        x_m, y_m = center_m.tolist()
        head = {"type": "scan", "frame": scan.header.frame_id, "step_m": SCAN_STEP_M}
        return binary_frame({**head, "x_m": x_m, "y_m": y_m}, steps.tobytes())


def _path_frame(path: Any) -> bytes:
    places = [pose.pose.position for pose in path.poses]
    points_m: FloatArray = np.array([(place.x, place.y) for place in places]).reshape(-1, 2)
    if len(points_m) > MOST_POINTS:
        points_m = points_m[np.linspace(0, len(points_m) - 1, MOST_POINTS).astype(np.int64)]
    return binary_frame({"type": "path"}, points_m.astype("<f4").tobytes())


def _map_frame(grid: Any) -> bytes:
    """Cells row by row from the map's origin: 0 to 100, or 255 for unknown; compressed by zlib."""
    info = grid.info
    cells = np.asarray(grid.data, dtype=np.int8)[: info.width * info.height]
    cells = cells.reshape(info.height, info.width)
    coarser = math.ceil(max(*cells.shape, 1) / MOST_CELLS)
    if coarser > 1:  # a wall of one cell stays a wall
        padding = [(0, -side % coarser) for side in cells.shape]
        rows, columns = (-(-side // coarser) for side in cells.shape)
        padded = np.pad(cells, padding, constant_values=-1)
        cells = padded.reshape(rows, coarser, columns, coarser).max(axis=(1, 3))
    origin = info.origin
    yaw_rad = 2.0 * math.atan2(origin.orientation.z, origin.orientation.w)
    head = {
        "type": "map",
        "height": cells.shape[0],
        "width": cells.shape[1],
        "resolution_m": info.resolution * coarser,
        "x_m": origin.position.x,
        "y_m": origin.position.y,
        "yaw_rad": yaw_rad,
    }
    return binary_frame(head, zlib.compress(cells.view(np.uint8).tobytes(), 1))


_KEPT = 256
"""Poses of each moving frame: more than a second at 200 Hz, longer than any scan takes."""


@dataclass(slots=True)
class _Edge:
    """A frame below its parent; a moving one has (stamp_ns, x, y, yaw) of its last poses."""

    parent: str
    T_parent_child: FloatArray
    poses: deque[tuple[int, float, float, float]] = field(
        default_factory=lambda: deque(maxlen=_KEPT)
    )

    def pose_at(self, stamps_ns: IntArray) -> FloatArray:
        """(n, 3) in the plane, interpolated; the first and the last pose hold beyond them."""
        times_ns, x, y, yaw = map(np.array, zip(*self.poses, strict=True))
        since_ns, wanted_ns = times_ns - times_ns[0], stamps_ns - times_ns[0]
        columns = (np.interp(wanted_ns, since_ns, each) for each in (x, y, np.unwrap(yaw)))
        return np.stack(list(columns), axis=-1)

    def newest_pose(self) -> FloatArray:
        if not self.poses:
            return se2_from_se3(self.T_parent_child)
        return np.array(self.poses[-1][1:])


class LiveTransforms:
    """Of a tree of frames, all that is needed to place its scans and its base in its root."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Any, *, moving: bool) -> None:
        """The transforms of a tf2_msgs/msg/TFMessage. A moving frame is taken as planar. Time that
        runs back is a new drive: the poses before it are forgotten. Raises BadNumbers."""
        for each in message.transforms:
            stamp = each.header.stamp
            p, q = each.transform.translation, each.transform.rotation
            quat_xyzw = np.array([q.x, q.y, q.z, q.w])
            require_finite("a transform", np.array([p.x, p.y, p.z, *quat_xyzw]), (7,))
            child, parent = each.child_frame_id, each.header.frame_id
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent or not moving:
                translation_m = np.array([p.x, p.y, p.z])
                T = se3_from_parts(matrix_from_xyzw(quat_xyzw), translation_m)
                edge = self._edges[child] = _Edge(parent, T)
            if moving:
                stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
                if edge.poses and stamp_ns < edge.poses[-1][0]:
                    edge.poses.clear()
                edge.poses.append((stamp_ns, p.x, p.y, float(yaw_from_xyzw(quat_xyzw))))

    def base_above(self, frame: str) -> str:
        """The first frame at or above a frame that moves: the robot's base; the frame itself where
        nothing moves."""
        return next((name for name, edge in self._above(frame) if edge.poses), frame)

    def newest_pose(self, frame: str) -> tuple[str, FloatArray]:
        """(root, T_root_frame in the plane)."""
        root, pose = frame, np.zeros(3)
        for _, edge in self._above(frame):
            root, pose = edge.parent, compose(edge.newest_pose(), pose)
        return root, pose

    def to_root(self, frame: str, points_m: FloatArray, stamps_ns: IntArray) -> FloatArray:
        """(n, 2) points in the root of the tree, from (n, 3) in a frame, each at its own time."""
        for _, edge in self._above(frame):
            if edge.poses:
                planar_m = transform_points(edge.pose_at(stamps_ns), points_m[:, :2])
                points_m = np.column_stack([planar_m, points_m[:, 2]])
            else:
                T = edge.T_parent_child
                points_m = points_m @ T[:3, :3].T + T[:3, 3]
        return points_m[:, :2]

    def _above(self, frame: str) -> list[tuple[str, _Edge]]:
        """From a frame up to its root; a loop, which no tree has, ends after one round."""
        found: dict[str, _Edge] = {}
        while frame in self._edges and frame not in found:
            found[frame] = self._edges[frame]
            frame = found[frame].parent
        return list(found.items())
