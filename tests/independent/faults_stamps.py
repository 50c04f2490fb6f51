"""Faults of stamps: steps, scatter, rounding, order."""

from __future__ import annotations

from functools import partial

import numpy as np

from independent.fault import Fault, Made, Of, fault, of_all, of_imu, of_lidar, of_wheels
from independent.robots import Robot
from independent.sensors import BEGIN_NS


def _shift(made: Made, of: Of, by_s: float, since: float) -> None:
    """From this share of the drive on."""
    for stream in of(made.bag):
        later = np.arange(len(stream.stamps_ns)) >= since * len(stream.stamps_ns)
        stream.stamps_ns = stream.stamps_ns + np.where(later, round(1e9 * by_s), 0)


def _delayed(made: Made, of: Of, spread_s: float) -> None:
    """Stamps are those of publishing, after delays with this standard deviation, one behind the
    other."""
    delays_ns = 1e9 * spread_s / HALF_NORMAL * np.abs(made.rng.standard_normal(100_000))
    for stream in of(made.bag):
        count = len(stream.stamps_ns)
        in_turn_ns = 100_000 * np.arange(count)
        published_ns = stream.stamps_ns + delays_ns[:count].astype(np.int64) - in_turn_ns
        stream.stamps_ns = np.maximum.accumulate(published_ns) + in_turn_ns
        stream.received_ns = np.maximum(stream.received_ns, stream.stamps_ns + 300_000)


HALF_NORMAL = float(np.sqrt(1.0 - 2.0 / np.pi))
"""Standard deviation of the size of a standard normal number."""


def _rounded(made: Made, of: Of, quantum_s: float) -> None:
    quantum_ns = round(1e9 * quantum_s)
    for stream in of(made.bag):
        stream.stamps_ns = stream.stamps_ns // quantum_ns * quantum_ns


def _shared(made: Made, of: Of, count: int) -> None:
    """So many messages in a row have the stamp of the first."""
    for stream in of(made.bag):
        index = np.arange(len(stream.stamps_ns))
        stream.stamps_ns = stream.stamps_ns[index // count * count]


def _swapped(made: Made, of: Of, share: float) -> None:
    """Of some neighbours each has the other's stamp."""
    for stream in of(made.bag):
        pairs = np.flatnonzero(made.rng.random(len(stream.stamps_ns) // 2 - 1) < share) * 2
        stamps_ns = stream.stamps_ns.copy()
        stamps_ns[pairs], stamps_ns[pairs + 1] = stamps_ns[pairs + 1], stamps_ns[pairs].copy()
        stream.stamps_ns = stamps_ns


def _disordered(made: Made, of: Of, share: float) -> None:
    """Some messages are received after the one behind them."""
    for stream in of(made.bag):
        index = np.arange(len(stream.stamps_ns))
        late = made.rng.random(len(index)) < share
        order = np.argsort(index + 1.5 * late, kind="stable")
        received_ns = stream.received_ns.copy()
        stream.take(order)
        stream.received_ns = received_ns


def _stamped_at_receipt(made: Made, of: Of) -> None:
    """By the recorder, which is busy again and again: messages wait and arrive together."""
    for stream in of(made.bag):
        at_ns = stream.received_ns.copy()
        for begin_s in np.arange(2.0, 60.0, 3.0):
            begin_ns = BEGIN_NS + int(1e9 * begin_s)
            waits = (at_ns > begin_ns) & (at_ns < begin_ns + 400_000_000)
            late_ns = begin_ns + 400_000_000 + 300_000 * np.arange(waits.sum())
            at_ns[waits] = late_ns
        stream.received_ns = np.maximum.accumulate(at_ns)
        stream.stamps_ns = stream.received_ns - 150_000


def _slow_robot(robot: Robot) -> bool:
    """Scans far enough apart that their order cannot be mistaken."""
    return robot.lidar.rate_hz < 20.0


STEPS = [
    fault(
        f"{name}_clock_step_{by_s * 1e3:g}ms",
        "step",
        "clock_step",
        "stamps_future",
        change=partial(_shift, of=of, by_s=by_s, since=0.5),
    )
    for name, of, by_s in (
        ("lidar", of_lidar, 0.05),
        ("lidar", of_lidar, 0.4),
        ("imu", of_imu, 0.03),
        ("wheels", of_wheels, 0.06),
    )
]

SCATTER = [
    *(
        fault(
            f"{name}_delayed_{1e3 * spread_s:g}ms",
            "jitter",
            "stamps_jitter",
            f"time_offset_{name} tf_contradicts_odometry",
            change=partial(_delayed, of=of, spread_s=spread_s),
        )
        for name, of, spread_s in (
            ("lidar", of_lidar, 0.01),
            ("lidar", of_lidar, 0.02),
            ("imu", of_imu, 0.012),
            ("wheels", of_wheels, 0.02),
        )
    ),
    fault(
        "lidar_stamps_100ms",
        "rounded_stamps",
        "stamps_quantised stamps_repeated",
        change=partial(_rounded, of=of_lidar, quantum_s=0.1),
    ),
    fault(
        "imu_stamps_20ms",
        "rounded_stamps",
        "stamps_quantised stamps_repeated",
        change=partial(_rounded, of=of_imu, quantum_s=0.05),
    ),
    fault(
        "all_stamps_1s",
        "rounded_stamps",
        "stamps_quantised stamps_repeated",
        change=partial(_rounded, of=of_all, quantum_s=1.0),
    ),
    fault(
        "scans_share_stamps",
        "shared",
        "stamps_repeated",
        "stamps_quantised",
        change=partial(_shared, of=of_lidar, count=2),
    ),
    fault(
        "imu_shares_stamps",
        "shared",
        "stamps_repeated",
        "stamps_quantised",
        change=partial(_shared, of=of_imu, count=4),
    ),
    fault(
        "wheels_share_stamps",
        "shared",
        "stamps_repeated",
        "stamps_quantised",
        change=partial(_shared, of=of_wheels, count=2),
    ),
    fault(
        "lidar_swapped_stamps",
        "order",
        "stamps_backward",
        change=partial(_swapped, of=of_lidar, share=0.05),
    ),
    fault(
        "scans_out_of_order",
        "order",
        "stamps_backward",
        change=partial(_disordered, of=of_lidar, share=0.05),
    ),
    fault(
        "wheels_out_of_order",
        "order",
        "stamps_backward",
        change=partial(_disordered, of=of_wheels, share=0.03),
    ),
    fault(
        "imu_out_of_order",
        "order",
        "stamps_backward",
        change=partial(_disordered, of=of_imu, share=0.03),
    ),
    fault(
        "scans_stamped_at_receipt",
        "receipt",
        "stamps_jitter stamps_repeated time_offset_lidar scan_stamp_end",  # late by a sweep
        "stamps_quantised scans_overlap",
        change=partial(_stamped_at_receipt, of=of_lidar),
        fits=_slow_robot,
    ),
    fault(
        "imu_stamped_at_receipt",
        "receipt",
        "stamps_jitter stamps_repeated",
        "stamps_quantised",
        change=partial(_stamped_at_receipt, of=of_imu),
    ),
]

STAMP_FAULTS: list[Fault] = [*STEPS, *SCATTER]
