"""A live robot in the Rerun viewer, which is a process of its own.

A thread of its own sends what is newest: what is not sent in time is not sent at all, so that
neither viewer nor network ever delays the robot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from threading import Event, Lock, Thread
from typing import Any, Self

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.types import FloatArray, Grid, Scan, ScanGeometry
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.message_types import ros2_types
from slamsim.live.hub import Hub, Message, Undrawn
from slamsim.recording.schemas import TRANSFORMS
from slamsim.report.viewer.live import LiveScene
from slamsim.report.viewer.process import live_viewer
from slamsim.report.viewer.stage import BASE

SHOWN = {
    "sensor_msgs/msg/LaserScan": ("/scan", "scan"),
    "nav_msgs/msg/Odometry": ("/odom", "odometry"),
    "nav_msgs/msg/OccupancyGrid": ("/map", "map"),
    "nav_msgs/msg/Path": ("/path", "path"),
}
"""By type: the topic that is shown of several, and how it is drawn; else the first one is."""
PERIOD_S = 0.05
"""No eye sees more than 20 pictures a second of a map."""
BACK_NS = 1_000_000_000
"""A message that is so much earlier than the one before it belongs to another drive."""
_TRANSFORMS = 256
"""Messages of /tf that are looked through for the newest of each frame."""


def start_rerun(hub: Hub) -> RerunServer:
    """Show from now until the block of what this returns ends; in a window where there is a
    screen, else on a page of this machine. Raises SlamsimError where no viewer starts."""
    with ExitStack() as opened:
        url, shown = opened.enter_context(live_viewer())
        showing = opened.enter_context(Showing(hub, url))
        return RerunServer(shown, showing, opened.pop_all())


class RerunServer:
    """See ``start_rerun``."""

    def __init__(self, address: str, showing: Showing, opened: ExitStack) -> None:
        self.address, self.showing, self._opened = address, showing, opened

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._opened.close()


class Showing:
    """Sends what is newest to a viewer, from its block's beginning to its end."""

    def __init__(self, hub: Hub, url: str) -> None:
        self._hub, self._url = hub, url
        self._shown = shown_topics(hub.topics.values())
        self._lock, self._arrived, self._over = Lock(), Event(), Event()
        self._newest: dict[str, Message] = {}
        self._moved: deque[Message] = deque(maxlen=_TRANSFORMS)
        self._last_ns, self._anew = 0, False
        self._thread = Thread(target=self._show, daemon=True, name="rerun")

    def __enter__(self) -> Self:
        self._thread.start()
        self._leave = self._hub.listen(self._keep)
        return self

    def __exit__(self, *error: object) -> None:
        self._leave()
        self._over.set()
        self._arrived.set()
        self._thread.join()

    def _keep(self, message: Message) -> None:
        name = message.topic.name
        with self._lock:
            if message.log_ns < self._last_ns - BACK_NS:
                self._anew = True
                self._newest.clear()
                self._moved.clear()
            self._last_ns = message.log_ns
            if message.topic.type_name == TRANSFORMS and not message.topic.latched:
                self._moved.append(message)
            elif name in self._shown:
                self._newest[name] = message
            else:
                return
        self._arrived.set()

    def _show(self) -> None:
        drawn = _Drawn(LiveScene(self._url), self._shown)
        over = False
        while not over:
            self._arrived.wait()
            self._arrived.clear()
            over = self._over.is_set()
            with self._lock:
                moved, newest, anew = list(self._moved), self._newest, self._anew
                self._moved.clear()
                self._newest, self._anew = {}, False
            if anew:  # the drive was reset: its times are those of the last one again
                drawn.scene.close()
                drawn = _Drawn(LiveScene(self._url), self._shown)
            drawn.draw(moved, newest)
            self._over.wait(PERIOD_S)
        drawn.scene.close()


