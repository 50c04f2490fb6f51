"""Where all key frames are by now, and how surely relative to the newest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.core.geometry import adjoint, between, compose
from slamsim.core.jit import kernel
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.backend.marginals import edge_covariances, relative_covariances
from slamsim.slam.matching.small import product


class Estimate:
    """The last solution, with the chain of key frames since then added to it.

    Uncertainties are kept as those of small steps of each key frame in its own frame. Between any
    two key frames they are the sum of what was added in between, seen from the later one: nothing
    is subtracted, so that they stay exact however far from the map's origin, and beyond any weak
    link.
    """

    def __init__(self) -> None:
        self._poses = np.zeros((64, 3))
        self._chain = np.zeros((64, 3, 3))  # added since the key frame before
        self._solved = np.zeros((0, 3, 3))  # relative to the last key frame that was solved
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def poses(self) -> FloatArray:
        """(n, 3) T_map_base."""
        return self._poses[: self._count]

    def begin(self, T_map_base: FloatArray) -> None:
        """The first key frame. T_map_base: (3,)."""
        self._poses[0], self._count = T_map_base, 1

    def extend(self, edge: GraphEdge) -> None:
        """One more key frame, joined to the last by an edge of the chain."""
        if self._count == len(self._poses):
            self._poses = np.concatenate([self._poses, np.zeros_like(self._poses)])
            self._chain = np.concatenate([self._chain, np.zeros_like(self._chain)])
        new = self._count
        self._poses[new] = compose(self._poses[new - 1], edge.T_source_target)
        self._count += 1
        self._chain[new] = edge_covariances([edge])[0]

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
        self._chain[1 : self._count] = edge_covariances(chain)
        self._solved = relative_covariances(self.poses, edges, self._count - 1)

    def covariances(self, earlier: IntArray, later: int) -> FloatArray:
        """(m, 3, 3) of each earlier key frame relative to a later one, as small steps of the later
        in its own frame.

        Between two key frames that were both solved, the smaller of two bounds: the chain
        between them alone, or both relative to the last one as if they were independent.
        """
        last = len(self._solved) - 1
        solved = np.flatnonzero(earlier <= last)
        if not solved.size:
            return self._along_chain(earlier, later)
        since = self._solved[min(last, later)]
        if later > last:
            since = self._along_chain(np.array([last]), later)[0]
        carry = adjoint(between(self._poses[later], self._poses[earlier[solved]]))
        through_last = carry @ self._solved[earlier[solved]] @ np.swapaxes(carry, 1, 2) + since
        bounds = np.trace(through_last, axis1=1, axis2=2)
        enough = bounds.max() if solved.size == earlier.size else np.inf
        covariances = self._along_chain(earlier, later, enough)
        shorter = bounds < np.trace(covariances[solved], axis1=1, axis2=2)
        covariances[solved[shorter]] = through_last[shorter]
        return covariances

    def _along_chain(self, earlier: IntArray, later: int, enough: float = np.inf) -> FloatArray:
        latest_first = np.argsort(-earlier)
        return _along_chain(self.poses, self._chain, earlier, latest_first, later, enough)

    def covariance(self, earlier: int, later: int) -> FloatArray:
        """(3, 3) of the later key frame relative to the earlier, in the frame of the later."""
        covariance = self.covariances(np.array([earlier]), later)[0]
        return np.asarray(0.5 * (covariance + covariance.T))


@kernel
def _along_chain(
    poses: FloatArray,
    chain: FloatArray,
    earlier: IntArray,
    latest_first: IntArray,
    later: int,
    enough: float,
) -> FloatArray:
    """(m, 3, 3) covariance of one pose relative to each of (m,) earlier ones, in its own frame.

    poses: (n, 3). chain: (n, 3, 3) of each pose relative to the one before, in its own frame.
    latest_first: (m,) the order of the earlier ones: sorted here, the sort alone took a second to
    compile. enough: the sum ends once its trace is larger than this.
    """
    out = np.zeros((earlier.size, 3, 3))
    total, carry, half = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    carry[2, 2] = 1.0
    x, y, yaw = poses[later]
    cos, sin = np.cos(yaw), np.sin(yaw)
    k = later
    for at in latest_first:
        while k > earlier[at] and total[0, 0] + total[1, 1] + total[2, 2] <= enough:
            turn = poses[k, 2] - yaw
            dx, dy = poses[k, 0] - x, poses[k, 1] - y
            carry[0, 0] = carry[1, 1] = np.cos(turn)
            carry[1, 0] = np.sin(turn)
            carry[0, 1] = -carry[1, 0]
            carry[0, 2], carry[1, 2] = cos * dy - sin * dx, -cos * dx - sin * dy
            product(carry, chain[k], half)
            for i in range(3):
                for j in range(3):
                    for m in range(3):
                        total[i, j] += half[i, m] * carry[j, m]
            k -= 1
        for i in range(3):
            for j in range(3):
                out[at, i, j] = total[i, j]
    return out
