"""Faults of stamps, and of messages that are lost, doubled or late."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from independent.fault import Fault, Made, fault
from independent.recorded import Bag, Messages
from independent.robots import Robot
from independent.sensors import BEGIN_NS

Of = Callable[[Bag], list[Messages]]


def _lidar(bag: Bag) -> list[Messages]:
    return list(bag.scans)


def _imu(bag: Bag) -> list[Messages]:
    return list(bag.imu)


def _wheels(bag: Bag) -> list[Messages]:
    """The odometry and its transform, which are one publisher's."""
    return [*bag.odometry, *(edge for edge in bag.edges if not edge.static)]


def _all(bag: Bag) -> list[Messages]:
    return [*_lidar(bag), *_imu(bag), *_wheels(bag)]


def _shift(made: Made, of: Of, by_s: float, since: float) -> None:
    """From this share of the drive on."""
    for stream in of(made.bag):
        later = np.arange(len(stream.stamps_ns)) >= since * len(stream.stamps_ns)
        stream.stamps_ns = stream.stamps_ns + np.where(later, round(1e9 * by_s), 0)


def _scattered(made: Made, of: Of, sigma_s: float) -> None:
    noise_ns = 1e9 * sigma_s * made.rng.standard_normal(100_000)
    for stream in of(made.bag):
        stream.stamps_ns = stream.stamps_ns + noise_ns[: len(stream.stamps_ns)].astype(np.int64)


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


def _lost(made: Made, of: Of, share: float) -> None:
    for stream in of(made.bag):
        kept = np.random.default_rng(5).random(len(stream.stamps_ns)) >= share
        stream.take(kept)


def _gap(made: Made, of: Of, begin_s: float, seconds: float) -> None:
    for stream in of(made.bag):
        at_s = (stream.received_ns - BEGIN_NS) * 1e-9
        stream.take((at_s < begin_s) | (at_s > begin_s + seconds))


def _doubled(made: Made, of: Of, share: float) -> None:
    """Some messages are recorded twice."""
    for stream in of(made.bag):
        again = np.random.default_rng(6).random(len(stream.stamps_ns)) < share
        stream.take(np.repeat(np.arange(len(again)), 1 + again))


def _invented(made: Made, of: Of, receipt: bool) -> None:
    """Stamps by counting messages, at the mean rate; the receipt perhaps too."""
    for stream in of(made.bag):
        first, last = int(stream.stamps_ns[0]), int(stream.stamps_ns[-1])
        stream.stamps_ns = np.linspace(first, last, len(stream.stamps_ns)).astype(np.int64)
        if receipt:
            stream.received_ns = stream.stamps_ns.copy()


def _counted_over_losses(made: Made) -> None:
    """A sixth of the scans was lost, and then they were numbered at a constant rate."""
    _lost(made, _lidar, 1.0 / 6.0)
    _invented(made, _lidar, True)


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


def _other_origin(made: Made, of: Of, origin_s: float) -> None:
    """Time since the sensor's start, or another epoch."""
    for stream in of(made.bag):
        stream.stamps_ns = stream.stamps_ns - BEGIN_NS + round(1e9 * origin_s)


def _received(made: Made, by_s: float) -> None:
    """All messages, long after or before their stamps."""
    for stream in _all(made.bag):
        stream.received_ns = stream.received_ns + round(1e9 * by_s)


def _slow_robot(robot: Robot) -> bool:
    """Scans far enough apart that their order cannot be mistaken."""
    return robot.lidar.rate_hz < 20.0


STEPS = [
    fault(
        f"{name}_clock_step_{by_s * 1e3:g}ms",
        "step",
        "clock_step",
        change=partial(_shift, of=of, by_s=by_s, since=0.5),
    )
    for name, of, by_s in (
        ("lidar", _lidar, 0.05),
        ("lidar", _lidar, 0.4),
        ("imu", _imu, 0.03),
        ("wheels", _wheels, 0.06),
    )
]

