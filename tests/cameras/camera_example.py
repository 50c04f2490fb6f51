"""Cameras in the room of the sensors' tests, and their messages by topic."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensing_example import Robot, room, windows

from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import Drive, FloatArray
from slamsim.io.ros.encoding import stream_messages
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sensors.rig import SensorRig

FRAME_TRUTH = """
std_msgs/Header header
int64 instant_ns
float64 exposure_s
float64 gain
int64[] row_instants_ns
float64[] positions_m
float64[] quats_xyzw
"""
"""As the recording defines it, written once more: what others have to read."""


def small(**settings: Any) -> dict[str, Any]:
    """An imager of a few pixels."""
    lens = {"width": 32, "height": 24, "horizontal_fov_deg": 70.0}
    return {"lens": {**lens, **settings.pop("lens", {})}, "encoding": "raw", **settings}


def sensors(**settings: Any) -> SensorsConfig:
    """A camera on the robot; the other sensors are switched off."""
    mount = {"x_m": 0.1, "y_m": 0.05, "z_m": 0.4, "yaw_deg": 20.0}
    entry = {"type": "camera", "name": "cam", "rate_hz": 10.0, "mount": mount, **settings}
    off = {name: {"enabled": False} for name in ("lidar", "imu", "encoders")}
    return SensorsConfig.model_validate({**off, "additional": [entry]})


def the_camera(config: SensorsConfig) -> CameraEntry:
    entry = config.additional[0]
    assert isinstance(entry, CameraEntry)
    return entry


def recorded(
    config: SensorsConfig,
    drive: Drive,
    cuts: list[int] | None = None,
    threads: int = 1,
    seed: int = 3,
) -> dict[str, list[bytes]]:
    """The CDR messages of each topic, in order."""
    rig = SensorRig(room(), Robot(), config, seed=seed, threads=threads)
    found: dict[str, list[bytes]] = defaultdict(list)
    for window in windows(drive, cuts or []):
        for batch in rig.sense(window).additional:
            for stream in batch.streams():
                rows = stream_messages(stream).rows(slice(None))
                found[stream.topic] += [rows[i : i + 1].tobytes() for i in range(len(rows))]
    return dict(found)


def decoded(messages: dict[str, list[bytes]], topic: str, type_name: str) -> list[Any]:
    """As rosbags reads them."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(FRAME_TRUTH, "slamsim_msgs/msg/FrameTruth"))
    return [store.deserialize_cdr(data, type_name) for data in messages[topic]]


def pixels(message: Any, dtype: str, channels: int = 1) -> Any:
    """(h, w) or (h, w, channels) of a sensor_msgs/Image."""
    values = np.frombuffer(bytes(message.data), dtype=dtype)
    shape = message.height, message.width, channels
    return values.reshape(shape if channels > 1 else shape[:2])


def frames(messages: dict[str, list[bytes]], imager: str) -> list[Any]:
    return decoded(messages, f"/ground_truth/cam/{imager}/frame", "slamsim_msgs/msg/FrameTruth")


def true_images(messages: dict[str, list[bytes]], imager: str, what: str) -> list[Any]:
    kinds = {"depth": ("<f4", 1), "normals": ("<f4", 3), "flow": ("<f4", 2)}
    kinds |= {"instances": ("<i4", 1), "materials": ("u1", 1)}
    topic = f"/ground_truth/cam/{imager}/{what}"
    return [pixels(m, *kinds[what]) for m in decoded(messages, topic, "sensor_msgs/msg/Image")]


@cache
def _room_bounds() -> tuple[FloatArray, FloatArray]:
    vertices = room().vertices_m
    return vertices.min(axis=0), vertices.max(axis=0)


def room_depth(origin_m: FloatArray, toward: FloatArray) -> float:
    """How often a direction fits in before a wall or the floor of ``room()``; inf over these."""
    low, high = _room_bounds()
    nearest = float("inf")
    for axis, level in [(0, low[0]), (0, high[0]), (1, low[1]), (1, high[1]), (2, 0.0)]:
        steps = (level - origin_m[axis]) / toward[axis] if toward[axis] else -1.0
        hit = origin_m + steps * toward
        within = axis == 2 or low[2] <= hit[2] <= high[2]
        if 0.0 < steps < nearest and within:
            nearest = float(steps)
    return nearest
