"""Branch and bound over the pyramid of a likelihood grid, compiled (Hess et al. 2016)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray

FULL_SCALE = 255.0
MAX_LOOKUPS = 60_000_000
"""A search in a small window that has read the grid so often is given up."""


def best_offset(
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    min_score: float,
    around: IntArray,
    most_lookups: float = MAX_LOOKUPS,
) -> tuple[IntArray, float]:
    """Best (turn, x, y) in cells and its score; score 0 if none reaches min_score, -1 if given up.

    around: (k, 6) (turn, x, y, half width in turns, in cells, turns of a whole circle) of poses not
    to consider. most_lookups: a search that has read the grid so often is given up.
    """
    full = FULL_SCALE * cells.shape[1]
    top = min(int(np.ceil(np.log2(max(half.max(), 1)))), len(levels) - 1)
    roots = _roots(levels, cells, half, top, min_score * full, around)
    roots = roots[np.argsort(-roots[:, 0], kind="stable")]
    best, found = _descend(roots, levels, cells, half, min_score * full, around, most_lookups)
    return best, found / full if found >= 0.0 else -1.0


@kernel
def _bound(
    level: NDArray[np.uint8], cells: NDArray[np.int32], x: int, y: int, enough: float
) -> float:
    """Sum of the points' values at an offset, -1 as soon as it cannot reach ``enough``."""
    rows, columns = level.shape
    total, left = 0, 255 * cells.shape[0]
    for k in range(cells.shape[0]):
        r, c = cells[k, 0] + y, cells[k, 1] + x
        left -= 255
        if 0 <= r < rows and 0 <= c < columns:
            total += level[r, c]
        if total + left < enough:
            return -1.0
    return float(total)


@kernel
def _excluded(a: int, x: int, y: int, size: int, around: IntArray) -> bool:
    """Whether a whole block of offsets lies in one of the neighbourhoods that do not count."""
    for k in range(around.shape[0]):
        best_a, best_x, best_y, turn, reach, circle = around[k]
        apart = abs(a - best_a) % circle
        if (
            min(apart, circle - apart) <= turn
            and x >= best_x - reach
            and y >= best_y - reach
            and x + size - 1 <= best_x + reach
            and y + size - 1 <= best_y + reach
        ):
            return True
    return False


@kernel
def _roots(
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    top: int,
    goal: float,
    around: IntArray,
) -> FloatArray:
    """(k, 5) blocks (score bound, turn, x, y, level) of the coarsest level to look into."""
    size = 1 << top
    nx, ny = (2 * half[0]) // size + 1, (2 * half[1]) // size + 1
    roots = np.empty((cells.shape[0] * nx * ny, 5))
    count = 0
    for a in range(cells.shape[0]):
        for i in range(nx):
            for j in range(ny):
                x, y = i * size - half[0], j * size - half[1]
                score = _bound(levels[top], cells[a], x, y, goal)
                if score >= goal and not _excluded(a, x, y, size, around):
                    _set_block(roots, count, score, (a, x, y, top))
                    count += 1
    return roots[:count]


@kernel
def _set_block(blocks: FloatArray, at: int, score: float, place: tuple[int, int, int, int]) -> None:
    blocks[at, 0], blocks[at, 1], blocks[at, 2] = score, place[0], place[1]
    blocks[at, 3], blocks[at, 4] = place[2], place[3]


@kernel
def _push_quarters(
    place: tuple[int, int, int, int],
    stack: FloatArray,
    depth: int,
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    goal: float,
    around: IntArray,
) -> int:
    """Put the quarters of a block that may still win onto the stack, the best on top; its depth."""
    a, x, y, level = place[0], place[1], place[2], place[3] - 1
    size = 1 << level
    first = depth
    for i in range(2):
        for j in range(2):
            cx, cy = x + i * size, y + j * size
            if cx > half[0] or cy > half[1] or _excluded(a, cx, cy, size, around):
                continue
            score = _bound(levels[level], cells[a], cx, cy, goal)
            if score < goal:
                continue
            at = depth
            while at > first and stack[at - 1, 0] > score:
                for field in range(5):
                    stack[at, field] = stack[at - 1, field]
                at -= 1
            _set_block(stack, at, score, (a, cx, cy, level))
            depth += 1
    return depth


@kernel
def _descend(
    roots: FloatArray,
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    goal: float,
    around: IntArray,
    most_lookups: float,
) -> tuple[IntArray, float]:
    """Depth first through the blocks, best first; the winner and its score, -1 if given up."""
    best, found = np.zeros(3, np.int64), 0.0
    stack = np.empty((4 * (levels.shape[0] + 1), 5))
    blocks = 0
    for k in range(roots.shape[0]):
        for field in range(5):
            stack[0, field] = roots[k, field]
        depth = 1
        while depth > 0:
            depth -= 1
            score = stack[depth, 0]
            if score < goal or (found > 0.0 and score <= found):
                continue
            a, x, y = int(stack[depth, 1]), int(stack[depth, 2]), int(stack[depth, 3])
            level = int(stack[depth, 4])
            if level == 0:
                best[0], best[1], best[2] = a, x, y
                found = goal = score
                continue
            depth = _push_quarters(
                (a, x, y, level), stack, depth, levels, cells, half, goal, around
            )
            blocks += 4
            if blocks * cells.shape[1] > most_lookups:
                return best, -1.0
    return best, found
