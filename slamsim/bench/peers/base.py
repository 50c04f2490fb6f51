"""Interface of a peer: input, output, and the array shapes of its library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slamsim.core.types import FloatArray, ScanGeometry

Settings = Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class PeerScan:
    """One scan as it is handed to a peer.

    points_m: (n, 2) hits in the base frame; fired: (n,) when in the sweep, 0 to 1; both freed of
    motion for a guided peer, as measured for one as shipped. ranges_m: (beams,) of the laser, for
    matchers that want a scan, ``inf`` where nothing returned. T_odom_base: (3,) the odometry
    that the peer may use, at the instant that its pose is asked for.
    """

    points_m: FloatArray
    fired: FloatArray
    ranges_m: FloatArray
    T_odom_base: FloatArray


class Peer(Protocol):
    """Places scan after scan."""

    def step(self, scan: PeerScan) -> FloatArray:
        """(3,) ``T_map_base``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What a peer is made from. guided: whether it gets our prediction from wheels and gyroscope
    and our deskewed points, or the raw scan and the log's own odometry. settings: all that differs
    from the library's own. T_base_laser: (4, 4)."""

    guided: bool
    settings: Settings
    geometry: ScanGeometry
    T_base_laser: FloatArray


def flat_points(points_m: FloatArray) -> FloatArray:
    """(n, 3) on the floor: best for matchers from point to point."""
    return np.column_stack([points_m, np.zeros(len(points_m))])


def band_points(points_m: FloatArray, rings: int, spacing_m: float) -> FloatArray:
    """(rings * n, 3) the same points at several heights: to matchers that look for planes, walls
    are planes only so; a line on the floor has its flattest direction upwards."""
    heights_m = spacing_m * (np.arange(rings) - 0.5 * (rings - 1))
    return np.concatenate(
        [np.column_stack([points_m, np.full(len(points_m), z)]) for z in heights_m]
    )
