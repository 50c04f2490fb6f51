"""Carrying corrected poses over to everything that was measured relative to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slamsim.core.geometry import between, compose, interpolate_se2
from slamsim.core.stamps import merged, order_once
from slamsim.core.types import FloatArray, IntArray, OutsideTimeRange, PlanarTrajectory


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """T_map_base: (3,) of a key frame as the closures known by now have it. covariance: (3, 3)
    relative to the first key frame, of a small step of the base in its own frame. keyframe: its
    index as it came. joined: whether anything tells where it is in the map of the first.
    """

    keyframe: int
    T_map_base: FloatArray
    covariance: FloatArray
    joined: bool = True


def correct_pieces(
    relative: PlanarTrajectory, anchors: PlanarTrajectory, breaks_ns: Sequence[int]
) -> PlanarTrajectory:
    """``correct`` for a trajectory that is torn apart: nothing is blended across a break.

    breaks_ns: stamps at which something new begins, in order. A piece without an anchor stays
    as it is.
    """
    if not len(relative):
        return relative
    cuts = np.searchsorted(relative.stamps_ns, np.array(breaks_ns, dtype=np.int64))
    bounds = [0, *cuts.tolist(), len(relative)]
    poses = []
    for first, end in pairwise(bounds):
        piece = relative.select(slice(first, end))
        if not len(piece):
            continue
        inside = anchors.stamps_ns >= piece.stamps_ns[0]
        inside &= anchors.stamps_ns <= piece.stamps_ns[-1]
        own = anchors.select(inside)
        poses.append(correct(piece, own).poses if len(own) else piece.poses)
    return PlanarTrajectory(relative.stamps_ns, np.concatenate(poses))


def correct(relative: PlanarTrajectory, anchors: PlanarTrajectory) -> PlanarTrajectory:
    """The fine motion of one trajectory, bent to pass through the poses of another.

    relative: ``T_odom_base``, smooth but drifting, at the stamps wanted. anchors: ``T_map_base``
    at some of the instants that ``relative`` covers. Between two anchors the pose as carried
    forward from the first and back from the second are blended by elapsed time; before the
    first and after the last anchor, the nearest one moves everything rigidly. Returns
    ``T_map_base`` at the stamps of ``relative``. Raises OutsideTimeRange if an anchor lies
    outside ``relative``, or there is none.
    """
    if not len(anchors):
        raise OutsideTimeRange("a trajectory cannot be corrected: there is no pose to do it by")
    T_odom_anchor = relative.at(anchors.stamps_ns)
    right = np.clip(np.searchsorted(anchors.stamps_ns, relative.stamps_ns), 0, len(anchors) - 1)
    left = np.where(anchors.stamps_ns[right] > relative.stamps_ns, right - 1, right)
    left = np.clip(left, 0, len(anchors) - 1)
    from_left = _carry(relative.poses, T_odom_anchor[left], anchors.poses[left])
    from_right = _carry(relative.poses, T_odom_anchor[right], anchors.poses[right])
    fraction = _fraction(relative.stamps_ns, anchors.stamps_ns[left], anchors.stamps_ns[right])
    poses = interpolate_se2(from_left, from_right, fraction)
    return PlanarTrajectory(relative.stamps_ns, poses)


def densify(coarse: PlanarTrajectory, motion: PlanarTrajectory) -> PlanarTrajectory:
    """``coarse`` with the instants of ``motion`` added, where both cover them.

    coarse: ``T_map_base`` at the stamps of scans. motion: ``T_odom_base``, more often. After the
    last pose of ``coarse`` the motion goes on alone, so that the last scan's beams are covered.
    """
    if not len(motion):
        return coarse
    overlap = (coarse.stamps_ns >= motion.stamps_ns[0]) & (coarse.stamps_ns <= motion.stamps_ns[-1])
    anchors = coarse.select(overlap)
    if not len(anchors):
        return coarse
    inside = motion.stamps_ns >= anchors.stamps_ns[0]
    stamps_ns = merged(motion.stamps_ns[inside], anchors.stamps_ns)
    fine = correct(PlanarTrajectory(stamps_ns, motion.at(stamps_ns)), anchors)
    stamps_ns = np.concatenate([coarse.stamps_ns[~overlap], fine.stamps_ns])
    poses = np.concatenate([coarse.poses[~overlap], fine.poses])
    order = order_once(stamps_ns)
    return PlanarTrajectory(stamps_ns[order], poses[order])


def _carry(poses: FloatArray, T_odom_anchor: FloatArray, T_map_anchor: FloatArray) -> FloatArray:
    return compose(T_map_anchor, between(T_odom_anchor, poses))


def _fraction(stamps_ns: IntArray, left_ns: IntArray, right_ns: IntArray) -> FloatArray:
    span = (right_ns - left_ns).astype(np.float64)
    elapsed = (stamps_ns - left_ns).astype(np.float64)
    return np.divide(elapsed, span, out=np.zeros_like(elapsed), where=span > 0)
