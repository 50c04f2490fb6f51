"""What poses of the graph see of tags: observations are carried to the nearest pose."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.slam import LandmarksConfig
from slamsim.core.geometry import adjoint, between, compose, inverse, rotation, wrap_angle
from slamsim.core.landmarks import AS_CLAIMED, CameraErrors, TagObservation, TagsSeen
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory

WALK_M, WALK_RAD = 0.01, 0.003
"""Standard deviation of the motion from a node to an image near it, per square root of a metre:
what wheels that slip a little leave."""
STANDING_M = 1e-4
AROUND_NS = 50_000_000
"""A velocity is that between poses so long before and after: a few scans."""
SHARED = 0.1
"""Share of the variance of one observation that all of a node have in common: a small tag far away
is seen nearer than it is, by a fifth of the standard deviation of one image (2,144 views at 4 to
11 m)."""
FARTHEST_SIGMAS = 3.5
"""Observations of one tag that differ more from the others of a node are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class TagView:
    """What a node saw of a tag with a camera. edge: from 0 to 1, for its ends are numbered when the
    graph is built. slopes: (3, 6) how errors that all views of the camera share move the tag, in
    its own frame (``joint.SHARED``)."""

    node: int
    number: int
    camera: str
    edge: GraphEdge
    slopes: FloatArray


def tag_views(
    trajectory: PlanarTrajectory,
    nodes: PlanarTrajectory,
    tags: TagsSeen,
    config: LandmarksConfig,
) -> list[TagView]:
    """What each node sees of each tag by each camera, in this order.

    Observations at times that the trajectory (T_map_base) does not cover are left out.
    """
    inside = [
        one
        for one in tags.observations
        if trajectory.stamps_ns[0] <= one.stamp_ns <= trajectory.stamps_ns[-1]
    ]
    if not inside:
        return []
    stamps_ns = np.array([one.stamp_ns for one in inside], dtype=np.int64)
    poses, velocities = trajectory.at(stamps_ns), _velocities(trajectory, stamps_ns)
    seen: dict[tuple[int, int, str], list[tuple[GraphEdge, FloatArray]]] = defaultdict(list)
    for one, pose, velocity in zip(inside, poses, velocities, strict=True):
        node = int(np.abs(nodes.stamps_ns - one.stamp_ns).argmin())
        T_node_base = between(trajectory.at(nodes.stamps_ns[node : node + 1])[0], pose)
        errors = tags.cameras.get(one.camera, AS_CLAIMED)
        edge, slopes = _carried(T_node_base, one), _slopes(one, velocity, errors)
        # In the frame of the node: tags that fit two ways are not turned alike in all images.
        slopes = rotation(edge.T_source_target[2]) @ slopes
        seen[node, one.number, one.camera].append((edge, slopes))
    found = []
    for key in sorted(seen):
        edges, turned = zip(*seen[key], strict=True)
        edge = _joined(edges, config)
        own = rotation(-edge.T_source_target[2]) @ np.mean(turned, axis=0)
        found.append(TagView(*key, edge, own))
    return found


def _velocities(trajectory: PlanarTrajectory, stamps_ns: IntArray) -> FloatArray:
    """(n, 3) of the base in its own frame, m/s and rad/s, over a tenth of a second or less."""
    first_ns, last_ns = trajectory.stamps_ns[0], trajectory.stamps_ns[-1]
    begin_ns = np.maximum(stamps_ns - AROUND_NS, first_ns)
    end_ns = np.minimum(stamps_ns + AROUND_NS, last_ns)
    step = between(trajectory.at(begin_ns), trajectory.at(end_ns))
    seconds = np.maximum(1e-9 * (end_ns - begin_ns), 1e-9)
    return np.asarray(step / seconds[:, None])


def _slopes(one: TagObservation, velocity: FloatArray, camera: CameraErrors) -> FloatArray:
    """(3, 6) of one observation."""
    by_base = adjoint(inverse(one.T_base_tag))
    by_time = by_base @ velocity
    turned = rotation(-one.T_base_tag[2])[:2, :2]
    ray = np.append(turned @ (one.T_base_tag[:2] - camera.middle_m), 0.0)
    return np.column_stack([by_base, by_time, one.row * by_time, ray])


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
