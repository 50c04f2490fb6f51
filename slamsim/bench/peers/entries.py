"""The peers and their configurations. Nothing here is tuned to a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from types import MappingProxyType

from slamsim.bench.peers.base import Peer, Settings, Setup
from slamsim.core.types import FloatArray, ScanGeometry

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
