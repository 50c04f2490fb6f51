"""Covariances of a solved pose graph without inverting it.

Poses are disturbed from the left, in the map frame: then an edge's information enters the
system as a graph Laplacian with matrix weights, and the inverse, with one pose held fixed, has the
uncertainty of every other pose relative to that one on its diagonal. Only the entries of
the inverse that lie on the pattern of its factor are computed (Takahashi, Fagan & Chen 1973;
Erisman & Tinney 1975).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from slamsim.jit import kernel
from slamsim.types import FloatArray, GraphEdge


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """(..., 3, 3): takes a small step (x, y, yaw) seen in frame b to the same step in frame a."""
    T_a_b = np.asarray(T_a_b, dtype=np.float64)
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = [
        np.stack([cos, -sin, T_a_b[..., 1]], axis=-1),
        np.stack([sin, cos, -T_a_b[..., 0]], axis=-1),
        np.stack([zero, zero, one], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def rotation(yaw_rad: FloatArray) -> FloatArray:
    """(..., 3, 3): turns x and y of a step (x, y, yaw), leaving yaw as it is."""
    turn = np.zeros((*np.shape(yaw_rad), 3))
    turn[..., 2] = yaw_rad
    return adjoint(turn)


def edge_covariances_in_map(
    poses: FloatArray, edges: Sequence[GraphEdge], origin_m: FloatArray
) -> FloatArray:
    """(m, 3, 3) covariance of each edge as a step of the map about ``origin_m``."""
    covariances = np.array([edge.covariance for edge in edges]).reshape(-1, 3, 3)
    measured = np.array([edge.T_source_target for edge in edges]).reshape(-1, 3)
    targets = poses[[edge.target for edge in edges]] - np.append(origin_m, 0.0)
    # From the frame of the source to that of the target, and from there to the map.
    transport = adjoint(targets) @ rotation(-measured[:, 2])
    return np.asarray(transport @ covariances @ np.swapaxes(transport, -1, -2))


def relative_covariances(
    poses: FloatArray, edges: Sequence[GraphEdge], fixed: int, origin_m: FloatArray
) -> FloatArray:
    """(n, 3, 3) covariance of each pose relative to the fixed one, as steps about ``origin_m``.

    Edges count by their weight. Every pose must be joined to the fixed one.
    """
    count = len(poses)
    if count == 1:
        return np.zeros((1, 3, 3))
    used = [edge for edge in edges if edge.weight > 0.0]
    weights = np.array([edge.weight for edge in used])
    information = weights[:, None, None] * np.linalg.inv(
        edge_covariances_in_map(poses, used, origin_m)
    )
    # The fixed pose goes last in the numbering and is left out of the system.
    place = np.delete(np.arange(count), fixed)
    number = np.empty(count, dtype=np.int64)
    number[place], number[fixed] = np.arange(count - 1), count - 1
    ends = np.array([[number[edge.source], number[edge.target]] for edge in used])
    starts, rows, order = _pattern(ends, count - 1)
    values = _assemble(starts, rows, order, ends, information)
    if not _invert(starts, rows, values):
        raise np.linalg.LinAlgError("the information matrix is not positive definite")
    covariances = np.zeros((count, 3, 3))
    covariances[place] = values[starts[order[:-1]]]
    return covariances


def _pattern(
    ends: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Column starts and sorted rows of the block factor, and the place of each pose in it.

    The pattern is that of the factor of an M-matrix on the same graph, all of whose entries have
    one sign, so that none cancels. order: (count + 1,), the fixed pose, ``count``, maps to itself.
    """
    inner = ends[(ends < count).all(axis=1)]
    degree = np.bincount(ends.ravel(), minlength=count + 1)[:count] + 1.0
    rows = np.concatenate([inner[:, 0], inner[:, 1], np.arange(count)])
    columns = np.concatenate([inner[:, 1], inner[:, 0], np.arange(count)])
    values = np.concatenate([np.full(2 * len(inner), -1.0), degree])
    graph = coo_matrix((values, (rows, columns)), shape=(count, count)).tocsc()
    factor = splu(
        graph,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    lower = csc_matrix(factor.L)
    lower.sort_indices()
    order = np.append(np.asarray(factor.perm_c, dtype=np.int64), count)
    return lower.indptr.astype(np.int64), lower.indices.astype(np.int64), order


@kernel
def _find(starts: NDArray[np.int64], rows: NDArray[np.int64], row: int, column: int) -> int:
    """Where an entry is stored, by bisection."""
    low, high = starts[column], starts[column + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return int(low)


@kernel
def _assemble(
    starts: NDArray[np.int64],
    rows: NDArray[np.int64],
    order: NDArray[np.int64],
    ends: NDArray[np.int64],
    information: FloatArray,
) -> FloatArray:
    """(entries, 3, 3) lower half of the system on the pattern of its factor."""
    values = np.zeros((rows.size, 3, 3))
    last = order.size - 1
    for m in range(ends.shape[0]):
        a, b = order[ends[m, 0]], order[ends[m, 1]]
        across = _find(starts, rows, max(a, b), min(a, b)) if last not in (a, b) else -1
        for i in range(3):
            for k in range(3):
                if a != last:
                    values[starts[a], i, k] += information[m, i, k]
                if b != last:
                    values[starts[b], i, k] += information[m, i, k]
                if across >= 0:
                    values[across, i, k] -= information[m, i, k]
    return values


@kernel
def _inverse_3x3(m: FloatArray, out: FloatArray) -> bool:
    """Inverse of a symmetric positive definite matrix; False if it is not that."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    minor = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    if not (m[0, 0] > 0.0 and minor > 0.0 and determinant > 0.0):
        return False
    share = 1.0 / determinant
    out[0, 0], out[0, 1], out[0, 2] = share * c00, share * c01, share * c02
    out[1, 1] = share * (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0])
    out[1, 2] = share * (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2])
    out[2, 2] = share * minor
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return True


@kernel
def _copy(out: FloatArray, a: FloatArray, factor: float) -> None:
    """out = factor a."""
    for i in range(3):
        for j in range(3):
            out[i, j] = factor * a[i, j]


@kernel
def _add(out: FloatArray, a: FloatArray, b: FloatArray, transpose_a: bool) -> None:
    """out += a b, or a^T b."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += (a[k, i] if transpose_a else a[i, k]) * b[k, j]


@kernel
def _add_transposed(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """out += a b^T."""
    for i in range(3):
        for j in range(3):
            out[i, j] += a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@kernel
def _factorise(
    starts: NDArray[np.int64],
    rows: NDArray[np.int64],
    values: FloatArray,
    minus_l: FloatArray,
    pivot: FloatArray,
) -> bool:
    """Fill minus_l and the inverse pivots of L D L^T, spoiling values; False if not definite."""
    negative = np.empty((3, 3))
    for j in range(starts.size - 1):
        begin, end = starts[j] + 1, starts[j + 1]
        if not _inverse_3x3(values[starts[j]], pivot[j]):
            return False
        _copy(negative, pivot[j], -1.0)
        for p in range(begin, end):
            _add(minus_l[p], values[p], negative, False)
        for p in range(begin, end):
            r = starts[rows[p]]
            for q in range(p, end):
                while rows[r] < rows[q]:
                    r += 1
                _add_transposed(values[r], minus_l[q], values[p])
    return True


@kernel
def _invert(starts: NDArray[np.int64], rows: NDArray[np.int64], values: FloatArray) -> bool:
    """Replace a matrix by its inverse, on the pattern of its factor; False if not definite."""
    minus_l = np.zeros(values.shape)
    pivot = np.zeros((starts.size - 1, 3, 3))
    if not _factorise(starts, rows, values, minus_l, pivot):
        return False
    for j in range(starts.size - 2, -1, -1):
        begin, end = starts[j] + 1, starts[j + 1]
        for p in range(begin, end):
            _copy(values[p], pivot[j], 0.0)
        for p in range(begin, end):
            r = starts[rows[p]]
            for q in range(p, end):
                while rows[r] < rows[q]:
                    r += 1
                _add(values[q], values[r], minus_l[p], False)
                if q != p:
                    _add(values[p], values[r], minus_l[q], True)
        _copy(values[starts[j]], pivot[j], 1.0)
        for p in range(begin, end):
            _add(values[starts[j]], values[p], minus_l[p], True)
    return True
