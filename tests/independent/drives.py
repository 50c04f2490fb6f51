"""How the robot moves: a differential drive under smooth commands, integrated to 1e-12 m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from independent.rays import Floats, Scene, cast, clearance

STEP_S = 0.02
"""Speeds are given at such instants and are linear between them."""

ROBOT_RADIUS_M = 0.35
RAMP_S = 0.6
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class Drive:
    """speeds_m_s, turns_rad_s, poses: (n,), (n,), (n, 3) at the multiples of STEP_S; a pose is x,
    y, heading in the room, the heading not wrapped."""

    speeds_m_s: Floats
    turns_rad_s: Floats
    poses: Floats

    @property
    def seconds(self) -> float:
        return STEP_S * (len(self.speeds_m_s) - 1)

    def at(self, times_s: Floats) -> Floats:
        """Poses (m, 3) at any instants; before the begin and after the end the robot stands."""
        times_s = np.clip(times_s, 0.0, self.seconds)
        step = np.minimum((times_s / STEP_S).astype(int), len(self.poses) - 2)
        for_s = times_s - STEP_S * step
        gains: Floats = _moved(*self._of(step), self.poses[step, 2], for_s)
        return np.asarray(self.poses[step] + gains)

    def rates_at(self, times_s: Floats) -> Floats:
        """Speed, turn rate (m, 2), in m/s and rad/s."""
        known_s = STEP_S * np.arange(len(self.speeds_m_s))
        return np.column_stack(
            [np.interp(times_s, known_s, each) for each in (self.speeds_m_s, self.turns_rad_s)]
        )

    def _of(self, step: np.ndarray) -> tuple[Floats, Floats, Floats, Floats]:
        """Speed and turn rate at the begin of steps, and how they grow."""
        v, w = self.speeds_m_s, self.turns_rad_s
        return v[step], w[step], (v[step + 1] - v[step]) / STEP_S, (w[step + 1] - w[step]) / STEP_S


def _moved(v: Floats, w: Floats, dv: Floats, dw: Floats, heading: Floats, for_s: Floats) -> Floats:
    """What a pose gains (m, 3): the heading exactly, the place by Gauss-Legendre quadrature."""
    at_s = 0.5 * for_s[:, None] * (_NODES + 1.0)
    turned = heading[:, None] + w[:, None] * at_s + 0.5 * dw[:, None] * at_s**2
    speed = (v[:, None] + dv[:, None] * at_s) * _WEIGHTS * 0.5 * for_s[:, None]
    x, y = (speed * np.cos(turned)).sum(axis=1), (speed * np.sin(turned)).sum(axis=1)
    return np.column_stack([x, y, w * for_s + 0.5 * dw * for_s**2])


def integrated(speeds_m_s: Floats, turns_rad_s: Floats, start: Floats) -> Drive:
    """The drive under these speeds, given at multiples of STEP_S."""
    n = len(speeds_m_s)
    if n < 2:
        return Drive(speeds_m_s, turns_rad_s, np.asarray(start)[None])
    dv, dw = np.diff(speeds_m_s) / STEP_S, np.diff(turns_rad_s) / STEP_S
    gains = turns_rad_s[:-1] * STEP_S + 0.5 * dw * STEP_S**2
    headings = start[2] + np.concatenate([[0.0], np.cumsum(gains)])
    whole = np.full(n - 1, STEP_S)
    steps = _moved(speeds_m_s[:-1], turns_rad_s[:-1], dv, dw, headings[:-1], whole)
    places = start[:2] + np.vstack([np.zeros(2), np.cumsum(steps[:, :2], axis=0)])
    return Drive(speeds_m_s, turns_rad_s, np.column_stack([places, headings]))


def random_drive(scene: Scene, rng: np.random.Generator, seconds: float) -> Drive:
    """Straight legs, arcs, turns on the spot, stops and backing up, that touch nothing.

    The first of thirty that is rich, or the richest: nothing can be told of wheels that hardly
    roll, or never turn to one side.
    """
    drives: list[Drive] = []
    while len(drives) < 30 and not (drives and _richness(drives[-1], seconds) > 1.0):
        drives.append(_one_drive(scene, rng, seconds))
    return max(drives, key=lambda drive: _richness(drive, seconds))


def _richness(drive: Drive, seconds: float) -> float:
    """Over 1 if in a minute it goes 15 m, of that 1 m backward, and turns 270 degrees each way."""
    v, w = STEP_S * drive.speeds_m_s, STEP_S * drive.turns_rad_s
    gone = np.abs(v).sum() / 15.0, -v[v < 0.0].sum() / 1.0
    turned = w[w > 0.0].sum() / 4.7, -w[w < 0.0].sum() / 4.7
    return float(min(*gone, *turned)) * 60.0 / seconds


def _one_drive(scene: Scene, rng: np.random.Generator, seconds: float) -> Drive:
    """Every manoeuvre is taken only if the robot could also stop behind it."""
    still = np.zeros(int(rng.uniform(2.0, 3.0) / STEP_S))
    v, w, pose = still, still, np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    count = round(seconds / STEP_S) + 1
    done = integrated(v, w, pose)
    fastest = rng.uniform(0.45, 0.9), rng.uniform(0.7, 1.3)
    while len(v) < count:
        more = _manoeuvre(scene, done.poses[-1], (v[-1], w[-1]), fastest, rng)
        v, w = np.concatenate([v, more[0]]), np.concatenate([w, more[1]])
        done = integrated(v, w, pose)
    return Drive(v[:count], w[:count], done.poses[:count])


def _manoeuvre(
    scene: Scene,
    pose: Floats,
    now: tuple[float, float],
    fastest: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Speeds and turn rates of the next one, from those of now on."""
    for _ in range(30):
        speed, turn, hold_s = _wanted(scene, pose, fastest, rng)
        v = _ramped(now[0], speed, hold_s)
        w = _ramped(now[1], turn, hold_s)
        stopping = _ramped(speed, 0.0, 0.0), _ramped(turn, 0.0, 0.0)
        tried = (
            np.concatenate([[now[0]], v, stopping[0]]),
            np.concatenate([[now[1]], w, stopping[1]]),
        )
        path = integrated(*tried, pose).poses[::5, :2]
        if clearance(scene, path).min() > ROBOT_RADIUS_M:
            return v, w
    turn = fastest[1] * rng.choice([-1.0, 1.0])
    return _ramped(now[0], 0.0, 2.0), _ramped(now[1], turn if abs(now[0]) < 0.01 else 0.0, 2.0)


