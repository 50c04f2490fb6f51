"""Point-to-line registration of surface pieces on the local map (Gauss-Newton, robust weights).

Steps are taken in the frame of the base: ``T_map_base <- compose(T_map_base, step)``. Rotation is
scaled by the scan's typical range, so that eigenvalues of the three directions compare.
Directions that the surfaces do not hold are projected out of the scan's equations and left to the
prior (solution remapping, Zhang, Kaess & Singh 2016, with the prior in place of nothing).
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.slam.matching.local_map import nearest_surface
from slamsim.slam.matching.small import eigen, median, sandwich, solve, times
from slamsim.slam.matching.surfaces import (
    HALF_LENGTH,
    NORMAL_X,
    NORMAL_Y,
    VARIANCE,
    X,
    Y,
)

CONVERGED_STEP_M = 1e-4
MAX_STEP_M = 0.3
INLIER_SIGMAS = 3.0
ROBUST_SIGMAS = 5.0
INLIER_M = 0.03
"""What is this near, on top of noise, counts as fitting: real surfaces are rough."""

FAINT = 1e-3
"""Weight of the prior, along what the surfaces hold, while partners are still being found."""

LEAST_GATE_M = 0.15
"""How far partners may be in the end."""

DOUBT_SIGMAS = 3.0
ALIKE = 2.0
"""Scans matched one after the other err alike, through the map they share: their errors do not
average out. Variances are claimed this much larger; measured on simulated labyrinths, for 3 mm to
3 cm of noise."""

MEDIAN_CHI2 = 0.455
COVERED, INLIERS, CONVERGED, WEAK, WEIGHTS, UNIT, PULL = range(7)
SUMMARY_FIELDS = PULL + 3
"""From PULL on: the gradient of the scan alone where the prior came to rest with it."""


@kernel
def _equations(
    pieces: FloatArray,
    T_map_base: FloatArray,
    sizes: tuple[float, float, float, float],
    grid: tuple[FloatArray, IntArray, float, float],
    sums: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Fill information, gradient, spread, grip and summary at one pose.

    spread: mean outer product of the rows by the map's normals, for its axes; grip: the same
    with the scan's own normal in place of the map's once, for its sizes: the noise of the two is
    not the same, so that their product holds only what both have seen.

    sizes: gate, robust scale in sigmas, length that scales rotation, variance of unit weight.
    """
    gate, robust, length, unit = sizes
    summary = sums[4]
    _clear(sums)
    row, seen = np.empty(3), np.empty(3)
    ratios, partners = np.empty(pieces.shape[0]), 0
    cos, sin = np.cos(T_map_base[2]), np.sin(T_map_base[2])
    for k in range(pieces.shape[0]):
        x, y = pieces[k, X], pieces[k, Y]
        nx, ny = pieces[k, NORMAL_X], pieces[k, NORMAL_Y]
        there = (T_map_base[0] + cos * x - sin * y, T_map_base[1] + sin * x + cos * y)
        at = (there[0], there[1], cos * nx - sin * ny, sin * nx + cos * ny)
        slot, off, covered = nearest_surface(at, pieces[k, HALF_LENGTH], gate, grid)
        if covered:
            summary[COVERED] += 1.0
        if slot < 0:
            continue
        variance = pieces[k, VARIANCE] + grid[0][slot, VARIANCE]
        ratios[partners] = off * off / variance
        partners += 1
        variance *= unit
        if off * off < INLIER_SIGMAS * INLIER_SIGMAS * variance + INLIER_M * INLIER_M:
            summary[INLIERS] += 1.0
        mx, my = grid[0][slot, NORMAL_X], grid[0][slot, NORMAL_Y]
        row[0], row[1] = cos * mx + sin * my, -sin * mx + cos * my
        row[2] = (row[1] * x - row[0] * y) / length
        seen[0], seen[1], seen[2] = nx, ny, (ny * x - nx * y) / length
        _add(row, seen, (off, variance, robust), sums)
    summary[UNIT] = median(ratios, partners) / MEDIAN_CHI2 if partners > 0 else unit
    share = 1.0 / max(summary[WEIGHTS], 1e-9)
    for i in range(3):
        for j in range(3):
            sums[2][i, j] *= share
            sums[3][i, j] *= share


@kernel
def _clear(sums: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]) -> None:
    information, gradient, spread, grip, summary = sums
    for i in range(3):
        gradient[i] = 0.0
        for j in range(3):
            information[i, j] = spread[i, j] = grip[i, j] = 0.0
    summary[COVERED] = summary[INLIERS] = summary[WEIGHTS] = 0.0


