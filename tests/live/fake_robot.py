"""A small robot in a small house that can be driven, for the tests of servers: it publishes as the
live drive does, and notes what it was asked."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.core.geometry import compose, xyzw_from_yaw
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import BadNumbers
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.message_types import ros2_types
from slamsim.live.controls import HOLD_S, Mode, Status
from slamsim.live.hub import Hub

TOPICS = (
    TopicKind("/scan", "sensor_msgs/msg/LaserScan"),
    TopicKind("/tf", "tf2_msgs/msg/TFMessage"),
    TopicKind("/tf_static", "tf2_msgs/msg/TFMessage", latched=True),
    TopicKind("/map", "nav_msgs/msg/OccupancyGrid", latched=True),
    TopicKind("/path", "nav_msgs/msg/Path", latched=True),
)
CELL_M = 0.05
BEAMS, RANGE_M = 720, 8.0
LASER_X_M = 0.1
STORE = ros2_types()


def house() -> FloatArray:
    """(rows, columns) of cells, 1 where a wall is: rooms with doors."""
    walls = np.zeros((180, 260))
    walls[[0, -1], :] = walls[:, [0, -1]] = 1
    walls[:, [1, -2]] = walls[[1, -2], :] = 1
    walls[60:62, :] = walls[120:122, :] = 1
    walls[:, 86:88] = walls[:, 172:174] = 1
    for row, column in ((30, 87), (90, 87), (150, 173), (90, 173), (30, 173)):
        walls[row - 12 : row + 12, column - 2 : column + 2] = 0
    for row, column in ((60, 40), (120, 40), (60, 130), (120, 130), (60, 215), (120, 215)):
        walls[row - 2 : row + 3, column - 12 : column + 12] = 0
    walls[20:30, 20:40] = walls[80:86, 120:140] = walls[140:160, 200:210] = 1
    return walls


def made(type_name: str, **fields: Any) -> Any:
    return STORE.types[type_name](**fields)


def header(stamp_ns: int, frame: str) -> Any:
    stamp = made("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(x_m: float, y_m: float, yaw_rad: float) -> Any:
    x, y, z, w = xyzw_from_yaw(np.array(yaw_rad)).tolist()
    return made(
        "geometry_msgs/msg/Pose",
        position=made("geometry_msgs/msg/Point", x=x_m, y=y_m, z=0.0),
        orientation=made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )


def transform(stamp_ns: int, parent: str, child: str, x_m: float, y_m: float, yaw: float) -> Any:
    x, y, z, w = xyzw_from_yaw(np.array(yaw)).tolist()
    return made(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=made(
            "geometry_msgs/msg/Transform",
            translation=made("geometry_msgs/msg/Vector3", x=x_m, y=y_m, z=0.0),
            rotation=made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
    )


def cdr(message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def grid_message(stamp_ns: int, cells: np.ndarray[Any, Any], x_m: float, y_m: float) -> Any:
    info = made(
        "nav_msgs/msg/MapMetaData",
        map_load_time=header(stamp_ns, "").stamp,
        resolution=CELL_M,
        width=cells.shape[1],
        height=cells.shape[0],
        origin=pose(x_m, y_m, 0.0),
    )
    return made(
        "nav_msgs/msg/OccupancyGrid",
        header=header(stamp_ns, "map"),
        info=info,
        data=cells.astype(np.int8).ravel(),
    )


def scan_message(stamp_ns: int, ranges_m: FloatArray, beam_dt_s: float = 0.0) -> Any:
    return made(
        "sensor_msgs/msg/LaserScan",
        header=header(stamp_ns, "laser_link"),
        angle_min=-np.pi,
        angle_max=np.pi,
        angle_increment=2.0 * np.pi / len(ranges_m),
        time_increment=beam_dt_s,
        scan_time=0.0,
        range_min=0.05,
        range_max=RANGE_M,
        ranges=ranges_m.astype(np.float32),
        intensities=np.zeros(0, np.float32),
    )


class FakeRobot:
    """Implements ``Controls``. ``advance`` lets time pass; ``run`` does so in real time."""

    def __init__(self, folder: Path) -> None:
        self.hub = Hub(TOPICS)
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self._folder, self._lock = folder, threading.Lock()
        self._walls = house()
        self._count = 0
        self._recording: Path | None = None
        self._rate: float | None = 1.0
        self._paused = False
        self._mode: Mode = "manual"
        self.reset()
        self.calls.clear()
        static = transform(0, "base_footprint", "laser_link", LASER_X_M, 0.0, 0.0)
        self._publish("/tf_static", made("tf2_msgs/msg/TFMessage", transforms=[static]))

    def _publish(self, topic: str, message: Any) -> None:
        self.hub.publish(topic, self.stamp_ns, cdr(message))

    def _note(self, name: str, *given: Any) -> None:
        self.calls.append((name, given))

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        if not np.isfinite([speed_m_s, yaw_rate_rad_s]).all():
            raise BadNumbers(f"a twist of {speed_m_s} m/s, {yaw_rate_rad_s} rad/s is not finite")
        self._note("drive", speed_m_s, yaw_rate_rad_s, hold_s)
        limited = np.clip([speed_m_s, yaw_rate_rad_s], [-0.7, -2.0], [0.7, 2.0])
        self._twist, self._until = limited, time.monotonic() + hold_s
        self._mode = "manual"

    def go_to(self, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        self._note("go_to", x_m, y_m, yaw_rad)
        row, column = int(y_m / CELL_M), int(x_m / CELL_M)
        if not (0 <= row < 180 and 0 <= column < 260) or self._walls[row, column]:
            raise SlamsimError(f"no known free path leads to x {x_m:.2f} m, y {y_m:.2f} m")

    def set_mode(self, mode: Mode) -> None:
        self._note("set_mode", mode)
        self._mode = mode

    def pause(self, paused: bool) -> None:
        self._note("pause", paused)
        self._paused = paused

    def step(self, seconds: float) -> None:
        self._note("step", seconds)
        if not 0.0 < seconds <= 60.0:
            raise BadNumbers(f"a step of {seconds} s is not within (0, 60]")

    def set_rate(self, rate: float | None) -> None:
        self._note("set_rate", rate)
        if rate is not None and not 0.01 <= rate <= 100.0:
            raise BadNumbers(f"a rate of {rate} is not within [0.01, 100]")
        self._rate = rate

    def reset(self) -> None:
        self._note("reset")
        with self._lock:
            self.stamp_ns, self.pose = 10**12, np.array([1.8, 4.5, 0.0])
            self.known = np.full(self._walls.shape, -1, np.int8)
            self.path: list[FloatArray] = []
            self._twist, self._until = np.zeros(2), 0.0

    def record(self, on: bool) -> Path | None:
        self._note("record", on)
        if on:
            self._count += 1
            self._recording = self._folder / f"recording_{self._count}"
            return self._recording
        ended, self._recording = self._recording, None
        if ended is not None:
            (ended / "log").mkdir(parents=True)
            (ended / "log" / "log_0.mcap").write_bytes(bytes(range(256)) * 4000)
            (ended / "drive.yaml").write_text("first_tick: 0\n")
        return ended

    def save_map(self) -> Path:
        self._note("save_map")
        return self._folder / "maps" / "map_1"

    def status(self) -> Status:
        windows = self.stamp_ns // 25_000_000
        return Status(
            self.stamp_ns, self._rate, 0.998, self._paused, self._mode, windows, windows // 400,
            float(self._twist[0]), float(self._twist[1]), self._recording, "tracking",
            len(self.path), len(self.path) // 20, "",
        )  # fmt: skip

    def advance(self, dt_s: float) -> None:
        """One scan, and the transforms around it. The map is drawn anew each second."""
        with self._lock:
            if time.monotonic() > self._until:
                self._twist = np.zeros(2)
            speed, yaw_rate = self._twist.tolist()
            step = np.array([speed * dt_s, 0.0, yaw_rate * dt_s])
            moved = compose(self.pose, step)
            row, column = int(moved[1] / CELL_M), int(moved[0] / CELL_M)
            if not self._walls[row - 4 : row + 5, column - 4 : column + 5].any():
                self.pose = moved
            self.stamp_ns += round(dt_s * 1e9)
            if not self.path or np.hypot(*(self.pose - self.path[-1])[:2]) > 0.1:
                self.path.append(self.pose)
            self._tell()

    def run(self, dt_s: float, goes_on: Callable[[], bool]) -> None:
        """In real time."""
        while goes_on():
            if not self._paused:
                self.advance(dt_s)
            time.sleep(dt_s)

    def _tell(self) -> None:
        x, y, yaw = self.pose.tolist()
        stamp_ns = self.stamp_ns
        edges = [
            transform(stamp_ns, "odom", "base_footprint", x, y, yaw),
            transform(stamp_ns, "map", "odom", 0.0, 0.0, 0.0),
        ]
        self._publish("/tf", made("tf2_msgs/msg/TFMessage", transforms=edges))
        self._publish("/scan", scan_message(stamp_ns, self._ranges()))
        if stamp_ns % 10**9 < 50_000_000:
            self.draw()

    def draw(self) -> None:
        """Publish the map and the path."""
        rows, columns = np.nonzero(self.known >= 0)
        top, left = (rows.min(), columns.min()) if len(rows) else (0, 0)
        bottom, right = (rows.max() + 1, columns.max() + 1) if len(rows) else (1, 1)
        cells = self.known[top:bottom, left:right]
        grid = grid_message(self.stamp_ns, cells, left * CELL_M, top * CELL_M)
        self._publish("/map", grid)
        stamped = [
            made("geometry_msgs/msg/PoseStamped", header=header(0, "map"), pose=pose(*p.tolist()))
            for p in self.path
        ]
        self._publish("/path", made("nav_msgs/msg/Path", header=header(0, "map"), poses=stamped))

    def _ranges(self) -> FloatArray:
        """(beams,) metres to the first wall, inf without one; what they pass becomes known."""
        laser = compose(self.pose, np.array([LASER_X_M, 0.0, 0.0]))
        angles_rad = laser[2] - np.pi + 2.0 * np.pi / BEAMS * np.arange(BEAMS)
        along_m = np.arange(0.0, RANGE_M, CELL_M / 2.0)
        rows = ((laser[1] + np.outer(np.sin(angles_rad), along_m)) / CELL_M).astype(int)
        columns = ((laser[0] + np.outer(np.cos(angles_rad), along_m)) / CELL_M).astype(int)
        rows, columns = rows.clip(0, 179), columns.clip(0, 259)
        hit = self._walls[rows, columns] > 0
        first = np.where(hit.any(axis=1), hit.argmax(axis=1), len(along_m))
        passed = np.arange(len(along_m))[None, :] < first[:, None]
        self.known[rows[passed], columns[passed]] = 0
        beams = np.nonzero(first < len(along_m))[0]
        self.known[rows[beams, first[beams]], columns[beams, first[beams]]] = 100
        return np.where(first < len(along_m), first * CELL_M / 2.0, np.inf)
