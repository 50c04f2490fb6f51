"""How sure the returned key frames are: what holds the map, and what is left of single scans.

Two errors add up. The map itself is off by the noise of all views of its surfaces and of the
odometry between them: the inverse of their joint information, as in any bundle adjustment
(Triggs et al. 2000). And each pose is off in this map by what the smoothing of all scans left of
the noise of its own. Before that smoothing, odometry could not be believed between two key frames
better than the matches that placed them: covariances of the bundle adjustment alone are those of
other, shakier poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from slamsim.core.geometry import adjoint, between, compose, inverse
from slamsim.core.result import MapGraph
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.supernodes import Panels
from slamsim.slam.backend.gauge import WholeMap
from slamsim.slam.backend.marginals import Joined
from slamsim.slam.backend.smoothing import Smoothed


class Sure(NamedTuple):
    """Covariances (n, 3, 3) of small steps of the base in its own frame, relative to the first of
    all poses, and to the map that these n make, None where they all lie in one place."""

    relative: FloatArray
    in_map: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceInformation:
    """What holds n views of a map together.

    panels, values: what the views of shared surfaces say, a system whose unknowns are small steps
    of each view but the first, which is held fixed and stands for all that are, in its own frame.
    drift: (n - 1, 3, 3) covariance of the odometry from view to view, of the later one in its own
    frame. closures: (c, 2) views that a closure joins without any surface that they share, and
    (c, 3, 3) covariance of the second ones. pairs: (p, 2) of views that share surfaces. poses:
    (n, 3) T_map_view. T_base_view: (n, 3) where each view is seen from its base.
    """

    panels: Panels
    values: FloatArray
    drift: FloatArray
    closures: tuple[IntArray, FloatArray]
    pairs: IntArray
    poses: FloatArray
    T_base_view: FloatArray

    def covariances(self) -> FloatArray:
        """(n, 3, 3) relative to the first pose, of small steps of the base in its own frame.

        Raises NoSolution if nothing holds some pose.
        """
        return _carried(adjoint(self.T_base_view), self._joined().covariances())

    def smoothed(self, scatter: FloatArray, first: int = 0) -> Sure:
        """Of the poses from number ``first`` on, when each is off by an error of its own besides,
        of (n, 3, 3) ``scatter``."""
        to_base, joined = adjoint(self.T_base_view), self._joined()
        poses = compose(self.poses, inverse(self.T_base_view))
        whole, shares = WholeMap.of(poses[first:]), np.zeros_like(scatter)
        if whole is not None:
            shares[first:] = whole.shares
            of_views = joined.times(np.swapaxes(to_base, 1, 2) @ shares)
            products = (to_base @ of_views + scatter @ shares)[first:]
        of_map = _carried(to_base, joined.covariances())
        return Sure(
            with_scatter(poses, of_map, scatter)[first:],
            None if whole is None else whole.covariances((of_map + scatter)[first:], products),
        )

    def _joined(self) -> Joined:
        count = len(self.poses)
        ends = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
        seen = (self.panels, self.values, self.pairs)
        steps = (
            np.concatenate([ends, self.closures[0]]),
            np.concatenate([self.drift, self.closures[1]]),
        )
        return Joined(self.poses, 0, seen, steps)


def smoothed_covariances(
    information: SurfaceInformation, graph: MapGraph, first: int, smoothed: Smoothed
) -> Sure:
    """Of the smoothed key frames from number ``first`` of the graph on.

    smoothed: the drive of these key frames, which alone is laid onto the truth. Where only a guess
    of the front end joins two of them, it stays as unsure as it was. Poses that are held fixed are
    the map.
    """
    held = len(graph.keyframes) - len(information.poses)
    stamps_ns = graph.keyframes.stamps_ns[first:]
    first -= held
    guessed = {edge.target - held for edge in graph.edges if edge.kind == "odometry"}
    count = len(information.poses)
    driven = np.array([k not in guessed for k in range(first + 1, count)], dtype=np.bool_)
    drift, scatter = information.drift.copy(), np.zeros((count, 3, 3))
    to_view = adjoint(inverse(information.T_base_view[first + 1 :]))
    drift[first:][driven] = _carried(to_view, drift_between(smoothed, stamps_ns))[driven]
    scatter[first:] = smoothed.covariances[_numbers(smoothed, stamps_ns)]
    sure = replace(information, drift=drift).smoothed(scatter, first)
    return sure._replace(in_map=sure.relative) if held else sure


def drift_between(smoothed: Smoothed, stamps_ns: IntArray) -> FloatArray:
    """(k - 1, 3, 3) covariance of the odometry between scans, by their (k,) stamps, of the base at
    the later scan in its own frame."""
    at, poses = _numbers(smoothed, stamps_ns), smoothed.track.poses
    end = poses[np.repeat(at[1:], np.diff(at))]
    steps = slice(at[0], at[-1])
    carried = _carried(adjoint(between(end, poses[1:][steps])), smoothed.drift[steps])
    return np.asarray(np.add.reduceat(carried, at[:-1] - at[0], axis=0))


def with_scatter(poses: FloatArray, covariances: FloatArray, scatter: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3) relative to the first pose when each pose, the first one too, is off
    by an error of its own besides, of (n, 3, 3) ``scatter`` in its own frame."""
    from_first = adjoint(between(poses[1:], poses[0]))
    whole = covariances.copy()
    whole[1:] += scatter[1:] + _carried(from_first, scatter[0])
    return whole


def _carried(carry: FloatArray, covariances: FloatArray) -> FloatArray:
    return np.asarray(carry @ covariances @ np.swapaxes(carry, -1, -2))


def _numbers(smoothed: Smoothed, stamps_ns: IntArray) -> IntArray:
    return np.searchsorted(smoothed.track.stamps_ns, stamps_ns)
