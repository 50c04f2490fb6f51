"""A finished map solved once more, with tags as landmarks in it.

What holds the key frames is the whole information that the refinement has of them (``joint``), and
the odometry in between; without a refinement, the edges of the graph, measured anew where SLAM put
the key frames in the end (``nodes``). So what was found stays as it is where no tag contradicts.
A tag is one more pose, and each node that sees it joins it by an edge that may be doubted and
withdrawn as a closure may. Surveyed tags hang on the origin of their survey, which then holds the
graph in the place of the first key frame. What wheels and gyroscope get wrong is learnt from the
tags, as far as no scan tells it (``wheels``).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import compose, inverse, rotation
from slamsim.core.landmarks import CameraErrors, KnownTag, Landmark, TagsSeen
from slamsim.core.result import GraphEdge, SlamResult
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.slam.backend.correction import correct_pieces
from slamsim.slam.backend.surface_information import MapInformation, with_scatter
from slamsim.slam.failures import Failures
from slamsim.slam.landmarks.joint import SHARED, JointSolver, Ties
from slamsim.slam.landmarks.nodes import Nodes, nodes_of
from slamsim.slam.landmarks.views import TagView, tag_views
from slamsim.slam.landmarks.wheels import WHEELS, learnt_noise, wheel_slopes

NOT_WHILE_MAPPED = "tags were seen only before the first scan or after the last: they hold nothing"
WEIGHING_ROUNDS = 10
"""In which views are weighed and the noise of wheels is learnt."""
PART = "landmarks"
"""Of ``SlamResult.parts``."""


def held_by_tags(
    result: SlamResult,
    information: MapInformation | None,
    tags: TagsSeen,
    config: SlamConfig,
    failures: Failures,
) -> SlamResult:
    """``with_landmarks`` where there are any; the result as it is where that fails."""
    if tags.observations:
        with failures.caught("landmarks", len(result.graph.keyframes) - 1):
            return with_landmarks(result, information, tags, config)
    return result


def with_landmarks(
    result: SlamResult, information: MapInformation | None, tags: TagsSeen, config: SlamConfig
) -> SlamResult:
    """The result with its key frames and trajectory held by tags, and these in ``landmarks``.

    information: what holds the key frames, None without a refinement. If a surveyed tag was seen,
    the map is in the frame of the survey. A tag of an earlier map that was carried elsewhere since
    is mapped anew. Raises NoSolution.
    """
    nodes = nodes_of(result, tags, config.front_end.motion, information)
    views = tag_views(result.trajectory, nodes.track, tags, config.landmarks)
    if not views:
        return replace(result, warnings=(*result.warnings, NOT_WHILE_MAPPED))
    problem = _Problem.of(nodes, views, tags)
    solver = _solved(problem, config)
    warnings = (*problem.warnings, *_not_there(problem, solver))
    if moved_tags := _carried_elsewhere(problem, solver):
        known = tuple(each for each in tags.known if each.number not in moved_tags)
        problem = _Problem.of(nodes, views, replace(tags, known=known))
        solver = _solved(problem, config)
    poses = solver.poses
    anchors = replace(nodes.track, poses=poses[problem.base : problem.base + len(nodes.track)])
    moved = replace(result.graph.keyframes, poses=poses[problem.keyframes])
    breaks_ns = sorted(e.start_ns for e in result.events if e.kind == "kidnapped")
    covariances = _covariances(problem, solver, information)
    graph = replace(result.graph, keyframes=moved, covariances=covariances, in_map=None)
    return replace(
        result,
        trajectory=correct_pieces(result.trajectory, anchors, breaks_ns),
        graph=graph,
        parts={**result.parts, PART: moved},
        landmarks=_landmarks(problem, solver),
        warnings=(*result.warnings, *warnings, *_left_out(problem, solver)),
    )


def as_known(tag: Landmark) -> KnownTag:
    """A tag of a finished map, as a later drive takes it."""
    turned = rotation(tag.T_map_tag[2])
    return KnownTag(tag.number, tag.T_map_tag, turned @ tag.covariance @ turned.T)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """poses: (m, 3): the origin of the survey or the earlier map if base is 1, nodes from number
    base on, then tags by number. fixed: edges that are no views of tags; views: those that are.
    keyframes: (k,)."""

    poses: FloatArray
    base: int
    keyframes: IntArray
    numbers: Mapping[int, int]
    fixed: tuple[GraphEdge, ...]
    blind: BoolArray
    views: tuple[GraphEdge, ...]
    seen: tuple[TagView, ...]
    cameras: Mapping[str, CameraErrors]
    surfaces: tuple[IntArray, FloatArray]
    known: frozenset[int]
    warnings: tuple[str, ...]
    continues: bool
    joined: bool

    @staticmethod
    def of(nodes: Nodes, views: Sequence[TagView], tags: TagsSeen) -> _Problem:
        track = nodes.track.poses
        first = _places(track, views)
        seen = sorted(first)
        known = [each for each in tags.known if each.number in first]
        base = 1 if known or tags.continues else 0
        numbers = {tag: base + len(track) + k for k, tag in enumerate(seen)}
        poses = np.concatenate([track, [first[tag] for tag in seen]])
        fixed = [replace(e, source=base + e.source, target=base + e.target) for e in nodes.edges]
        if known and not tags.continues:
            anchor = known[0]
            poses = compose(compose(anchor.T_map_tag, inverse(first[anchor.number])), poses)
        if base:
            poses = np.concatenate([np.zeros((1, 3)), poses])
        fixed += [
            GraphEdge(0, numbers[each.number], each.T_map_tag, each.covariance, "match")
            for each in known
        ]
        return _Problem(
            poses,
            base,
            base + nodes.keyframes,
            numbers,
            tuple(fixed),
            np.append(nodes.blind, np.zeros(len(known), np.bool_)),
            tuple(replace(v.edge, source=base + v.node, target=numbers[v.number]) for v in views),
            tuple(views),
            tags.cameras,
            (base + nodes.surfaces[0], nodes.surfaces[1]),
            frozenset(each.number for each in known),
            () if tags.continues else _missing(tags.known, known),
            tags.continues,
            tags.joined,
        )

    def fitting(self, solver: JointSolver) -> dict[int, list[bool]]:
        """Of each tag by its number, whether its views count."""
        found: dict[int, list[bool]] = {tag: [] for tag in self.numbers}
        for view, weight in zip(self.seen, solver.weights[len(self.fixed) :], strict=True):
            found[view.number].append(bool(weight > 0.0))
        return found

    def ties(self) -> Ties:
        """The wheels count as the last of the cameras: they have errors in common as well."""
        names = {name: k for k, name in enumerate(self.cameras)}
        driven = [edge.kind == "odometry" for edge in self.fixed]
        none = np.zeros((3, SHARED))
        slopes = [
            wheel_slopes(edge) if by_wheels else none
            for edge, by_wheels in zip(self.fixed, driven, strict=True)
        ]
        return Ties(
            (*self.fixed, *self.views),
            np.array(
                [len(names) if by_wheels else -1 for by_wheels in driven]
                + [names.get(view.camera, -1) for view in self.seen]
            ),
            np.array([*slopes, *(view.slopes for view in self.seen)]),
            np.array([*(each.sigmas for each in self.cameras.values()), WHEELS]),
            self.surfaces,
            self.poses,
        )


def _places(track: FloatArray, views: Sequence[TagView]) -> dict[int, FloatArray]:
    """Of each tag by its number, (3,) that place of all in which nodes saw it which is nearest to
    the others: one view may be of another tag."""
    told: dict[int, list[FloatArray]] = defaultdict(list)
    for view in views:
        told[view.number].append(compose(track[view.node], view.edge.T_source_target))
    found = {}
    for number, poses in told.items():
        places = np.array(poses)
        # Row by row: a tag may be in view from thousands of nodes.
        apart = [np.linalg.norm(place[:2] - places[:, :2], axis=1).sum() for place in places]
        found[number] = places[int(np.argmin(apart))]
    return found


def _missing(known: Sequence[KnownTag], seen: Sequence[KnownTag]) -> tuple[str, ...]:
    if not known or seen:
        return ()
    return (
        f"none of the {len(known)} surveyed tags was seen: the map begins at its first key frame",
    )


def _solved(problem: _Problem, config: SlamConfig) -> JointSolver:
    """Where all poses are in the end, and the edges with their weights.

    Views that do not fit are withdrawn in the end; before, all count by how far they are off beside
    the others.
    """
    solver = JointSolver(problem.ties(), problem.poses, 0 if problem.base else problem.keyframes[0])
    for _ in range(WEIGHING_ROUNDS):
        solver.weigh(config.back_end.graph)
        solver.relax()
        if problem.blind.any():
            fixed = learnt_noise(problem.fixed, problem.blind, solver)
            solver.measure((*fixed, *problem.views))
    solver.doubt(config.back_end.graph)
    return solver


def _covariances(
    problem: _Problem, solver: JointSolver, information: MapInformation | None
) -> FloatArray:
    """(k, 3, 3) of the key frames relative to the first of the map."""
    first = 0 if problem.continues else int(problem.keyframes[0])
    held = solver.covariances(first)[problem.keyframes]
    if information is None:
        return held
    poses, scatter = solver.poses[problem.keyframes], information.scatter[information.first :]
    return held + scatter if problem.continues else with_scatter(poses, held, scatter)


def _not_there(problem: _Problem, solver: JointSolver) -> list[str]:
    """What to tell of known tags of which no view fits."""
    where = "map that is continued" if problem.continues else "survey"
    return [
        f"tag {tag} is not where the {where} has it: none of {len(fits)} views fits"
        for tag, fits in problem.fitting(solver).items()
        if tag in problem.known and not any(fits)
    ]


def _carried_elsewhere(problem: _Problem, solver: JointSolver) -> set[int]:
    """Tags of the earlier map of which no view fits. One view alone may have a wrong number."""
    if not problem.continues:
        return set()
    found = problem.fitting(solver).items()
    return {tag for tag, fits in found if tag in problem.known and len(fits) > 1 and not any(fits)}


def _left_out(problem: _Problem, solver: JointSolver) -> list[str]:
    """What to tell of tags that nothing holds, which are no landmarks."""
    loose = set(solver.loose().tolist())
    return [
        f"tag {tag} is left out: its {len(fits)} views fit neither each other nor the map"
        for tag, fits in problem.fitting(solver).items()
        if problem.numbers[tag] in loose
    ]


def _landmarks(problem: _Problem, solver: JointSolver) -> tuple[Landmark, ...]:
    # A drive that nothing joins to the earlier map is a map of its own.
    hangs = problem.base and problem.joined
    covariances = solver.covariances(0 if hangs else int(problem.keyframes[0]))
    loose, fitting = set(solver.loose().tolist()), problem.fitting(solver)
    return tuple(
        Landmark(
            tag,
            solver.poses[number],
            covariances[number],
            len(fitting[tag]),
            fitting[tag].count(False),
            tag in problem.known and not problem.continues,
        )
        for tag, number in problem.numbers.items()
        if number not in loose
    )
