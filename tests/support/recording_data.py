"""Made-up recordings in memory for the tests of the checker; nothing is simulated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace

import numpy as np

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import (
    RawImu,
    RawOdometry,
    RawScans,
    RawTicks,
    Recording,
    ScanLayout,
    TransformEdge,
)

BEAMS = 60
LAYOUT = ScanLayout(-1.5, -1.5 + 0.05 * (BEAMS - 1), 0.05, 1e-3, 0.1, 0.1, 30.0)


def stamps(rate_hz: float, seconds: float, start_s: float = 100.0) -> IntArray:
    """Perfectly even ones."""
    count = np.arange(int(seconds * rate_hz))
    return np.asarray(np.rint((start_s + count / rate_hz) * 1e9), dtype=np.int64)


def scans_at(stamps_ns: IntArray, received_ns: IntArray | None = None) -> RawScans:
    """The walls of a square room, seen turning slowly, with a little noise."""
    angles = -1.5 + 0.05 * np.arange(BEAMS) + 0.02 * np.arange(stamps_ns.size)[:, None]
    walls = 4.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    noise = np.random.default_rng(7).normal(0.0, 0.01, walls.shape)
    return RawScans(
        topic="/scan",
        frame_ids=("laser",),
        stamps_ns=stamps_ns,
        received_ns=stamps_ns + 70_000_000 if received_ns is None else received_ns,
        layouts=(LAYOUT,),
        layout_of=np.zeros(stamps_ns.size, dtype=np.int32),
        ranges_m=(walls + noise).astype(np.float32),
    )


def imu_at(stamps_ns: IntArray) -> RawImu:
    rates = np.random.default_rng(1).normal([0.0, 0.0, 0.2], 1e-3, (stamps_ns.size, 3))
    feels = np.random.default_rng(2).normal([0.0, 0.0, 9.81], 1e-2, (stamps_ns.size, 3))
    return RawImu("/imu", ("imu_link",), stamps_ns, stamps_ns + 2_000_000, rates, feels)


def ticks_at(stamps_ns: IntArray) -> RawTicks:
    since_s = (stamps_ns - stamps_ns[:1]) * 1e-9
    ticks = np.floor(np.column_stack([900.0 * since_s, 1000.0 * since_s])).astype(np.int64)
    return RawTicks(
        "/ticks", ("base_link",), stamps_ns, stamps_ns + 1_000_000, ticks, 2000, 0.05, 0.3
    )


def odometry_at(stamps_ns: IntArray, topic: str = "/odom") -> RawOdometry:
    """Along a circle."""
    since_s: FloatArray = (stamps_ns - stamps_ns[0]).astype(np.float64) * 1e-9
    yaw, zero = 0.2 * since_s, np.zeros(stamps_ns.size)
    return RawOdometry(
        topic=topic,
        frame_ids=("odom",),
        stamps_ns=stamps_ns,
        received_ns=stamps_ns + 1_500_000,
        child_frame_ids=("base_link",),
        positions_m=np.column_stack([2.0 * np.sin(yaw), 2.0 - 2.0 * np.cos(yaw), zero]),
        quats_xyzw=xyzw_from_yaw(yaw),
        linear_m_s=np.column_stack([zero + 0.4, zero, zero]),
        angular_rad_s=np.column_stack([zero, zero, zero + 0.2]),
    )


def edge(
    parent: str, child: str, stamps_ns: IntArray, *, static: bool = True, x_m: float = 0.0
) -> TransformEdge:
    poses = np.tile([x_m, 0.0, 0.0], (stamps_ns.size, 1))
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (stamps_ns.size, 1))
    topic = "/tf_static" if static else "/tf"
    return TransformEdge(topic, parent, child, static, stamps_ns, stamps_ns, poses, quats)


def recording(seconds: float = 30.0) -> Recording:
    """A lidar, an inertial unit, counters, odometry, and where they sit."""
    scans_ns, wheels_ns = stamps(10.0, seconds), stamps(50.0, seconds)
    odometry = odometry_at(wheels_ns)
    moving = replace(
        edge("odom", "base_link", wheels_ns, static=False),
        positions_m=odometry.positions_m,
        quats_xyzw=odometry.quats_xyzw,
    )
    return Recording(
        streams=(
            scans_at(scans_ns),
            imu_at(stamps(100.0, seconds)),
            odometry,
            ticks_at(wheels_ns),
        ),
        name="made",
        format="memory",
        transforms=(
            edge("base_link", "laser", scans_ns[:1], x_m=0.1),
            edge("base_link", "imu_link", scans_ns[:1]),
            moving,
        ),
    )


def leaves(value: object, at: str = "") -> Iterator[tuple[str, object]]:
    """Every array, number and text of a recording with its place."""
    if isinstance(value, Recording):
        for kind in ("scans", "imus", "odometries", "ticks", "joints"):
            yield from leaves(getattr(value, kind), f".{kind}")
    if is_dataclass(value):
        for field in fields(value):
            if field.name != "streams":
                yield from leaves(getattr(value, field.name), f"{at}.{field.name}")
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from leaves(item, f"{at}[{index}]")
    else:
        yield at, value
