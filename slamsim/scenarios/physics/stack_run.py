"""A stack of boxes in the physics engine: how long it stands, how it moves, and how it leaves the
vertical: box slides on box, all tilt as one, or the stack bends.

How it leaves the vertical: the centre of the top box is reached from the foot of the stack over
each box's own upright axis and over the offset between the faces of each pair of neighbours. Of the
top's way to the side the offsets add up to the share that *slid*; the axis of the lowest box,
followed to the top, is the share that the whole stack *tilted* as one rigid piece; what is left is
how far it *bent*, each box leaning a little more than the one below it with their faces closed or
gaping.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamsim.config.scenarios.bodies import SolverConfig, StackingConfig
from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray
from slamsim.sim.bodies import BodySurroundings, Box, BurstApart, FreeBodies, State, free_bodies

LOOKED_AT_EVERY_S = 0.1
"""A stack on the way down doubles its offset in about a quarter of a second."""
FLOOR = np.array([[0.0, 0.0, 1.0]])
"""Normals of the half-spaces around: one, upwards."""


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


NOTICED = 0.01
"""Of the width of a box: from here on the top's offset counts as sway."""
LEFT = 0.5
"""Of the width of a box: the top is no longer above the foot. Shares are taken here."""


@dataclass(frozen=True, slots=True, eq=False)
class Sway:
    """The top's way to the side at m instants, and its three parts along that way: all (m,)."""

    stamps_s: FloatArray
    top_m: FloatArray
    slid_m: FloatArray
    tilted_m: FloatArray
    bent_m: FloatArray


@dataclass(frozen=True, slots=True)
class Leaving:
    """How a stack left the vertical, as the top's offset reached half a box.

    slid, tilted, bent: shares of the offset, 1 in all. straight: the share of it that a straight
    line through the foot and, as well as it can, the centres of all boxes explains. growth_per_s:
    of the offset, from the first that was noticed, as if it were exponential. swings: how often
    the top had crossed the vertical.
    """

    after_s: float
    slid: float
    tilted: float
    bent: float
    straight: float
    growth_per_s: float
    swings: int


def sway_of(run: StackRun, height_m: float) -> Sway:
    """height_m: of a box."""
    aside = _aside_m(run)
    top_m = np.linalg.norm(aside[:, -1], axis=1)
    along = aside[:, -1] / np.maximum(top_m, 1e-12)[:, None]
    upright = matrix_from_xyzw(run.quats_xyzw)[..., :2, 2] * height_m
    tilted = upright[:, 0] * (upright.shape[1] - 0.5)
    leaned = upright.sum(axis=1) - upright[:, -1] / 2
    slid = aside[:, -1] - leaned
    parts = [np.einsum("mk,mk->m", part, along) for part in (slid, tilted, leaned - tilted)]
    return Sway(run.stamps_s, top_m, *parts)


def leaving_of(run: StackRun, sway: Sway, width_m: float) -> Leaving | None:
    """None if the top never left, or left at the first look."""
    left = _first(sway.top_m, LEFT * width_m)
    noticed = _first(sway.top_m, NOTICED * width_m)
    if left is None or noticed is None or noticed == left:
        return None
    top_m = sway.top_m[left]
    grown = np.log(top_m / sway.top_m[noticed]) / (sway.stamps_s[left] - sway.stamps_s[noticed])
    return Leaving(
        after_s=float(sway.stamps_s[left]),
        slid=float(sway.slid_m[left] / top_m),
        tilted=float(sway.tilted_m[left] / top_m),
        bent=float(sway.bent_m[left] / top_m),
        straight=_straight(run, left),
        growth_per_s=float(grown),
        swings=_swings(_aside_m(run)[: left + 1, -1], NOTICED * width_m),
    )


def _aside_m(run: StackRun) -> FloatArray:
    """(m, n, 2) of each box from where it was put down."""
    return run.centres_m[..., :2] - run.centres_m[0, :, :2]


def _first(values: FloatArray, above: float) -> int | None:
    found = np.flatnonzero(values > above)
    return int(found[0]) if found.size else None


def _straight(run: StackRun, at: int) -> float:
    """Share of the top's offset on the best line through the foot (least squares)."""
    aside = _aside_m(run)[at]
    heights_m = run.centres_m[0, :, 2]
    along = aside[-1] / np.linalg.norm(aside[-1])
    slope = heights_m @ (aside @ along) / (heights_m @ heights_m)
    return float(slope * heights_m[-1] / np.linalg.norm(aside[-1]))


def _swings(aside_m: FloatArray, noticed_m: float) -> int:
    """Crossings of the vertical, along the way that it left in the end, that were noticed."""
    along = aside_m @ aside_m[-1] / np.linalg.norm(aside_m[-1])
    sides = np.sign(along[np.abs(along) > noticed_m])
    return int(np.count_nonzero(np.diff(sides)))
