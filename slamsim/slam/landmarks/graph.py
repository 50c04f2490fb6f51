"""The pose graph of a finished map solved once more, with tags as landmarks in it.

The edges of the graph are measured anew where SLAM put the key frames in the end (``nodes``), so
that what its refinement found stays as it is where no tag contradicts; they keep their covariances.
A tag is one more pose of the graph, and each node that sees it joins it by an edge that may be
doubted and withdrawn as a closure may. Surveyed tags hang on the origin of their survey, which then
holds the graph in the place of the first key frame. Where only wheels and gyroscope tell the way,
what they get wrong alike everywhere (sizes of wheels and track) is learnt from the tags.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import compose, inverse
from slamsim.core.landmarks import KnownTag, Landmark, TagsSeen
from slamsim.core.result import GraphEdge, SlamResult
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.slam.backend.correction import correct_pieces
from slamsim.slam.backend.graph import PoseGraphSolver
from slamsim.slam.backend.marginals import relative_covariances
from slamsim.slam.failures import Failures
from slamsim.slam.landmarks.nodes import Nodes, nodes_of, rescaled
from slamsim.slam.landmarks.views import tag_views

NOT_WHILE_MAPPED = "tags were seen only before the first scan or after the last: they hold nothing"
CALIBRATION_ROUNDS = 5
"""Each solution is drawn half way to what the last one's odometry said."""
PART = "landmarks"
"""Of ``SlamResult.parts``."""


def held_by_tags(
    result: SlamResult, tags: TagsSeen, config: SlamConfig, failures: Failures
) -> SlamResult:
    """``with_landmarks`` where there are any; the result as it is where that fails."""
    if tags.observations:
        with failures.caught("landmarks", len(result.graph.keyframes) - 1):
            return with_landmarks(result, tags, config)
    return result


def with_landmarks(result: SlamResult, tags: TagsSeen, config: SlamConfig) -> SlamResult:
    """The result with its key frames and trajectory held by tags, and these in ``landmarks``.

    If a surveyed tag was seen, the map is in the frame of the survey. Raises GraphUnsound.
    """
    nodes = nodes_of(result, tags.observations, config.front_end.motion)
    views = tag_views(result.trajectory, nodes.track, tags.observations, config.landmarks)
    if not views:
        return replace(result, warnings=(*result.warnings, NOT_WHILE_MAPPED))
    problem = _Problem.of(nodes, views, tags.known)
    poses, edges = _solved(problem, config)
    anchors = replace(nodes.track, poses=poses[problem.base : problem.base + len(nodes.track)])
    kept = problem.base + nodes.keyframes
    moved = PlanarTrajectory(result.graph.keyframes.stamps_ns, poses[kept])
    breaks_ns = sorted(e.start_ns for e in result.events if e.kind == "kidnapped")
    covariances = relative_covariances(poses, edges, int(kept[0]))[kept]
    graph = replace(result.graph, keyframes=moved, covariances=covariances, in_map=None)
    return replace(
        result,
        trajectory=correct_pieces(result.trajectory, anchors, breaks_ns),
        graph=graph,
        parts={**result.parts, PART: moved},
        landmarks=_landmarks(problem, poses, edges),
        warnings=(*result.warnings, *problem.warnings),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """poses: (m, 3): the survey's origin if base is 1, nodes from number base on, then tags by
    number. fixed: edges that are no views of tags."""

    poses: FloatArray
    base: int
    numbers: Mapping[int, int]
    fixed: tuple[GraphEdge, ...]
    views: tuple[GraphEdge, ...]
    surveyed: frozenset[int]
    warnings: tuple[str, ...] = ()

    @staticmethod
    def of(
        nodes: Nodes, views: Sequence[tuple[int, int, GraphEdge]], known: Sequence[KnownTag]
    ) -> _Problem:
        track = nodes.track.poses
        first = {tag: compose(track[k], edge.T_source_target) for k, tag, edge in reversed(views)}
        tags = sorted(first)
        seen_known = [each for each in known if each.number in first]
        base = 1 if seen_known else 0
        numbers = {tag: base + len(track) + k for k, tag in enumerate(tags)}
        poses = np.concatenate([track, [first[tag] for tag in tags]])
        fixed = [replace(e, source=base + e.source, target=base + e.target) for e in nodes.edges]
        if seen_known:
            anchor = seen_known[0]
            T_survey_map = compose(anchor.T_map_tag, inverse(first[anchor.number]))
            poses = np.concatenate([np.zeros((1, 3)), compose(T_survey_map, poses)])
            fixed += [
                GraphEdge(0, numbers[each.number], each.T_map_tag, each.covariance, "match")
                for each in seen_known
            ]
        return _Problem(
            poses,
            base,
            numbers,
            tuple(fixed),
            tuple(replace(e, source=base + k, target=numbers[t]) for k, t, e in views),
            frozenset(each.number for each in seen_known),
            _missing(known, seen_known),
        )


def _missing(known: Sequence[KnownTag], seen: Sequence[KnownTag]) -> tuple[str, ...]:
    if not known or seen:
        return ()
    return (
        f"none of the {len(known)} surveyed tags was seen: the map begins at its first key frame",
    )


def _solved(problem: _Problem, config: SlamConfig) -> tuple[FloatArray, list[GraphEdge]]:
    """Where all poses are in the end, and the edges with their weights.

    First everything counts as it is, for without tags a robot may have drifted by metres, which a
    robust estimator would take for an error of the tag; then views that do not fit are withdrawn.
    """
    poses, fixed = problem.poses, problem.fixed
    for _ in range(CALIBRATION_ROUNDS):
        trusting = PoseGraphSolver(config.back_end.graph)
        for edge in (*fixed, *problem.views):
            trusting.add(replace(edge, kind="match"))
        poses = trusting.solve(poses)
        fixed = rescaled(problem.fixed, poses)
    doubting = PoseGraphSolver(config.back_end.graph)
    for edge in (*fixed, *problem.views):
        doubting.add(edge)
    poses = doubting.solve(poses)
    return poses, doubting.edges


def _landmarks(
    problem: _Problem, poses: FloatArray, edges: Sequence[GraphEdge]
) -> tuple[Landmark, ...]:
    covariances = relative_covariances(poses, edges, 0)
    found = []
    for tag, number in problem.numbers.items():
        views = [e for e in edges if e.target == number and e.source >= problem.base]
        doubted = sum(edge.weight == 0.0 for edge in views)
        surveyed = tag in problem.surveyed
        found.append(
            Landmark(tag, poses[number], covariances[number], len(views), doubted, surveyed)
        )
    return tuple(found)
