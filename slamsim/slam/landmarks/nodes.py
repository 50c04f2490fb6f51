"""Poses of the graph that see tags: key frames, and more of them where these lie far apart.

Where a lidar sees nothing, there are few key frames, if any; images in between see tags all the
same. The step from one key frame to the next is then cut into several, each with the share of its
covariance that its path has: that is how errors of wheels and gyroscopes grow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import MotionConfig
from slamsim.core.geometry import between, rotation
from slamsim.core.landmarks import TagsSeen
from slamsim.core.result import GraphEdge, SlamResult
from slamsim.core.types import BoolArray, FloatArray, IntArray, PlanarTrajectory
from slamsim.slam.backend.surface_information import MapInformation
from slamsim.slam.landmarks.wheels import wheel_sigmas

EARLIER = -1
"""Number of the origin of a map that a drive continues."""
SPACING_M, SPACING_RAD = 0.25, 0.2
"""A pose that sees a tag stands for images up to half of this away; the motion to them is small
beside the error of one image."""
MOSTLY = 0.5
ARM_M = 0.3
"""What a turn counts as path: as far from the wheels' axle as wheels are apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """track: T_map_base of all poses of the graph. keyframes: (k,) which of them are key frames.
    edges: between them, measured anew where SLAM put the poses in the end. blind: (m,) those of
    odometry beside which hardly a scan was matched. wheels: (6,) ``wheel_sigmas``. surfaces: (p, 2)
    ordered pairs of poses and (p, 3, 3) what they know of each other. ``EARLIER`` stands for a map
    that the drive continues."""

    track: PlanarTrajectory
    keyframes: IntArray
    edges: tuple[GraphEdge, ...]
    blind: BoolArray
    wheels: FloatArray
    surfaces: tuple[IntArray, FloatArray]


def nodes_of(
    result: SlamResult,
    tags: TagsSeen,
    motion: MotionConfig,
    information: MapInformation | None,
) -> Nodes:
    """The key frames of a result, with further poses where tags were seen on the way.

    information: what holds the key frames; without it the edges of the graph do.
    """
    keyframes, trajectory = result.graph.keyframes, result.trajectory
    seen_ns = np.array([one.stamp_ns for one in tags.observations], dtype=np.int64)
    inside = (seen_ns >= trajectory.stamps_ns[0]) & (seen_ns <= trajectory.stamps_ns[-1])
    stamps_ns = _spread(trajectory, keyframes.stamps_ns, np.unique(seen_ns[inside]))
    poses = trajectory.at(stamps_ns)
    number = np.searchsorted(stamps_ns, keyframes.stamps_ns)
    poses[number] = keyframes.poses
    edges, surfaces = _held(result, information, number, motion)
    if tags.continues and information is None:
        edges.append(_from_earlier(result, int(number[0])))
    edges = [piece for edge in edges for piece in _cut(edge, poses)]
    edges = [_measured(edge, poses) for edge in edges]
    outer = [*range(number[0]), *range(number[-1], len(poses) - 1)]
    edges += [_by_wheels(k, poses, motion) for k in outer]
    shares = [_blind_share(result, stamps_ns[[e.source, e.target]]) for e in edges]
    blind = np.array([e.kind == "odometry" for e in edges]) & (np.array(shares) > MOSTLY)
    wheels = wheel_sigmas(result.calibration)
    return Nodes(PlanarTrajectory(stamps_ns, poses), number, tuple(edges), blind, wheels, surfaces)


def _held(
    result: SlamResult,
    information: MapInformation | None,
    number: IntArray,
    motion: MotionConfig,
) -> tuple[list[GraphEdge], tuple[IntArray, FloatArray]]:
    """What holds the key frames, whose numbers are (k,): edges, and the surfaces of ``Nodes``."""
    if information is None:
        edges = [edge for edge in result.graph.edges if edge.weight > 0.0]
        surfaces = np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3, 3))
    else:
        edges, (pairs, known) = information.steps(), information.blocks()
        edges = [_as_blind(edge, result, motion) for edge in edges]
        surfaces = np.append(number, EARLIER)[pairs], known
    ends = np.append(number, EARLIER)
    return [
        replace(edge, source=int(ends[edge.source]), target=int(ends[edge.target]))
        for edge in edges
    ], surfaces


def _from_earlier(result: SlamResult, node: int) -> GraphEdge:
    """Where the first key frame is in the map that the drive continues."""
    pose = result.graph.keyframes.poses[0]
    turned = rotation(pose[2])  # out of the key frame's own frame
    covariance = turned @ result.graph.covariances[0] @ turned.T
    return GraphEdge(EARLIER, node, pose, covariance, "match")


def _spread(trajectory: PlanarTrajectory, keyframes_ns: IntArray, seen_ns: IntArray) -> IntArray:
    """(n,) stamps of the key frames, and of images that are apart from each other and from them."""
    found = set(keyframes_ns.tolist())
    ordered = np.union1d(keyframes_ns, seen_ns)
    poses, last = trajectory.at(ordered), 0
    for k in range(len(ordered)):
        step = between(poses[last], poses[k])
        far = np.hypot(step[0], step[1]) > SPACING_M or abs(step[2]) > SPACING_RAD
        if k == 0 or far or int(ordered[k]) in found:
            found.add(int(ordered[k]))
            last = k
    return np.array(sorted(found), dtype=np.int64)


def _cut(edge: GraphEdge, poses: FloatArray) -> list[GraphEdge]:
    """An edge of the chain as edges from pose to pose between its ends; others as they are."""
    if edge.kind == "closure" or edge.source == EARLIER:
        return [edge]
    numbers = range(edge.source, edge.target)
    paths_m = [_path_m(between(poses[k], poses[k + 1])) for k in numbers]
    whole_m = sum(paths_m)
    kind = edge.kind if len(paths_m) == 1 else "odometry"
    found = []
    for k, path_m in zip(numbers, paths_m, strict=True):
        turned = rotation(poses[edge.source, 2] - poses[k, 2])
        covariance = turned @ edge.covariance @ turned.T * (path_m / whole_m)
        found.append(replace(edge, source=k, target=k + 1, covariance=covariance, kind=kind))
    return found


def _measured(edge: GraphEdge, poses: FloatArray) -> GraphEdge:
    """An edge as if it had been measured where its ends are."""
    source = np.zeros(3) if edge.source == EARLIER else poses[edge.source]
    return replace(edge, T_source_target=between(source, poses[edge.target]))


def _by_wheels(source: int, poses: FloatArray, motion: MotionConfig) -> GraphEdge:
    """A step before the first key frame or after the last, as unsure as wheels are."""
    step = between(poses[source], poses[source + 1])
    return GraphEdge(source, source + 1, step, _of_wheels(step, motion), "odometry")


def _as_blind(edge: GraphEdge, result: SlamResult, motion: MotionConfig) -> GraphEdge:
    """A step of the odometry between key frames, with the noise of wheels on top of its own as far
    as no scan was matched: how good they are is learnt from scans, which tell nothing there."""
    if edge.kind == "closure" or edge.source == EARLIER:
        return edge
    share = _blind_share(result, result.graph.keyframes.stamps_ns[[edge.source, edge.target]])
    noise = share * _of_wheels(edge.T_source_target, motion)
    return replace(edge, covariance=edge.covariance + noise)


def _blind_share(result: SlamResult, ends_ns: IntArray) -> float:
    """Of the scans from one instant to another, those that were not matched."""
    if result.match_information is None:
        return 0.0
    begin, end = np.searchsorted(result.trajectory.stamps_ns, ends_ns).tolist()
    between_them = result.match_information[begin + 1 : max(end, begin + 1) + 1]
    return float((between_them == 0.0).all(axis=(1, 2)).mean()) if len(between_them) else 0.0


def _of_wheels(step: FloatArray, motion: MotionConfig) -> FloatArray:
    """(3, 3) covariance of a step by wheels and gyroscope alone."""
    slip_m2 = motion.slip_m_per_sqrt_m**2
    return np.diag([slip_m2, slip_m2, motion.turn_rad_per_sqrt_m**2]) * _path_m(step)


def _path_m(step: FloatArray) -> float:
    """At least a millimetre: a pose that stands is not exactly where it was."""
    return float(np.hypot(step[0], step[1]) + ARM_M * abs(step[2])) + 1e-3
