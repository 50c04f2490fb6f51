"""Where a finished map hangs together by little: odometry alone, or scans that no loop checks."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence

import numpy as np

from slamsim.core.components import components, runs_of
from slamsim.core.geometry import adjoint, between
from slamsim.core.quantiles import chi_square
from slamsim.core.result import Event, GraphEdge, MapGraph
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.slam.frontend.odometry import ELSEWHERE_M

CELL_M, SURE_SIGMAS = 0.05, 2.0
"""A stretch of path that no loop checks is told from where on the position may, with 95 %, be off
by more than a cell of the map: its walls are then drawn beside where they are."""

HELD_M = 0.2
"""A closure that is less sure of a direction does not check it. The loosest that hold both
directions, found in a search of the whole map, are sure to 0.15 m; along what a corridor leaves
free they are sure to 1 m at best."""

AGREEMENT = float(chi_square(0.99, 3))
"""Squared distance, in sigmas, up to which a closure is where it was measured."""

DIRECTIONS, APART_RAD = 18, np.deg2rad(15.0)
"""Directions of the plane that loops must check one by one, and how far from the one that it leaves
free a closure holds. Where many closures of one corridor slid, what they leave free differs by
some degrees: added up, their information would seem to hold it to decimetres."""


def open_loops(graph: MapGraph, held: int = 0) -> Iterator[Event]:
    """Stretches of path that no loop checks in some direction, and along which the position has
    become unsure: wheels that slipped, or a robot that was carried, along a corridor without marks
    would not show, for closures slide along it.

    held: so many key frames are a map that was finished before.
    """
    stamps_ns, poses = graph.keyframes.stamps_ns, graph.keyframes.poses
    checked = _checked(graph.edges, poses)
    checked[:held] = True
    for begin, last in runs_of(~checked):
        end = last + 1
        off_m = SURE_SIGMAS * _grown_m(poses, graph.covariances, begin - 1, end)
        unsure = np.flatnonzero(off_m > CELL_M)
        if len(unsure):
            steps_m = np.diff(poses[begin - 1 : end, :2], axis=0)
            path_m = float(np.hypot(steps_m[:, 0], steps_m[:, 1]).sum())
            words = (
                f"no loop checks {path_m:.0f} m of the path, along which the position may come to "
                f"be off by {off_m.max():.2f} m (95 %), and by more if the robot was carried"
            )
            first = begin + int(unsure[0])
            yield Event(int(stamps_ns[first]), int(stamps_ns[end - 1]), "open loop", words)


def _checked(edges: Sequence[GraphEdge], poses: FloatArray) -> BoolArray:
    """(n,) of each key frame whether the edge that leads to it needs no other check: loops that
    hold every direction go over it, or it is one of odometry alone, of which is told anyway."""
    loops = np.zeros((len(poses) + 1, DIRECTIONS), dtype=np.int64)
    other = np.ones(len(poses), dtype=np.bool_)
    for edge in edges:
        if edge.kind == "match":
            other[edge.target] = False
        elif edge.kind == "closure" and edge.weight > 0.0:
            held = _held_directions(edge, poses[edge.source, 2])
            loops[min(edge.source, edge.target) + 1] += held
            loops[max(edge.source, edge.target) + 1] -= held
    return np.asarray(other | (np.cumsum(loops, axis=0)[:-1] > 0).all(axis=1))


def closures_agree(graph: MapGraph, number: int) -> bool:
    """Whether what was seen later tells that the robot came to a key frame about as the edges that
    lead to it say: loops that hold every direction go over them and are where they were measured,
    and they move none of these edges farther than a closure may be unsure.
    """
    held = np.zeros(DIRECTIONS, dtype=np.bool_)
    for edge in graph.edges:
        source, target = sorted((edge.source, edge.target))
        if not source < number <= target or edge.weight <= 0.0:
            continue
        there = between(graph.keyframes.poses[edge.source], graph.keyframes.poses[edge.target])
        apart = between(edge.T_source_target, there)
        if edge.kind != "closure" and np.hypot(apart[0], apart[1]) > HELD_M:
            return False
        if edge.kind == "closure" and apart @ np.linalg.solve(edge.covariance, apart) < AGREEMENT:
            held |= _held_directions(edge, graph.keyframes.poses[edge.source, 2])
    return bool(held.all())


def _held_directions(edge: GraphEdge, yaw_rad: float) -> BoolArray:
    """(DIRECTIONS,) of the map in which a closure tells where its target is."""
    variances, axes = np.linalg.eigh(edge.covariance[:2, :2])
    free_rad = yaw_rad + np.arctan2(axes[1, 1], axes[0, 1])
    off_rad = np.arange(DIRECTIONS) * np.pi / DIRECTIONS - free_rad
    apart = np.abs(np.cos(off_rad)) < np.cos(APART_RAD)
    return np.asarray(apart | (variances[1] <= HELD_M**2))


def _grown_m(poses: FloatArray, covariances: FloatArray, begin: int, end: int) -> FloatArray:
    """(k,) by how much the position of the key frames after ``begin`` up to and without ``end`` is
    less sure than that of ``begin``: standard deviation along the worst direction."""
    carry = adjoint(between(poses[begin + 1 : end], poses[begin]))
    before = carry @ covariances[begin] @ np.swapaxes(carry, 1, 2)
    grown = (covariances[begin + 1 : end] - before)[:, :2, :2]
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(grown)[:, 1], 0.0)))


def doubtful_joints(graph: MapGraph, drives: Container[int]) -> Iterator[Event]:
    """One event for each edge of odometry alone whose sides no match and no closure joins, or only
    closures that were found without knowing where to look; but for edges to a few key frames that
    fitted nowhere, which hang by odometry between such as hold together.

    drives: the key frames with which later drives begin: that these are recognised was asked for.
    """
    count = len(graph.keyframes)
    firm = [e for e in graph.edges if e.kind != "odometry" and e.weight > 0.0]
    ends = np.array([(e.source, e.target) for e in firm], dtype=np.int64).reshape(-1, 2)
    part = components(ends, count)
    stamps_ns, poses = graph.keyframes.stamps_ns, graph.keyframes.poses
    breaks = [edge for edge in graph.edges if edge.kind == "odometry"]
    ends_at = [*(e.target for e in breaks if is_elsewhere(e)), count]
    for edge in breaks:
        x, y = poses[edge.target, :2]
        if part[edge.source] != part[edge.target]:
            if not is_elsewhere(edge) and _is_bridged(edge, part, graph):
                continue
            words = f"near ({x:.1f}, {y:.1f}) m {_how_loose(edge)}"
            yield Event(int(stamps_ns[edge.source]), int(stamps_ns[edge.target]), "joined", words)
        elif is_elsewhere(edge) and edge.target not in drives:
            end = next(k for k in ends_at if k > edge.target)
            words = _by_its_looks(edge.target, end, ends)
            yield Event(int(stamps_ns[edge.target]), int(stamps_ns[end - 1]), "joined", words)


def _is_bridged(edge: GraphEdge, part: IntArray, graph: MapGraph) -> bool:
    """Whether key frames before and after an edge of odometry hold together, so near to it that
    what lies between is as sure as a cell of the map. part: (n,) of each key frame."""
    source, target = sorted((edge.source, edge.target))
    last = {int(number): k for k, number in enumerate(part[: source + 1])}
    after = next((k for k in range(target, len(part)) if int(part[k]) in last), None)
    if after is None:
        return False
    grown_m = _grown_m(graph.keyframes.poses, graph.covariances, last[int(part[after])], after + 1)
    return bool(SURE_SIGMAS * grown_m.max() <= CELL_M)


def _by_its_looks(first: int, end: int, closures: IntArray) -> str:
    """Of how many of its key frames, first up to and without end, closures (n, 2) lead away."""
    inside = (closures >= first) & (closures < end)
    crossing = inside[:, 0] != inside[:, 1]
    recognised = len(np.unique(closures[crossing][inside[crossing]]))
    return (
        "nothing tells how the robot came here: this part of the map was put where it looks like "
        f"the rest, as it does from {recognised} of its {end - first} key frames; its place may "
        "be wrong"
    )


def is_elsewhere(edge: GraphEdge) -> bool:
    """Whether not even odometry tells where its end is."""
    return bool(edge.covariance[:2, :2].trace() >= ELSEWHERE_M**2)


def _how_loose(edge: GraphEdge) -> str:
    if is_elsewhere(edge):
        return (
            "the map goes on without being joined to what was mapped before: it is drawn beside it"
        )
    return "the map is joined to what was mapped before by odometry alone"
