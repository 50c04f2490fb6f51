"""Conditions that are hard on sensors, and no fault of the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from independent.drives import random_drive
from independent.rays import Floats, clearance
from independent.rooms import bare_round_room
from independent.sensors import Conditions

LEG_RADIUS_M = 0.07
APART_M = 0.5
"""So near to a person no robot drives."""


def _people(usual: Conditions, rng: np.random.Generator) -> Conditions:
    """Up to three people, each on two legs, walk to and fro where the robot does not meet them."""
    legs: list[Floats] = []
    for _ in range(60):
        leg = _walk(usual, rng)
        if leg is not None and len(legs) < 6:
            other = leg + np.array([0.25, 0.1, 0.25, 0.1, 0.0, 0.0])
            legs += [leg, other]
    return replace(usual, people=np.array(legs).reshape(-1, 6))


def _walk(usual: Conditions, rng: np.random.Generator) -> Floats | None:
    """From a place to another and back, if nothing stands between and the robot keeps away."""
    path = usual.drive.poses[::25, :2]
    begin = path[int(rng.integers(len(path)))] + rng.uniform(-2.5, 2.5, 2)
    end = begin + rng.uniform(-1.5, 1.5, 2)
    between = begin + np.linspace(0.0, 1.0, 12)[:, None] * (end - begin)
    period_s = rng.uniform(4.0, 12.0)
    times = 0.5 * np.arange(len(path))
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * times / period_s)
    apart = np.linalg.norm(begin + share[:, None] * (end - begin) - path, axis=1)
    if clearance(usual.scene, between).min() < 0.4 or apart.min() < APART_M:
        return None
    return np.array([*begin, *end, period_s, LEG_RADIUS_M])


def _glass(usual: Conditions, rng: np.random.Generator) -> Conditions:
    """The room was drawn with panes."""
    return usual


def _carpet(usual: Conditions, rng: np.random.Generator) -> Conditions:
    """Wheels slip four times as much, to both sides alike."""
    return replace(usual, slips=4.0)


def _coarse_clock(usual: Conditions, rng: np.random.Generator) -> Conditions:
    """Stamps in whole milliseconds."""
    return replace(usual, clock_s=1e-3)


def _busy_recorder(usual: Conditions, rng: np.random.Generator) -> Conditions:
    """Every seven seconds messages wait and arrive together; their stamps are right."""
    return replace(usual, bursts=True)


def _round_room(usual: Conditions, rng: np.random.Generator) -> Conditions:
    """A bare circle with some furniture: half of what is seen tells no turn."""
    scene = bare_round_room(rng)
    return replace(usual, scene=scene, drive=random_drive(scene, rng, usual.drive.seconds))


HARSH: dict[str, Callable[[Conditions, np.random.Generator], Conditions]] = {
    "people": _people,
    "glass": _glass,
    "carpet": _carpet,
    "coarse clock": _coarse_clock,
    "busy recorder": _busy_recorder,
    "round room": _round_room,
}
