"""Covariances of a solved pose graph without inverting it.

Poses are disturbed from the left, in the map frame: then an edge's information enters the
system as a graph Laplacian with matrix weights, and the inverse, with one pose held fixed, has the
uncertainty of every other pose relative to that one on its diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.geometry import inverse
from slamsim.jit import kernel
from slamsim.result import GraphEdge
from slamsim.safe.numbers import NoSolution
from slamsim.slam.blocks import add_block, empty_system, factorise
from slamsim.slam.panels import Panels, make_panels
from slamsim.types import FloatArray, IntArray


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """(..., 3, 3): takes a small step (x, y, yaw) seen in frame b to the same step in frame a."""
    T_a_b = np.asarray(T_a_b, dtype=np.float64)
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = [
        np.stack([cos, -sin, T_a_b[..., 1]], axis=-1),
        np.stack([sin, cos, -T_a_b[..., 0]], axis=-1),
        np.stack([zero, zero, one], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def rotation(yaw_rad: FloatArray) -> FloatArray:
    """(..., 3, 3): turns x and y of a step (x, y, yaw), leaving yaw as it is."""
    turn = np.zeros((*np.shape(yaw_rad), 3))
    turn[..., 2] = yaw_rad
    return adjoint(turn)


def edge_covariances_in_map(
    poses: FloatArray, edges: Sequence[GraphEdge], origin_m: FloatArray
) -> FloatArray:
    """(m, 3, 3) covariance of each edge as a step of the map about ``origin_m``."""
    covariances = np.array([edge.covariance for edge in edges]).reshape(-1, 3, 3)
    measured = np.array([edge.T_source_target for edge in edges]).reshape(-1, 3)
    targets = poses[[edge.target for edge in edges]] - np.append(origin_m, 0.0)
    # From the frame of the source to that of the target, and from there to the map.
    transport = adjoint(targets) @ rotation(-measured[:, 2])
    return np.asarray(transport @ covariances @ np.swapaxes(transport, -1, -2))


def relative_covariances(
    poses: FloatArray, edges: Sequence[GraphEdge], fixed: int, origin_m: FloatArray
) -> FloatArray:
    """(n, 3, 3) covariance of each pose relative to the fixed one, as steps about ``origin_m``.

    Edges count by their weight. Raises NoSolution unless every pose is joined to the fixed one.
    """
    count = len(poses)
    if count == 1:
        return np.zeros((1, 3, 3))
    used = [edge for edge in edges if edge.weight > 0.0]
    if not used:
        raise NoSolution(f"nothing joins {count} poses, which are as unsure as can be")
    weights = np.array([edge.weight for edge in used])
    information = weights[:, None, None] * np.linalg.inv(
        edge_covariances_in_map(poses, used, origin_m)
    )
    # The fixed pose goes last in the numbering and is left out of the system.
    place = np.delete(np.arange(count), fixed)
    number = np.empty(count, dtype=np.int64)
    number[place], number[fixed] = np.arange(count - 1), count - 1
    ends = np.array([[number[edge.source], number[edge.target]] for edge in used])
    panels = make_panels(ends, count - 1)
    system = empty_system(panels)
    add_edges(panels, system, ends, information)
    covariances = np.zeros((count, 3, 3))
    covariances[place] = factorise(panels, system).inverse_diagonal()
    return covariances


def in_own_frame(poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """(n, 3, 3) steps of the map about its origin as small steps of each base in its own frame."""
    own = adjoint(inverse(poses))
    return np.asarray(own @ covariances @ np.swapaxes(own, -1, -2))


@kernel
def add_edges(panels: Panels, system: FloatArray, ends: IntArray, information: FloatArray) -> None:
    """Add a graph Laplacian with matrix weights: ends (m, 2), information (m, 3, 3)."""
    fixed = panels.place.size - 1
    for m in range(ends.shape[0]):
        a, b = ends[m, 0], ends[m, 1]
        if a != fixed:
            add_block(panels, system, a, a, information[m])
        if b != fixed:
            add_block(panels, system, b, b, information[m])
        if fixed not in (a, b):
            add_block(panels, system, a, b, -information[m])