SCATTER = [
    fault(
        "imu_jitter", "jitter", "stamps_jitter", change=partial(_scattered, of=_imu, sigma_s=0.012)
    ),
    fault(
        "wheels_jitter",
        "jitter",
        "stamps_jitter",
        "tf_contradicts_odometry",
        change=partial(_scattered, of=_wheels, sigma_s=0.02),
    ),
    fault(
        "lidar_stamps_100ms",
        "rounded_stamps",
        "stamps_quantised stamps_repeated",
        change=partial(_rounded, of=_lidar, quantum_s=0.1),
    ),
    fault(
        "imu_stamps_20ms",
        "rounded_stamps",
        "stamps_quantised stamps_repeated",
        change=partial(_rounded, of=_imu, quantum_s=0.05),
    ),
    fault(
        "all_stamps_1s",
        "rounded_stamps",
        "stamps_quantised stamps_repeated",
        change=partial(_rounded, of=_all, quantum_s=1.0),
    ),
    fault(
        "scans_share_stamps",
        "shared",
        "stamps_repeated",
        "stamps_quantised",
        change=partial(_shared, of=_lidar, count=2),
    ),
    fault(
        "imu_shares_stamps",
        "shared",
        "stamps_repeated",
        "stamps_quantised",
        change=partial(_shared, of=_imu, count=4),
    ),
    fault(
        "wheels_share_stamps",
        "shared",
        "stamps_repeated",
        "stamps_quantised",
        change=partial(_shared, of=_wheels, count=2),
    ),
    fault(
        "lidar_swapped_stamps",
        "order",
        "stamps_backward",
        change=partial(_swapped, of=_lidar, share=0.05),
    ),
    fault(
        "scans_out_of_order",
        "order",
        "stamps_backward",
        change=partial(_disordered, of=_lidar, share=0.05),
    ),
    fault(
        "wheels_out_of_order",
        "order",
        "stamps_backward",
        change=partial(_disordered, of=_wheels, share=0.03),
    ),
    fault(
        "imu_out_of_order",
        "order",
        "stamps_backward",
        change=partial(_disordered, of=_imu, share=0.03),
    ),
    fault(
        "scans_stamped_at_receipt",
        "receipt",
        "stamps_jitter stamps_repeated",
        "stamps_quantised scans_overlap",
        change=partial(_stamped_at_receipt, of=_lidar),
        fits=_slow_robot,
    ),
    fault(
        "imu_stamped_at_receipt",
        "receipt",
        "stamps_jitter stamps_repeated",
        "stamps_quantised",
        change=partial(_stamped_at_receipt, of=_imu),
    ),
]

LOSSES = [
    fault(
        "scans_lost_10%",
        "lost_messages",
        "stream_gaps",
        change=partial(_lost, of=_lidar, share=0.1),
        pairs=True,
    ),
    fault(
        "imu_lost_15%",
        "lost_messages",
        "stream_gaps",
        change=partial(_lost, of=_imu, share=0.15),
        pairs=True,
    ),
    fault(
        "scans_gap_4s",
        "lost_messages",
        "stream_gaps",
        change=partial(_gap, of=_lidar, begin_s=30.0, seconds=4.0),
    ),
    fault(
        "imu_gap_4s",
        "lost_messages",
        "stream_gaps",
        change=partial(_gap, of=_imu, begin_s=20.0, seconds=4.0),
    ),
    fault(
        "wheels_gap_3s",
        "lost_messages",
        "stream_gaps",
        "tf_coverage",
        change=partial(_gap, of=_wheels, begin_s=40.0, seconds=3.0),
    ),
    fault(
        "scans_doubled",
        "doubled",
        "stamps_repeated scan_stuck",
        "scan_stuck stamps_repeated",
        change=partial(_doubled, of=_lidar, share=0.1),
    ),
    fault(
        "imu_doubled",
        "doubled",
        "stamps_repeated",
        "imu_stuck",
        change=partial(_doubled, of=_imu, share=0.1),
    ),
    fault(
        "wheels_doubled",
        "doubled",
        "stamps_repeated",
        change=partial(_doubled, of=_wheels, share=0.1),
    ),
]

ORIGINS = [
    fault("lidar_invented_over_losses", "invented", "stamps_invented", change=_counted_over_losses),
    fault(
        "scans_invented",
        "invented",
        "stamps_invented",
        change=partial(_invented, of=_lidar, receipt=True),
    ),
    fault(
        "all_invented",
        "invented",
        "stamps_invented",
        change=partial(_invented, of=_all, receipt=True),
    ),
    fault(
        "imu_since_boot",
        "origin",
        "epoch_mismatch",
        "stamps_late",
        change=partial(_other_origin, of=_imu, origin_s=120.0),
    ),
    fault(
        "lidar_since_boot",
        "origin",
        "epoch_mismatch",
        "stamps_late tf_coverage",
        change=partial(_other_origin, of=_lidar, origin_s=5.0),
    ),
    fault(
        "lidar_leap",
        "origin",
        "epoch_mismatch",
        "stamps_future tf_coverage",
        change=partial(_shift, of=_lidar, by_s=3600.0, since=0.0),
    ),
    fault("stamps_1s_in_future", "received", "stamps_future", change=partial(_received, by_s=-1.0)),
    fault("received_2s_late", "received", "stamps_late", change=partial(_received, by_s=2.0)),
]

STAMP_FAULTS: list[Fault] = [*STEPS, *SCATTER, *LOSSES, *ORIGINS]
