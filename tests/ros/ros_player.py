"""A robot in the process of the node: it plays ``scan_recording.healthy`` by the clock of a
simulator, some times faster than real, once the node listens, and notes what the node publishes.

Started by the stub where ``SLAMSIM_TEST_ROBOT`` is ``ros_player``. ``SLAMSIM_TEST_HEARD``: a file
for what was heard. ``SLAMSIM_TEST_TF``: publish the odometry on /tf, too.
"""

from __future__ import annotations

import json
import os
import struct
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import rclpy
from rclpy import graph
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from ros_stub import message_type, publisher, quality
from scan_recording import healthy

from slamsim.io.ros.values import cdr_of, plain_values
from slamsim.recording import RawImu, RawOdometry, RawScans

SPEED = 4.0
START_NS = 1_700_000_000_000_000_000
TRANSFORMS = "tf2_msgs/msg/TFMessage"
MOUNTED = ("laser", "imu")
SENT = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
}
if "SLAMSIM_TEST_TF" in os.environ:
    SENT["/tf"] = TRANSFORMS
HEARD = {
    "/map": ("nav_msgs/msg/OccupancyGrid", True),
    "/tf": (TRANSFORMS, False),
    "/slamsim/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", False),
}
SCAN_NS = 80_000_000
"""From the first beam of a scan to its arrival."""
Played = tuple[int, str, bytes]
"""(when it arrives in ns, topic, CDR)."""


def start() -> None:
    context = Context()
    context.init()
    Thread(target=_live, args=(context,), daemon=True).start()


def _live(context: Context) -> None:
    robot = rclpy.create_node("robot", context=context)
    static = publisher(robot, "/tf_static", TRANSFORMS, kept=True)
    mounts = [_edge(0, "base_footprint", name, [0.0] * 3, [0.0] * 3 + [1.0]) for name in MOUNTED]
    static.publish(cdr_of(TRANSFORMS, {"transforms": mounts}, 0))
    senders = {name: publisher(robot, name, kind, reliable=False) for name, kind in SENT.items()}
    clock = publisher(robot, "/clock", "rosgraph_msgs/msg/Clock")
    heard, executor = Heard(), SingleThreadedExecutor(context=context)
    executor.add_node(robot)
    for topic, (kind, kept) in HEARD.items():
        note = partial(heard.note, topic)
        robot.create_subscription(message_type(kind), topic, note, quality(True, kept), raw=True)
    played, listened = messages(), [senders["/scan"], senders["/odom"]]
    while not all(any(one in sub.matched for sub in graph.subscriptions) for one in listened):
        clock.publish(_clock(START_NS))
        executor.spin_once(timeout_sec=0.05)
    begun_s = time.monotonic()
    for arrival_ns, topic, data in played:
        while (left_s := (arrival_ns - START_NS) * 1e-9 / SPEED + begun_s - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left_s)
        clock.publish(_clock(arrival_ns))
        senders[topic].publish(data)
    while context.ok():
        executor.spin_once(timeout_sec=0.1)
        heard.write()


class Heard:
    """The last message of each topic of the node."""

    def __init__(self) -> None:
        self.last: dict[str, Any] = {}

    def note(self, topic: str, data: bytes) -> None:
        self.last[topic] = plain_values(HEARD[topic][0], data, ros1=False)

    def write(self) -> None:
        path = Path(os.environ["SLAMSIM_TEST_HEARD"])
        text = json.dumps(self.last, default=np.ndarray.tolist)
        path.with_suffix(".new").write_text(text)
        path.with_suffix(".new").replace(path)


def messages() -> list[Played]:
    """In the order of their arrival."""
    of = healthy()
    parts = (_scans(of.scans[0]), _odometry(of.odometries[0]), _imu(of.imus[0]))
    return sorted((one for part in parts for one in part), key=lambda one: one[0])


def _scans(scans: RawScans) -> Iterator[Played]:
    layout = scans.layouts[0]
    declared = {
        "angle_min": layout.angle_min_rad,
        "angle_max": layout.angle_max_rad,
        "angle_increment": layout.angle_step_rad,
        "time_increment": layout.beam_dt_s,
        "scan_time": layout.scan_time_s,
        "range_min": layout.range_min_m,
        "range_max": layout.range_max_m,
    }
    fixed = {name: float(value) for name, value in declared.items()}
    for stamp_ns, ranges in zip(scans.stamps_ns.tolist(), scans.ranges_m, strict=True):
        values = fixed | {"header": _header(stamp_ns, "laser"), "ranges": ranges.tolist()}
        yield _message("/scan", stamp_ns, values, SCAN_NS)


def _odometry(odometry: RawOdometry) -> Iterator[Played]:
    rows = (odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw)
    for stamp_ns, position, quat in zip(*(row.tolist() for row in rows), strict=True):
        pose = {
            "position": dict(zip("xyz", position, strict=True)),
            "orientation": dict(zip("xyzw", quat, strict=True)),
        }
        values = {
            "header": _header(stamp_ns, "odom"),
            "child_frame_id": "base_footprint",
            "pose": {"pose": pose},
        }
        yield _message("/odom", stamp_ns, values)
        if "/tf" in SENT:
            transform = _edge(stamp_ns, "odom", "base_footprint", position, quat)
            yield _message("/tf", stamp_ns, {"transforms": [transform]})


def _imu(imu: RawImu) -> Iterator[Played]:
    rows = (imu.stamps_ns, imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2)
    for stamp_ns, rates, accelerations in zip(*(row.tolist() for row in rows), strict=True):
        values = {
            "header": _header(stamp_ns, "imu"),
            "angular_velocity": dict(zip("xyz", rates, strict=True)),
            "linear_acceleration": dict(zip("xyz", accelerations, strict=True)),
        }
        yield _message("/imu", stamp_ns, values)


def _message(topic: str, stamp_ns: int, values: dict[str, Any], late_ns: int = 0) -> Played:
    return START_NS + stamp_ns + late_ns, topic, cdr_of(SENT[topic], values, 0)


def _clock(now_ns: int) -> bytes:
    """rosgraph_msgs/Clock."""
    return b"\0\1\0\0" + struct.pack("<iI", *divmod(now_ns, 10**9))


def _header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    sec, nanosec = divmod(START_NS + stamp_ns, 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def _edge(
    stamp_ns: int, parent: str, child: str, position: list[float], quat: list[float]
) -> dict[str, Any]:
    rotation = dict(zip("xyzw", quat, strict=True))
    transform = {"translation": dict(zip("xyz", position, strict=True)), "rotation": rotation}
    header = _header(stamp_ns, parent)
    return {"header": header, "child_frame_id": child, "transform": transform}
