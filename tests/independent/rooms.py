"""Places to drive in, drawn by seed: offices, corridors, halls, round rooms, clutter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from independent.rays import Floats, Scene

FREE_M = 1.0
"""Nothing stands nearer to where the robot begins, the origin."""

Walls = list[tuple[float, float, float, float]]
Posts = list[tuple[float, float, float]]


def random_room(rng: np.random.Generator, glass: bool = False) -> Scene:
    """Any of the kinds; the robot begins at the origin. glass: a fifth of the walls are panes."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    walls, posts = kind(rng)
    turned = _turned(np.array(walls), rng.uniform(0.0, 2.0 * np.pi))
    return Scene(turned[0], _turned_posts(posts, turned[1]), _panes(len(walls), glass, rng))


def _panes(count: int, glass: bool, rng: np.random.Generator) -> np.ndarray:
    return (rng.random(count) < 0.2) & glass


def _turned(walls: Floats, by_rad: float) -> tuple[Floats, Floats]:
    """No room lies along the axes of its map."""
    cos, sin = np.cos(by_rad), np.sin(by_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    return np.hstack([walls[:, :2] @ turn.T, walls[:, 2:] @ turn.T]), turn


def _turned_posts(posts: Posts, turn: Floats) -> Floats:
    every = np.array(posts, dtype=np.float64).reshape(-1, 3)
    return np.column_stack([every[:, :2] @ turn.T, every[:, 2]])


def _polygon(corners: Sequence[tuple[float, float]]) -> Walls:
    ends = [*corners[1:], corners[0]]
    return [(*a, *b) for a, b in zip(corners, ends, strict=True)]


def _box(x: float, y: float, long: float, wide: float, by_rad: float) -> Walls:
    cos, sin = np.cos(by_rad), np.sin(by_rad)
    half = [(-long, -wide), (long, -wide), (long, wide), (-long, wide)]
    return _polygon([(x + (cos * a - sin * b) / 2, y + (sin * a + cos * b) / 2) for a, b in half])


def _furniture(
    rng: np.random.Generator, count: int, reach_x: float, reach_y: float
) -> tuple[Walls, Posts]:
    """Boxes and bins, turned anyhow, about the origin and away from it."""
    walls: Walls = []
    posts: Posts = []
    for _ in range(count):
        x, y = rng.uniform(-reach_x, reach_x), rng.uniform(-reach_y, reach_y)
        if np.hypot(x, y) < FREE_M + 0.7:
            continue
        if rng.random() < 0.3:
            posts.append((x, y, rng.uniform(0.1, 0.3)))
        else:
            long, wide = rng.uniform(0.3, 1.2), rng.uniform(0.2, 0.6)
            walls += _box(x, y, long, wide, rng.uniform(0.0, np.pi))
    return walls, posts


def _office(rng: np.random.Generator) -> tuple[Walls, Posts]:
    """Two rows of rooms with doors on a corridor, in which the robot begins."""
    half, deep = rng.uniform(1.0, 1.4), rng.uniform(3.0, 5.0)
    wide, count = rng.uniform(3.0, 4.5), int(rng.integers(2, 4))
    left, right = -wide * count / 2, wide * count / 2
    walls = _polygon(
        [(left, -half - deep), (right, -half - deep), (right, half + deep), (left, half + deep)]
    )
    for side in (-1.0, 1.0):
        for number in range(count):
            begin, end = left + wide * number, left + wide * (number + 1)
            door = rng.uniform(begin + 0.4, end - 1.6)
            walls += [
                (begin, side * half, door, side * half),
                (door + 1.2, side * half, end, side * half),
            ]
            if number:
                walls.append((begin, side * half, begin, side * (half + deep)))
            desk = rng.uniform(begin + 0.8, end - 0.8)
            walls += _box(desk, side * (half + deep - 0.7), 1.2, 0.6, rng.uniform(-0.2, 0.2))
    return walls, []


def _corridor(rng: np.random.Generator) -> tuple[Walls, Posts]:
    """An L, with niches and cupboards that tell where along it one is."""
    half, one, other = rng.uniform(0.9, 1.3), rng.uniform(6.0, 9.0), rng.uniform(5.0, 8.0)
    walls = _polygon(
        [
            (-2.5, -half),
            (one + 2 * half, -half),
            (one + 2 * half, other),
            (one, other),
            (one, half),
            (-2.5, half),
        ]
    )
    for x in np.arange(1.6, one - 0.5, rng.uniform(1.3, 2.0)):
        side = rng.choice([-1.0, 1.0])
        walls += _box(float(x), side * (half - 0.12), rng.uniform(0.3, 0.7), 0.24, 0.0)
    for y in np.arange(half + 1.0, other - 0.6, 1.7):
        side = rng.choice([-1.0, 1.0])
        walls += _box(one + half + side * (half - 0.1), float(y), 0.2, rng.uniform(0.3, 0.7), 0.0)
    return walls, []


def _hall(rng: np.random.Generator) -> tuple[Walls, Posts]:
    """Large, with rows of round pillars."""
    x, y = rng.uniform(4.5, 6.5), rng.uniform(3.5, 5.0)
    walls = _polygon([(-x, -y), (x, -y), (x, y * 0.8), (-x * 0.9, y)])
    apart = rng.uniform(2.4, 3.0)
    posts = [
        (float(px) + rng.normal(0.0, 0.1), float(py) + rng.normal(0.0, 0.1), 0.2)
        for px in np.arange(-x + 1.2, x - 0.8, apart)
        for py in np.arange(-y + 1.2, y - 1.4, apart)
        if np.hypot(px, py) > FREE_M + 0.4
    ]
    more, bins = _furniture(rng, 4, x - 1.0, y - 1.2)
    return walls + more, posts + bins


def bare_round_room(rng: np.random.Generator) -> Scene:
    """A circle with furniture, by which alone turns can be told."""
    radius = rng.uniform(3.5, 5.0)
    walls, posts = _furniture(rng, 10, radius * 0.68, radius * 0.68)
    walls.append((radius - 1.0, -0.6, radius - 1.0, 0.9))
    every = np.array([*posts, (0.0, 0.0, radius)])
    return Scene(np.array(walls), every, np.zeros(len(walls), bool))


def _round(rng: np.random.Generator) -> tuple[Walls, Posts]:
    """A round room with furniture, and pilasters between its windows."""
    bare = bare_round_room(rng)
    walls: Walls = [(float(a), float(b), float(c), float(d)) for a, b, c, d in bare.walls]
    radius = float(bare.posts[-1, 2])
    for angle in np.arange(0.0, 6.0, 0.7) + rng.uniform(-0.15, 0.15, 9):
        deep, wide = rng.uniform(0.2, 0.4), rng.uniform(0.3, 0.5)
        place = (radius - deep / 2) * np.array([np.cos(angle), np.sin(angle)])
        walls += _box(float(place[0]), float(place[1]), deep, wide, float(angle))
    return walls, [(float(x), float(y), float(r)) for x, y, r in bare.posts]


def _cluttered(rng: np.random.Generator) -> tuple[Walls, Posts]:
    """A room that is no rectangle, with much in it."""
    x, y = rng.uniform(3.5, 5.0), rng.uniform(3.0, 4.0)
    walls = _polygon(
        [(-x, -y), (x, -y * 0.9), (x * 0.9, y), (0.3 * x, y), (0.2 * x, 0.8 * y), (-x, y * 0.9)]
    )
    more, posts = _furniture(rng, 12, x - 0.8, y - 0.9)
    return walls + more, posts


KINDS: tuple[Callable[[np.random.Generator], tuple[Walls, Posts]], ...] = (
    _office,
    _corridor,
    _hall,
    _round,
    _cluttered,
)