@kernel
def _add(
    row: FloatArray,
    seen: FloatArray,
    residual: tuple[float, float, float],
    sums: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """One piece and its partner; weights of Geman & McClure (1987).

    residual: signed distance, its variance, robust scale in sigmas.
    """
    off, variance, robust = residual
    information, gradient, spread, grip, summary = sums
    ratio = 1.0 + off * off / (variance * robust * robust)
    weight = 1.0 / (ratio * ratio)
    summary[WEIGHTS] += weight
    for i in range(3):
        gradient[i] += weight / variance * row[i] * off
        for j in range(3):
            information[i, j] += weight / variance * row[i] * row[j]
            spread[i, j] += weight * row[i] * row[j]
            grip[i, j] += 0.5 * weight * (row[i] * seen[j] + seen[i] * row[j])


@kernel
def _sizes(grip: FloatArray, axes: FloatArray, values: FloatArray) -> None:
    """How large the grip is along each axis."""
    for k in range(3):
        values[k] = 0.0
        for i in range(3):
            for j in range(3):
                values[k] += axes[i, k] * grip[i, j] * axes[j, k]


@kernel
def _project_out(
    information: FloatArray, gradient: FloatArray, axes: FloatArray, weak: int
) -> None:
    """Remove the first ``weak`` columns of axes from the scan's equations."""
    if weak == 0:
        return
    keep = np.zeros((3, 3))
    for k in range(weak, 3):
        for i in range(3):
            for j in range(3):
                keep[i, j] += axes[i, k] * axes[j, k]
    sandwich(keep, information)
    times(keep, gradient.copy(), gradient)


@kernel
def _pull(
    prior: FloatArray,
    offset: FloatArray,
    axes: FloatArray,
    values: FloatArray,
    numbers: tuple[float, bool],
) -> FloatArray:
    """The prior as it enters the equations: whole along the weak axes, doubted along the others.

    Wheels that slip err by many of their own sigmas. Where the surfaces hold the scan, the prior
    is therefore faint while the search is wide, and a Cauchy weight of its own distance
    afterwards. In between it fades with the square of the grip.
    """
    weak_share, wide = numbers
    squared = 0.0
    for i in range(3):
        for j in range(3):
            squared += offset[i] * prior[i, j] * offset[j]
    belief = FAINT if wide else 1.0 / (1.0 + squared / (DOUBT_SIGMAS * DOUBT_SIGMAS))
    root = np.zeros((3, 3))
    for k in range(3):
        grip = max(values[k], weak_share) / weak_share
        share = np.sqrt(max(belief, 1.0 / (grip * grip)))
        for i in range(3):
            for j in range(3):
                root[i, j] += share * axes[i, k] * axes[j, k]
    pull = prior.copy()
    sandwich(root, pull)
    for i in range(3):
        pull[i, i] += 1e-6
    return pull


@kernel
def _offset(T_guess: FloatArray, T: FloatArray, length: float, out: FloatArray) -> None:
    """The step from guess to T in the frame of T, rotation scaled by length."""
    cos, sin = np.cos(T[2]), np.sin(T[2])
    dx, dy = T[0] - T_guess[0], T[1] - T_guess[1]
    turn = T[2] - T_guess[2]
    turn -= 2.0 * np.pi * np.floor((turn + np.pi) / (2.0 * np.pi))
    out[0], out[1], out[2] = cos * dx + sin * dy, -sin * dx + cos * dy, turn * length


@kernel
def _newton_step(
    information: FloatArray, gradient: FloatArray, pull: FloatArray, offset: FloatArray
) -> FloatArray:
    """The step that scan and prior agree on."""
    step = np.empty(3)
    times(pull, offset, step)
    whole = np.empty((3, 3))
    for i in range(3):
        step[i] = -(gradient[i] + step[i])
        for j in range(3):
            whole[i, j] = information[i, j] + pull[i, j]
    solve(whole, step.copy(), step)
    return step


@kernel
def typical_range(pieces: FloatArray) -> float:
    """Root mean square distance of the pieces, in metres. pieces: (n, PIECE_FIELDS)."""
    squares = 0.0
    for k in range(pieces.shape[0]):
        squares += pieces[k, X] * pieces[k, X] + pieces[k, Y] * pieces[k, Y]
    return float(max(np.sqrt(squares / max(pieces.shape[0], 1)), 0.1))


@kernel
def support(
    pieces: FloatArray,
    T_map_base: FloatArray,
    unit: float,
    grid: tuple[FloatArray, IntArray, float, float],
) -> float:
    """Sum of the robust weights at a pose: how many pieces lie on the map there.

    pieces: (n, PIECE_FIELDS). T_map_base: (3,).
    """
    blocks = np.zeros((3, 3, 3))
    sums = (blocks[0], np.zeros(3), blocks[1], blocks[2], np.zeros(SUMMARY_FIELDS))
    _equations(pieces, T_map_base, (LEAST_GATE_M, ROBUST_SIGMAS, 1.0, unit), grid, sums)
    return float(sums[4][WEIGHTS])


@kernel
def align(
    pieces: FloatArray,
    T_start: FloatArray,
    T_guess: FloatArray,
    prior: FloatArray,
    limits: tuple[float, float, float, float, int],
    grid: tuple[FloatArray, IntArray, float, float],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Register the pieces, beginning at T_start, with a prior about T_guess of information (3, 3)
    in the frame of the base.

    limits: gate, sigmas at which robust weights begin (more than ROBUST_SIGMAS: partners are
    still to be found, and the prior is faint until the last), variance of unit weight, weak
    share, iterations. grid: surfaces, keys, cell, oldest path length. Returns
    T_map_base, information (3, 3) of the scan alone, weak axes (3, 3: columns, the first
    ``summary[WEAK]`` count) in the frame of the base, and the summary.
    """
    narrow, robust, unit, weak_share, max_iterations = limits
    length = typical_range(pieces)
    T, offset = T_start.copy(), np.empty(3)
    information, gradient = np.zeros((3, 3)), np.zeros(3)
    spread, grip = np.zeros((3, 3)), np.zeros((3, 3))
    values, axes, summary = np.zeros(3), np.zeros((3, 3)), np.zeros(SUMMARY_FIELDS)
    prior_scaled = prior.copy()
    _scale(prior_scaled, 1.0 / length)
    # From wide to narrow: first everything within the gate pulls, in the end only what fits.
    least = min(narrow, LEAST_GATE_M)
    for iteration in range(max_iterations):
        sums = (information, gradient, spread, grip, summary)
        _equations(pieces, T, (narrow, robust, length, unit), grid, sums)
        eigen(spread, values, axes)
        _sizes(grip, axes, values)
        weak = 0
        while weak < 3 and values[weak] < weak_share:
            weak += 1
        _project_out(information, gradient, axes, weak)
        summary[WEAK] = weak
        _offset(T_guess, T, length, offset)
        pull = _pull(prior_scaled, offset, axes, values, (weak_share, robust > ROBUST_SIGMAS))
        step = _newton_step(information, gradient, pull, offset)
        _rest(information, gradient, step, summary)
        size = _move(T, step, length)
        if not np.isfinite(size):
            break
        if size < CONVERGED_STEP_M and robust <= ROBUST_SIGMAS:
            summary[CONVERGED] = 1.0
            break
        if size < 0.02 or iteration > max_iterations // 2:
            robust = max(robust * 0.4, ROBUST_SIGMAS)
            narrow = max(0.5 * narrow, least)
    _scale(information, length)
    summary[PULL + 2] *= length
    for i in range(3):
        axes[2, i] /= length
        summary[PULL + i] /= ALIKE
        for j in range(3):
            information[i, j] /= ALIKE
    return T, information, axes, summary


@kernel
def _rest(
    information: FloatArray, gradient: FloatArray, step: FloatArray, summary: FloatArray
) -> None:
    """What the scan alone still wants after the step that it shared with the prior."""
    left = np.empty(3)
    times(information, step, left)
    for i in range(3):
        summary[PULL + i] = -(gradient[i] + left[i])


@kernel
def _move(T: FloatArray, step: FloatArray, length: float) -> float:
    """T <- compose(T, step), a long step shortened; the size of the step, nan if it is no step."""
    size = np.abs(step[0]) + np.abs(step[1]) + np.abs(step[2])
    short = min(1.0, MAX_STEP_M / max(size, 1e-12))
    cos, sin = short * np.cos(T[2]), short * np.sin(T[2])
    T[0] += cos * step[0] - sin * step[1]
    T[1] += sin * step[0] + cos * step[1]
    T[2] += short * step[2] / length
    T[2] -= 2.0 * np.pi * np.floor((T[2] + np.pi) / (2.0 * np.pi))
    return float(size)


@kernel
def _scale(matrix: FloatArray, length: float) -> None:
    """Another unit for rotation, in place."""
    for i in range(3):
        matrix[i, 2] *= length
        matrix[2, i] *= length
