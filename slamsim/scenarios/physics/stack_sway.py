"""How a stack leaves the vertical: box slides on box, all tilt as one, or the stack bends.

The centre of the top box is reached from the foot of the stack over each box's own upright axis
and over the offset between the faces of each pair of neighbours. Of the top's way to the side
the offsets add up to the share that *slid*; the axis of the lowest box, followed to the top, is
the share that the whole stack *tilted* as one rigid piece; what is left is how far it *bent*,
each box leaning a little more than the one below it with their faces closed or gaping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import FloatArray
from slamsim.scenarios.physics.stack_run import StackRun

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
