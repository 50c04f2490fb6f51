"""A stack of boxes in the physics engine: how long it stands, and how it moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.scenarios.solver import SolverConfig
from slamsim.config.scenarios.stacking import StackingConfig
from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray
from slamsim.sim.bodies import BodySurroundings, Box, BurstApart, FreeBodies, State, free_bodies

LOOKED_AT_EVERY_S = 0.1
"""A stack on the way down doubles its offset in about a quarter of a second."""
FLOOR = np.array([[0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class StackRun:
    """One stack of n boxes, lowest first, at m instants; the first is the start.

    collapsed_s: None if it stood to the end. stamps_s: (m,). centres_m: (m, n, 3). quats_xyzw:
    (m, n, 4). energy_j, load_n: (m,), the floor's load at the start taken as 0. burst: it ended
    because numbers exploded.
    """

    collapsed_s: float | None
    stamps_s: FloatArray
    centres_m: FloatArray
    quats_xyzw: FloatArray
    energy_j: FloatArray
    load_n: FloatArray
    burst: bool


def run_stack(
    config: StackingConfig,
    boxes: int,
    step_s: float,
    solver: SolverConfig,
    seed: int,
    every_s: float = LOOKED_AT_EVERY_S,
    aftermath_s: float = 0.0,
) -> StackRun:
    """Stack ``boxes`` and watch until they collapse or ``config.duration_s`` is over.

    every_s: from look to look. aftermath_s: how long to go on watching what has collapsed.
    """
    shape, start_m = Box(config.box_size_m), _start_m(config, boxes, seed)
    around = BodySurroundings(FLOOR, config.friction)
    steps = max(1, round(every_s / step_s))
    looks = math.ceil(config.duration_s / (steps * step_s) - 1e-9)
    collapsed_s: float | None = None
    with free_bodies(shape, config.box_mass_kg, start_m, around, step_s, solver) as stack:
        seen = [_look(stack, 0.0)]
        for look in range(1, looks + 1):
            now_s = look * steps * step_s
            try:
                stack.advance(steps)
                seen.append(_look(stack, now_s))
            except BurstApart:
                return _told(seen, now_s if collapsed_s is None else collapsed_s, burst=True)
            if collapsed_s is None and _fallen(seen[-1].state.centres_m, config):
                collapsed_s = now_s
            if collapsed_s is not None and now_s >= collapsed_s + aftermath_s:
                break
    return _told(seen, collapsed_s, burst=False)


@dataclass(frozen=True, slots=True, eq=False)
class _StackLook:
    stamp_s: float
    state: State
    energy_j: float
    load_n: float


def _look(stack: FreeBodies, stamp_s: float) -> _StackLook:
    state = stack.state()
    return _StackLook(stamp_s, state, stack.energy_j(state), stack.load_n())


def _told(seen: Sequence[_StackLook], collapsed_s: float | None, *, burst: bool) -> StackRun:
    return StackRun(
        collapsed_s,
        np.array([look.stamp_s for look in seen]),
        np.array([look.state.centres_m for look in seen]),
        np.array([look.state.quats_xyzw for look in seen]),
        np.array([look.energy_j for look in seen]),
        np.array([look.load_n for look in seen]),
        burst,
    )


def _start_m(config: StackingConfig, boxes: int, seed: int) -> FloatArray:
    """(boxes, 3) centres; a box lies the same in a stack of any number of boxes."""
    aside = random_stream(seed, "stacking", "misplacement").uniform(-1.0, 1.0, (boxes, 2))
    heights_m = (np.arange(boxes) + 0.5) * config.box_size_m[2]
    return np.column_stack([config.misplacement_m * aside, heights_m])


def _fallen(centres_m: FloatArray, config: StackingConfig) -> bool:
    """The centre of a box is no longer above the box below it, or has sunk halfway into it."""
    length_m, width_m, height_m = config.box_size_m
    rise_m = np.diff(centres_m, axis=0, prepend=[[*centres_m[0, :2], -height_m / 2]])
    aside_m = np.linalg.norm(rise_m[:, :2], axis=1)
    return bool(np.any(aside_m > min(length_m, width_m) / 2) or np.any(rise_m[:, 2] < height_m / 2))
