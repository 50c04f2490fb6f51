"""Scans put together over a short stretch of odometry, where one alone shows too little.

A lidar of 36 beams sees some four pieces of surface in a scan. They fit somewhere in any map, and
that they do not fit says nothing either; matched one by one they lead astray. So scans are held
back, each where odometry has it, until all together show enough; each is matched once only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slamsim.core.geometry import between, transform_points
from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.matching.base import Match

ENOUGH_PIECES = 7
"""Four more than a pose has unknowns. A pose that is wrong puts about a quarter of a scan's pieces
on some surface or other: all four by chance once in 250. Lidars of 180 beams and more show at least
eleven in every scan of aces, intel and fr079. Swept from 6 to 30 on fr079 with 36, 60 and 90 beams
and on a labyrinth with 36: with more, scans wait for so long that odometry smears them."""

MOST_S = 2.0
"""Longer than this no scan is held back; on line, odometry is kept for three seconds."""

MOST_DRIFT_M = 0.06
"""Scans that odometry puts together worse than this are matched as they are. Swept from 0.03 to 0.2
on fr079 with 36, 60 and 90 beams and intel with 45: with less, too few scans come together; with
more, walls are smeared."""

REACH_M = 4.0
"""A heading that is off shifts surfaces this far away; those of indoor lidars are about there."""

SAME_VIEW_M, SAME_VIEW_RAD = 0.01, np.deg2rad(0.3)
"""A robot that has moved less than this sees what it saw before, with other noise."""


class ScanWindow:
    """The scans since the last match, seen from where the robot is by now."""

    def __init__(self) -> None:
        self._kept: list[tuple[Cloud, FloatArray]] = []

    def add(self, cloud: Cloud, T_map_base: FloatArray) -> Cloud:
        """All that was seen in the window, as if from the newest scan's laser, by bearing.

        T_map_base: (3,) where odometry puts the newest, from the same start as all others.
        """
        newest = (cloud, T_map_base)
        if self._kept and _same_view(between(self._kept[-1][1], T_map_base)):
            return _seen_from_last([*self._kept[:-1], newest])
        self._kept.append(newest)
        return _seen_from_last(self._kept)

    def clear(self) -> None:
        """The scans so far were matched."""
        self._kept.clear()


def _seen_from_last(clouds: Sequence[tuple[Cloud, FloatArray]]) -> Cloud:
    """One cloud of several: beams of different scans that are neighbours show one surface."""
    newest, T_map_base = clouds[-1]
    if len(clouds) == 1:
        return newest
    points_m = np.concatenate(
        [transform_points(between(T_map_base, T), one.points_m) for one, T in clouds]
    )
    origin_m = newest.origins_m.mean(axis=0) if len(newest.origins_m) else np.zeros(2)
    away_m = points_m - origin_m
    order = np.argsort(np.arctan2(away_m[:, 1], away_m[:, 0]), kind="stable")
    hit = np.concatenate([one.hit for one, _ in clouds])[order]
    origins_m = np.tile(origin_m, (len(points_m), 1))
    return Cloud(newest.stamp_ns, points_m[order], origins_m, hit)


def worth_waiting(prediction: Prediction, pieces: int) -> bool:
    """Whether a window that shows so many pieces can still grow, and has to."""
    odometry = prediction.odometry
    if pieces >= ENOUGH_PIECES or odometry is None or prediction.jump:
        return False
    variances = np.diag(prediction.step_covariance)
    drift_m = np.sqrt(variances[0] + variances[1]) + REACH_M * np.sqrt(variances[2])
    return bool(odometry.seconds < MOST_S and drift_m < MOST_DRIFT_M)


def with_drift(match: Match, prediction: Prediction) -> Match:
    """A match of several scans, as sure as odometry put them together.

    Where the newest scan stands among them is as unsure as odometry is over a part of the window:
    on average over it, a third of the variance of the whole.
    """
    drift = prediction.step_covariance / 3.0
    blur = np.linalg.inv(np.eye(3) + match.information @ drift)
    information = blur @ match.information
    information = 0.5 * (information + information.T)
    return replace(match, information=information, pull=blur @ match.pull)


def _same_view(step: FloatArray) -> bool:
    return bool(np.hypot(step[0], step[1]) < SAME_VIEW_M and abs(step[2]) < SAME_VIEW_RAD)
