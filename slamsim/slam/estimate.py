"""Where all key frames are by now, and how surely relative to the newest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.geometry import compose, inverse
from slamsim.result import GraphEdge
from slamsim.slam.marginals import adjoint, edge_covariances_in_map, relative_covariances
from slamsim.types import FloatArray, IntArray

_ORIGIN = np.zeros(2)


class Estimate:
    """The last solution, with the chain of key frames since then added to it.

    Uncertainties are kept as those of small steps of the map about its origin: along the chain
    they simply add up, and between any two key frames they are what was added in between.
    """

    def __init__(self) -> None:
        self._poses = np.zeros((64, 3))
        self._chain = np.zeros((64, 3, 3))  # summed from the first key frame
        self._solved = np.zeros((0, 3, 3))  # relative to the last key frame that was solved
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def poses(self) -> FloatArray:
        """(n, 3) T_map_base."""
        return self._poses[: self._count]

    def begin(self, T_map_base: FloatArray) -> None:
        """The first key frame."""
        self._poses[0], self._count = T_map_base, 1

    def extend(self, edge: GraphEdge) -> None:
        """One more key frame, joined to the last by an edge of the chain."""
        if self._count == len(self._poses):
            self._poses = np.concatenate([self._poses, np.zeros_like(self._poses)])
            self._chain = np.concatenate([self._chain, np.zeros_like(self._chain)])
        new = self._count
        self._poses[new] = compose(self._poses[new - 1], edge.T_source_target)
        self._count += 1
        added = edge_covariances_in_map(self.poses, [edge], _ORIGIN)[0]
        self._chain[new] = self._chain[new - 1] + added

    @property
    def solved_count(self) -> int:
        """For how many key frames covariances beyond those of the chain are known."""
        return len(self._solved)

    def move(self, poses: FloatArray) -> None:
        """Take over a solution (n, 3) for all key frames."""
        self._poses[: self._count] = poses

    def renew_covariances(self, edges: Sequence[GraphEdge]) -> None:
        """Take over what the edges of the graph say about all key frames where they stand now."""
        chain = [edge for edge in edges if edge.kind != "closure"]
        added = edge_covariances_in_map(self.poses, chain, _ORIGIN)
        self._chain[1 : self._count] = np.cumsum(added, axis=0)
        self._solved = relative_covariances(self.poses, edges, self._count - 1, _ORIGIN)

    def covariances_in_map(self, earlier: IntArray, later: IntArray) -> FloatArray:
        """(m, 3, 3) of each earlier key frame relative to a later one, about the map's origin.

        Between two key frames that were both solved, the smaller of two bounds: the chain
        between them alone, or both relative to the last one as if they were independent.
        """
        by_chain = self._chain[later] - self._chain[earlier]
        if not len(self._solved):
            return np.asarray(by_chain)
        last = len(self._solved) - 1
        since = self._chain[later] - self._chain[last]
        rest = np.where((later > last)[:, None, None], since, self._solved[np.minimum(later, last)])
        through_last = self._solved[np.minimum(earlier, last)] + rest
        better = (earlier <= last) & (
            np.trace(through_last, axis1=1, axis2=2) < np.trace(by_chain, axis1=1, axis2=2)
        )
        return np.asarray(np.where(better[:, None, None], through_last, by_chain))

    def covariance(self, earlier: int, later: int) -> FloatArray:
        """(3, 3) of the later key frame relative to the earlier, in the frame of the later."""
        to_later = adjoint(inverse(self._poses[later]))
        in_map = self.covariances_in_map(np.array([earlier]), np.array([later]))[0]
        covariance = to_later @ in_map @ to_later.T
        return np.asarray(0.5 * (covariance + covariance.T))
