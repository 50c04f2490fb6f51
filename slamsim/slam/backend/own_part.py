"""The graph of one drive out of that of several."""

from __future__ import annotations

from dataclasses import replace

from slamsim.core.result import MapGraph, PoseGraph
from slamsim.core.types import PlanarPoses, PlanarTrajectory


def since(graph: MapGraph, first: int) -> PoseGraph:
    """The key frames from number ``first`` on, and the edges between them."""
    edges = tuple(
        replace(edge, source=edge.source - first, target=edge.target - first)
        for edge in graph.edges
        if min(edge.source, edge.target) >= first
    )
    return PoseGraph(poses_since(graph.keyframes, first), graph.covariances[first:], edges)


def poses_since(keyframes: PlanarPoses, first: int) -> PlanarTrajectory:
    """Those of one drive alone; the stamps of several are in no order."""
    return PlanarTrajectory(keyframes.stamps_ns[first:], keyframes.poses[first:])
