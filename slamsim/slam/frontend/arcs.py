"""Integrating what wheels and gyroscope report, with derivatives by their calibration."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray


@kernel
def walk(
    stamps_ns: IntArray,
    steps: FloatArray,
    first_ns: int,
    last_ns: int,
    parameters: FloatArray,
    lever_m2: float,
    poses: FloatArray,
    jacobian: FloatArray,
    totals: FloatArray,
) -> None:
    """Integrate the steps between two instants. poses: one more than steps, the first zero.

    jacobian: (4, 5), see OdometryStep. totals: turn by the wheels, path and turn without sign,
    raw turn and seconds of the gyroscope.
    """
    path_scale, turn_scale, curvature, gyro_scale, bias = parameters
    change = np.zeros((5, 3))
    for n in range(steps.shape[0]):
        nanoseconds = max(min(stamps_ns[n + 1], last_ns) - max(stamps_ns[n], first_ns), 0)
        share, seconds = nanoseconds / (stamps_ns[n + 1] - stamps_ns[n]), nanoseconds * 1e-9
        forward, sideways = share * steps[n, 0], share * steps[n, 1]
        wheels, gyro = share * steps[n, 2], share * steps[n, 3]
        heard = not np.isnan(gyro)
        along = (1.0 + path_scale) * forward + curvature * lever_m2 * wheels
        across = (1.0 + path_scale) * sideways
        by_wheels = (1.0 + turn_scale) * wheels + curvature * forward
        turn = (1.0 + gyro_scale) * gyro - bias * seconds if heard else by_wheels
        # By parameter: what it changes in along, across and turn.
        change[0, 0], change[0, 1] = forward, sideways
        change[1, 2] = 0.0 if heard else wheels
        change[2, 0], change[2, 2] = lever_m2 * wheels, 0.0 if heard else forward
        change[3, 2], change[4, 2] = gyro if heard else 0.0, -seconds if heard else 0.0
        _arc(along, across, turn, change, poses[n], poses[n + 1], jacobian)
        jacobian[3, 1] += wheels
        jacobian[3, 2] += forward
        totals[0] += by_wheels
        totals[1] += np.hypot(along, across)
        totals[2] += abs(turn)
        if heard:
            totals[3] += gyro
            totals[4] += seconds


@kernel
def _arc(
    along: float,
    across: float,
    turn: float,
    change: FloatArray,
    start: FloatArray,
    end: FloatArray,
    jacobian: FloatArray,
) -> None:
    """One arc: from the start pose to the end pose; the jacobian is carried to its end."""
    half = 0.5 * turn
    cos, sin = np.cos(half), np.sin(half)
    stretch = sin / half if abs(half) > 1e-6 else 1.0
    stretch_by_turn = 0.5 * (cos - stretch) / half if abs(half) > 1e-3 else -turn / 12.0
    # The chord as seen from its end, and what it gains by turning more.
    x, y = cos * along + sin * across, cos * across - sin * along
    x_by_turn = -0.5 * stretch * y + stretch_by_turn * x
    y_by_turn = 0.5 * stretch * x + stretch_by_turn * y
    x, y = stretch * x, stretch * y
    end_cos, end_sin = np.cos(start[2] + turn), np.sin(start[2] + turn)
    end[0] = start[0] + end_cos * x - end_sin * y
    end[1] = start[1] + end_sin * x + end_cos * y
    end[2] = start[2] + turn
    turn_cos, turn_sin = np.cos(turn), np.sin(turn)
    for c in range(change.shape[0]):
        a, b, yaw = jacobian[0, c], jacobian[1, c], jacobian[2, c]
        more_along, more_across = stretch * change[c, 0], stretch * change[c, 1]
        jacobian[0, c] = turn_cos * a + turn_sin * b - y * yaw
        jacobian[1, c] = turn_cos * b - turn_sin * a + x * yaw
        jacobian[0, c] += cos * more_along + sin * more_across + x_by_turn * change[c, 2]
        jacobian[1, c] += cos * more_across - sin * more_along + y_by_turn * change[c, 2]
        jacobian[2, c] += change[c, 2]
