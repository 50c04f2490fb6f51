"""The path of a robot as a smooth function of time, with its velocities."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from slamsim.core.types import BoolArray, FloatArray, IntArray, PlanarTrajectory
from slamsim.guard.numbers import BadNumbers

WIDEST_GAP_S = 0.5
"""Between two poses: of a longer one nothing is known."""
MARGIN_S = 0.3
"""At both ends: so far a clock may be off, and more than an image takes to be read out."""


class SmoothPath:
    """T_map_base between the poses of a trajectory: a line through each that bends where its
    neighbours do (Akima 1970), which a single bad pose disturbs nearby alone."""

    def __init__(self, trajectory: PlanarTrajectory) -> None:
        """Raises BadNumbers for a trajectory of a single pose."""
        if len(trajectory) < 2:
            raise BadNumbers("the path of the robot has a single pose; two are needed at least")
        self.origin_ns = int(trajectory.stamps_ns[0])
        self._known_s = self.seconds(trajectory.stamps_ns)
        yaw = np.unwrap(trajectory.poses[:, 2])
        poses = np.column_stack([trajectory.poses[:, :2], yaw])
        self._poses = Akima1DInterpolator(self._known_s, poses, method="makima")
        self._slopes = self._poses.derivative()

    def seconds(self, stamps_ns: IntArray) -> FloatArray:
        """(n,) since the first pose."""
        return np.asarray((stamps_ns - self.origin_ns) * 1e-9)

    def covers(self, at_s: FloatArray, margin_s: float = MARGIN_S) -> BoolArray:
        """(n,) whether the path is known at each instant, and so far before and after."""
        known = self._known_s
        inside = (at_s >= known[0] + margin_s) & (at_s <= known[-1] - margin_s)
        right = np.clip(np.searchsorted(known, at_s), 1, len(known) - 1)
        return np.asarray(inside & (known[right] - known[right - 1] <= WIDEST_GAP_S))

    def at(self, at_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 3) T_map_base and (n, 3) velocities in the base's own frame, m/s and rad/s.

        Beyond the ends the nearest one counts.
        """
        inside = np.clip(at_s, self._known_s[0], self._known_s[-1])
        poses, slopes = self._poses(inside), self._slopes(inside)
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        forward = cos * slopes[:, 0] + sin * slopes[:, 1]
        leftward = cos * slopes[:, 1] - sin * slopes[:, 0]
        return np.asarray(poses), np.column_stack([forward, leftward, slopes[:, 2]])
