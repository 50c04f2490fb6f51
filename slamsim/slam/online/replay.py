"""A log as a robot would have delivered it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.core.types import IntArray, Log, Scan
from slamsim.slam.online.samples import MotionSamples

EVER_NS = int(np.iinfo(np.int64).min)


def replay(log: Log, since_ns: int = EVER_NS) -> Iterator[tuple[Scan, MotionSamples]]:
    """Each scan with the motion samples between the end of the scan before and its own end.

    since_ns: samples up to here were delivered already.
    """
    for scan in log.scans:
        until_ns = max(scan.span_ns[1], since_ns)
        yield scan, samples_between(log, since_ns, until_ns)
        since_ns = until_ns


def samples_between(log: Log, since_ns: int, until_ns: int) -> MotionSamples:
    """The log's motion samples with since_ns < stamp <= until_ns."""

    def part(stamps_ns: IntArray) -> slice:
        first, last = np.searchsorted(stamps_ns, [since_ns, until_ns], side="right")
        return slice(int(first), int(last))

    odometry, encoders, imu = log.odometry, log.encoders, log.imu
    return MotionSamples(
        None if odometry is None else odometry.select(part(odometry.stamps_ns)),
        None if encoders is None else encoders.select(part(encoders.stamps_ns)),
        None if imu is None else imu.select(part(imu.stamps_ns)),
    )
