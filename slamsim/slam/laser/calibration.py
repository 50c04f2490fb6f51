"""A laser as it is, not as its recording declares it: what differs, and a log put right by it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from slamsim.core.geometry import rotation, se2_from_se3, wrap_angle
from slamsim.core.result import Calibrated
from slamsim.core.types import (
    BoolArray,
    FloatArray,
    Log,
    Scan,
    ScanBeside,
    ScanGeometry,
    ScanSource,
)
from slamsim.guard.quantities import as_interval
from slamsim.slam.laser.reversed import NONE_REVERSED, UPSIDE_DOWN, Reversed

NAMES = (
    "laser_angle_scale",
    "laser_range_offset_m",
    "laser_sweep_s",
    "laser_x_m",
    "laser_y_m",
    "laser_yaw_rad",
    "laser_delay_s",
)
ANGLE_SCALE, RANGE_OFFSET, SWEEP = range(3)
SHAPE, MOUNT, YAW, DELAY = slice(0, 3), slice(3, 6), 5, 6
PLACED = slice(3, 7)
PRIOR_SIGMAS = np.array([0.005, 0.03, 0.025, 0.05, 0.05, np.deg2rad(2.0), 0.05])
"""What is to be expected of a laser before it was looked at: step between beams confused with that
of one beam more or less; +-30 mm of Hokuyo and SICK; beam times left out; a mount by tape; stamps
by software."""

NO_SWEEP = 0.15
"""Sweeps shorter than this share of the declared one are none: mirrors take as long as is declared,
or all beams fire at once."""

KNOWN_DELAY_S = 0.01
"""Delays up to this are left as they are, and one that is known no better is not known."""

OBSERVED_SHARE = 0.3
"""A number counts as observed if the recording left less than this of what was uncertain."""


def swept_s(found_s: float, sigma_s: float, declared_s: float) -> float:
    """From the beam that has the stamp to the other end of a sweep, of one that scans tell.

    Below 0 only where that is declared. Where it plainly is although nothing declares it, the last
    beam fired first, and has the stamp: a driver that turns an array round (a clockwise lidar's, to
    make it counter-clockwise) stamps the begin of the sweep. Beams of one instant come out as a
    little before or after each other.
    """
    if abs(found_s) < NO_SWEEP * abs(declared_s):
        return 0.0
    if found_s >= 0.0 or declared_s < 0.0:
        return found_s
    return -found_s if found_s + 1.96 * sigma_s < 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LaserCalibration:
    """(7,) arrays in the order of ``NAMES``.

    Angle between beams, true over declared; by how much ranges are too long; seconds from the
    first beam to the last; T_base_laser in the plane; seconds by which a scan was taken later than
    its stamp says by wheels and gyroscope. values: as found, with sigmas (infinite where
    nothing told); declared: by the recording; corrected: which are contradicted so plainly that the
    value found is used. reversed: what turns the other way than the robot. beside: of the robot's
    other lidars, by their topics. left: (3,) which of the mount are as plainly contradicted, but by
    wheels that skid.
    """

    values: FloatArray
    sigmas: FloatArray
    declared: FloatArray
    corrected: BoolArray
    reversed: Reversed = NONE_REVERSED
    beside: Mapping[str, LaserCalibration] = field(default_factory=dict)
    left: BoolArray = field(default_factory=lambda: np.zeros(3, dtype=np.bool_))

    @staticmethod
    def unknown(T_base_laser: FloatArray, sweep_s: float = 0.0) -> LaserCalibration:
        """Nothing known but what is declared; sweep_s: of all beams of a scan."""
        declared = np.array([1.0, 0.0, sweep_s, *se2_from_se3(T_base_laser), 0.0])
        none = np.zeros(len(NAMES), dtype=np.bool_)
        return LaserCalibration(declared, np.full(len(NAMES), np.inf), declared, none)

    def told(
        self, which: slice, values: FloatArray, sigmas: FloatArray, corrected: BoolArray
    ) -> LaserCalibration:
        """With some of the numbers as they were found."""
        all_values, all_sigmas = self.values.copy(), self.sigmas.copy()
        all_corrected = self.corrected.copy()
        all_values[which], all_sigmas[which], all_corrected[which] = values, sigmas, corrected
        return replace(self, values=all_values, sigmas=all_sigmas, corrected=all_corrected)

    @property
    def used(self) -> FloatArray:
        """(7,) found where corrected, else declared."""
        return np.where(self.corrected, self.values, self.declared)

    @property
    def backward(self) -> bool:
        """Whether the last beam plainly fired first, although nothing declares it."""
        return bool(self.used[SWEEP] < 0.0 < self.sweep_s)

    @property
    def sweep_s(self) -> float:
        """See ``swept_s``."""
        told = self.used[SWEEP], self.sigmas[SWEEP], self.declared[SWEEP]
        return swept_s(*(float(one) for one in told))

    @property
    def is_turned_round(self) -> bool:
        """Whether place and direction are the declared ones turned by 180 degrees about the base,
        as those of a robot whose wheels are read backward; a laser that looks the other way stays
        in its place."""
        declared = self.declared[MOUNT]
        off = self.values[MOUNT] - np.append(-declared[:2], declared[2] + np.pi)
        off[2] = wrap_angle(off[2])
        agrees = np.abs(off) < np.minimum(_SURE_SIGMAS * self.sigmas[MOUNT], _TURNED_WITHIN)
        return bool(self.corrected[YAW] and agrees.all())

    @property
    def later_ns(self) -> int:
        """By how much the middle beam fired later after the stamp than declared."""
        return round(0.5e9 * (self.sweep_s - float(self.declared[SWEEP])))

    @property
    def is_stamped_at_end(self) -> bool:
        """Whether scans are plainly stamped when their sweep ends, or as they then arrive: they are
        given the instant of their first beam."""
        off_s, sweep_s = float(self.used[DELAY]), self.sweep_s
        within_s = max(_SURE_SIGMAS * float(self.sigmas[DELAY]), _ON_ARRIVAL_S)
        return off_s != 0.0 and sweep_s > 2.0 * within_s and abs(off_s + sweep_s) < within_s

    @property
    def moves_odometry(self) -> bool:
        """Whether wheels and gyroscope are set to the clock of the scans. Which of them is wrong
        nothing tells (in fr079 both are 135 ms apart, by a serial line): poses keep the stamps that
        the scans have."""
        return float(self.used[DELAY]) != 0.0 and not self.is_stamped_at_end

    def applied(self, log: Log) -> Log:
        """The log as its lidars really recorded it, with a warning for each number corrected."""
        if not any(one._differs for one in (self, *self.beside.values())):
            return log
        warnings = self._warnings(moves_odometry=self.moves_odometry)
        for topic, one in self.beside.items():
            warnings += [f"{topic}: {words}" for words in one._warnings(moves_odometry=False)]
        if self.moves_odometry:
            log = _with_motion_later(log, round(-1e9 * float(self.used[DELAY])))
        return replace(
            log,
            scans=_Corrected(log.scans, self),
            T_base_laser=self.mounted(log.T_base_laser),
            warnings=(*warnings, *log.warnings),
        )

    def mounted(self, T_base_laser: FloatArray) -> FloatArray:
        """4 x 4 moved and turned about the base's z from where it is declared to where it is, and
        rolled by half a turn if it hangs upside down; height and tilt kept."""
        declared, used = self.declared[MOUNT], self.used[MOUNT]
        moved = T_base_laser.copy()
        moved[:2, :3] = rotation(used[2] - declared[2])[:2, :2] @ T_base_laser[:2, :3]
        moved[:2, 3] += used[:2] - declared[:2]
        return moved @ UPSIDE_DOWN if self.reversed.laser else moved

    def calibrated(self) -> dict[str, Calibrated]:
        """Every number that the recording tells anything of, under its name with its unit."""
        values = self.values.copy()
        values[YAW] = wrap_angle(values[YAW])
        return {
            name: Calibrated(float(value), float(sigma), bool(sigma < OBSERVED_SHARE * before))
            for name, value, sigma, before in zip(
                NAMES, values, self.sigmas, PRIOR_SIGMAS, strict=True
            )
            if np.isfinite(sigma)
        }

    @property
    def _differs(self) -> bool:
        return bool(self.corrected.any() or self.left.any()) or self.reversed.laser

    def _warnings(self, *, moves_odometry: bool) -> list[str]:
        off = self.values - self.declared
        size, doubt = off * _UNITS, self.sigmas * _UNITS
        told = [_UPSIDE_DOWN] if self.reversed.laser else []
        told += [_TURNED_ROUND] if self.is_turned_round else []
        shown = self.corrected.copy()
        shown[MOUNT] |= self.left
        shown[MOUNT] &= not self.is_turned_round
        for n in np.flatnonzero(shown):
            sentence, more, less = _WORDS[n]
            interval = as_interval(abs(float(size[n])), float(doubt[n]))
            if n == SWEEP and self.backward:
                sentence = "the last beam fires first, the first one {} ms later"
                interval = as_interval(-float(self.used[n] * _UNITS[n]), float(doubt[n]))
            if n == DELAY and moves_odometry:
                sentence, more, less = _OF_ODOMETRY
            end = "; corrected" if self.corrected[n] else _LEFT
            told.append(sentence.format(interval, more if size[n] > 0.0 else less) + end)
        return told


_SURE_SIGMAS = 3.0
_ON_ARRIVAL_S = 0.005
"""Scans that are stamped on arrival come some milliseconds after their last beam."""
_TURNED_WITHIN = np.array([0.05, 0.05, np.deg2rad(10.0)])
"""However unsure a mount is: as well as a tape and a glance tell one."""
_TURNED_ROUND = (
    "the wheels are read backward, or the laser looks the other way from the other side of the "
    "base; corrected"
)
_LEFT = (
    " from the point about which the robot turns; left as declared, for the wheels skid, and that "
    "point may as well be elsewhere than the base"
)
_UPSIDE_DOWN = (
    "the scans turn against wheels and gyroscope: the lidar is mounted upside down, and the "
    "transform to it does not say so; corrected"
)
_UNITS = np.array([100.0, 1e3, 1e3, 1e3, 1e3, np.rad2deg(1.0), 1e3])
"""From shares, metres and radians to the units of _WORDS."""
_WORDS = (
    ("the angle between beams is {} % {} than declared", "larger", "smaller"),
    ("ranges are {} mm too {}", "long", "short"),
    ("a sweep lasts {} ms {} than declared", "longer", "shorter"),
    ("the laser sits {} mm further {} than declared", "forward", "back"),
    ("the laser sits {} mm further to the {} than declared", "left", "right"),
    ("the laser looks {} degrees further to the {} than declared", "left", "right"),
    ("scans are stamped {} ms too {} for wheels and gyroscope", "early", "late"),
)


_OF_ODOMETRY = ("wheels and gyroscope are stamped {} ms too {} for the scans", "late", "early")


def _with_motion_later(log: Log, later_ns: int) -> Log:
    """The log with the stamps of wheels, odometry and inertial unit moved."""
    odometry, encoders, imu = log.odometry, log.encoders, log.imu
    if odometry is not None:
        odometry = replace(odometry, stamps_ns=odometry.stamps_ns + later_ns)
    if encoders is not None:
        encoders = replace(encoders, stamps_ns=encoders.stamps_ns + later_ns)
    if imu is not None:
        imu = replace(imu, stamps_ns=imu.stamps_ns + later_ns)
    return replace(log, odometry=odometry, encoders=encoders, imu=imu)


class _Corrected:
    """The scans of all lidars with other angles, ranges and beam times, made as they are asked
    for."""

    def __init__(self, scans: ScanSource, lidar: LaserCalibration) -> None:
        clock_s = float(lidar.used[DELAY]) if lidar.moves_odometry else 0.0
        self._scans, self._own = scans, _CorrectedShape(lidar, clock_s)
        self._beside = {
            topic: (_CorrectedShape(one, clock_s), one.mounted)
            for topic, one in lidar.beside.items()
        }

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[Scan]:
        for scan in self._scans:
            beside = tuple(map(self._corrected_beside, scan.beside))
            yield replace(self._own.corrected(scan), beside=beside)

    def _corrected_beside(self, other: ScanBeside) -> ScanBeside:
        known = self._beside.get(other.topic)
        if known is None:
            return other
        shape, mounted = known
        return ScanBeside(shape.corrected(other.scan), mounted(other.T_base_laser), other.topic)


class _CorrectedShape:
    """Corrects the scans of one lidar. clock_s: its delay if it has the clock to which wheels and
    gyroscope are set, which one whose own delay is not known has."""

    def __init__(self, lidar: LaserCalibration, clock_s: float) -> None:
        used = lidar.used
        self._scale, self._offset_m = float(used[ANGLE_SCALE]), float(used[RANGE_OFFSET])
        is_known = float(lidar.sigmas[DELAY]) < KNOWN_DELAY_S
        later_s = float(used[DELAY]) - clock_s if is_known else 0.0
        self._later_ns = round(1e9 * later_s)
        self._backward = lidar.backward
        sweep_s = -lidar.sweep_s if self._backward else lidar.sweep_s
        self._longer_s = sweep_s - float(lidar.declared[SWEEP])
        self._geometries: dict[ScanGeometry, ScanGeometry] = {}

    def corrected(self, scan: Scan) -> Scan:
        """As the lidar really took it, its beams in the order of their firing."""
        geometry = self._geometries.get(scan.geometry)
        if geometry is None:
            geometry = self._geometries[scan.geometry] = self._of(scan.geometry)
        ranges_m = scan.ranges_m
        if self._offset_m != 0.0:
            ranges_m = ranges_m - np.float32(self._offset_m)
            ranges_m = np.where(ranges_m > 0.0, ranges_m, np.float32(np.nan))
        scan = replace(scan, stamp_ns=scan.stamp_ns + self._later_ns)
        if not self._backward:
            return replace(scan, ranges_m=ranges_m, geometry=geometry)
        intensities = None if scan.intensities is None else scan.intensities[::-1]
        ranges_m = np.ascontiguousarray(ranges_m[::-1])
        return replace(scan, ranges_m=ranges_m, geometry=geometry, intensities=intensities)

    def _of(self, geometry: ScanGeometry) -> ScanGeometry:
        """Angles about the middle beam, limits moved with the ranges; the beam that fires first
        has the stamp, unless it is declared that it has not."""
        step_rad = geometry.angle_step_rad * self._scale
        intervals = geometry.beam_count - 1
        first_rad = geometry.angle_min_rad - 0.5 * intervals * (step_rad - geometry.angle_step_rad)
        beam_dt_ns = geometry.beam_dt_ns + round(1e9 * self._longer_s / max(intervals, 1))
        if self._backward:
            first_rad, step_rad = first_rad + intervals * step_rad, -step_rad
            beam_dt_ns = -beam_dt_ns
        return replace(
            geometry,
            angle_min_rad=first_rad,
            angle_step_rad=step_rad,
            beam_dt_ns=beam_dt_ns,
            range_min_m=max(geometry.range_min_m - self._offset_m, 0.0),
            range_max_m=geometry.range_max_m - self._offset_m,
        )
