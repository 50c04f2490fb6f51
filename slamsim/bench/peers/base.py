"""Peers: their interface, and their configurations, none of which is tuned to a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from types import MappingProxyType
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


GUIDED, SHIPPED = "our prediction and deskew", "as shipped"
FIRST, MIDDLE, LAST = 0.0, 0.5, 1.0
"""Instants of a sweep. One that is not deskewed fits best where the robot was in its middle."""

INDOORS = MappingProxyType(
    {"max_range_m": 30.0, "voxel_m": 0.2, "initial_threshold_m": 0.5, "min_motion_m": 0.01}
)
"""For rooms of some metres and a good prediction, where the libraries' own are for streets."""


@dataclass(frozen=True, slots=True)
class PeerEntry:
    """One peer in one way of use.

    library: the module that must be installed. adapter, kind: module of this package and its
    class. instant: of which part of the sweep its pose is, 0 the first beam, 1 the last; guided
    peers get points deskewed to the first. The rest: see ``Setup``.
    """

    name: str
    how: str
    library: str
    adapter: str
    kind: str
    guided: bool
    instant: float
    settings: Settings = field(default_factory=dict)

    def make(self, geometry: ScanGeometry, T_base_laser: FloatArray) -> Peer:
        """The peer, ready for the first scan; imports its library."""
        adapter = import_module(f"slamsim.bench.peers.{self.adapter}")
        setup = Setup(self.guided, self.settings, geometry, T_base_laser)
        peer: Peer = getattr(adapter, self.kind)(setup)
        return peer


ENTRIES = (
    PeerEntry("kiss-icp", GUIDED, "kiss_icp", "kiss", "Kiss", True, FIRST, dict(INDOORS)),
    PeerEntry("kiss-icp", SHIPPED, "kiss_icp", "kiss", "Kiss", False, LAST),
    PeerEntry(
        "small-gicp",
        GUIDED,
        "small_gicp",
        "gicp",
        "Gicp",
        True,
        FIRST,
        {"voxel_m": 0.25, "point_m": 0.1, "gate_m": 0.25},
    ),
    PeerEntry(
        "small-gicp",
        SHIPPED,  # the numbers of the library's own odometry example
        "small_gicp",
        "gicp",
        "Gicp",
        False,
        MIDDLE,
        {"voxel_m": 1.0, "point_m": 0.25, "gate_m": 1.0},
    ),
    PeerEntry(
        "karto-scanmatcher",
        GUIDED,
        "karto_scanmatcher",
        "karto",
        "Karto",
        True,
        FIRST,
        {"range_threshold_m": 30.0},
    ),
    PeerEntry("karto-scanmatcher", SHIPPED, "karto_scanmatcher", "karto", "Karto", False, MIDDLE),
    PeerEntry("genz-icp", GUIDED, "genz_icp", "genz", "Guided", True, FIRST, dict(INDOORS)),
    PeerEntry("genz-icp", SHIPPED, "genz_icp", "genz", "Shipped", False, MIDDLE),
)
