"""Steps of a laser from scan to scan: the measurements that the joint fit explains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.check.findings import SURE_SIGMAS, Measurement, decide
from slamsim.core.arrays import Samples
from slamsim.core.geometry import wrap_angle, yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import MOST, require_covariances, require_finite, require_number
from slamsim.recording import RawScans, Recording
from slamsim.recording.choice import lidars
from slamsim.slam.laser.calibration import swept_s
from slamsim.slam.laser.noise_bias import without_noise_bias
from slamsim.slam.laser.scan_motion import ScanMotions, window_motions
from slamsim.slam.laser.scan_windows import choose_windows

OFFSET_BIAS_SHARE, OFFSET_BIAS_UNSURE = 0.1, 0.08
"""Of the noise of the ranges: by what the range offset that scans tell is too large, and the
standard deviation of that from lidar to lidar. Noise moves points across a slanted wall by less
than across others, and what fits best is then a little too slanted: with some 15 mm of noise by
2.0 mm on average over 18 drives of nine lidars (tests/independent, seeds 9 and 11), of single
lidars 0.8 to 4.3 mm, by 0.8 mm in the labyrinth; without noise by less than 0.25 mm."""


ANGLE_LIMIT = 5e-4
"""0.05 % between beams is a fifth of a degree in a full turn; walls are no straighter."""

SWEEP_LIMIT, SWEEP_LIMIT_S = 0.05, 5e-4
"""Errors of the time between beams up to this share, or of the sweep up to this, do no harm."""

WHOLE = 0.01
"""So surely, as a share, must an angle be known that is called a multiple of another: one of fifty
is so near to a whole number by chance."""

SINGLE = 0.3
UNEVEN, SCATTERED_SHARE = 0.1, 0.2
"""Stamps scatter if so many steps between them differ by more than this share of a period."""

LONG_WINDOW = 2.0
"""A window whose scans are this many times as far apart as usual spans a pause, in which half of
its time nothing was recorded."""

ACTIVE = 0.9
"""The quantile of a stream's values that counts as activity 1."""

MOST_ACTIVE = 2.0
"""A single value far above the others, as of a jump, counts no more than twice what is usual."""


@dataclass(frozen=True, slots=True, eq=False)
class LaserSteps(Samples):
    """Relative motions of one laser between pairs of its scans.

    first, second: (n,) which scans of the stream. first_ns, second_ns: (n,) their claimed stamps,
    plus half the sweep: when the middle beam claims to have fired. T_first_second: (n, 3) of the
    laser between those two instants, in the plane of the scan as its messages declare it.
    information: (n, 3, 3) of a small step of the second scan in its own frame. window: (n,) equal
    for pairs of one contiguous stretch; pairs that share a scan lie in the same window. sweep_s:
    from the first beam to the last.
    """

    topic: str
    first: IntArray
    second: IntArray
    first_ns: IntArray
    second_ns: IntArray
    T_first_second: FloatArray
    information: FloatArray
    window: IntArray
    sweep_s: float

    def __post_init__(self) -> None:
        require_finite("steps of a laser", self.T_first_second, (len(self), 3), MOST**4)
        shape = (len(self), 3, 3)
        require_covariances("the information of steps", self.information, shape, MOST**4)
        require_number("the seconds of a sweep", self.sweep_s)

    def __len__(self) -> int:
        return int(self.first.size)


def laser_steps(motions: ScanMotions, even: bool = True) -> LaserSteps:
    """Of all windows; steps that are not finite, or take no time, are left out.

    even: whether stamps that scatter are put on an even beat; not where others share them.
    """
    sweep_s = _swept_s(motions)
    later_ns = round(0.5e9 * (sweep_s - motions.sweep_s.declared))
    stamps = [window.middle_ns for window in motions.windows]
    stamps = _evened(stamps) if even else stamps
    begins = [middle_ns[:-1] for middle_ns in stamps]
    ends = [middle_ns[1:] for middle_ns in stamps]
    steps = LaserSteps(
        motions.topic,
        *(motions.first, motions.second),
        *(_joined(begins) + later_ns, _joined(ends) + later_ns),
        *_in_metres(motions),
        *(motions.window.astype(np.int64), abs(sweep_s)),
    )
    finite = np.isfinite(steps.T_first_second).all(axis=1)
    finite &= np.isfinite(steps.information).all(axis=(1, 2))
    return steps.select(finite & (steps.second_ns > steps.first_ns))


