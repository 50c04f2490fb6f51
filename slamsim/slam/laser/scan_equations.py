"""The equations of a window of scans: points with their derivatives by pose and shape."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.line_bundle import Seen, add_surfaces, pull_to_lines
from slamsim.models.supernodes import empty_system, one_panel
from slamsim.slam.laser.scan_bends import INFORMATION, straightened

SHAPES = 3
"""Unknowns of the shape of a scan: sweep in seconds, relative angle, range offset in metres."""

POSE = 3
UNKNOWNS = POSE + SHAPES


@kernel
def moved_points(
    raw: FloatArray,
    seen: tuple[FloatArray, FloatArray, IntArray],
    poses: FloatArray,
    motion: FloatArray,
    shape: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray]:
    """Both points of each observation in the frame of the window, (k, 2, 2), and what they change
    by, (k, 2, UNKNOWNS, 2), with a small step of their pose in its own frame and of the shape.

    raw: (k, 2, 2) as the scan has them. seen: (k, 2) share of the sweep and angle, both from the
    middle beam, and (k,) the scan. motion: (n, 2, 3) as in ``scan_sweep.moved_pieces``.
    """
    shares, angles, views = seen
    points, change = np.empty_like(raw), np.empty((raw.shape[0], 2, UNKNOWNS, 2))
    for k in range(raw.shape[0]):
        px, py, yaw = poses[views[k]]
        cos, sin = np.cos(yaw), np.sin(yaw)
        for end in range(2):
            local = change[k, end]
            beam = (shares[k, end], angles[k, end])
            x, y = _deskewed(raw[k, end], beam, motion[views[k]], shape, local)
            points[k, end, 0] = px + cos * x - sin * y
            points[k, end, 1] = py + sin * x + cos * y
            for u in range(UNKNOWNS):
                dx, dy = local[u, 0], local[u, 1]
                local[u, 0] = cos * dx - sin * dy
                local[u, 1] = sin * dx + cos * dy
    return points, change


@kernel
def _deskewed(
    raw: FloatArray,
    beam: tuple[float, float],
    motion: FloatArray,
    shape: tuple[float, float, float],
    change: FloatArray,
) -> tuple[float, float]:
    """A point in the frame of its pose; change: (UNKNOWNS, 2) of it there, which is written.

    beam: share of the sweep, and angle, from the middle beam. motion: (2, 3).
    """
    (share, angle), (sweep_s, scale, offset) = beam, shape
    first, second = motion[0], motion[1]
    x, y = raw
    reach = max(np.hypot(x, y), 1e-6)
    turned = (scale - 1.0) * angle
    cos, sin = np.cos(turned), np.sin(turned)
    shorter = 1.0 - offset / reach
    x, y = shorter * (cos * x - sin * y), shorter * (sin * x + cos * y)
    ux, uy = x / (reach * shorter), y / (reach * shorter)
    after = share * sweep_s
    yaw = after * (first[2] + after * second[2])
    cos, sin = np.cos(yaw), np.sin(yaw)
    rx, ry = cos * x - sin * y, sin * x + cos * y
    qx = rx + after * (first[0] + after * second[0])
    qy = ry + after * (first[1] + after * second[1])
    rate = first[2] + 2.0 * after * second[2]
    change[0, 0], change[0, 1] = 1.0, 0.0
    change[1, 0], change[1, 1] = 0.0, 1.0
    change[2, 0], change[2, 1] = -qy, qx
    change[3, 0] = share * (first[0] + 2.0 * after * second[0] - rate * ry)
    change[3, 1] = share * (first[1] + 2.0 * after * second[1] + rate * rx)
    change[4, 0], change[4, 1] = -angle * ry, angle * rx
    change[5, 0], change[5, 1] = -(cos * ux - sin * uy), -(sin * ux + cos * uy)
    return qx, qy


def window_system(
    seen: tuple[FloatArray, FloatArray, FloatArray, IntArray],
    surfaces: IntArray,
    starts: IntArray,
    lines: FloatArray,
    bends: FloatArray,
    count: int,
) -> tuple[FloatArray, FloatArray]:
    """Information (d, d) and right-hand side (d,) of ``count`` poses, then the shape.

    seen: points, their changes, weights (k,) and scans (k,) of the observations, sorted by
    surface (k,), then scan. lines, bends: as ``fit_lines`` and ``fit_bends`` give them; every
    surface has an offset, a turn and a bend of its own, which are eliminated.
    """
    points, change, weights, views = seen
    flat, normals, bent = straightened(points, starts, lines, bends)
    across = np.einsum("keuc,kec->keu", change, normals)
    unknowns = np.column_stack([views, np.full_like(views, count)])
    rows = across.reshape(-1, 2, UNKNOWNS // POSE, POSE)
    bundle = Seen(flat, weights, starts, lines, rows, unknowns)
    panel = one_panel(count + 1)
    system, right = empty_system(panel), np.zeros((count + 1, POSE))
    add_surfaces(bundle, panel, system)
    pull_to_lines(bundle, right)
    lower = np.tril(system.reshape(right.size, right.size))
    whole = lower + np.tril(lower, -1).T
    shared = np.zeros((len(lines), count + 1, POSE))
    by_bend = np.einsum("k,ke,kebi->kbi", weights, bent, rows)
    np.add.at(shared, (surfaces[:, None], unknowns), by_bend)
    held = shared.reshape(-1, right.size) / np.sqrt(bends[:, INFORMATION])[:, None]
    return whole - held.T @ held, right.ravel()
