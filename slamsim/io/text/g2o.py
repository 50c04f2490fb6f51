"""Pose graphs in the g2o text format, in the plane and in space."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.result import GraphEdge, PoseGraph
from slamsim.core.spatial import SpatialEdge
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import write_atomic


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """``VERTEX_SE2 id x y yaw`` and ``EDGE_SE2 from to x y yaw`` with the upper information.

    Vertices are numbered as the key frames; edges that the estimator withdrew (weight 0) and
    priors, for which the format has no line, are left out; other weights scale the information.
    Raises SlamsimError for a covariance that has no inverse.
    """
    lines = [f"VERTEX_SE2 {i} {_numbers(pose)}" for i, pose in enumerate(graph.keyframes.poses)]
    lines += [
        _planar_edge(edge) for edge in graph.edges if edge.kind != "prior" and edge.weight > 0.0
    ]
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def _planar_edge(edge: GraphEdge) -> str:
    try:
        information = edge.weight * np.linalg.inv(edge.covariance)
    except np.linalg.LinAlgError:
        information = np.full((3, 3), np.nan)
    if not np.isfinite(information).all():
        raise SlamsimError(f"the edge {edge.source} -> {edge.target} has no information matrix")
    upper = information[np.triu_indices(3)]
    pose = _numbers(np.asarray(edge.T_source_target))
    return f"EDGE_SE2 {edge.source} {edge.target} {pose} {_numbers(upper)}"


def write_g2o_space(path: Path, poses: FloatArray, edges: Sequence[SpatialEdge]) -> None:
    """``VERTEX_SE3:QUAT id x y z qx qy qz qw`` of poses (n, 4, 4), and ``EDGE_SE3:QUAT`` with the
    upper information.

    Edges that were withdrawn, and what is known of single poses, are left out.
    """
    lines = [f"VERTEX_SE3:QUAT {k} {_spatial_pose(pose)}" for k, pose in enumerate(poses)]
    lines += [_spatial_edge(edge) for edge in edges if edge.kind != "floor" and edge.weight > 0.0]
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def _spatial_edge(edge: SpatialEdge) -> str:
    # The format's rotations are the vector part of a quaternion, which is half the angle.
    half = np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    information = half @ np.linalg.inv(edge.covariance) @ half
    upper = _numbers(information[np.triu_indices(6)])
    return (
        f"EDGE_SE3:QUAT {edge.source} {edge.target} {_spatial_pose(edge.T_source_target)} {upper}"
    )


def _spatial_pose(T: FloatArray) -> str:
    return _numbers(np.concatenate([T[:3, 3], xyzw_from_matrix(T[:3, :3])]))


def _numbers(values: NDArray[Any]) -> str:
    return " ".join(f"{value:.12g}" for value in values.tolist())
