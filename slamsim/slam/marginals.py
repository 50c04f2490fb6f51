"""Covariances of a solved pose graph without inverting it.

Each pose is disturbed by a small step in its own frame, so that no number grows with the distance
from the map's origin: levers are those between the two poses of an edge. The inverse, with one pose
held fixed, has the uncertainty of every other pose relative to that one on its diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.geometry import between
from slamsim.jit import kernel
from slamsim.result import GraphEdge
from slamsim.safe.numbers import NoSolution
from slamsim.slam.blocks import BlockFactor, factorise
from slamsim.slam.panels import Panels, add_block, empty_system, make_panels
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


def edge_covariances(edges: Sequence[GraphEdge]) -> FloatArray:
    """(m, 3, 3) covariance of each edge as a small step of its target in the target's frame."""
    covariances = np.array([edge.covariance for edge in edges]).reshape(-1, 3, 3)
    measured = np.array([edge.T_source_target for edge in edges]).reshape(-1, 3)
    turn = rotation(-measured[:, 2])
    return np.asarray(turn @ covariances @ np.swapaxes(turn, -1, -2))


def relative_covariances(poses: FloatArray, edges: Sequence[GraphEdge], fixed: int) -> FloatArray:
    """(n, 3, 3) covariance of each pose relative to the fixed one, as small steps in its own frame.

    Edges count by their weight. Raises NoSolution unless every pose is joined to the fixed one.
    """
    covariances = np.zeros((len(poses), 3, 3))
    if len(poses) > 1:
        factor = graph_factor(poses, edges, fixed)
        covariances[factor.keyframes] = factor.inverse_diagonal()
    return covariances


def graph_factor(poses: FloatArray, edges: Sequence[GraphEdge], fixed: int) -> BlockFactor:
    """The information of all poses (n, 3) but the fixed one, as small steps in their own frames.

    Its unknowns are the other poses in their order. Raises as ``relative_covariances``.
    """
    used = [edge for edge in edges if edge.weight > 0.0]
    if not used:
        raise NoSolution(f"nothing joins {len(poses)} poses, which are as unsure as can be")
    weights = np.array([edge.weight for edge in used])
    information = weights[:, None, None] * np.linalg.inv(edge_covariances(used))
    ends = np.array([(edge.source, edge.target) for edge in used])
    T_target_source = between(poses[ends[:, 1]], poses[ends[:, 0]])
    # The fixed pose goes last in the numbering and is left out of the system.
    others = np.delete(np.arange(len(poses)), fixed)
    number = np.empty(len(poses), dtype=np.int64)
    number[others], number[fixed] = np.arange(len(others)), len(others)
    panels = make_panels(number[ends], len(others))
    system = empty_system(panels)
    add_edges(panels, system, number[ends], adjoint(T_target_source), information)
    return factorise(panels, system, others)


def add_edges(
    panels: Panels, system: FloatArray, ends: IntArray, carry: FloatArray, information: FloatArray
) -> None:
    """Add what edges know of the unknowns that they join.

    ends: (m, 2) source and target. carry: (m, 3, 3) takes a small step of the source to the frame
    of the target. information: (m, 3, 3) in the target's frame.
    """
    beside = -np.swapaxes(carry, -1, -2) @ information
    _add_blocks(panels, system, ends, -beside @ carry, beside, information)


@kernel
def _add_blocks(
    panels: Panels,
    system: FloatArray,
    ends: IntArray,
    of_source: FloatArray,
    beside: FloatArray,
    of_target: FloatArray,
) -> None:
    fixed = panels.place.size - 1
    for m in range(ends.shape[0]):
        a, b = ends[m, 0], ends[m, 1]
        if a != fixed:
            add_block(panels, system, a, a, of_source[m])
        if b != fixed:
            add_block(panels, system, b, b, of_target[m])
        if fixed not in (a, b):
            add_block(panels, system, a, b, beside[m])
