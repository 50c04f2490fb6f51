"""Branch and bound over the pyramid of a likelihood grid, compiled (Hess et al. 2016).

Large blocks hold many neighbouring turns as well: in a building of 450 x 240 m (fr-clinic) that
takes a third to an eighth of the time of a search turn by turn, whose blocks of 1.6 to 6.4 m took
four fifths of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray

FULL_SCALE = 255.0
MAX_LOOKUPS = 60_000_000
"""A search in a small window that has read the grid so often is given up."""

MOST_PARTS = 4
"""Into so many groups of turns a block is divided at most."""


def best_offset(
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    min_score: float,
    around: IntArray,
    shift: float = np.inf,
    most_lookups: float = MAX_LOOKUPS,
) -> tuple[IntArray, float]:
    """Best (turn, x, y) in cells and its score; score 0 if none reaches min_score, -1 if given up.

    around: (k, 6) (turn, x, y, half width in turns, in cells, turns of a whole circle) of poses not
    to consider. shift: no point moves by more cells from one turn to the next. most_lookups: a
    search that has read the grid so often is given up.
    """
    full = FULL_SCALE * cells.shape[1]
    top = min(int(np.ceil(np.log2(max(half.max(), 1)))), max(len(levels) - 2, 0))
    groups = _groups(top, shift)
    roots = _roots(levels, cells, half, groups, min_score * full, around)
    roots = roots[np.argsort(-roots[:, 0], kind="stable")]
    space = (levels, cells, half, groups)
    best, found = _descend(roots, space, min_score * full, around, most_lookups)
    return best, found / full if found >= 0.0 else -1.0


def _groups(top: int, shift: float) -> IntArray:
    """(top + 1,) how many neighbouring turns, a power of two, blocks of each level hold: within
    them points move from the middle turn by no more than half of the block."""
    groups = [1]
    for level in range(1, top + 1):
        most = max((2.0**level - 2.0) / max(shift, 1e-9), 1.0)
        groups.append(min(1 << int(np.log2(most)), MOST_PARTS * groups[-1]))
    return np.array(groups)


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
def _group_bound(
    space: tuple[NDArray[np.uint8], NDArray[np.int32], IntArray, IntArray],
    place: tuple[int, int, int, int],
    goal: float,
    around: IntArray,
) -> float:
    """No pose of a block, (first turn, x, y, level), scores more; -1 if none can reach the goal.

    A block of several turns is bounded by the middle one, with half a block more to each side.
    """
    levels, cells, _, groups = space
    a, x, y, level = place
    if groups[level] == 1:
        if _excluded(a, x, y, 1 << level, around):
            return -1.0
        return _bound(levels[level], cells[a], x, y, goal)
    middle, margin = min(a + groups[level] // 2, cells.shape[0] - 1), 1 << (level - 1)
    return _bound(levels[level + 1], cells[middle], x - margin, y - margin, goal)


@kernel
def _roots(
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: IntArray,
    groups: IntArray,
    goal: float,
    around: IntArray,
) -> FloatArray:
    """(k, 5) blocks (score bound, first turn, x, y, level) of the coarsest level to look into."""
    top = groups.size - 1
    size, turns = 1 << top, groups[top]
    nx, ny = (2 * half[0]) // size + 1, (2 * half[1]) // size + 1
    roots = np.empty((((cells.shape[0] - 1) // turns + 1) * nx * ny, 5))
    count = 0
    for a in range(0, cells.shape[0], turns):
        for i in range(nx):
            for j in range(ny):
                place = (a, i * size - half[0], j * size - half[1], top)
                score = _group_bound((levels, cells, half, groups), place, goal, around)
                if score >= goal:
                    _set_block(roots, count, score, place)
                    count += 1
    return roots[:count]


@kernel
def _set_block(blocks: FloatArray, at: int, score: float, place: tuple[int, int, int, int]) -> None:
    blocks[at, 0], blocks[at, 1], blocks[at, 2] = score, place[0], place[1]
    blocks[at, 3], blocks[at, 4] = place[2], place[3]


@kernel
def _push_parts(
    place: tuple[int, int, int, int],
    stack: FloatArray,
    depth: int,
    space: tuple[NDArray[np.uint8], NDArray[np.int32], IntArray, IntArray],
    goal: float,
    around: IntArray,
) -> int:
    """Put the parts of a block that may still win onto the stack, the best on top; its depth."""
    _, cells, half, groups = space
    level = place[3] - 1
    size, first = 1 << level, depth
    for a in range(place[0], min(place[0] + groups[level + 1], cells.shape[0]), groups[level]):
        for quarter in range(4):
            x, y = place[1] + (quarter >> 1) * size, place[2] + (quarter & 1) * size
            if x > half[0] or y > half[1]:
                continue
            score = _group_bound(space, (a, x, y, level), goal, around)
            if score < goal:
                continue
            at = depth
            while at > first and stack[at - 1, 0] > score:
                for field in range(5):
                    stack[at, field] = stack[at - 1, field]
                at -= 1
            _set_block(stack, at, score, (a, x, y, level))
            depth += 1
    return depth


@kernel
def _descend(
    roots: FloatArray,
    space: tuple[NDArray[np.uint8], NDArray[np.int32], IntArray, IntArray],
    goal: float,
    around: IntArray,
    most_lookups: float,
) -> tuple[IntArray, float]:
    """Depth first through the blocks, best first; the winner and its score, -1 if given up."""
    best, found = np.zeros(3, np.int64), 0.0
    levels, cells, _, groups = space
    stack = np.empty((4 * MOST_PARTS * (levels.shape[0] + 1), 5))
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
            depth = _push_parts((a, x, y, level), stack, depth, space, goal, around)
            blocks += 4 * (groups[level] // groups[level - 1])
            if blocks * cells.shape[1] > most_lookups:
                return best, -1.0
    return best, found
