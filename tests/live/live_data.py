"""A hub with a few topics, and messages of them."""

from __future__ import annotations

import math

import numpy as np

from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.values import cdr_of
from slamsim.live.hub import Hub

SCAN = TopicKind("/scan", "sensor_msgs/msg/LaserScan")
ODOM = TopicKind("/odom", "nav_msgs/msg/Odometry")
MAP = TopicKind("/map", "nav_msgs/msg/OccupancyGrid", latched=True)
CLOUD = TopicKind("/points", "sensor_msgs/msg/PointCloud2")


def hub() -> Hub:
    return Hub([SCAN, ODOM, MAP, CLOUD])


def scan(number: int, beams: int = 9) -> bytes:
    """Its stamp is as many milliseconds; it has a beam without return, and one that is invalid."""
    ranges: list[float | None] = [number * 1e-3] * beams
    ranges[0], ranges[-1] = math.inf, None
    header = {"stamp": {"sec": 0, "nanosec": number * 1_000_000}, "frame_id": "laser"}
    return cdr_of(SCAN.type_name, {"header": header, "ranges": ranges}, 0)


def grid(cells: int, seed: int = 0) -> bytes:
    """cells: of each side."""
    values = np.random.default_rng(seed).choice(np.array([-1, 0, 100], np.int8), cells * cells)
    info = {"width": cells, "height": cells, "resolution": 0.05}
    return cdr_of(MAP.type_name, {"info": info, "data": values}, 0)
