"""Finding a lost scan again: all poses of a bounded window coarsely, then the best ones finely."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.matching.local_map import nearest_surface
from slamsim.slam.matching.surfaces import HALF_LENGTH, NORMAL_X, NORMAL_Y, X, Y

STEP_M = 0.2
STEP_RAD = float(np.deg2rad(4.0))
"""Of the coarse search: its best pose is at most half a step off, from where a match comes home
(``slamsim bench matcher`` measures from how far)."""
SOFT_M = 0.1
"""Half a step: a pose between two of the grid still scores half."""
MAX_PIECES = 60


def coarse_poses(
    pieces: FloatArray,
    T_guess: FloatArray,
    window: tuple[float, float],
    grid: tuple[FloatArray, IntArray, float, float],
    count: int,
) -> FloatArray:
    """(count, 3) most promising poses around the guess, best first, no two of them neighbours.

    window: half widths (metres, radians). The score of a pose is the share of pieces that lie
    on the map, softly: 1 / (1 + (distance / SOFT_M)^2).
    """
    steps = int(np.ceil(window[0] / STEP_M))
    turns = int(np.ceil(window[1] / STEP_RAD))
    thinned = np.ascontiguousarray(pieces[:: max(1, len(pieces) // MAX_PIECES)])
    scores = _score_all(thinned, T_guess, (steps, turns), grid)
    return _pick(scores, T_guess, (steps, turns), count)


@kernel
def _score_all(
    pieces: FloatArray,
    T_guess: FloatArray,
    sizes: tuple[int, int],
    grid: tuple[FloatArray, IntArray, float, float],
) -> FloatArray:
    steps, turns = sizes
    side = 2 * steps + 1
    scores = np.zeros((2 * turns + 1, side, side))
    share = 1.0 / max(pieces.shape[0], 1)
    for a in range(2 * turns + 1):
        yaw = T_guess[2] + (a - turns) * STEP_RAD
        cos, sin = np.cos(yaw), np.sin(yaw)
        for k in range(pieces.shape[0]):
            bx, by = pieces[k, X], pieces[k, Y]
            bnx, bny = pieces[k, NORMAL_X], pieces[k, NORMAL_Y]
            px = T_guess[0] + cos * bx - sin * by
            py = T_guess[1] + sin * bx + cos * by
            nx, ny = cos * bnx - sin * bny, sin * bnx + cos * bny
            for i in range(side):
                for j in range(side):
                    at = (px + (i - steps) * STEP_M, py + (j - steps) * STEP_M, nx, ny)
                    slot, off, _ = nearest_surface(at, pieces[k, HALF_LENGTH], 0.25, grid)
                    if slot >= 0:
                        scores[a, i, j] += share / (1.0 + off * off / (SOFT_M * SOFT_M))
    return scores


@kernel
def _pick(
    scores: FloatArray, T_guess: FloatArray, sizes: tuple[int, int], count: int
) -> FloatArray:
    steps, turns = sizes
    side = 2 * steps + 1
    chosen = np.empty((count, 3))
    found = 0
    while found < count:
        best, a, i, j = 0.0, 0, 0, 0
        for turn in range(2 * turns + 1):
            for column in range(side):
                for row in range(side):
                    if scores[turn, column, row] > best:
                        best, a, i, j = scores[turn, column, row], turn, column, row
        if best <= 0.0:
            break
        chosen[found, 0] = T_guess[0] + (i - steps) * STEP_M
        chosen[found, 1] = T_guess[1] + (j - steps) * STEP_M
        chosen[found, 2] = T_guess[2] + (a - turns) * STEP_RAD
        found += 1
        for turn in range(max(0, a - 2), min(2 * turns + 1, a + 3)):
            for column in range(max(0, i - 1), min(side, i + 2)):
                for row in range(max(0, j - 1), min(side, j + 2)):
                    scores[turn, column, row] = 0.0
    return chosen[:found]
