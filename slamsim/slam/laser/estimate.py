"""A laser's calibration from its own recording, before the recording is mapped.

Windows of scans all over the recording are bundled with the shape of the scans (angle between
beams, range offset, sweep) as unknowns; the motion that comes out, held against wheels and
gyroscope, tells the mount. The scale of ranges is not among the unknowns: it scales the map and
the radii of the wheels alike.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import MotionConfig, SlamConfig
from slamsim.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Log,
    Scan,
    ScanBeside,
    ScanGeometry,
)
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.recording import RawScans, ScanLayout
from slamsim.slam.failures import Failures
from slamsim.slam.frontend.motion import Odometry
from slamsim.slam.laser.calibration import (
    ANGLE_SCALE,
    KNOWN_DELAY_S,
    MOUNT,
    PLACED,
    RANGE_OFFSET,
    SHAPE,
    SWEEP,
    LaserCalibration,
)
from slamsim.slam.laser.mount import (
    DELAY_ROUNDS,
    DELAY_STEP_S,
    Mount,
    Stretches,
    find_mount,
    stretches,
)
from slamsim.slam.laser.noise_bias import without_noise_bias
from slamsim.slam.laser.reversed import reversed_parts
from slamsim.slam.laser.scan_bundle import as_sure_as
from slamsim.slam.laser.scan_motion import ScanMotions, window_motions
from slamsim.slam.laser.scan_windows import choose_windows

FIRST_WINDOWS = 10
"""So many are looked at first; all of them only where these raise a doubt."""

DOUBT_SIGMAS, SURE_SIGMAS = 2.5, 4.0
"""A number this far off is looked at more closely; a mount is corrected only if this is sure, for
poses change with it."""

LEAST_WINDOWS, LEAST_UNDECLARED = 12, 3
"""Fewer windows correct nothing: glass or people in one of them count too much. Fewer are enough
for the sweep of scans without beam times, which is a number that was left out and not one that is
contradicted: in 12 s of a tenth of a second each it leads 14 mm astray, and is found to 1 ms."""

HARM, HARM_SIGMAS = np.array([2e-3, 0.01, 5e-3, 0.03, 0.03, np.deg2rad(1.0), 0.03]), 2.0
"""Errors of this size are to be excluded with so many sigmas by the first look: a third of a degree
over half a turn, the noise of a range, half a degree at 100 degrees a second, three of them."""

PLACE_TOLERANCE_M, POSES_TOLERANCE_M = 0.02, 0.06
TOLERANCE = np.array([2e-4, 2e-3, 5e-4, *(2 * [PLACE_TOLERANCE_M]), np.deg2rad(1.0), KNOWN_DELAY_S])
"""Errors up to this are left as they are: maps do not show them, and no bracket is better. Odometry
that comes as poses is about some point of the driver's: of four Radish logs it puts the laser up to
44 mm and 0.6 degrees from where relations that were verified by hand have it."""

LEVEL = 0.98
"""Cosine of the tilt from which on steps in the plane of the scans are none of the floor's."""

BENT = [ANGLE_SCALE, RANGE_OFFSET]
"""What noise makes of these is looked into before they are corrected; of the sweep it is known
(``scan_motion.made_up_sweep``)."""

LIVELY, MOST = 0.9, 2.0
"""Of all steps between scans, this share is smaller than the unit of liveliness; more than so many
units count no more."""

_FIRST = ""
"""For a topic, of which a log does not know the first lidar's."""


def laser_of(
    log: Log, odometry: Odometry | None, config: SlamConfig, failures: Failures
) -> LaserCalibration:
    """A log's lidars as their scans and odometry show them; as declared if that is wanted, or
    fails."""
    found = LaserCalibration.unknown(log.T_base_laser)
    if config.calibrate_laser:
        with failures.caught("laser calibration", 0):
            lidars, motion = _lidars(log, odometry), config.front_end.motion
            first, *beside = _moved_together(
                [_calibrated(one, odometry, motion) for one in lidars.values()]
            )
            found = replace(first, beside=dict(zip([*lidars][1:], beside, strict=True)))
    return found


