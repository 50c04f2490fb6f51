"""Finds intervals in which wheels and scans disagree: slip, and counters that stand still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.model import LASER_YAW, Model
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.types import BoolArray, FloatArray, IntArray

SPELL_S = 1.0
LEAST_M, LEAST_RAD, LEAST_SHARE = 0.02, 0.03, 0.04
"""What a spell must differ by, in path or in turn, and as a share of either, to be no noise."""

NOISE_SIGMAS = 6.0
ONE_STEP = 0.7
"""If one step makes up as much of a spell's difference, its scans were matched wrongly."""

STILL_SHARE = 0.02
MOVED_M, MOVED_RAD = 0.05, 0.1
LEAST_S = 0.25
"""Scans that arrived in a burst, stamped then, move within milliseconds in which no wheel does."""


@dataclass(frozen=True, slots=True, eq=False)
class SlipSpells:
    """Consecutive steps of about a second each.

    start_s: (k,) since the middle of the drive, by the lidar. step_of: (n,) the spell of each step.
    wheels, scans: (k, 2) path and turn by either, added up. slipping, frozen: (k,).
    beside_frozen: (k,) the spells before and after, in which the wheels may stand for a part.
    mismatched: (k,) the scans go further than the wheels that turn: more likely the match is
    wrong. least: (k, 2) path and turn below which a difference is noise of the scans.
    """

    start_s: FloatArray
    step_of: IntArray
    wheels: FloatArray
    scans: FloatArray
    slipping: BoolArray
    frozen: BoolArray
    beside_frozen: BoolArray
    mismatched: BoolArray
    least: FloatArray

    @property
    def distrusted(self) -> BoolArray:
        """(n,) steps in which the wheels are not used."""
        return np.asarray((self.slipping | self.frozen | self.mismatched)[self.step_of])


def find_spells(model: Model, values: FloatArray) -> SlipSpells:
    """Wheels against scans with everything else as fitted: (p,) values."""
    step_of = _numbered(model.steps)
    covered = model.rolling(values)
    T_wheels = model.predicted(values)[0]
    by_wheels = _added(T_wheels, covered, values[LASER_YAW], step_of)
    by_scans = _added(model.steps.T_first_second, covered, values[LASER_YAW], step_of)
    by_gyro = _turns_by_gyro(model, values, covered, step_of)
    apart = np.abs(by_wheels - by_scans)
    extent = np.maximum(np.abs(by_wheels), np.abs(by_scans))
    by_noise = NOISE_SIGMAS * _sigmas(model.steps, values[LASER_YAW], step_of)
    least = np.maximum(np.array([LEAST_M, LEAST_RAD]), by_noise)
    limits = np.maximum(least, NOISE_SIGMAS * np.median(apart, axis=0) / 0.6745)
    off = (apart > limits) & (apart > LEAST_SHARE * extent)
    # Wheels are fitted with a radius of 0 where scans err by more than they move.
    reported = _total(np.where(covered[:, None], model.reported(values), 0.0), step_of)
    rolled = np.maximum(np.abs(by_wheels), np.abs(reported))
    still = rolled < STILL_SHARE * np.abs(by_scans)
    moved = np.abs(by_scans) > np.array([MOVED_M, MOVED_RAD])
    frozen = (still & moved & off).any(axis=1) & (still | ~moved).all(axis=1)
    frozen &= _seconds(model.steps, step_of) > LEAST_S
    start_s = np.full(len(by_wheels), np.inf)
    np.minimum.at(start_s, step_of, model.first_s)
    beside = np.zeros_like(frozen)
    beside[1:] |= frozen[:-1]
    beside[:-1] |= frozen[1:]
    lasting = _largest_step(model, T_wheels, covered, values[LASER_YAW], step_of) < ONE_STEP * apart
    farther = np.abs(by_wheels) > np.abs(by_scans)
    # Of two that turn alike and one that does not, it is the one: here the scans.
    alone = np.abs(by_scans[:, 1] - by_gyro) > np.abs(by_wheels[:, 1] - by_gyro)
    lost = alone & (np.abs(by_scans[:, 1] - by_gyro) > limits[:, 1])
    slipping = (off & lasting & farther).any(axis=1) & ~frozen & ~lost
    mismatched = off.any(axis=1) & ~frozen & ~slipping
    return SlipSpells(
        *(start_s, step_of, by_wheels, by_scans, slipping, frozen, beside, mismatched, least)
    )


