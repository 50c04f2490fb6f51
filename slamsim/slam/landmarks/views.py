"""What poses of the graph see of tags: observations are carried to the nearest pose."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from slamsim.config.slam import LandmarksConfig
from slamsim.core.geometry import adjoint, between, compose, rotation, wrap_angle
from slamsim.core.landmarks import TagObservation
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, PlanarTrajectory

WALK_M, WALK_RAD = 0.01, 0.003
"""Standard deviation of the motion from a node to an image near it, per square root of a metre:
what wheels that slip a little leave."""
STANDING_M = 1e-4
SHARED = 0.1
"""Share of the variance of one observation that all of a node have in common: a small tag far away
is seen nearer than it is, by a fifth of the standard deviation of one image (2,144 views at 4 to
11 m)."""
FARTHEST_SIGMAS = 3.5
"""Observations of one tag that differ more from the others of a node are left out."""


def tag_views(
    trajectory: PlanarTrajectory,
    nodes: PlanarTrajectory,
    observations: Sequence[TagObservation],
    config: LandmarksConfig,
) -> list[tuple[int, int, GraphEdge]]:
    """(number of the node, tag's number, edge) of each node that sees a tag, in this order.

    Edges lead from 0 to 1, for their ends are numbered when the graph is built. Observations
    at times that the trajectory (T_map_base) does not cover are left out.
    """
    first_ns, last_ns = trajectory.stamps_ns[0], trajectory.stamps_ns[-1]
    seen: dict[tuple[int, int], list[GraphEdge]] = defaultdict(list)
    for one in observations:
        if first_ns <= one.stamp_ns <= last_ns:
            node = int(np.abs(nodes.stamps_ns - one.stamp_ns).argmin())
            stamps_ns = np.array([nodes.stamps_ns[node], one.stamp_ns])
            T_node_base = between(*trajectory.at(stamps_ns))
            seen[node, one.number].append(_carried(T_node_base, one))
    return [(*key, _joined(seen[key], config)) for key in sorted(seen)]


def _carried(T_node_base: FloatArray, one: TagObservation) -> GraphEdge:
    """The observation as its node would have made it."""
    path_m = float(np.hypot(*T_node_base[:2])) + STANDING_M
    motion = path_m * np.diag(np.square([WALK_M, WALK_M, WALK_RAD]))
    turned = rotation(T_node_base[2])
    # A step of the base moves the tag as seen from the node by the lever between the two.
    lever = adjoint(np.array([*-(turned[:2, :2] @ one.T_base_tag[:2]), 0.0]))
    covariance = turned @ one.covariance @ turned.T + lever @ motion @ lever.T
    T_node_tag = compose(T_node_base, one.T_base_tag)
    return GraphEdge(0, 1, T_node_tag, covariance, "closure")


def _joined(edges: Sequence[GraphEdge], config: LandmarksConfig) -> GraphEdge:
    """All that a node saw of a tag as one measurement."""
    middle = np.median([edge.T_source_target[:2] for edge in edges], axis=0)
    sigmas = [np.sqrt(np.trace(edge.covariance[:2, :2])) for edge in edges]
    near = [
        edge
        for edge, sigma in zip(edges, sigmas, strict=True)
        if np.linalg.norm(edge.T_source_target[:2] - middle) <= FARTHEST_SIGMAS * sigma
    ] or [edges[int(np.argmin(sigmas))]]
    about = near[0].T_source_target
    information, pull = np.zeros((3, 3)), np.zeros(3)
    for edge in near:
        off = edge.T_source_target - about
        off[2] = wrap_angle(off[2])
        certain = np.linalg.inv(edge.covariance)
        information, pull = information + certain, pull + certain @ off
    covariance = np.linalg.inv(information)
    mean = about + covariance @ pull
    mean[2] = wrap_angle(mean[2])
    least = [config.least_sigma_m, config.least_sigma_m, np.radians(config.least_sigma_deg)]
    shared = SHARED * near[int(np.argmin([np.trace(e.covariance) for e in near]))].covariance
    covariance = 0.5 * (covariance + covariance.T) + shared + np.diag(np.square(least))
    return GraphEdge(0, 1, mean, covariance, "closure")
