"""One Newton step for a chain of poses: block-tridiagonal normal equations, forwards and back.

Rauch, Tung & Striebel (1965) in information form, with the covariances that restricted maximum
likelihood needs to learn variances (Foerstner 1979). Unknowns are small steps
``(dx_m, dy_m, dyaw_rad)`` of each pose in its own frame.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray
from slamsim.slam.matching.small import invert, product, put, times

MIN_FREE = 10.0
ANCHOR = 1e-3
"""Information that holds a pose where it is when nothing else does: a metre, a radian, or more."""


@kernel
def newton_round(
    poses: FloatArray,
    measured: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    odometry: tuple[FloatArray, FloatArray],
    numbers: tuple[float, float],
    covariances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """One step of Gauss and Newton for all poses, and the factors of the four variances.

    numbers: variance of the matches over what they claim, degrees of freedom of Student's t. poses:
    (n, 3). measured: (n, 3) poses, (n, 3, 3) information, (n, 3) offsets, (n,) ranks. odometry:
    (n - 1, 3) steps and (n - 1, 3, 3) information. covariances: (n, 3, 3), filled. The step is (n,
    3), the factors are (4,).
    """
    count = poses.shape[0]
    diagonal, beside = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    wanted, moves = np.zeros((count, 3)), np.zeros((count, 3))
    carry, off = np.zeros((count, 3, 3)), np.zeros((count, 3))
    weights = np.ones((count, 2))
    _matches(poses, measured, numbers, (diagonal, wanted, weights))
    _steps(poses, odometry, numbers[1], (diagonal, beside, wanted), (carry, off, weights))
    _eliminate(diagonal, beside, wanted)
    _substitute(diagonal, beside, wanted, moves, covariances)
    learnt = np.ones(4)
    learnt[0] = _match_factor(poses, measured, numbers[0], (weights, covariances))
    _motion_factors(odometry, (carry, off, weights), (beside, covariances), learnt)
    return moves, learnt


@kernel
def _matches(
    poses: FloatArray,
    measured: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    numbers: tuple[float, float],
    system: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Enter what every scan alone wants."""
    _, information, _, ranks = measured
    scale, freedom = numbers
    diagonal, wanted, weights = system
    residual, pull = np.empty(3), np.empty(3)
    for k in range(poses.shape[0]):
        squared = _match_residual(poses, measured, k, residual) / scale
        weights[k, 0] = (freedom + ranks[k]) / (freedom + squared)
        share = weights[k, 0] / scale
        times(information[k], residual, pull)
        for i in range(3):
            diagonal[k, i, i] += ANCHOR
            wanted[k, i] -= share * pull[i]
            for j in range(3):
                diagonal[k, i, j] += share * information[k, i, j]


@kernel
def _match_residual(
    poses: FloatArray,
    measured: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    k: int,
    residual: FloatArray,
) -> float:
    """How far the pose is from where the scan wants it, and the squared distance in its metric."""
    track, information, offsets, _ = measured
    _between(track[k], poses[k], residual)
    pull = np.empty(3)
    squared = 0.0
    for i in range(3):
        residual[i] -= offsets[k, i]
    times(information[k], residual, pull)
    for i in range(3):
        squared += residual[i] * pull[i]
    return float(squared)


