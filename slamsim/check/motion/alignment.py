"""First look at what scans, gyroscope and wheels see in common: which stamps are off by how much,
roughly, which stream has the wrong sign, and which wheel counts backward."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slamsim.check.motion.coarse_offset import CLEAR, Lag, Rate, coarse_lag
from slamsim.check.motion.integrated import IntegratedMotion, rearranged
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.motion.local_lags import local_lags
from slamsim.core.types import FloatArray

Wiring = Literal[
    "as declared",
    "swapped",
    "left reversed",
    "right reversed",
    "both reversed",
    "left dead",
    "right dead",
]

Scans = Literal["of use", "unsteady", "not turning"]

UNSURE_SHARE, UNSURE_TIMES, LEAST_TOLD = 0.2, 3.0, 0.5
"""A step tells no turn if it is unsure by this share of what the robot usually turns in one, and by
so many times the usual; so many of all must tell it."""

BETTER = 0.15
"""A wheel counts backward if its path turns like the robot, by so much more than its turn does."""

ONE_CIRCLE = 0.9999
"""Correlation of path and turn of one wheel that rolls alone, but for what rounding leaves."""

PATH, TURN = 0, 1
DISAGREES, DISAGREES_TIMES = 0.04, 5.0
WANDER_S = 0.08
LIKE_ENERGY = 0.2
"""Scans that turn far less, or more, than the gyroscope have another fault than their stamps."""


@dataclass(frozen=True, slots=True)
class Shift:
    """shift_ns: what must be added to the stamps of the one stream for those of the other."""

    shift_ns: int
    correlation: float
    clear: bool


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """lidar_gyro, lidar_wheels, gyro_wheels: None where one of them says nothing. wheels: with the
    wiring as it was found."""

    lidar_gyro: Shift | None
    lidar_wheels: Shift | None
    gyro_wheels: Shift | None
    wheels: IntegratedMotion | None
    wiring: Wiring
    mirror: bool = False
    """The scans have been mirrored before the fit, for they turned the wrong way."""

    growth: float = 0.0
    """Of the shifts against the lidar, per second, if one number does not do."""

    scans: Scans = "of use"
    """Whether they turn with the others, which agree: not at all, or at no steady clock."""

    @property
    def mirrored(self) -> bool:
        """Whether the scans turn the wrong way, compared with all other streams."""
        others = [one for one in (self.lidar_gyro, self.lidar_wheels) if one is not None]
        opposite = all(one.clear and one.correlation < 0.0 for one in others)
        return self.lidar_wheels is not None and opposite

    @property
    def shifts_ns(self) -> tuple[int, int]:
        """Of gyroscope and wheels against the lidar, directly or by each other; 0 if unclear."""
        gyro, wheels, between = self.lidar_gyro, self.lidar_wheels, self.gyro_wheels
        gyro_ns = gyro.shift_ns if gyro is not None and gyro.clear else None
        wheels_ns = wheels.shift_ns if wheels is not None and wheels.clear else None
        if between is not None and between.clear:
            if gyro_ns is None and wheels_ns is not None:
                gyro_ns = wheels_ns - between.shift_ns
            elif wheels_ns is None:
                wheels_ns = (gyro_ns or 0) + between.shift_ns
        return gyro_ns or 0, wheels_ns or 0


def align(
    steps: LaserSteps,
    gyro: IntegratedMotion | None,
    wheels: IntegratedMotion | None,
    yaw_base_laser_rad: float,
) -> Alignment:
    """All three pairs, once the wheels are wired as the others say."""
    steps = _telling(steps)
    turns = [_laser_turn(steps)] if len(steps) else []
    turns += [_rate(gyro, 0)] if gyro is not None else []
    wiring: Wiring = "as declared"
    if wheels is not None:
        wiring = _wiring(laser_path(steps, yaw_base_laser_rad), steps, turns, wheels)
        wheels = rearranged(wheels, wiring) if wheels.wired else wheels
    laser = _laser_turn(steps) if len(steps) else None
    by_gyro = _rate(gyro, 0) if gyro is not None else None
    by_wheels = _rate(wheels, TURN) if wheels is not None else None
    lidar_gyro, lidar_wheels = _shift(laser, by_gyro), _shift(laser, by_wheels)
    first_look = Alignment(lidar_gyro, lidar_wheels, _shift(by_gyro, by_wheels), wheels, wiring)
    if laser is None or by_gyro is None or not _lidar_disagrees(first_look):
        return first_look
    return _piece_by_piece(first_look, laser, steps, by_gyro)


def _telling(steps: LaserSteps) -> LaserSteps:
    """Without those whose turn the scans do not tell, as where round walls let it slide; all of
    them where that holds of most."""
    if not np.any(steps.information):
        return steps
    sigma_rad = np.sqrt(np.linalg.pinv(steps.information, hermitian=True)[:, 2, 2])
    turns_rad = float(np.sqrt(np.mean(np.square(steps.T_first_second[:, 2]))))
    told = sigma_rad < max(UNSURE_SHARE * turns_rad, UNSURE_TIMES * float(np.median(sigma_rad)))
    return steps.select(told) if told.mean() > LEAST_TOLD else steps


def _lidar_disagrees(look: Alignment) -> bool:
    """Whether the other two agree much better with each other than with the lidar."""
    pairs = (look.lidar_gyro, look.lidar_wheels, look.gyro_wheels)
    to_gyro, to_wheels, others = (0.0 if one is None else abs(one.correlation) for one in pairs)
    return 1.0 - max(to_gyro, to_wheels) > DISAGREES + DISAGREES_TIMES * (1.0 - others)


def _piece_by_piece(
    look: Alignment, laser: _Timed, steps: LaserSteps, by_gyro: _Timed
) -> Alignment:
    """The lidar's clock followed window by window: it drifts, or it contradicts everything."""
    since_s = (by_gyro.origin_ns - laser.origin_ns) * 1e-9
    turns = by_gyro.rate
    moved = Rate(turns.starts_s + since_s, turns.ends_s + since_s, turns.values)
    piece_of = steps.window[np.argsort(steps.first_ns, kind="stable")]
    sign = -1.0 if look.lidar_gyro is not None and look.lidar_gyro.correlation < 0.0 else 1.0
    lags = local_lags(laser.rate, piece_of, moved, sign)
    if lags is None or lags.wander_s() > WANDER_S:
        energy = np.mean(np.square(laser.rate.values)), np.mean(np.square(turns.values))
        turning = LIKE_ENERGY < energy[0] / max(float(energy[1]), 1e-12) < 1.0 / LIKE_ENERGY
        return replace(look, scans="unsteady" if turning and lags is not None else "not turning")
    at_zero, growth = lags.line()
    middle_s = 0.5 * float(laser.rate.starts_s[0] + laser.rate.ends_s[-1])
    gyro_ns = round((at_zero + growth * middle_s) * 1e9)
    between = look.gyro_wheels
    wheels = None if between is None else Shift(gyro_ns + between.shift_ns, 1.0, True)
    return replace(look, lidar_gyro=Shift(gyro_ns, sign, True), lidar_wheels=wheels, growth=growth)


