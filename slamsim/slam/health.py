"""A finished map looked at without the truth: is it in one piece?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slamsim.slam.odometry import ELSEWHERE_M
from slamsim.types import Event, GraphEdge, PoseGraph


def loose_joints(graph: PoseGraph) -> Iterator[Event]:
    """One event for each edge of odometry alone whose sides no match and no closure joins."""
    count = len(graph.keyframes)
    firm = [e for e in graph.edges if e.kind != "odometry" and e.weight > 0.0]
    ends = np.array([(e.source, e.target) for e in firm], dtype=np.int64).reshape(-1, 2)
    joined = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    part = connected_components(joined, directed=False)[1]
    stamps_ns, poses = graph.keyframes.stamps_ns, graph.keyframes.poses
    for edge in graph.edges:
        if edge.kind == "odometry" and part[edge.source] != part[edge.target]:
            x, y = poses[edge.target, :2]
            words = f"near ({x:.1f}, {y:.1f}) m {_how_loose(edge)}"
            yield Event(int(stamps_ns[edge.source]), int(stamps_ns[edge.target]), "joined", words)


def _how_loose(edge: GraphEdge) -> str:
    if edge.covariance[:2, :2].trace() >= ELSEWHERE_M**2:
        return (
            "the map goes on without being joined to what was mapped before: its place is a guess"
        )
    return "the map is joined to what was mapped before by odometry alone"
