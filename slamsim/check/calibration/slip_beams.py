"""Whether single beams say that the scans were mistaken and no wheel slipped: people who walk ahead
of the robot look like slip to scans that see little else across the way."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.core.geometry import chained, transform_points
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.recording import RawScans
from slamsim.slam.laser.scan_beams import BeamReader

FIT_SIGMAS = 3.0
"""A beam that ends farther than this, of the noise of the ranges, from what an earlier scan saw
speaks for no motion."""

LEAST_NOISE_M = 0.005
"""Walls are no straighter between two beams, and poses of scans no surer."""

SLIP_SHARE, SURE = 0.7, 2.0
"""Where wheels slip, so many of the beams that fit one motion alone fit that of the scans: 54 of 75
along a corridor of 24 m seen by 120 beams, nearly all in rooms. Fewer by two standard deviations
are no slip: where people walk ahead it is none to a half."""


def mistaken_scans(calibration: Calibration, scans: RawScans, noise_m: float) -> BoolArray:
    """(k,) of the slipping spells those in which plainly fewer beams fit the scans' motion, not the
    wheels', than where wheels slip. Few beams across the way say neither.

    Spells in a row are judged together, by their first and their last scan: what moves of its own
    does not keep its shape for as long as walls do, and walls far away are told by single beams
    where no surface was. noise_m: of the ranges.
    """
    spells, steps = calibration.spells, calibration.model.steps
    assert spells is not None
    by_wheels = calibration.model.predicted(calibration.fit.values)[0]
    overlay = _Overlay(BeamReader(scans), noise_m, _mirrored(calibration))
    found = spells.slipping.copy()
    for run in _runs(spells.slipping, spells.step_of, steps):
        ends = int(steps.first[run[0]]), int(steps.second[run[-1]])
        by_scans, by_odometry = (
            chained(np.zeros(3), each[run])[-1] for each in (steps.T_first_second, by_wheels)
        )
        votes = overlay.votes(ends, (by_scans, by_odometry))
        found[spells.step_of[run]] &= _plainly_fewer(*votes)
    return found


def _mirrored(calibration: Calibration) -> bool:
    """Whether the fit has the scans' motion as seen from the other side."""
    return calibration.inputs.upside_down != calibration.alignment.mirror


def _runs(slipping: BoolArray, step_of: IntArray, steps: LaserSteps) -> list[IntArray]:
    """Steps of slipping spells that follow each other in one window."""
    chosen = np.flatnonzero(slipping[step_of])
    gaps = (np.diff(chosen) > 1) | (np.diff(steps.window[chosen]) != 0)
    gaps |= steps.second[chosen[:-1]] != steps.first[chosen[1:]]
    return np.split(chosen, np.flatnonzero(gaps) + 1) if chosen.size else []


def _plainly_fewer(for_scans: int, for_wheels: int) -> bool:
    """Whether plainly fewer beams fit the scans' motion alone than where wheels slip."""
    count = for_scans + for_wheels
    spread = np.sqrt(SLIP_SHARE * (1.0 - SLIP_SHARE) * count)
    return bool(for_scans < SLIP_SHARE * count - SURE * spread)


class _Overlay:
    """Lays one scan over another."""

    def __init__(self, reader: BeamReader, noise_m: float, mirror: bool) -> None:
        self._reader, self._mirror = reader, mirror
        self._noise_m = float(np.fmax(noise_m, LEAST_NOISE_M))

    def votes(
        self, ends: tuple[int, int], motions: tuple[FloatArray, FloatArray]
    ) -> tuple[int, int]:
        """How many beams of the later scan fit the first motion better, and how many the second.

        Those that fit both, within their noise, or neither have no vote.
        """
        seen, later = self._points(ends[0]), self._points(ends[1])
        if len(seen) < 2 or not len(later):
            return 0, 0
        one, other = (_off(seen, transform_points(motion, later)) for motion in motions)
        votes = np.minimum(one, other) < FIT_SIGMAS * self._noise_m
        votes &= np.abs(one - other) > self._noise_m
        first = votes & (one < other)
        return int(first.sum()), int((votes & ~first).sum())

    def _points(self, scan: int) -> FloatArray:
        points = self._reader.cloud(scan).points_m
        return points * np.array([1.0, -1.0]) if self._mirror else points


def _off(seen: FloatArray, points: FloatArray) -> FloatArray:
    """(n,) how far points are from the line through the two neighbours that the earlier scan
    measured (m, 2) on both sides of their direction."""
    angles = np.arctan2(seen[:, 1], seen[:, 0])
    order = np.argsort(angles)
    after = np.searchsorted(angles[order], np.arctan2(points[:, 1], points[:, 0]))
    left, right = seen[order[after - 1]], seen[order[after % len(order)]]
    along, beyond = right - left, points - left
    length = np.maximum(np.hypot(*along.T), 1e-9)
    return np.asarray(np.abs(along[:, 0] * beyond[:, 1] - along[:, 1] * beyond[:, 0]) / length)
