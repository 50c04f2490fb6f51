"""Poses over time, in the plane and in space; the conventions are those of ``types``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.arrays import FloatArray, IntArray, Samples
from slamsim.core.geometry import interpolate_se2, slerp_xyzw, yaw_from_xyzw
from slamsim.guard.numbers import require_finite, require_stamps, require_unit_quaternions


class OutsideTimeRange(ValueError):
    """A look-up at an instant that the data do not cover; nothing is extrapolated."""


def _require_covered(stamps_ns: IntArray, query_ns: IntArray) -> None:
    if query_ns.size == 0:
        return
    first, last = int(query_ns.min()), int(query_ns.max())
    if stamps_ns.size == 0 or first < stamps_ns[0] or last > stamps_ns[-1]:
        have = "nothing" if stamps_ns.size == 0 else f"{stamps_ns[0]}..{stamps_ns[-1]} ns"
        raise OutsideTimeRange(f"the trajectory covers {have}, asked for {first}..{last} ns")


def _bracket(stamps_ns: IntArray, query_ns: IntArray) -> tuple[IntArray, FloatArray]:
    """Index of the sample at or before each query and the fraction towards the next."""
    left = np.clip(
        np.searchsorted(stamps_ns, query_ns, side="right") - 1, 0, max(stamps_ns.size - 2, 0)
    )
    right = np.minimum(left + 1, stamps_ns.size - 1)
    span = (stamps_ns[right] - stamps_ns[left]).astype(np.float64)
    elapsed = (query_ns - stamps_ns[left]).astype(np.float64)
    fraction = np.divide(elapsed, span, out=np.zeros_like(elapsed), where=span > 0)
    return left, fraction


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPoses(Samples):
    """``T_target_base`` at some instants, in no order: the key frames of several drives.

    stamps_ns: (n,). poses: (n, 3) rows of (x_m, y_m, yaw_rad).
    """

    stamps_ns: IntArray
    poses: FloatArray

    def __post_init__(self) -> None:
        require_stamps("planar poses", self.stamps_ns, rising=False)
        require_finite("planar poses", self.poses, (self.stamps_ns.size, 3))

    def __len__(self) -> int:
        return int(self.stamps_ns.size)


@dataclass(frozen=True, slots=True, eq=False)
class PlanarTrajectory(PlanarPoses):
    """``T_target_base`` over time in the plane.

    stamps_ns: (n,) strictly increasing. poses: (n, 3) rows of (x_m, y_m, yaw_rad).
    """

    def __post_init__(self) -> None:
        require_stamps("a planar trajectory", self.stamps_ns)
        require_finite("the poses of a planar trajectory", self.poses, (self.stamps_ns.size, 3))

    def at(self, stamps_ns: IntArray) -> FloatArray:
        """(m, 3) poses at the given instants; raises OutsideTimeRange beyond the ends."""
        _require_covered(self.stamps_ns, stamps_ns)
        left, fraction = _bracket(self.stamps_ns, stamps_ns)
        right = np.minimum(left + 1, len(self) - 1)
        return interpolate_se2(self.poses[left], self.poses[right], fraction)

    def path_length_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory(Samples):
    """``T_target_base`` over time in space.

    stamps_ns: (n,), strictly increasing, for interpolation. positions_m: (n, 3).
    quats_xyzw: (n, 4), unit.
    """

    stamps_ns: IntArray
    positions_m: FloatArray
    quats_xyzw: FloatArray

    def __post_init__(self) -> None:
        require_stamps("a trajectory", self.stamps_ns, rising=False)
        require_finite("the positions of a trajectory", self.positions_m, (len(self), 3))
        require_unit_quaternions("the quaternions of a trajectory", self.quats_xyzw, len(self))

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    def at(self, stamps_ns: IntArray) -> Trajectory:
        """Poses at the given instants, in any order; raises OutsideTimeRange beyond the ends."""
        require_stamps("a trajectory", self.stamps_ns)
        _require_covered(self.stamps_ns, stamps_ns)
        left, fraction = _bracket(self.stamps_ns, stamps_ns)
        right = np.minimum(left + 1, len(self) - 1)
        step = self.positions_m[right] - self.positions_m[left]
        return Trajectory(
            stamps_ns,
            self.positions_m[left] + fraction[:, None] * step,
            slerp_xyzw(self.quats_xyzw[left], self.quats_xyzw[right], fraction),
        )

    def planar(self) -> PlanarTrajectory:
        """The projection onto the floor: x, y and the heading of the x axis."""
        yaw = yaw_from_xyzw(self.quats_xyzw)
        return PlanarTrajectory(self.stamps_ns, np.column_stack([self.positions_m[:, :2], yaw]))
