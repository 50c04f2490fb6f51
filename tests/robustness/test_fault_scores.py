"""Degenerate numbers into scores and maps: what has no answer is refused, never scored."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fault_numbers import BAD, Case, cases, each, judge, line, put, refused, right, steps

from slamsim.core.types import FloatArray, Grid, PlanarTrajectory
from slamsim.evaluate.bound import scan_bound
from slamsim.evaluate.budget import error_budget
from slamsim.evaluate.consistency import nees, nees_band
from slamsim.evaluate.grid import compare_grids, wrong_walls
from slamsim.evaluate.relations import score_relations
from slamsim.evaluate.score import evaluate
from slamsim.evaluate.trajectory import align_se2, compare, relative_errors, statistics
from slamsim.evaluate.visibility import seen_from
from slamsim.slam.backend.correction import correct, correct_pieces, densify
from slamsim.slam.mapping.known_map import map_of_grid
from slamsim.slam.mapping.map_files import map_files

pytestmark = pytest.mark.fault

N = 60
PATH = PlanarTrajectory(steps(N), line(N) * np.array([3.0, 3.0, 1.0]))
STILL = PlanarTrajectory(steps(N), np.zeros((N, 3)))
NOTHING = PlanarTrajectory(steps(0), np.zeros((0, 3)))
ONE = PlanarTrajectory(steps(1), np.zeros((1, 3)))
LATER = PlanarTrajectory(PATH.stamps_ns + 10**12, PATH.poses)
FAR = PlanarTrajectory(PATH.stamps_ns, PATH.poses + np.array([1e9 - 10.0, 0.0, 0.0]))
JUMPS = PlanarTrajectory(PATH.stamps_ns, put(PATH.poses, 9e8, 30))
SPARSE = PlanarTrajectory(PATH.stamps_ns * 10**6, PATH.poses)
ENDS = PlanarTrajectory(np.array([-(2**62), 2**62]), np.zeros((2, 3)))

COVARIANCES = np.broadcast_to(np.diag([1e-4, 1e-4, 1e-6]), (N, 3, 3)).copy()
ALIGNED = np.zeros(3)


def _room() -> Grid:
    occupancy = np.zeros((40, 40), np.float32)
    occupancy[[0, -1]], occupancy[:, [0, -1]] = 1.0, 1.0
    return Grid(occupancy, 0.1, (-2.0, -2.0))


ROOM = _room()
UNKNOWN = replace(ROOM, occupancy=np.full_like(ROOM.occupancy, np.nan))
FREE = replace(ROOM, occupancy=np.zeros_like(ROOM.occupancy))

CELL = Grid(np.ones((1, 1), np.float32), 0.1, (0.0, 0.0))
FAR_AWAY = replace(ROOM, origin_m=(9e8, 9e8))
AROUND = np.column_stack([np.cos(np.arange(20.0)), np.sin(np.arange(20.0))])

TRAJECTORIES: dict[str, Case] = {
    "compare: nothing": refused(lambda: compare(NOTHING, PATH)),
    "compare: with nothing": refused(lambda: compare(PATH, NOTHING)),
    "compare: one pose": refused(lambda: compare(ONE, PATH)),
    "compare: another time": refused(lambda: compare(LATER, PATH)),
    "compare: a truth of single instants": refused(
        lambda: compare(replace(PATH, stamps_ns=PATH.stamps_ns + 1), SPARSE)
    ),
    "compare: from end to end of time": right(lambda: compare(ENDS, ENDS)),
    "compare: a robot that stands": right(lambda: compare(STILL, STILL)),
    "compare: far from the origin": right(lambda: compare(FAR, PATH)),
    "compare: a jump as far as can be": right(lambda: compare(JUMPS, PATH)),
    "relative errors: a robot that stands": right(lambda: relative_errors(compare(STILL, STILL))),
    "relative errors: a jump": right(lambda: relative_errors(compare(JUMPS, PATH))),
    "relative errors: lengths of nan": refused(
        lambda: relative_errors(compare(PATH, PATH), (math.nan,))
    ),
    "relative errors: lengths of zero": refused(
        lambda: relative_errors(compare(PATH, PATH), (0.0,))
    ),
    "relative errors: no lengths": refused(lambda: relative_errors(compare(PATH, PATH), ())),
    "statistics: of nothing": refused(lambda: statistics(np.zeros(0))),
    **each("statistics: a number", lambda bad: statistics(np.array([1.0, bad]))),
    "alignment: of nothing": refused(lambda: align_se2(np.zeros((0, 3)), np.zeros((0, 3)))),
    "alignment: of one": right(lambda: align_se2(np.zeros((1, 3)), np.ones((1, 3)))),
    "alignment: all in one place": right(lambda: align_se2(np.zeros((9, 3)), np.ones((9, 3)))),
    "alignment: of different lengths": refused(
        lambda: align_se2(np.zeros((3, 3)), np.zeros((2, 3)))
    ),
    **each("alignment: a number", lambda bad: align_se2(put(line(N), bad), line(N))),
    "budget: nothing": right(lambda: error_budget({}, steps(5), PATH)),
    "budget: no key frames": right(lambda: error_budget({"graph": PATH}, steps(0), PATH)),
    "budget: a truth of nothing": right(lambda: error_budget({"graph": PATH}, steps(9), NOTHING)),
    "relations: none": refused(lambda: score_relations(PATH, steps(0), steps(0), np.zeros((0, 3)))),
    "relations: of nothing": refused(
        lambda: score_relations(NOTHING, steps(2), steps(2), np.zeros((2, 3)))
    ),
    "relations: outside": refused(
        lambda: score_relations(LATER, steps(2), steps(2), np.zeros((2, 3)))
    ),
    "relations: too few": refused(
        lambda: score_relations(PATH, steps(2), steps(2), np.zeros((1, 3)))
    ),
    "relations: between equal instants": right(
        lambda: score_relations(PATH, steps(2), steps(2), np.zeros((2, 3)))
    ),
    **each(
        "relations: a number",
        lambda bad: score_relations(PATH, steps(2), steps(2), put(np.zeros((2, 3)), bad)),
    ),
    "evaluate: nothing known": right(lambda: evaluate(PATH).numbers()),
    "evaluate: a range of nan": refused(lambda: evaluate(PATH, range_m=math.nan)),
}

CLAIMS: dict[str, FloatArray] = {
    **{k: put(COVARIANCES, v, 9 * 30) for k, v in BAD.items()},
    "zeros": 0.0 * COVARIANCES,
    "singular": COVARIANCES * np.diag([1.0, 1.0, 0.0]),
    "below zero": -COVARIANCES,
    "leaning": COVARIANCES + 1e-5 * np.eye(3, k=1),
    "one missing": COVARIANCES[1:],
    "of two numbers": COVARIANCES[:, :2, :2],
}

CONSISTENCY: dict[str, Case] = {
    **{f"nees: {k}": refused(partial(nees, PATH, v, PATH)) for k, v in CLAIMS.items()},
    "nees: of nothing": right(lambda: nees(NOTHING, np.zeros((0, 3, 3)), PATH)),
    "nees: without truth": right(lambda: nees(PATH, COVARIANCES, NOTHING)),
    "nees: a tiny covariance": right(lambda: nees(PATH, 1e-12 * COVARIANCES, PATH)),
    "band: of no run": refused(lambda: nees_band(0)),
    "band: of fewer than none": refused(lambda: nees_band(-1)),
    "band: everything": refused(lambda: nees_band(5, 1.0)),
    "band: nothing": refused(lambda: nees_band(5, 0.0)),
    "band: nan": refused(lambda: nees_band(5, math.nan)),
    "scan bound: no information": right(lambda: scan_bound(steps(2), np.zeros((2, 3, 3)))),
    "scan bound: nan": refused(lambda: scan_bound(steps(1), np.full((1, 3, 3), math.nan))),
    "scan bound: below zero": refused(lambda: scan_bound(steps(1), -1e6 * np.eye(3)[None])),
    "scan bound: a wall": right(
        lambda: scan_bound(steps(1), 1e12 * np.diag([0.0, 1.0, 0.0])[None])
    ),
}

MAPS: dict[str, Case] = {
    "map: the same": right(lambda: compare_grids(ROOM, ROOM, ALIGNED, AROUND)),
    "map: all unknown": right(lambda: compare_grids(UNKNOWN, ROOM, ALIGNED, AROUND)),
    "map: all free": right(lambda: compare_grids(FREE, ROOM, ALIGNED, AROUND)),
    "map: one cell": right(lambda: compare_grids(CELL, ROOM, ALIGNED, AROUND)),
    "map: no walls are true": refused(lambda: compare_grids(ROOM, FREE, ALIGNED, AROUND)),
    "map: at the end of the world": refused(lambda: compare_grids(FAR_AWAY, ROOM, ALIGNED, AROUND)),
    "map: in cells too many": refused(
        lambda: compare_grids(ROOM, replace(ROOM, resolution_m=1e-6), ALIGNED, AROUND * 1e-6)
    ),
    "map: no path": right(lambda: compare_grids(ROOM, ROOM, ALIGNED, np.zeros((0, 2)))),
    "map: a path of three numbers": refused(
        lambda: compare_grids(ROOM, ROOM, ALIGNED, np.zeros((4, 3)))
    ),
    "map: a range of zero": refused(lambda: compare_grids(ROOM, ROOM, ALIGNED, AROUND, 0.0)),
    "map: a range of nan": refused(lambda: compare_grids(ROOM, ROOM, ALIGNED, AROUND, math.nan)),
    "map: a range below zero": refused(lambda: wrong_walls(ROOM, ROOM, ALIGNED, AROUND, -1.0)),
    "map: a path to the end of the world": refused(
        lambda: seen_from(ROOM, np.array([[0, 0], [9e8, 0.0]] * 20))
    ),
    "map: a path from beyond": right(lambda: seen_from(ROOM, AROUND + 1e5)),
    **each("map: an alignment", lambda bad: compare_grids(ROOM, ROOM, put(ALIGNED, bad), AROUND)),
    **each("map: a path", lambda bad: compare_grids(ROOM, ROOM, ALIGNED, put(AROUND, bad))),
    **each("walls: a path", lambda bad: wrong_walls(ROOM, ROOM, ALIGNED, put(AROUND, bad))),
    "files: all unknown": right(lambda: map_files(UNKNOWN)),
    "known map: all unknown": refused(lambda: map_of_grid(UNKNOWN)),
    "known map: one cell": refused(lambda: map_of_grid(CELL)),
    "known map: at the end of the world": right(lambda: map_of_grid(FAR_AWAY)),
}

CORRECTIONS: dict[str, Case] = {
    "correct: without an anchor": refused(lambda: correct(PATH, NOTHING)),
    "correct: an anchor outside": refused(lambda: correct(PATH, LATER)),
    "correct: one anchor": right(lambda: correct(PATH, ONE)),
    "correct: nothing": refused(lambda: correct(NOTHING, ONE)),
    "pieces: without a break": right(lambda: correct_pieces(PATH, PATH, [])),
    "pieces: of nothing": right(lambda: correct_pieces(NOTHING, NOTHING, [])),
    "pieces: breaks at the ends of time": right(
        lambda: correct_pieces(PATH, PATH, [-(2**62), 2**62])
    ),
    "pieces: breaks backwards": refused(lambda: correct_pieces(PATH, PATH, [2 * 10**9, 10**9])),
    "densify: by nothing": right(lambda: densify(PATH, NOTHING)),
    "densify: nothing": right(lambda: densify(NOTHING, PATH)),
    "densify: another time": right(lambda: densify(PATH, LATER)),
}


@cases(TRAJECTORIES, CONSISTENCY, MAPS, CORRECTIONS)
def test_no_score_is_made_of_what_is_no_number(case: Case) -> None:
    judge(case)
