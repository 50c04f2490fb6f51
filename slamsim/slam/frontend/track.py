"""What is kept of every scan, in columns, so that an hour of scans is a few megabytes."""

from __future__ import annotations

import numpy as np

from slamsim.core.geometry import between, chained, compose
from slamsim.core.types import BoolArray, FloatArray, PlanarTrajectory
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.backend.smoothing import Chain, Smoothed, odometry_steps, smooth
from slamsim.slam.calibration.solve import Solved
from slamsim.slam.frontend.tracking import Tracked

DEGENERATE_SHARE_TO_TELL = 0.05
BLOCK = 4096
"""Scans for which memory is asked at once; what is kept is never copied while the robot drives."""

_ROW = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("T_map_base", np.float64, 3),
        ("T_odom_base", np.float64, 3),
        ("quality", np.float64),
        ("degenerate", np.bool_),
        ("begins", np.bool_),
        ("information", np.float64, (3, 3)),
        ("pull", np.float64, 3),
        ("step", np.float64, 3),
        ("jacobian", np.float64, (3, PARAMETERS)),
        ("parameters", np.float64, PARAMETERS),
    ]
)


class Track:
    """The front end's own poses, scan by scan."""

    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []
        self._count = self._last_ns = 0
        self.out_of_order = 0
        """Scans that were not later than the one before."""

    def __len__(self) -> int:
        return self._count

    def is_later(self, stamp_ns: int) -> bool:
        """Whether a scan follows on; counts those that do not."""
        later = self._count == 0 or stamp_ns > self._last_ns
        self.out_of_order += not later
        return later

    def keep(self, tracked: Tracked) -> None:
        """One more scan."""
        if self._count % BLOCK == 0:
            self._blocks.append(np.zeros(BLOCK, dtype=_ROW))
        self._blocks[-1][self._count % BLOCK] = (
            tracked.stamp_ns,
            tracked.T_map_base,
            tracked.T_odom_base,
            tracked.match_quality,
            tracked.degenerate,
            tracked.keyscan and tracked.match is None,
            tracked.information,
            np.zeros(3) if tracked.match is None else tracked.match.pull,
            *_step(tracked),
        )
        self._count += 1
        self._last_ns = tracked.stamp_ns

    def front_end(self) -> PlanarTrajectory:
        """``T_map_base`` before any loop was closed."""
        return PlanarTrajectory(self._column("stamp_ns"), self._column("T_map_base"))

    def odometry(self) -> PlanarTrajectory:
        """``T_odom_base`` as wheels and gyroscope predicted it."""
        return PlanarTrajectory(self._column("stamp_ns"), self._column("T_odom_base"))

    def calibrated_odometry(self, calibration: Solved | None) -> PlanarTrajectory:
        """The same with what is known in the end."""
        predicted = self.odometry()
        if calibration is None:
            return predicted
        parameters = calibration.parameters(predicted.stamps_ns)
        moved = np.einsum(
            "nij,nj->ni", self._column("jacobian"), parameters - self._column("parameters")
        )
        steps = compose(self._column("step"), moved)
        silent = np.logical_not(np.abs(self._column("jacobian")).sum(axis=(1, 2)))
        steps[1:][silent[1:]] = between(predicted.poses[:-1], predicted.poses[1:])[silent[1:]]
        return PlanarTrajectory(predicted.stamps_ns, chained(predicted.poses[0], steps[1:]))

    def smoothed(self, T_map_base: PlanarTrajectory, T_odom_base: PlanarTrajectory) -> Smoothed:
        """All scans taken together with the odometry between them, each matched to a map that
        has moved with ``T_map_base``: the front end's track, with the map's corrections.

        A scan that a local map began with lies on it like the one after it."""
        information, pull = self._column("information"), self._column("pull")
        begins = np.flatnonzero(self._column("begins")[:-1])
        information[begins] = information[begins + 1]
        return smooth(Chain(T_map_base, information, pull, *odometry_steps(T_odom_base)))

    @property
    def quality(self) -> FloatArray:
        """(n,) inlier ratio of each match."""
        return self._column("quality")

    @property
    def degenerate(self) -> BoolArray:
        """(n,) whether some direction was left to odometry."""
        return self._column("degenerate")

    @property
    def information(self) -> FloatArray:
        """(n, 3, 3) of each match, in the frame of the base."""
        return self._column("information")

    def warnings(self) -> tuple[str, ...]:
        """What the user should know, in words and counts."""
        told = []
        if self.out_of_order:
            told.append(f"{self.out_of_order} scans left out: not later than the one before")
        share = float(np.mean(self.degenerate)) if self._count else 0.0
        if share > DEGENERATE_SHARE_TO_TELL:
            told.append(f"{share:.0%} of the scans left some direction to odometry (corridor?)")
        return tuple(told)

    def _column(self, name: str) -> np.ndarray:
        blocks = self._blocks or [np.zeros(0, dtype=_ROW)]
        return np.concatenate([block[name] for block in blocks])[: self._count]


def _step(tracked: Tracked) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The step by odometry, its jacobian and parameters; zeros where it was silent."""
    step = tracked.odometry
    if step is None:
        return np.zeros(3), np.zeros((3, PARAMETERS)), np.zeros(PARAMETERS)
    return step.T_first_last, step.jacobian[:3], step.parameters