@kernel
def _steps(
    poses: FloatArray,
    odometry: tuple[FloatArray, FloatArray],
    freedom: float,
    system: tuple[FloatArray, FloatArray, FloatArray],
    kept: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Enter the odometry. kept: what a step of the earlier pose does to the later, residuals and
    weights."""
    steps, believed = odometry
    diagonal, beside, wanted = system
    carry, off, weights = kept
    found, pull, back = np.empty(3), np.empty(3), np.empty((3, 3))
    for k in range(poses.shape[0] - 1):
        _between(poses[k], poses[k + 1], found)
        _adjoint_of_inverse(found, carry[k])
        _between(steps[k], found, off[k])
        times(believed[k], off[k], pull)
        squared = off[k, 0] * pull[0] + off[k, 1] * pull[1] + off[k, 2] * pull[2]
        weight = (freedom + 3.0) / (freedom + squared)
        weights[k, 1] = weight
        product(believed[k], carry[k], back)
        for i in range(3):
            wanted[k + 1, i] -= weight * pull[i]
            for j in range(3):
                diagonal[k + 1, i, j] += weight * believed[k, i, j]
                beside[k, i, j] = -weight * back[j, i]
                wanted[k, i] += weight * carry[k, j, i] * pull[j]
                for m in range(3):
                    diagonal[k, i, j] += weight * carry[k, m, i] * back[m, j]


@kernel
def _eliminate(diagonal: FloatArray, beside: FloatArray, wanted: FloatArray) -> None:
    """Forwards: each pose is expressed by the next. ``diagonal`` becomes its inverse, ``beside``
    the gain from the next pose, ``wanted`` what remains."""
    count = diagonal.shape[0]
    inverse, gain = np.empty((3, 3)), np.empty((3, 3))
    for k in range(count):
        invert(diagonal[k], inverse)
        for i in range(3):
            put(inverse[i], diagonal[k, i])
        if k + 1 == count:
            break
        product(inverse, beside[k], gain)
        for i in range(3):
            for j in range(3):
                wanted[k + 1, i] -= gain[j, i] * wanted[k, j]
                for m in range(3):
                    diagonal[k + 1, i, j] -= beside[k, m, i] * gain[m, j]
        for i in range(3):
            for j in range(3):
                beside[k, i, j] = -gain[i, j]


@kernel
def _substitute(
    inverses: FloatArray,
    gains: FloatArray,
    wanted: FloatArray,
    moves: FloatArray,
    covariances: FloatArray,
) -> None:
    """Backwards: the moves of all poses and their covariances."""
    last = inverses.shape[0] - 1
    times(inverses[last], wanted[last], moves[last])
    for i in range(3):
        put(inverses[last, i], covariances[last, i])
    half = np.empty((3, 3))
    for k in range(last - 1, -1, -1):
        times(inverses[k], wanted[k], moves[k])
        product(gains[k], covariances[k + 1], half)
        for i in range(3):
            for j in range(3):
                moves[k, i] += gains[k, i, j] * moves[k + 1, j]
                covariances[k, i, j] = inverses[k, i, j]
                for m in range(3):
                    covariances[k, i, j] += half[i, m] * gains[k, j, m]


@kernel
def _match_factor(
    poses: FloatArray,
    measured: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    scale: float,
    found: tuple[FloatArray, FloatArray],
) -> float:
    """Squares of the residuals over how many of them are free."""
    _, information, _, ranks = measured
    weights, covariances = found
    residual = np.empty(3)
    squares, free = 0.0, 0.0
    for k in range(poses.shape[0]):
        share = weights[k, 0] / scale
        squares += share * _match_residual(poses, measured, k, residual)
        free += ranks[k]
        for i in range(3):
            for j in range(3):
                free -= share * information[k, i, j] * covariances[k, j, i]
    return float(squares / free) if free >= MIN_FREE else 1.0


@kernel
def _motion_factors(
    odometry: tuple[FloatArray, FloatArray],
    kept: tuple[FloatArray, FloatArray, FloatArray],
    found: tuple[FloatArray, FloatArray],
    learnt: FloatArray,
) -> None:
    """As for the matches, for each direction of the odometry."""
    _, believed = odometry
    carry, off, weights = kept
    gains, covariances = found
    squares, free = np.zeros(3), np.zeros(3)
    cross, both, moved = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(off.shape[0] - 1):
        product(gains[k], covariances[k + 1], cross)
        product(carry[k], cross, both)
        product(carry[k], covariances[k], moved)
        for i in range(3):
            share = weights[k, 1] * believed[k, i, i]
            spread = covariances[k + 1, i, i] - 2.0 * both[i, i]
            for j in range(3):
                spread += moved[i, j] * carry[k, i, j]
            squares[i] += share * off[k, i] * off[k, i]
            free[i] += 1.0 - share * spread
    for i in range(3):
        learnt[1 + i] = squares[i] / free[i] if free[i] >= MIN_FREE else 1.0


@kernel
def _between(T_a_b: FloatArray, T_a_c: FloatArray, T_b_c: FloatArray) -> None:
    cos, sin = np.cos(T_a_b[2]), np.sin(T_a_b[2])
    dx, dy = T_a_c[0] - T_a_b[0], T_a_c[1] - T_a_b[1]
    turn = T_a_c[2] - T_a_b[2]
    T_b_c[0], T_b_c[1] = cos * dx + sin * dy, -sin * dx + cos * dy
    T_b_c[2] = turn - 2.0 * np.pi * np.floor((turn + np.pi) / (2.0 * np.pi))


@kernel
def _adjoint_of_inverse(T_a_b: FloatArray, out: FloatArray) -> None:
    """Takes a small step seen in frame a to the same step in frame b."""
    x, y = T_a_b[0], T_a_b[1]
    cos, sin = np.cos(T_a_b[2]), np.sin(T_a_b[2])
    out[0, 0], out[0, 1], out[0, 2] = cos, sin, sin * x - cos * y
    out[1, 0], out[1, 1], out[1, 2] = -sin, cos, cos * x + sin * y
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0