def laser_path(steps: LaserSteps, yaw_base_laser_rad: float) -> FloatArray:
    """(n,) path of each step along the base's x axis, m, but for the laser's own lever."""
    cos, sin = np.cos(yaw_base_laser_rad), np.sin(yaw_base_laser_rad)
    return np.asarray(cos * steps.T_first_second[:, 0] - sin * steps.T_first_second[:, 1])


@dataclass(frozen=True, slots=True, eq=False)
class _Timed:
    origin_ns: int
    rate: Rate


def _laser_turn(steps: LaserSteps) -> _Timed:
    return _laser(steps, steps.T_first_second[:, 2])


def _laser(steps: LaserSteps, moved: FloatArray) -> _Timed:
    order = np.argsort(steps.first_ns, kind="stable")
    origin = int(steps.first_ns[order[0]])
    starts = np.asarray((steps.first_ns[order] - origin) * 1e-9)
    ends = np.asarray((steps.second_ns[order] - origin) * 1e-9)
    return _Timed(origin, Rate(starts, ends, moved[order] / (ends - starts)))


def _rate(motion: IntegratedMotion, column: int) -> _Timed:
    values = np.diff(motion.totals[:, column]) / np.diff(motion.times_s)
    return _Timed(motion.origin_ns, Rate(motion.times_s[:-1], motion.times_s[1:], values))


def _shift(one: _Timed | None, other: _Timed | None) -> Shift | None:
    if one is None or other is None:
        return None
    apart_ns = other.origin_ns - one.origin_ns
    begin_s = apart_ns * 1e-9
    disjoint = begin_s > one.rate.ends_s[-1] or begin_s + other.rate.ends_s[-1] < 0.0
    guess_ns = apart_ns if disjoint else 0
    since_s = (apart_ns - guess_ns) * 1e-9
    moved = Rate(other.rate.starts_s + since_s, other.rate.ends_s + since_s, other.rate.values)
    lag: Lag | None = coarse_lag(one.rate, moved)
    if lag is None:
        return None
    return Shift(guess_ns + round(lag.lag_s * 1e9), lag.correlation, lag.clear)


def _wiring(
    ahead_m: FloatArray, steps: LaserSteps, turns: list[_Timed], wheels: IntegratedMotion
) -> Wiring:
    """Left and right as the others see them: a wheel that counts backward makes the reported path
    turn like the robot, and the reported turn go forward like it."""
    by_turn = [_correlation(turn, _rate(wheels, TURN)) for turn in turns]
    by_path = [_correlation(turn, _rate(wheels, PATH)) for turn in turns]
    strongest = [max((abs(one) for one in found), default=0.0) for found in (by_turn, by_path)]
    along, turned = np.diff(wheels.totals, axis=0).T
    if not wheels.wired and strongest[0] < CLEAR and _is_one_wheel(along, turned):
        return "left dead" if float(along @ turned) > 0.0 else "right dead"
    if strongest[1] > max(CLEAR, strongest[0] + BETTER):
        forward = float(wheels.totals[-1, TURN] - wheels.totals[0, TURN])
        return "left reversed" if forward > 0.0 else "right reversed"
    if len(by_turn) < 2 or max(by_turn) > -CLEAR:
        return "as declared"
    ahead = _correlation(_laser(steps, ahead_m), _rate(wheels, PATH))
    return "both reversed" if ahead < -CLEAR else "swapped"


def _is_one_wheel(along_m: FloatArray, turned_rad: FloatArray) -> bool:
    """Whether steps of an odometry all lie on one circle, as if one wheel alone rolled."""
    lengths = float(np.linalg.norm(along_m) * np.linalg.norm(turned_rad))
    return lengths > 0.0 and abs(float(along_m @ turned_rad)) > ONE_CIRCLE * lengths


def _correlation(one: _Timed, other: _Timed) -> float:
    found = _shift(one, other)
    return 0.0 if found is None else found.correlation