def _seconds(steps: LaserSteps, step_of: IntArray) -> FloatArray:
    """(k,) how long the steps of each spell take."""
    return np.asarray(np.bincount(step_of, 1e-9 * (steps.second_ns - steps.first_ns)))


def _total(of_steps: FloatArray, step_of: IntArray) -> FloatArray:
    """(k, 2) of each spell, from path and turn (n, 2) of each step."""
    total = np.zeros((int(step_of.max(initial=-1)) + 1, 2))
    np.add.at(total, step_of, of_steps)
    return total


def _turns_by_gyro(
    model: Model, values: FloatArray, covered: BoolArray, step_of: IntArray
) -> FloatArray:
    """(k,) turn of each spell by the gyroscope, nan where it does not cover the whole."""
    count = int(step_of.max(initial=-1)) + 1
    turned = np.bincount(step_of, np.where(covered, model.predicted(values)[1], 0.0), count)
    missing = np.bincount(step_of, covered & ~model.covered(values)[0], count) > 0
    return np.asarray(np.where(missing, np.nan, turned))


def _largest_step(
    model: Model, T_wheels: FloatArray, covered: BoolArray, yaw_rad: float, step_of: IntArray
) -> FloatArray:
    """(k, 2) the most that one step adds to a spell's difference in path and turn."""
    each = np.arange(step_of.size)
    differ = _added(T_wheels, covered, yaw_rad, each)
    differ -= _added(model.steps.T_first_second, covered, yaw_rad, each)
    total = _total(differ, step_of)
    largest = np.zeros_like(total)
    np.maximum.at(largest, step_of, differ * np.sign(total)[step_of])
    return largest


def _numbered(steps: LaserSteps) -> IntArray:
    """(n,) which spell a step belongs to: parts of one window, of about SPELL_S each."""
    second = ((steps.first_ns - steps.first_ns.min()) / (SPELL_S * 1e9)).astype(np.int64)
    labels = np.stack([steps.window, second], axis=1)
    return np.asarray(np.unique(labels, axis=0, return_inverse=True)[1]).reshape(-1)


def _sigmas(steps: LaserSteps, yaw_rad: float, step_of: IntArray) -> FloatArray:
    """(k, 2) standard deviations, m and rad, of path ahead and turn of each spell by the
    scans, as if errors of steps only added up. Along a corridor the path is not known at all."""
    count = int(step_of.max(initial=-1)) + 1
    if not np.any(steps.information):
        return np.zeros((count, 2))
    covariance = np.linalg.pinv(steps.information, hermitian=True)
    heading = yaw_rad + steps.T_first_second[:, 2]
    ahead = np.stack([np.cos(heading), -np.sin(heading), np.zeros(len(steps))], axis=1)
    variance = np.column_stack(
        [np.einsum("ni,nij,nj->n", ahead, covariance, ahead), covariance[:, 2, 2]]
    )
    total = np.zeros((count, 2))
    np.add.at(total, step_of, variance)
    return np.sqrt(np.maximum(total, 0.0))


def _added(
    T_first_second: FloatArray, covered: BoolArray, yaw_rad: float, step_of: IntArray
) -> FloatArray:
    """(k, 2) path along the base's x axis, m, and turn, rad, of each spell."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    ahead = cos * T_first_second[:, 0] - sin * T_first_second[:, 1]
    moved = np.where(covered[:, None], np.column_stack([ahead, T_first_second[:, 2]]), 0.0)
    return _total(moved, step_of)
