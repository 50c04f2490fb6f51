"""Sudden steps of the scans, and what held them gone all of a sudden, at places that look like
others: there the robot may have been carried, and neither scans nor loops would tell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np
from scipy.spatial import cKDTree

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import transform_points
from slamsim.core.result import Event, MapGraph
from slamsim.core.types import FloatArray
from slamsim.slam.closures.relocalise import Everywhere
from slamsim.slam.closures.submaps import SIGMA_M
from slamsim.slam.closures.whole_part import LEAST_PIECES, LEAST_SCORE, MOST_PIECES, SURE_NATS
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.mapping.joints import closures_agree
from slamsim.slam.matching.surfaces import X, Y

SEEN_AFTER_M = 3.0
"""Of the path after a step: about where the same walls are in view as before it."""

NEAR_SIGMAS = 3.0
"""What was seen after a step is held against what was seen before where both know the same wall."""


def ambiguous_steps(
    steps: Iterable[Event],
    keyframes: Sequence[Keyframe],
    graph: MapGraph,
    first: int,
    config: BackEndConfig,
) -> tuple[Event, ...]:
    """The steps, if after each of them the robot was elsewhere as likely as where the map has it:
    what was seen just after fits what was seen before in several places, or in another one.

    Where it fits in one place alone, the odometry was wrong and not the map: that of such a
    recording (stamps that jitter, as in aces) makes such steps by itself, and nothing is told.
    keyframes: of the graph, in their order. first: number of the first one of the drive.
    """
    told = []
    for step in steps:
        if not (number := _next(step, keyframes, first)):
            continue
        if not _is_ambiguous(number, keyframes, graph.keyframes.poses, config):
            return ()
        told.append(step)
    return tuple(told)


def unchecked_holds(
    lost: Iterable[Event],
    keyframes: Sequence[Keyframe],
    graph: MapGraph,
    first: int,
    config: BackEndConfig,
) -> tuple[Event, ...]:
    """Those of the places where what held the scans was gone after which the robot was elsewhere as
    likely as where the map has it, and no loop tells otherwise.

    keyframes, first: as for ``ambiguous_steps``.
    """
    poses = graph.keyframes.poses
    return tuple(
        event
        for event in lost
        if (number := _next(event, keyframes, first))
        and not closures_agree(graph, number)
        and _is_ambiguous(number, keyframes, poses, config)
    )


def _next(event: Event, keyframes: Sequence[Keyframe], first: int) -> int | None:
    """Number of the first key frame of a drive that was taken after an event."""
    return next((k.index for k in keyframes[first:] if k.stamp_ns >= event.end_ns), None)


def _is_ambiguous(
    number: int, keyframes: Sequence[Keyframe], poses: FloatArray, config: BackEndConfig
) -> bool:
    reach_m = keyframes[number].path_m + SEEN_AFTER_M
    after = [k.index for k in keyframes[number:] if k.path_m <= reach_m]
    before_m, now_m = _points(keyframes, poses, range(number)), _points(keyframes, poses, after)
    # New walls would fit better wherever the robot has been longer, along any corridor.
    now_m = now_m[cKDTree(before_m).query(now_m)[0] <= NEAR_SIGMAS * SIGMA_M]
    now_m = np.random.default_rng(0).permutation(now_m)[:MOST_PIECES]
    if len(now_m) < LEAST_PIECES:
        return True
    before = Everywhere(before_m, config)
    found = before.places(now_m, LEAST_SCORE, SURE_NATS / len(now_m))
    places = list(islice(found, 2))  # each further one is a search of its own
    if len(places) != 1 or places[0] is None:
        return True
    middle_m = now_m.mean(axis=0)
    moved_m = transform_points(places[0][0], middle_m[None])[0] - middle_m
    return bool(np.hypot(*moved_m) > config.closures.ambiguity_distance_m)


def _points(keyframes: Sequence[Keyframe], poses: FloatArray, numbers: Iterable[int]) -> FloatArray:
    """(n, 2) the middles of the pieces of wall that key frames saw, in the map frame."""
    placed = [transform_points(poses[k], keyframes[k].pieces[:, [X, Y]]) for k in numbers]
    return np.concatenate(placed) if placed else np.zeros((0, 2))
