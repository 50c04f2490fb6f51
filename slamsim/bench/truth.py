"""Loop closures against the truth: false closures, and missed revisits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between, wrap_angle
from slamsim.core.result import GraphEdge, PoseGraph
from slamsim.core.types import BoolArray, FloatArray, PlanarTrajectory
from slamsim.slam.backend.graph import residual_sigmas

FALSE_SIGMAS = 5.0
FALSE_M = 0.10
FALSE_RAD = float(np.deg2rad(3.0))
"""A closure is false if it is off by more than FALSE_SIGMAS of its own and by more than any true
one: a match of submaps is off by some centimetres at most."""
REVISIT_M = 0.5
"""A place within half a metre of one that was passed shows the same walls."""
REVISIT_AFTER_M = 10.0
CLOSED_WITHIN_M = 2.0
"""A closure says of a stretch of the path where it is, not of one key frame alone: of so much of it
to either side."""


@dataclass(frozen=True, slots=True)
class ClosureCheck:
    """One closure of the graph that is not so in truth.

    off_m, off_deg: how far its measurement is from the truth; off_sigmas: in its own standard
    deviations (Mahalanobis). believed: whether SLAM still believed it in the end.
    """

    source: int
    target: int
    target_ns: int
    off_m: float
    off_deg: float
    off_sigmas: float
    believed: bool


def false_closures(
    graph: PoseGraph, truth: PlanarTrajectory, least_m: float = FALSE_M
) -> list[ClosureCheck]:
    """Closures that differ from the truth by more than 5 of their own sigmas, and also by more
    than ``least_m`` or 3 degrees. Key frames that the truth does not cover are left out."""
    closures = _covered_closures(graph, truth)
    if not closures:
        return []
    stamps_ns = np.clip(graph.keyframes.stamps_ns, truth.stamps_ns[0], truth.stamps_ns[-1])
    poses = truth.at(stamps_ns)
    sigmas = residual_sigmas(poses, closures)
    found = []
    for edge, off_sigmas in zip(closures, sigmas.tolist(), strict=True):
        off = between(between(poses[edge.source], poses[edge.target]), edge.T_source_target)
        off_m, off_rad = float(np.hypot(off[0], off[1])), abs(float(wrap_angle(off[2])))
        if off_sigmas > FALSE_SIGMAS and (off_m > least_m or off_rad > FALSE_RAD):
            found.append(
                ClosureCheck(
                    edge.source,
                    edge.target,
                    int(graph.keyframes.stamps_ns[edge.target]),
                    off_m,
                    float(np.rad2deg(off_rad)),
                    off_sigmas,
                    edge.weight > 0.0,
                )
            )
    return found


def revisits_closed(graph: PoseGraph, truth: PlanarTrajectory) -> tuple[int, int]:
    """How many key frames stand where the robot had been before, and how many of them are tied
    to an earlier pass.

    Been before: within 0.5 m of an earlier key frame that lies 10 m of path or more back. Tied:
    the key frame, or one within 2 m of path, ends a closure that is still believed.
    """
    stamps_ns = np.clip(graph.keyframes.stamps_ns, truth.stamps_ns[0], truth.stamps_ns[-1])
    places_m = truth.at(stamps_ns)[:, :2]
    steps_m = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    path_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    closed = np.unique([edge.target for edge in graph.edges if _believed(edge)]).astype(np.int64)
    revisits = _been_before(places_m, path_m)
    tied = np.zeros(len(path_m), dtype=np.bool_)
    for number in closed.tolist():
        tied |= np.abs(path_m - path_m[number]) <= CLOSED_WITHIN_M
    return int(np.count_nonzero(revisits)), int(np.count_nonzero(revisits & tied))


def _been_before(places_m: FloatArray, path_m: FloatArray) -> BoolArray:
    """(n,) which places were passed before, REVISIT_AFTER_M of path or more ago."""
    been = np.zeros(len(path_m), dtype=np.bool_)
    for number in range(len(path_m)):
        earlier = int(np.searchsorted(path_m, path_m[number] - REVISIT_AFTER_M, side="right"))
        away_m = np.linalg.norm(places_m[:earlier] - places_m[number], axis=1)
        been[number] = bool((away_m <= REVISIT_M).any())
    return been


def _believed(edge: GraphEdge) -> bool:
    return edge.kind == "closure" and edge.weight > 0.0


def _covered_closures(graph: PoseGraph, truth: PlanarTrajectory) -> Sequence[GraphEdge]:
    stamps_ns = graph.keyframes.stamps_ns
    inside = (stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])
    return [
        edge
        for edge in graph.edges
        if edge.kind == "closure" and inside[edge.source] and inside[edge.target]
    ]
