"""Pose graphs in space in the g2o text format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slamsim.core.geometry import xyzw_from_matrix
from slamsim.core.spatial import SpatialEdge
from slamsim.core.types import FloatArray
from slamsim.guard.output import write_atomic


def write_g2o_space(path: Path, poses: FloatArray, edges: Sequence[SpatialEdge]) -> None:
    """``VERTEX_SE3:QUAT id x y z qx qy qz qw`` of poses (n, 4, 4), and ``EDGE_SE3:QUAT`` with the
    upper information.

    Edges that were withdrawn, and what is known of single poses, are left out.
    """
    lines = [f"VERTEX_SE3:QUAT {k} {_pose(pose)}" for k, pose in enumerate(poses)]
    lines += [_edge(edge) for edge in edges if edge.kind != "floor" and edge.weight > 0.0]
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def _edge(edge: SpatialEdge) -> str:
    # The format's rotations are the vector part of a quaternion, which is half the angle.
    half = np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    information = half @ np.linalg.inv(edge.covariance) @ half
    upper = _numbers(information[np.triu_indices(6)])
    return f"EDGE_SE3:QUAT {edge.source} {edge.target} {_pose(edge.T_source_target)} {upper}"


def _pose(T: FloatArray) -> str:
    return _numbers(np.concatenate([T[:3, 3], xyzw_from_matrix(T[:3, :3])]))


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:.12g}" for value in values.tolist())
