"""Coarsely sampled motion of the bodies of a trial, for the viewer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.core.types import BoolArray, FloatArray, Trajectory
from slamsim.scenarios.base import BodyMotion, Solid
from slamsim.sim.bodies import Box, Shape

POSES_PER_S = 25.0
"""As films have."""


def filmed(
    names: Sequence[str],
    shape: Shape,
    stamps_s: FloatArray,
    centres_m: FloatArray,
    quats_xyzw: FloatArray,
) -> tuple[BodyMotion, ...]:
    """Of n equal bodies at m instants: centres (m, n, 3), orientations (m, n, 4)."""
    kept = _thinned(stamps_s)
    stamps_ns = np.round(stamps_s[kept] * 1e9).astype(np.int64)
    solid = solid_of(shape)
    return tuple(
        BodyMotion(name, solid, Trajectory(stamps_ns, centres_m[kept, k], quats_xyzw[kept, k]))
        for k, name in enumerate(names)
    )


def solid_of(shape: Shape) -> Solid:
    if isinstance(shape, Box):
        return Solid("box", shape.size_m)
    return Solid("sphere", (shape.radius_m,))


def _thinned(stamps_s: FloatArray) -> BoolArray:
    """Mask of the first instant within each piece of ``1 / POSES_PER_S``."""
    pieces = np.floor(stamps_s * POSES_PER_S + 1e-9)
    kept: BoolArray = np.diff(pieces, prepend=-1.0) > 0
    return kept
