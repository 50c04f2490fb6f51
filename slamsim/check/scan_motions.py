"""Motion of a laser as its scans alone show it: what everything else is held against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamsim.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ScanMotions:
    """Relative motions of one laser between pairs of its scans.

    first, second: (n,) int64 which scans of the stream. first_ns, second_ns: (n,) their stamps as
    claimed, which is when beam 0 claims to have fired. T_first_second: (n, 3) of the laser between
    those two instants, in the plane of the scan as its messages declare it (x forward, angles
    counter-clockwise). information: (n, 3, 3) of a small step of the second scan in its own frame.
    inlier_share: (n,) 0 to 1. window: (n,) int64, equal for pairs of one contiguous stretch; pairs
    that share a scan lie in the same window, and windows are in the order of time.
    """

    first: IntArray
    second: IntArray
    first_ns: IntArray
    second_ns: IntArray
    T_first_second: FloatArray
    information: FloatArray
    inlier_share: FloatArray
    window: IntArray

    def __len__(self) -> int:
        return int(self.first.size)

    def keep(self, chosen: NDArray[np.bool_]) -> ScanMotions:
        """Only the (n,) chosen pairs."""
        return ScanMotions(
            *(self.first[chosen], self.second[chosen]),
            *(self.first_ns[chosen], self.second_ns[chosen]),
            *(self.T_first_second[chosen], self.information[chosen]),
            *(self.inlier_share[chosen], self.window[chosen]),
        )
