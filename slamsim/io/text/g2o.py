"""Pose graphs in the g2o text format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.result import GraphEdge, PoseGraph
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import write_atomic


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """``VERTEX_SE2 id x y yaw`` and ``EDGE_SE2 from to x y yaw`` with the upper information.

    Vertices are numbered as the key frames; edges that the estimator withdrew (weight 0) and
    priors, for which the format has no line, are left out; other weights scale the information.
    Raises SlamsimError for a covariance that has no inverse.
    """
    lines = [
        f"VERTEX_SE2 {i} {_numbers(pose)}" for i, pose in enumerate(graph.keyframes.poses.tolist())
    ]
    lines += [_edge(edge) for edge in graph.edges if edge.kind != "prior" and edge.weight > 0.0]
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def _edge(edge: GraphEdge) -> str:
    try:
        information = edge.weight * np.linalg.inv(edge.covariance)
    except np.linalg.LinAlgError:
        information = np.full((3, 3), np.nan)
    if not np.isfinite(information).all():
        raise SlamsimError(f"the edge {edge.source} -> {edge.target} has no information matrix")
    upper = information[np.triu_indices(3)].tolist()
    pose = _numbers(np.asarray(edge.T_source_target).tolist())
    return f"EDGE_SE2 {edge.source} {edge.target} {pose} {_numbers(upper)}"


def _numbers(values: list[float]) -> str:
    return " ".join(f"{value:.12g}" for value in values)