def shown_topics(topics: Iterable[TopicKind]) -> dict[str, str]:
    """How each topic that is shown is drawn: what is mounted before what is seen from there."""
    known = list(topics)
    found = {t.name: "mounts" for t in known if t.type_name == TRANSFORMS and t.latched}
    for kind, (usual, drawn) in SHOWN.items():
        names = [topic.name for topic in known if topic.type_name == kind]
        found |= dict.fromkeys([usual] if usual in names else names[:1], drawn)
    return found


class _Drawn:
    """Draws messages into a scene. shown: as ``shown_topics``."""

    def __init__(self, scene: LiveScene, shown: Mapping[str, str]) -> None:
        self.scene, self._shown, self._types = scene, shown, ros2_types()
        self._base, self._undrawn = BASE, Undrawn()
        self._fixed: dict[str, tuple[str, FloatArray]] = {}
        """Parent and (7,) T_parent_child of what is mounted, by child."""

    def draw(self, moved: list[Message], newest: dict[str, Message]) -> None:
        """moved: of /tf, in their order. newest: of the other topics."""
        frames = {}
        for message in moved:
            with self._undrawn.told(message):
                for transform in self._read(message).transforms:
                    frames[transform.child_frame_id] = message.log_ns, transform
        for log_ns, transform in sorted(frames.values(), key=lambda one: one[0]):
            self.scene.at(log_ns)
            self._transform(transform, False)
        for name, drawn in self._shown.items():
            if name in newest:
                self.scene.at(newest[name].log_ns)
                with self._undrawn.told(newest[name]):
                    getattr(self, f"_draw_{drawn}")(self._read(newest[name]))

    def _read(self, message: Message) -> Any:
        return self._types.deserialize_cdr(message.data, message.topic.type_name)

    def _draw_mounts(self, message: Any) -> None:
        for transform in message.transforms:
            parent, child, pose = self._transform(transform, True)
            self._fixed[child] = parent, pose

    def _transform(self, transform: Any, fixed: bool) -> tuple[str, str, FloatArray]:
        parent, child = transform.header.frame_id, transform.child_frame_id
        moved, turned = transform.transform.translation, transform.transform.rotation
        pose = np.array([moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w])
        self.scene.transform(parent, child, pose, fixed)
        return parent, child, pose

    def _draw_scan(self, message: Any) -> None:
        geometry = ScanGeometry(
            angle_min_rad=float(message.angle_min),
            angle_step_rad=float(message.angle_increment),
            beam_count=message.ranges.size,
            beam_dt_ns=round(message.time_increment * 1e9),
            range_min_m=float(message.range_min),
            range_max_m=float(message.range_max),
            frame_id=message.header.frame_id,
        )
        stamp = message.header.stamp
        scan = Scan(stamp.sec * 10**9 + stamp.nanosec, message.ranges, geometry)
        self.scene.scan(scan, self._mounted(geometry.frame_id))

    def _draw_odometry(self, message: Any) -> None:
        base = message.child_frame_id
        if base and base != self._base:  # the robot is drawn where the odometry says that it is
            self._base = base
            if BASE not in self._fixed:
                same = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
                self.scene.transform(base, BASE, same, True)
        self.scene.curve("speed", message.twist.twist.linear.x)
        self.scene.curve("turn", message.twist.twist.angular.z)

    def _draw_map(self, message: Any) -> None:
        info = message.info
        per_cent = message.data.reshape(info.height, info.width).astype(np.float32)
        occupancy = np.where(per_cent < 0.0, np.float32(np.nan), per_cent / np.float32(100.0))
        origin = info.origin.position
        self.scene.map(Grid(occupancy, float(info.resolution), (origin.x, origin.y)))

    def _draw_path(self, message: Any) -> None:
        places = [(one.pose.position.x, one.pose.position.y) for one in message.poses]
        self.scene.path(np.array(places, dtype=np.float64).reshape(-1, 2))

    def _mounted(self, frame: str) -> FloatArray:
        """4 x 4 T_base_frame."""
        T_base_frame = np.eye(4)
        while frame != self._base and frame in self._fixed:
            frame, pose = self._fixed[frame]
            T_base_frame = se3_from_parts(matrix_from_xyzw(pose[3:]), pose[:3]) @ T_base_frame
        return T_base_frame
