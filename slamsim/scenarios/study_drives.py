"""Figures of the 2019 study for the robot that drives: basic drive and squares."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.scenarios.base import Who

FIFTH_STOP_M: dict[Who, tuple[float, float]] = {
    "theory": (6.0, 0.0),
    "reality": (5.5, 0.3),
    "unity": (5.0, 1.5),
    "gazebo": (6.0, 0.0),
}
"""Mean place of the fifth stop; read from figures, and for Gazebo told as the theoretical one."""
FIFTH_STOP_SPEEDS_M_S = (0.2, 0.25, 0.3)
"""The script that it belongs to, with FIFTH_STOP_DRIVE_S for each drive."""
FIFTH_STOP_DRIVE_S = 20.0


@dataclass(frozen=True, slots=True)
class SquareFigures:
    """Squares of 2 m, five runs in each direction; None where the study gives no number."""

    largest_error_m: float
    spread_m: float | None
    corner_deg: float | None


SQUARES: dict[Who, SquareFigures] = {
    "reality": SquareFigures(1.06, 1.8, 70.0),
    "unity": SquareFigures(1.56, None, 70.0),
    "gazebo": SquareFigures(0.02, 0.01, None),
}
SQUARE_SIDE_M = 2.0
UNITY_CORNERS_DEG = {0.6: 30.0, 1.4: 70.0}
"""True turn of a corner of 90 degrees in Unity, by the friction of the tyres."""
