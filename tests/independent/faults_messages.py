"""Messages that are lost or doubled, stamps that are made up or of another origin."""

from __future__ import annotations

from functools import partial

import numpy as np

from independent.fault import Fault, Made, Of, fault, of_all, of_imu, of_lidar, of_wheels
from independent.sensors import BEGIN_NS


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
    _lost(made, of_lidar, 1.0 / 6.0)
    _invented(made, of_lidar, True)


def _other_origin(made: Made, of: Of, origin_s: float) -> None:
    """Time since the sensor's start, or another epoch."""
    for stream in of(made.bag):
        stream.stamps_ns = stream.stamps_ns - BEGIN_NS + round(1e9 * origin_s)


def _received(made: Made, by_s: float) -> None:
    """All messages, long after or before their stamps."""
    for stream in of_all(made.bag):
        stream.received_ns = stream.received_ns + round(1e9 * by_s)


LOSSES = [
    fault(
        "scans_lost_10%",
        "lost_messages",
        "stream_gaps",
        change=partial(_lost, of=of_lidar, share=0.1),
        pairs=True,
    ),
    fault(
        "imu_lost_15%",
        "lost_messages",
        "stream_gaps",
        change=partial(_lost, of=of_imu, share=0.15),
        pairs=True,
    ),
    fault(
        "scans_gap_4s",
        "lost_messages",
        "stream_gaps",
        change=partial(_gap, of=of_lidar, begin_s=30.0, seconds=4.0),
    ),
    fault(
        "imu_gap_4s",
        "lost_messages",
        "stream_gaps",
        change=partial(_gap, of=of_imu, begin_s=20.0, seconds=4.0),
    ),
    fault(
        "wheels_gap_3s",
        "lost_messages",
        "stream_gaps",
        "tf_coverage",
        change=partial(_gap, of=of_wheels, begin_s=40.0, seconds=3.0),
    ),
    fault(
        "scans_doubled",
        "doubled",
        "stamps_repeated scan_stuck",
        "scan_stuck stamps_repeated",
        change=partial(_doubled, of=of_lidar, share=0.1),
    ),
    fault(
        "imu_doubled",
        "doubled",
        "stamps_repeated",
        "imu_stuck",
        change=partial(_doubled, of=of_imu, share=0.1),
    ),
    fault(
        "wheels_doubled",
        "doubled",
        "stamps_repeated",
        change=partial(_doubled, of=of_wheels, share=0.1),
    ),
]

ORIGINS = [
    fault("lidar_invented_over_losses", "invented", "stamps_invented", change=_counted_over_losses),
    fault(
        "scans_invented",
        "invented",
        "stamps_invented",
        change=partial(_invented, of=of_lidar, receipt=True),
    ),
    fault(
        "all_invented",
        "invented",
        "stamps_invented",
        change=partial(_invented, of=of_all, receipt=True),
    ),
    fault(
        "imu_since_boot",
        "origin",
        "epoch_mismatch",
        "stamps_late",
        change=partial(_other_origin, of=of_imu, origin_s=120.0),
    ),
    fault(
        "lidar_since_boot",
        "origin",
        "epoch_mismatch",
        "stamps_late tf_coverage",
        change=partial(_other_origin, of=of_lidar, origin_s=5.0),
    ),
    fault(
        "lidar_leap",
        "origin",
        "epoch_mismatch",
        "stamps_future tf_coverage",
        change=partial(_other_origin, of=of_lidar, origin_s=BEGIN_NS * 1e-9 + 3600.0),
    ),
    fault("stamps_1s_in_future", "received", "stamps_future", change=partial(_received, by_s=-1.0)),
    fault("received_2s_late", "received", "stamps_late", change=partial(_received, by_s=2.0)),
]

MESSAGE_FAULTS: list[Fault] = [*LOSSES, *ORIGINS]
