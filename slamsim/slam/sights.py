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

import numpy as np

from slamsim.geometry import between
from slamsim.result import MapGraph
from slamsim.slam.blocks import factorise
from slamsim.slam.marginals import add_edges, adjoint, in_own_frame
from slamsim.slam.panels import Panels
from slamsim.slam.smoothing import Smoothed
from slamsim.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """What holds n poses of a map together.

    panels, values: what the views of shared surfaces say, a system whose unknowns are steps of the
    map, one for each pose but the first, which is held fixed. drift: (n - 1, 3, 3) covariance of
    the odometry from pose to pose, as a step of the map.
    """

    panels: Panels
    values: FloatArray
    drift: FloatArray

    def covariances(self, poses: FloatArray) -> FloatArray:
        """(n, 3, 3) relative to the first pose, of small steps of the base in its own frame.

        poses: (n, 3) T_map_base. Raises numpy.linalg.LinAlgError if nothing holds some pose.
        """
        last = len(poses) - 1
        number = np.append(last, np.arange(last))
        system = self.values.copy()
        ends = np.stack([number[:-1], number[1:]], axis=1)
        add_edges(self.panels, system, ends, np.asarray(np.linalg.inv(self.drift), np.float64))
        in_map = np.zeros((len(poses), 3, 3))
        in_map[1:] = factorise(self.panels, system).inverse_diagonal()
        return in_own_frame(poses, in_map)


def smoothed_covariances(
    sights: Sights, graph: MapGraph, first: int, smoothed: Smoothed
) -> FloatArray:
    """(n - first, 3, 3) of the smoothed key frames from number ``first`` of the graph on, relative
    to its first, of small steps of the base in its own frame.

    smoothed: the drive of these key frames. Where only a guess of the front end joins two of them,
    it stays as unsure as it was.
    """
    poses, stamps_ns = graph.keyframes.poses, graph.keyframes.stamps_ns[first:]
    guessed = {edge.target for edge in graph.edges if edge.kind == "odometry"}
    driven = np.array([k not in guessed for k in range(first + 1, len(poses))], dtype=np.bool_)
    drift, scatter = sights.drift.copy(), np.zeros((len(poses), 3, 3))
    drift[first:][driven] = drift_between(smoothed, stamps_ns)[driven]
    scatter[first:] = smoothed.covariances[_numbers(smoothed, stamps_ns)]
    of_map = replace(sights, drift=drift).covariances(poses)
    return with_scatter(poses, of_map, scatter)[first:]


def drift_between(smoothed: Smoothed, stamps_ns: IntArray) -> FloatArray:
    """(k - 1, 3, 3) covariance of the odometry between scans, by their (k,) stamps, as a step of
    the map."""
    at = _numbers(smoothed, stamps_ns)
    turn = adjoint(smoothed.track.poses[1:])
    in_map = turn @ smoothed.drift @ np.swapaxes(turn, 1, 2)
    return np.asarray(np.add.reduceat(in_map[: at[-1]], at[:-1], axis=0))


def with_scatter(poses: FloatArray, covariances: FloatArray, scatter: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3) relative to the first pose when each pose, the first one too, is off
    by an error of its own besides, of (n, 3, 3) ``scatter`` in its own frame."""
    from_first = adjoint(between(poses[1:], poses[0]))
    whole = covariances.copy()
    whole[1:] += scatter[1:] + from_first @ scatter[0] @ np.swapaxes(from_first, 1, 2)
    return whole


def _numbers(smoothed: Smoothed, stamps_ns: IntArray) -> IntArray:
    return np.searchsorted(smoothed.track.stamps_ns, stamps_ns)