def calibrate_laser(log: Log, odometry: Odometry | None, config: MotionConfig) -> LaserCalibration:
    """What the log itself says of its laser; nothing is corrected where it says too little. Other
    lidars beside it are left alone."""
    return _calibrated(_lidars(log, odometry)[_FIRST], odometry, config)[0]


def _calibrated(
    lidar: _Lidar, odometry: Odometry | None, config: MotionConfig
) -> tuple[LaserCalibration, Mount | None]:
    scans, windows, T_base_laser = lidar.scans, lidar.windows, lidar.T_base_laser
    unknown = LaserCalibration.unknown(T_base_laser, lidar.sweep_s)
    mount: Mount | None = None
    some = windows[:: max(len(windows) // FIRST_WINDOWS, 1)]
    for looked_at in (some, windows):
        motions = window_motions(scans, looked_at)
        found = _with_shape(unknown, motions)
        if found.corrected[BENT].any():
            motions = without_noise_bias(scans, looked_at, motions)
            found = _with_shape(unknown, motions)
        if odometry is not None and abs(float(T_base_laser[2, 2])) >= LEVEL:
            moved = stretches(motions.windows, found.later_ns, odometry)
            moved = moved.mirrored() if T_base_laser[2, 2] < 0.0 else moved
            found = replace(found, reversed=reversed_parts(moved.turns_rad))
            upside_down = found.reversed.laser != bool(T_base_laser[2, 2] < 0.0)
            moved = moved.mirrored() if found.reversed.laser else moved
            if _declares_mount(T_base_laser):
                mount = _mount(moved, motions, found, odometry, config, upside_down=upside_down)
                found = _with_mount(found, mount, by_counters=lidar.by_counters)
        if not _doubtful(found) or len(some) == len(windows):
            break
    return found, mount


def _mount(
    moved: Stretches,
    motions: ScanMotions,
    found: LaserCalibration,
    odometry: Odometry,
    config: MotionConfig,
    *,
    upside_down: bool,
) -> Mount | None:
    """The mount and the delay, which is sought again about the one that was found until it stays:
    one step is right only while the robot turns evenly. Unknown if it does not stay. moved: the
    laser as seen from above, with odometry as stamped."""
    delay_s = 0.0
    for _ in range(DELAY_ROUNDS):
        mount = find_mount(moved, found.declared[MOUNT], config)
        if mount is None:
            return None
        found_s, mount = float(mount.off[-1]), mount.delayed(delay_s)
        if abs(found_s) < DELAY_STEP_S:
            return mount
        delay_s += found_s
        again = stretches(motions.windows, found.later_ns + round(1e9 * delay_s), odometry)
        moved = again.mirrored() if upside_down else again
        unsure = replace(mount, sigmas=np.append(mount.sigmas[:-1], np.inf))
    return unsure


@dataclass(frozen=True, slots=True, eq=False)
class _Lidar:
    """A lidar of a log as its calibration sees it.

    scans: those of the windows alone. windows: as indices of these. sweep_s: from the first beam to
    the last, as declared. by_counters: whether odometry is that of wheel encoders.
    """

    T_base_laser: FloatArray
    scans: RawScans
    windows: list[IntArray]
    sweep_s: float
    by_counters: bool


def _lidars(log: Log, odometry: Odometry | None) -> dict[str, _Lidar]:
    """All lidars by their topics, the first one under ``_FIRST``. The log is read twice, for the
    stamps alone and for the scans of the windows: all ranges of a long one fill the memory."""
    stamps_ns: defaultdict[str, list[int]] = defaultdict(list)
    mounts = {_FIRST: log.T_base_laser}
    for one in _all_scans(log):
        stamps_ns[one.topic].append(one.scan.stamp_ns)
        mounts.setdefault(one.topic, one.T_base_laser)
    windows = {topic: _windows(stamps_ns[topic], odometry) for topic in mounts}

    wanted = {
        topic: {number for window in each for number in window.tolist()}
        for topic, each in windows.items()
    }
    number: Counter[str] = Counter()
    kept: dict[str, list[Scan]] = {topic: [] for topic in mounts}
    for one in _all_scans(log):
        if number[one.topic] in wanted[one.topic]:
            kept[one.topic].append(one.scan)
        number[one.topic] += 1
    return {
        topic: _Lidar(
            T_base_laser=T_base_laser,
            scans=_raw(kept[topic]),
            windows=[np.searchsorted(sorted(wanted[topic]), each) for each in windows[topic]],
            sweep_s=1e-9 * max((scan.geometry.duration_ns for scan in kept[topic][:1]), default=0),
            by_counters=log.encoders is not None,
        )
        for topic, T_base_laser in mounts.items()
    }


def _all_scans(log: Log) -> Iterator[ScanBeside]:
    """Of all lidars."""
    for scan in log.scans:
        yield ScanBeside(scan, log.T_base_laser, _FIRST)
        yield from scan.beside


def _windows(stamps_ns: list[int], odometry: Odometry | None) -> list[IntArray]:
    stamps = np.array(stamps_ns, dtype=np.int64)
    return choose_windows(stamps, _activity(odometry, stamps))


def _activity(odometry: Odometry | None, stamps_ns: IntArray) -> FloatArray | None:
    """(n,) how much the robot drives and turns until each scan."""
    if odometry is None or not stamps_ns.size:
        return None
    first_ns, last_ns = odometry.stamps_ns[[0, -1]].tolist()
    path = odometry.path(first_ns, last_ns, np.zeros(PARAMETERS))
    steps = np.abs(np.diff(path.poses, axis=0))
    steps[:, 2] = np.minimum(steps[:, 2], 2.0 * np.pi - steps[:, 2])
    active = np.zeros(stamps_ns.size)
    for moved in (np.hypot(steps[:, 0], steps[:, 1]), steps[:, 2]):
        total = np.concatenate([[0.0], np.cumsum(moved)])
        at_s = (stamps_ns - first_ns) * 1e-9
        until = np.interp(at_s, (path.stamps_ns - first_ns) * 1e-9, total)
        between = np.abs(np.diff(until, prepend=until[0]))
        unit = float(np.quantile(between, LIVELY))
        if unit > 0.0:
            active += np.minimum(between / unit, MOST)
    return active


def _raw(scans: list[Scan]) -> RawScans:
    numbers: dict[ScanGeometry, int] = {}
    layout_of = [numbers.setdefault(scan.geometry, len(numbers)) for scan in scans]
    return RawScans(
        topic="",
        frame_ids=(),
        stamps_ns=np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
        received_ns=None,
        layouts=tuple(map(_layout, numbers)),
        layout_of=np.array(layout_of, dtype=np.int32),
        ranges_m=[scan.ranges_m for scan in scans],
    )


def _layout(geometry: ScanGeometry) -> ScanLayout:
    span_rad = geometry.angle_step_rad * (geometry.beam_count - 1)
    return ScanLayout(
        angle_min_rad=geometry.angle_min_rad,
        angle_max_rad=geometry.angle_min_rad + span_rad,
        angle_step_rad=geometry.angle_step_rad,
        beam_dt_s=geometry.beam_dt_ns * 1e-9,
        scan_time_s=0.0,
        range_min_m=geometry.range_min_m,
        range_max_m=geometry.range_max_m,
    )


def _with_shape(found: LaserCalibration, motions: ScanMotions) -> LaserCalibration:
    told = (motions.angle_step, motions.range_offset_m, motions.sweep_s)
    sweep, angle, offset = motions.contradicted.tolist()
    least_for_sweep = LEAST_WINDOWS if found.declared[SWEEP] else LEAST_UNDECLARED
    least = np.array([LEAST_WINDOWS, LEAST_WINDOWS, least_for_sweep])
    return found.told(
        SHAPE,
        np.array([one.value for one in told]),
        np.array([one.sigma for one in told]),
        np.array([angle, offset, sweep]) & (len(motions.windows) >= least),
    )


def _declares_mount(T_base_laser: FloatArray) -> bool:
    """Not of a laser at the very origin: poses are then the laser's, as nearly all CARMEN logs
    have it, and where the axle lies is not asked."""
    return not np.array_equal(T_base_laser[:2], np.eye(4)[:2])


def _with_mount(
    found: LaserCalibration, mount: Mount | None, *, by_counters: bool
) -> LaserCalibration:
    """A laser that is turned, but at the origin, stays there for the same reason. Where scans and
    odometry do not show one motion, as of a robot that skids, or show the delay no better than what
    is tolerated of it (2 Hz: 135 +- 23 ms for none), stamps are left alone; skidding wheels turn it
    about a point that may as well be elsewhere than its base, so that the place of the laser is
    told, and left as well."""
    if mount is None:
        return found
    tolerance = TOLERANCE.copy()
    if not by_counters:
        tolerance[MOUNT][:2] = POSES_TOLERANCE_M
    values = found.declared[PLACED] + mount.off
    told = found.told(PLACED, values, mount.sigmas, np.zeros(4, dtype=np.bool_))
    wrong = _off(told, as_sure_as(SURE_SIGMAS, mount.windows), tolerance)[PLACED]
    wrong &= np.append(_placed(found), mount.fits and mount.sigmas[-1] < KNOWN_DELAY_S)
    left = wrong & [not mount.fits, not mount.fits, False, False]
    return replace(found.told(PLACED, values, mount.sigmas, wrong & ~left), left=left[:3])


def _placed(found: LaserCalibration) -> BoolArray:
    """(3,) which numbers of the mount may be corrected at all."""
    return np.array([*(2 * [bool(found.declared[MOUNT][:2].any())]), True])


def _moved_together(lidars: list[tuple[LaserCalibration, Mount | None]]) -> list[LaserCalibration]:
    """Mounts of several are corrected only where each is known: a base that is elsewhere than
    declared is so for all of them, and walls would be doubled by moving some. For the same reason
    a number that is corrected of one goes to where it was found, within the tolerance too, of each.
    """
    if len(lidars) == 1:
        return [lidars[0][0]]
    wrong = np.any([one.corrected[MOUNT] for one, _ in lidars], axis=0)
    wrong &= all(_known(one) for one, _ in lidars)
    moved = []
    for one, mount in lidars:
        sigmas = np.inf if mount is None else as_sure_as(DOUBT_SIGMAS, mount.windows)
        off = _off(one, sigmas, np.zeros(len(TOLERANCE)))[MOUNT]
        moved.append(one.told(MOUNT, one.values[MOUNT], one.sigmas[MOUNT], wrong & off))
    return moved


def _known(found: LaserCalibration) -> bool:
    """Whether the mount may be corrected, and no error of it that matters would be missed."""
    sure = HARM_SIGMAS * found.sigmas[MOUNT] < HARM[MOUNT]
    return bool((sure & _placed(found)).all())


def _doubtful(found: LaserCalibration) -> bool:
    """Whether a closer look may find an error that matters."""
    largest = np.abs(found.values - found.declared) + HARM_SIGMAS * found.sigmas
    harm = np.isfinite(largest) & (largest > HARM)
    return bool((harm | _off(found, DOUBT_SIGMAS, TOLERANCE)).any())


def _off(found: LaserCalibration, sigmas: float, tolerance: FloatArray) -> BoolArray:
    """(7,) which numbers differ from the declared by more than so many sigmas, and more than the
    tolerance (7,)."""
    off = np.abs(found.values - found.declared)
    return np.asarray(off > np.maximum(sigmas * found.sigmas, tolerance))
