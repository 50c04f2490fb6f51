"""How unsure poses are within their map, wherever the map as a whole may lie.

Relative to one pose, all others share its error: a first heading that is off by half a milliradian
moves what lies 40 m away by 20 mm, though nothing in the map is bent by as much. Relative to the
map as a whole, which is laid onto the truth by the motion that minimises the squared distances of
all positions, as for the ATE, that error is the first pose's alone. The change from one to the
other is Baarda's S-transformation (1981).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slamsim.core.geometry import adjoint, between
from slamsim.core.types import FloatArray

LEAST_SPREAD_M = 0.05
"""RMS of positions that lie too close together to say how the map is turned."""


class WholeMap(NamedTuple):
    """A map of n poses, laid onto the truth.

    carry: (n, 3, 3) takes a small step of the whole map to the own frame of each pose. shares: (n,
    3, 3): the sum of their transposes times the errors of all poses, each in its own frame, is the
    step by which the whole map is off.
    """

    carry: FloatArray
    shares: FloatArray

    @staticmethod
    def of(poses: FloatArray) -> WholeMap | None:
        """poses: (n, 3) T_map_base. None if they lie too close together."""
        middle = np.append(poses[:, :2].mean(axis=0), 0.0)
        if np.sqrt(np.square(poses[:, :2] - middle[:2]).sum(axis=1).mean()) < LEAST_SPREAD_M:
            return None
        carry = adjoint(between(poses, middle))
        levers = carry[:, :2]
        normal = np.einsum("nki,nkj->ij", levers, levers)
        shares = np.zeros_like(carry)
        shares[:, :2] = levers @ np.linalg.inv(normal)
        return WholeMap(carry, shares)

    def covariances(self, relative: FloatArray, products: FloatArray) -> FloatArray:
        """(n, 3, 3) of each pose relative to the whole map, in the pose's own frame.

        relative: (n, 3, 3) relative to anything, such as the first pose. products: (n, 3, 3) of the
        joint covariance of all poses (3 n, 3 n), relative to the same, with ``shares``.
        """
        both = products @ np.swapaxes(self.carry, 1, 2)
        of_whole = np.einsum("nki,nkj->ij", self.shares, products)
        moved = self.carry @ of_whole @ np.swapaxes(self.carry, 1, 2)
        found = relative - both - np.swapaxes(both, 1, 2) + moved
        return np.asarray(0.5 * (found + np.swapaxes(found, 1, 2)))
