"""Parses a start pose given on the command line."""

from __future__ import annotations

import math

import numpy as np

from slamsim.core.types import FloatArray
from slamsim.guard.errors import OverrideRefused, shown


def start_pose(typed: str | None) -> FloatArray | None:
    """(3,) of "x,y,yaw_deg", None for nothing. Raises OverrideRefused."""
    if typed is None:
        return None
    try:
        numbers = [float(word) for word in typed.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise OverrideRefused(
            "--start", f"{shown(typed)} is not x,y,yaw_deg: three numbers, as in 1.5,-2,90"
        )
    return np.array([numbers[0], numbers[1], math.radians(numbers[2])])
