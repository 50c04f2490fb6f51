"""Rays in the plane: where they first meet straight walls and round posts, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AT_ONCE = 4096
"""Rays against all walls in one piece of work: the products stay in the processor's cache."""

EDGE = 1e-9
"""A wall is longer by this share at both ends, or rays would pass between two that touch."""

GLASS_COSINE = 0.95
"""A laser sees a pane where it falls on it within 18 degrees of head-on, and else through it."""


@dataclass(frozen=True)
class Scene:
    """walls: (s, 4) from x, y to x, y in metres. posts: (c, 3) x, y, radius, seen from outside and
    from inside. glass: (s,) which walls are panes."""

    walls: Floats
    posts: Floats
    glass: NDArray[np.bool_]


def cast(scene: Scene, origins: Floats, angles: Floats) -> Floats:
    """Distances (n,) in metres, inf where a ray meets nothing. origins: (n, 2), angles: (n,)."""
    found = np.empty(len(angles))
    for begin in range(0, len(angles), AT_ONCE):
        part = slice(begin, begin + AT_ONCE)
        along = np.column_stack([np.cos(angles[part]), np.sin(angles[part])])
        to_walls = _to_walls(scene, origins[part], along)
        found[part] = np.minimum(to_walls, to_posts(scene.posts, origins[part], along))
    return found


def _to_walls(scene: Scene, origins: Floats, along: Floats) -> Floats:
    """With a + s e the wall and o + t d the ray: t = (a-o)xe / dxe, s = (a-o)xd / dxe."""
    if not len(scene.walls):
        return np.full(len(origins), np.inf)
    ax, ay = scene.walls[:, 0], scene.walls[:, 1]
    ex, ey = scene.walls[:, 2] - ax, scene.walls[:, 3] - ay
    (ox, oy), (dx, dy) = origins.T, along.T
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (along @ np.array([ey, -ex]))
        ones = np.ones(len(origins))
        far = np.column_stack([ones, ox, oy]) @ np.array([ax * ey - ay * ex, -ey, ex]) * inverse
        share = np.column_stack([dx, dy, ox * dy - oy * dx]) @ np.array(
            [-ay, ax, -np.ones(len(ax))]
        )
        share *= inverse
        seen = (np.abs(share - 0.5) <= 0.5 + EDGE) & (far > 0.0)
        if scene.glass.any():
            seen &= ~scene.glass | (np.abs(1.0 / inverse) > GLASS_COSINE * np.hypot(ex, ey))
    far[~seen] = np.inf
    return np.asarray(far.min(axis=1))


def to_posts(posts: Floats, origins: Floats, along: Floats) -> Floats:
    """Posts: (c, 3), or (n, c, 3) where they move and each ray finds them elsewhere."""
    if not posts.size:
        return np.full(len(origins), np.inf)
    by_x = posts[..., 0] - origins[:, :1]
    by_y = posts[..., 1] - origins[:, 1:]
    nearest = by_x * along[:, :1] + by_y * along[:, 1:]
    with np.errstate(invalid="ignore"):
        half = np.sqrt(nearest**2 - (by_x**2 + by_y**2 - posts[..., 2] ** 2))
    first = np.where(nearest - half > 0.0, nearest - half, nearest + half)
    return np.asarray(np.where(first > 0.0, first, np.inf).min(axis=1))


def clearance(scene: Scene, points: Floats) -> Floats:
    """From each of the points (n, 2) to the nearest surface (n,), in metres."""
    a, e = scene.walls[:, :2], scene.walls[:, 2:] - scene.walls[:, :2]
    to = points[:, None] - a
    share = np.clip((to * e).sum(-1) / (e * e).sum(-1), 0.0, 1.0)
    near = np.linalg.norm(to - share[..., None] * e, axis=-1).min(axis=1)
    if len(scene.posts):
        away = np.linalg.norm(points[:, None] - scene.posts[:, :2], axis=-1)
        near = np.minimum(near, np.abs(away - scene.posts[:, 2]).min(axis=1))
    return np.asarray(near)
