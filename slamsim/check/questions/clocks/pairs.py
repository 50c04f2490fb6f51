"""Offset and drift of the clocks of each pair of streams, and which streams explain them."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.findings import SURE_SIGMAS, Measurement, decide

LIMITS_S = {"gyro": 1e-3, "wheel": 1.5e-3, "gyro_wheel": 1.5e-3}
"""Offsets up to this are healthy: while the robot turns by 1 rad/s beams are off by a milliradian,
a tenth of their width. A robot that turns by jerks (MuJoCo's, up to 11 rad/s^2) seemed to have
0.7 ms between lidar and gyroscope that it did not have. Tyres that give make wheels seem 0.3 ms
late on the simulator's robot (0.27 to 0.36 in turns, 28 drives against the truth), more on soft
ones."""

DRIFT_LIMIT = 1e-5
GAINED_LIMIT_S = 1e-3
"""A drift matters if it is faster than 10 ppm and gains a millisecond over the recording."""

PAIR_WORDS = {
    "gyro": ("inertial unit", "lidar"),
    "wheel": ("wheels", "lidar"),
    "gyro_wheel": ("wheels", "inertial unit"),
}


@dataclass(frozen=True, slots=True)
class Offset:
    """One pair of streams: offset in the middle of what was compared, s, and drift, s/s.

    bound_s: the least standard deviation possible. span_s: of what was compared. given_s: the part
    of sigma_s that is of tyres that give, which the limit allows for.
    """

    pair: str
    offset_s: float
    sigma_s: float
    bound_s: float
    drift: float
    drift_sigma: float
    span_s: float
    given_s: float

    @property
    def size(self) -> Measurement:
        """In ms."""
        numbers = 1e3 * np.array([self.offset_s, self.sigma_s, self.bound_s, self.given_s])
        offset, sigma, bound, given = numbers.tolist()
        return Measurement(offset, sigma, "ms", bound, given)

    @property
    def is_off(self) -> bool:
        """Whether the offset is a fault."""
        return decide(self.size, 1e3 * LIMITS_S[self.pair]) == "fault"

    @property
    def drift_size(self) -> Measurement:
        """In ppm."""
        return Measurement(1e6 * self.drift, 1e6 * self.drift_sigma, "ppm")

    @property
    def drift_limit_ppm(self) -> float:
        """Up to which the drift does no harm over so long a recording."""
        return 1e6 * max(DRIFT_LIMIT, GAINED_LIMIT_S / max(self.span_s, 1e-9))

    @property
    def drifts(self) -> bool:
        """Whether the drift is a fault."""
        return decide(self.drift_size, self.drift_limit_ppm) == "fault"


def pairs_of(calibration: Calibration) -> tuple[str, ...]:
    """The pairs of streams that are there: keys of ``LIMITS_S``."""
    lidar = calibration.scans_count
    gyro, wheels = calibration.inputs.gyro is not None, calibration.inputs.wheels is not None
    there = {"gyro": lidar and gyro, "wheel": lidar and wheels, "gyro_wheel": gyro and wheels}
    return tuple(pair for pair, both in there.items() if both)


def offset_of(calibration: Calibration, pair: str) -> Offset:
    """The offset and drift of a pair. Of one that certainly drifts the least offset during the
    recording: clocks that agree at any time in it are at one rate, or they are not."""
    drift, drift_sigma, _ = calibration.drift(pair)
    given_s = 0.0 if pair == "gyro" else calibration.given("wheel_delay_s")
    span_s = calibration.model.span_s
    now = Offset(pair, *calibration.offset(pair), drift, drift_sigma, span_s, given_s)
    if not now.drifts:
        return now
    agree_s = float(np.clip(-now.offset_s / drift, *_recorded_s(calibration)))
    offset_s, sigma_s, bound_s = calibration.offset(pair, agree_s)
    return replace(now, offset_s=offset_s, sigma_s=sigma_s, bound_s=bound_s)


def _recorded_s(calibration: Calibration) -> tuple[float, float]:
    """When the first stream begins and the last one ends, after the middle of what was compared,
    which may have begun late: where nothing moves there is nothing to compare."""
    model, shifts_ns = calibration.model, calibration.alignment.shifts_ns
    ends_s = [float(model.first_s.min()), float(model.second_s.max())]
    for motion, shift_ns in zip((model.gyro, model.wheels), shifts_ns, strict=True):
        if motion is not None:
            ends_s += ((motion.stamps_ns[[0, -1]] - shift_ns - model.middle_ns) * 1e-9).tolist()
    return min(ends_s), max(ends_s)


OTHERS = {"lidar": "gyro_wheel", "imu": "wheel", "wheels": "gyro"}
"""The pair that a stream has no part in."""

_LATE = {
    "lidar": {"gyro": -1.0, "wheel": -1.0, "gyro_wheel": 0.0},
    "wheels": {"gyro": 0.0, "wheel": 1.0, "gyro_wheel": 1.0},
    "imu": {"gyro": 1.0, "wheel": 0.0, "gyro_wheel": -1.0},
}
"""What a stream that is late by one makes of each pair. Of two streams alone the first is blamed:
the messages of a lidar take longest to make."""


def most_likely(
    differences: Mapping[str, tuple[float, float]], wrong: Set[str], limits: Mapping[str, float]
) -> dict[str, float]:
    """How late the one stream is that explains the wrong pairs: by stream; empty if none does.

    differences: by pair, value and sigma, of those that were compared. wrong: pairs that are apart
    by more than healthy ones, which are by up to ``limits``. A stream is to blame where the two
    others agree: if these were not compared, where it is as late against the one as against the
    other. Where all three pairs are wrong, two streams are, and any two of them would explain it.
    """
    seen = [pair for pair in LIMITS_S if pair in differences][:2]  # the third follows from two
    values, sigmas = np.array([differences[pair] for pair in seen]).reshape(-1, 2).T
    healthy = np.array([limits[pair] for pair in seen]) + SURE_SIGMAS * sigmas
    fits = {}
    for name in _LATE if wrong else ():
        by = np.array([_LATE[name][pair] for pair in seen])
        if OTHERS[name] in wrong or not by.any():
            continue
        late = float((by * values / sigmas**2).sum() / (by**2 / sigmas**2).sum())
        left = values - late * by
        if OTHERS[name] in differences or (np.abs(left) <= healthy).all():
            fits[name] = late, float(np.square(left / sigmas).sum())
    if not fits:
        return {}
    best = min(fits, key=lambda name: fits[name][1])
    return {best: fits[best][0]}


def stream_of(pair: str) -> str:
    """The stream of a pair whose stamps are compared with the other's."""
    return "imu" if pair == "gyro" else "wheels"