def _wanted(
    scene: Scene, pose: Floats, fastest: tuple[float, float], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Speed, turn rate and for how long."""
    kind = rng.choice(["straight", "arc", "spot", "stop", "back"], p=[0.33, 0.28, 0.25, 0.04, 0.1])
    v, w = fastest[0] * rng.uniform(0.6, 1.0), fastest[1] * rng.uniform(0.5, 1.0)
    side = float(rng.choice([-1.0, 1.0]))
    if kind == "straight":
        free_m = float(cast(scene, pose[None, :2], pose[2:])[0])
        return (
            v,
            0.0,
            float(np.clip((min(free_m, 9.0) - 0.9) / v, 0.3, 8.0) * rng.uniform(0.5, 1.0)),
        )
    if kind == "arc":
        return v, side * w * rng.uniform(0.3, 1.0), rng.uniform(0.5, 3.0)
    if kind == "spot":
        return 0.0, side * w, rng.uniform(0.6, np.pi) / w
    if kind == "back":
        return -0.6 * v, 0.0, rng.uniform(1.0, 3.0)
    return 0.0, 0.0, rng.uniform(0.3, 1.5)


def _ramped(begin: float, end: float, hold_s: float) -> Floats:
    """From one speed to another along half a cosine, and then held."""
    ramp = int(RAMP_S / STEP_S)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, ramp + 1) / ramp)
    return np.concatenate([begin + (end - begin) * rise, np.full(int(hold_s / STEP_S), end)])