def thinned_by(motions: ScanMotions) -> int:
    """Every which beam was kept, 1 of all: the angle between those that are left is then a whole
    multiple of the declared one."""
    found = motions.angle_step
    every = round(found.value)
    if every < 2 or not SURE_SIGMAS * found.sigma < WHOLE * every:
        return 1
    size = Measurement(found.value, found.sigma, "of the declared angle")
    return 1 if decide(size, ANGLE_LIMIT * every, every) == "fault" else every


def times_of_all(motions: ScanMotions) -> bool:
    """Whether the time between beams, too, is declared as of all where some were left out. Who
    leaves one as it was leaves the other, unless the scans rather say that the sweep is right."""
    told, every = motions.sweep_s, thinned_by(motions)
    if every == 1 or told.declared == 0.0:
        return False
    of_all_s = every * told.declared
    limit_s = max(SWEEP_LIMIT * abs(of_all_s), SWEEP_LIMIT_S)
    if decide(Measurement(told.value, told.sigma, "s"), limit_s, of_all_s) == "fault":
        return False
    return abs(told.value - of_all_s) < max(abs(told.value - told.declared), told.sigma)


def _swept_s(motions: ScanMotions) -> float:
    """From the beam that has the stamp on, by the scans where they contradict what is declared."""
    told = motions.sweep_s
    if times_of_all(motions):
        return thinned_by(motions) * told.declared
    if not motions.contradicted[0]:
        return told.declared
    return swept_s(told.value, told.sigma, told.declared)


def middle_sigma_s(motions: ScanMotions) -> float:
    """How unsure it is when the middle beam of a scan fired: by half of what the sweep is, where it
    is by the scans."""
    by_scans = motions.contradicted[0] and not times_of_all(motions) and _swept_s(motions) != 0.0
    return 0.5 * float(motions.sweep_s.sigma) if by_scans else 0.0


def _in_metres(motions: ScanMotions) -> tuple[FloatArray, FloatArray]:
    """(n, 3) steps and (n, 3, 3) information, whatever unit the ranges are in."""
    scale = np.array([motions.metres_per_unit, motions.metres_per_unit, 1.0])
    return motions.T_first_second * scale, motions.information / (scale[:, None] * scale)


def _evened(stamps: list[IntArray]) -> list[IntArray]:
    """The stamps of each window, corrected where they scatter or single ones are outliers.

    A lidar turns evenly. Stamps that do not, and are not just missing some, are those of publishing
    or rounded; over a window their mean is still good.
    """
    steps = _joined([np.diff(window) for window in stamps])
    if steps.size < 2 or (period := _mean_period(stamps)) <= 0.0:
        return stamps
    usual = max(float(np.median(steps)), 1.0)
    scatter = np.abs(steps - np.rint(steps / usual) * usual) > UNEVEN * period
    if scatter.mean() < SCATTERED_SHARE and np.median(steps) > 0.5 * period:
        return [_without_single_steps(window, usual) for window in stamps]
    return [
        np.rint(window.mean() + period * (np.arange(len(window)) - 0.5 * (len(window) - 1))).astype(
            np.int64
        )
        for window in stamps
    ]


