"""The graph of one drive out of that of several."""

from __future__ import annotations

from dataclasses import replace

from slamsim.result import PoseGraph
from slamsim.types import PlanarTrajectory


def since(graph: PoseGraph, first: int) -> PoseGraph:
    """The key frames from number ``first`` on, and the edges between them."""
    if first == 0:
        return graph
    edges = tuple(
        replace(edge, source=edge.source - first, target=edge.target - first)
        for edge in graph.edges
        if min(edge.source, edge.target) >= first
    )
    return PoseGraph(poses_since(graph.keyframes, first), graph.covariances[first:], edges)


def poses_since(keyframes: PlanarTrajectory, first: int) -> PlanarTrajectory:
    """Those of one drive alone; the stamps of several are in no order."""
    return PlanarTrajectory(keyframes.stamps_ns[first:], keyframes.poses[first:])
