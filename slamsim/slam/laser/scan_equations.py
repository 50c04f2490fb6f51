"""The equations of a window of scans: points with their derivatives by pose and shape."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray
from slamsim.models.line_bundle import Seen, add_surfaces, pull_to_lines
from slamsim.models.supernodes import empty_system, one_panel

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
    sweep_s, scale, offset = shape
    points, change = np.empty_like(raw), np.empty((raw.shape[0], 2, UNKNOWNS, 2))
    for k in range(raw.shape[0]):
        view = views[k]
        px, py, pyaw = poses[view]
        pose_cos, pose_sin = np.cos(pyaw), np.sin(pyaw)
        first, second = motion[view, 0], motion[view, 1]
        for end in range(2):
            x, y = raw[k, end]
            reach = max(np.hypot(x, y), 1e-6)
            turned = (scale - 1.0) * angles[k, end]
            cos, sin = np.cos(turned), np.sin(turned)
            shorter = 1.0 - offset / reach
            x, y = shorter * (cos * x - sin * y), shorter * (sin * x + cos * y)
            ux, uy = x / (reach * shorter), y / (reach * shorter)
            after = shares[k, end] * sweep_s
            yaw = after * (first[2] + after * second[2])
            cos, sin = np.cos(yaw), np.sin(yaw)
            rx, ry = cos * x - sin * y, sin * x + cos * y
            qx = rx + after * (first[0] + after * second[0])
            qy = ry + after * (first[1] + after * second[1])
            rate = first[2] + 2.0 * after * second[2]
            local = change[k, end]
            local[0, 0], local[0, 1] = 1.0, 0.0
            local[1, 0], local[1, 1] = 0.0, 1.0
            local[2, 0], local[2, 1] = -qy, qx
            local[3, 0] = shares[k, end] * (first[0] + 2.0 * after * second[0] - rate * ry)
            local[3, 1] = shares[k, end] * (first[1] + 2.0 * after * second[1] + rate * rx)
            local[4, 0], local[4, 1] = -angles[k, end] * ry, angles[k, end] * rx
            local[5, 0], local[5, 1] = -(cos * ux - sin * uy), -(sin * ux + cos * uy)
            for u in range(UNKNOWNS):
                dx, dy = local[u, 0], local[u, 1]
                local[u, 0] = pose_cos * dx - pose_sin * dy
                local[u, 1] = pose_sin * dx + pose_cos * dy
            points[k, end, 0] = px + pose_cos * qx - pose_sin * qy
            points[k, end, 1] = py + pose_sin * qx + pose_cos * qy
    return points, change


def window_system(
    seen: tuple[FloatArray, FloatArray, FloatArray, IntArray],
    surfaces: IntArray,
    starts: IntArray,
    lines: FloatArray,
    count: int,
) -> tuple[FloatArray, FloatArray]:
    """Information (d, d) and right-hand side (d,) of ``count`` poses, then the shape.

    seen: points, their changes, weights (k,) and scans (k,) of the observations, sorted by
    surface (k,), then scan. lines: as ``fit_lines`` gives them; every surface has an offset and a
    turn of its own, which are eliminated.
    """
    points, change, weights, views = seen
    across = np.einsum("keuc,kc->keu", change, lines[surfaces, 2:])
    unknowns = np.column_stack([views, np.full_like(views, count)])
    rows = across.reshape(-1, 2, UNKNOWNS // POSE, POSE)
    bundle = Seen(points, weights, starts, lines, rows, unknowns)
    panel = one_panel(count + 1)
    system, right = empty_system(panel), np.zeros((count + 1, POSE))
    add_surfaces(bundle, panel, system)
    pull_to_lines(bundle, right)
    lower = np.tril(system.reshape(right.size, right.size))
    return lower + np.tril(lower, -1).T, right.ravel()