def _mean_period(stamps: list[IntArray]) -> float:
    """The mean step, but for windows in which a clock was set or nothing was recorded for long: an
    hour in one of them would make the mean seven seconds, and all others scattered by it."""
    means = np.array([float(np.ptp(window)) / (len(window) - 1) for window in stamps])
    lengths = np.array([len(window) - 1.0 for window in stamps])
    # Of two, the median would be their mean, which an hour in one of them is half of.
    usual = means < LONG_WINDOW * float(np.sort(means)[(means.size - 1) // 2])
    return float(np.average(means[usual], weights=lengths[usual])) if usual.any() else 0.0


def _without_single_steps(stamps_ns: IntArray, period: float) -> IntArray:
    """(n,) with single stamps that stand out put where an even pace has them."""
    pace = period * np.arange(len(stamps_ns))
    apart = (stamps_ns - stamps_ns[0]) - pace
    usual = float(np.median(apart))
    out = np.abs(apart - usual) > SINGLE * period
    alone = np.zeros_like(out)
    alone[1:-1] = out[1:-1] & ~out[:-2] & ~out[2:]
    even = np.rint(stamps_ns[0] + pace + usual).astype(np.int64)
    return np.where(alone, even, stamps_ns)


def _joined(parts: list[IntArray]) -> IntArray:
    return np.concatenate(parts).astype(np.int64) if parts else np.zeros(0, dtype=np.int64)


def laser_motions(recording: Recording) -> ScanMotions | None:
    """The motion of the first lidar by its scans alone; None without any lidar.

    Windows are chosen where other streams say that much happens. Only their activity is used:
    they are laid side by side from first message to last, without regard to stamps, units and
    axes, which may all be wrong.
    """
    scans = next(iter(lidars(recording)), None)
    if scans is None:
        return None
    windows = choose_windows(scans.stamps_ns, activity(recording, scans))
    motions = window_motions(scans, windows)
    if _seems_bent(motions):
        return without_noise_bias(scans, windows, motions)
    return _without_usual_bias(motions)


def _without_usual_bias(motions: ScanMotions) -> ScanMotions:
    """Less what noise makes of the range offset of most lidars."""
    offset, noise_m = motions.range_offset_m, motions.range_noise_m
    if not np.isfinite(noise_m):
        return motions
    value = offset.value - OFFSET_BIAS_SHARE * noise_m
    sigma = float(np.hypot(offset.sigma, OFFSET_BIAS_UNSURE * noise_m))
    return replace(motions, range_offset_m=replace(offset, value=value, sigma=sigma))


def _seems_bent(motions: ScanMotions) -> bool:
    """Whether an angle between beams would be told as wrong that noise may have made so."""
    angle = motions.angle_step
    size = Measurement(angle.value, angle.sigma, "of the declared")
    return decide(size, ANGLE_LIMIT, angle.declared) == "fault"


def activity(recording: Recording, scans: RawScans) -> FloatArray | None:
    """(n,) how much happens at each scan, from 0; None where no other stream tells."""
    signals = [np.linalg.norm(imu.angular_velocity_rad_s, axis=1) for imu in recording.imus]
    for odometry in recording.odometries:
        yaw = yaw_from_xyzw(odometry.quats_xyzw)
        signals.append(np.abs(wrap_angle(np.diff(yaw))))
        signals.append(np.linalg.norm(np.diff(odometry.positions_m, axis=0), axis=1))
    for ticks in recording.ticks:
        counted = np.diff(ticks.ticks, axis=0).astype(np.float64)
        signals += [np.abs(counted.sum(axis=1)), np.abs(counted[:, 1] - counted[:, 0])]
    found = [
        one for one in (_over_scans(signal, len(scans)) for signal in signals) if one is not None
    ]
    return np.sum(found, axis=0) if found else None


def _over_scans(signal: FloatArray, count: int) -> FloatArray | None:
    """A signal of a stream at as many scans, in units of its ``ACTIVE`` quantile."""
    signal = np.nan_to_num(np.asarray(signal, dtype=np.float64), posinf=0.0)
    unit = float(np.quantile(signal, ACTIVE)) if signal.size else 0.0
    if not unit > 0.0:
        return None
    smooth = max(1, signal.size // max(count, 1))
    mean = np.convolve(signal, np.full(smooth, 1.0 / smooth), mode="same")
    at = np.linspace(0.0, 1.0, count)
    return np.interp(at, np.linspace(0.0, 1.0, signal.size), np.minimum(mean / unit, MOST_ACTIVE))
