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

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import rotation
from slamsim.core.landmarks import KnownTag, Landmark, TagsSeen
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray
from slamsim.slam.backend.correction import correct_pieces
from slamsim.slam.backend.surface_information import MapInformation, with_scatter
from slamsim.slam.failures import Failures
from slamsim.slam.landmarks.agreement import DISAGREE_SIGMAS, contradicted, disagreement
from slamsim.slam.landmarks.joint import MOST_STEPS, JointSolver
from slamsim.slam.landmarks.nodes import Nodes, nodes_of
from slamsim.slam.landmarks.problem import Problem
from slamsim.slam.landmarks.views import TagView, tag_views
from slamsim.slam.landmarks.wheels import learnt_noise

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
    problem, solver, warnings = _agreed(nodes, views, tags, config)
    poses = solver.poses
    anchors = replace(nodes.track, poses=poses[problem.base : problem.base + len(nodes.track)])
    moved = replace(result.graph.keyframes, poses=poses[problem.keyframes])
    breaks_ns = sorted(e.start_ns for e in result.events if e.kind == "kidnapped")
    covariances = _covariances(problem, solver, information, result.graph.covariances)
    graph = replace(result.graph, keyframes=moved, covariances=covariances, in_map=None)
    return replace(
        result,
        trajectory=correct_pieces(result.trajectory, anchors, breaks_ns),
        graph=graph,
        parts={**result.parts, PART: moved},
        landmarks=_landmarks(problem, solver),
        warnings=(*result.warnings, *warnings, *_left_out(problem, solver)),
    )


def _agreed(
    nodes: Nodes, views: Sequence[TagView], tags: TagsSeen, config: SlamConfig
) -> tuple[Problem, JointSolver, list[str]]:
    """The solution once tags that stand elsewhere than known count as unknown ones, and lengths as
    unsure as they turn out; and what to tell of that."""
    told: list[str] = []
    if tags.known and not tags.continues:
        free = replace(tags, known=())
        problem, solver, free, told = _with_sure_lengths(nodes, views, free, config)
        found = {tag.number: tag for tag in _landmarks(problem, solver)}
        wrong = contradicted(found, tags.known)
        told += [
            f"tag {tag} is not where the survey has it but {off_m:.2g} m away, by where the others "
            "are: it counts as one that was not surveyed"
            for tag, off_m in wrong.items()
        ]
        kept = tuple(each for each in tags.known if each.number not in wrong)
        tags = replace(tags, known=kept, cameras=free.cameras)
    problem, solver, tags, lengths = _with_sure_lengths(nodes, views, tags, config)
    told += [*lengths, *problem.warnings, *_not_there(problem, solver)]
    if moved_tags := _carried_elsewhere(problem, solver):
        known = tuple(each for each in tags.known if each.number not in moved_tags)
        problem = Problem.of(nodes, views, replace(tags, known=known))
        solver = _solved(problem, config)
    if not solver.settled:
        told.append(f"the solution with tags still moved after {MOST_STEPS} steps: it is not exact")
    return problem, solver, told


def _with_sure_lengths(
    nodes: Nodes, views: Sequence[TagView], tags: TagsSeen, config: SlamConfig
) -> tuple[Problem, JointSolver, TagsSeen, list[str]]:
    """The solution with scales of the cameras as unsure as wheels or lidar and tags differ by, if
    that is more than is claimed of both: a tag's size has no tolerance, it is typed."""
    problem = Problem.of(nodes, views, tags)
    solver = _solved(problem, config)
    blind = bool(nodes.blind.any())
    wheels_sigma = float(nodes.wheels[-1]) if blind else 0.0
    apart, sigmas = disagreement(solver.shared, tags.cameras, wheels_sigma)
    if sigmas <= DISAGREE_SIGMAS:
        return problem, solver, tags, []
    widened = {
        name: replace(each, scale=max(each.scale, abs(apart)))
        for name, each in tags.cameras.items()
    }
    tags = replace(tags, cameras=widened)
    problem = Problem.of(nodes, views, tags)
    by, whose = ("wheels", "tags or of the wheels") if blind else ("lidar", "tags")
    told = (
        f"lengths by the tags are {100.0 * apart:+.1f} % off those by the {by} ({sigmas:.1f} "
        f"standard deviations): the size of the {whose} may be wrong"
    )
    return problem, _solved(problem, config), tags, [told]


def as_known(tag: Landmark) -> KnownTag:
    """A tag of a finished map, as a later drive takes it."""
    turned = rotation(tag.T_map_tag[2])
    return KnownTag(tag.number, tag.T_map_tag, turned @ tag.covariance @ turned.T)


def _solved(problem: Problem, config: SlamConfig) -> JointSolver:
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
    problem: Problem,
    solver: JointSolver,
    information: MapInformation | None,
    before: FloatArray,
) -> FloatArray:
    """(k, 3, 3) of the key frames relative to the first of the map.

    before: the same without tags. A map that is continued is one rigid piece in the solution: how
    unsure it is in itself is what its key frames were more unsure without tags than beside such a
    piece.
    """
    first = 0 if problem.continues else int(problem.keyframes[0])
    held = solver.covariances(first)[problem.keyframes]
    if information is None:
        return held
    poses, scatter = solver.poses[problem.keyframes], information.scatter[information.first :]
    if not problem.continues:
        return with_scatter(poses, held, scatter)
    rigid = solver.without_edges(len(problem.fixed)).covariances(first)[problem.keyframes] + scatter
    sizes, axes = np.linalg.eigh(before - rigid)
    inner = axes @ (np.maximum(sizes, 0.0)[:, :, None] * np.swapaxes(axes, 1, 2))
    return np.asarray(held + scatter + inner)


def _not_there(problem: Problem, solver: JointSolver) -> list[str]:
    """What to tell of known tags of which no view fits."""
    where = "map that is continued" if problem.continues else "survey"
    return [
        f"tag {tag} is not where the {where} has it: none of {len(fits)} views fits"
        for tag, fits in problem.fitting(solver).items()
        if tag in problem.known and not any(fits)
    ]


def _carried_elsewhere(problem: Problem, solver: JointSolver) -> set[int]:
    """Tags of the earlier map of which no view fits. One view alone may have a wrong number."""
    if not problem.continues:
        return set()
    found = problem.fitting(solver).items()
    return {tag for tag, fits in found if tag in problem.known and len(fits) > 1 and not any(fits)}


def _left_out(problem: Problem, solver: JointSolver) -> list[str]:
    """What to tell of tags that nothing holds, which are no landmarks."""
    loose = set(solver.loose().tolist())
    return [
        f"tag {tag} is left out: its {len(fits)} views fit neither each other nor the map"
        for tag, fits in problem.fitting(solver).items()
        if problem.numbers[tag] in loose
    ]


def _landmarks(problem: Problem, solver: JointSolver) -> tuple[Landmark, ...]:
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
            problem.family,
        )
        for tag, number in problem.numbers.items()
        if number not in loose
    )
