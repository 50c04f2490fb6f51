"""Integrating what wheels and gyroscope report, with derivatives by their calibration."""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray

PATH_SCALE, TURN_SCALE, CURVATURE, GYRO_SCALE, GYRO_BIAS = range(5)
"""Places in the (5,) parameters of odometry: relative errors of path and turn of the wheels, their
curvature on a straight line (rad/m), relative error and bias (rad/s) of the gyroscope. What is
reported times (1 + error), less the bias, is what was."""

PARAMETERS = 5
ROWS = 4
"""Of a jacobian: x, y and yaw of the step, and the turn by the wheels alone."""


def turn_at_samples(stamps_ns: IntArray, rates_rad_s: FloatArray) -> FloatArray:
    """(n,) rad turned since the first of n samples, by trapezoids: rates are of their instants."""
    steps = 0.5 * (rates_rad_s[:-1] + rates_rad_s[1:]) * np.diff(stamps_ns) * 1e-9
    return np.concatenate([[0.0], np.cumsum(steps)])


def turn_at_midpoints(stamps_ns: IntArray, rates_rad_s: FloatArray) -> tuple[IntArray, FloatArray]:
    """The n - 1 instants midway between n samples, ns, and (n - 1,) rad turned since the first.

    A sample is the mean rate between the midpoints to its neighbours: exact for a unit that
    averages over its period.
    """
    middle_ns = stamps_ns[:-1] + np.diff(stamps_ns) // 2
    turned = rates_rad_s[1:-1] * np.diff(middle_ns) * 1e-9
    return middle_ns, np.concatenate([[0.0], np.cumsum(turned)])


def calibrated_turn(
    turned_rad: FloatArray, seconds: FloatArray, gain: float, bias_rad_s: float
) -> FloatArray:
    """(n,) rad truly turned in (n,) seconds of which a gyroscope reports turned_rad (n,).

    gain: true over reported. bias_rad_s: of the rate, after the gain.
    """
    return np.asarray(gain * turned_rad - bias_rad_s * seconds)


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
    """Integrate the steps that lie between two instants, and add to jacobian and totals.

    stamps_ns: (n + 1,). steps: (n, 4) from each to the next: forward and sideways along the arc in
    m, turn by the wheels and by the gyroscope in rad, nan while that is silent. parameters: (5,).
    poses: (n + 1, 3) x, y in m and yaw in rad; the first is given, the others are written.
    jacobian: (4, 5) by the parameters, of a small step of the base at the end in its own frame
    and of the turn by the wheels. totals: (5,) turn by the wheels, path and turn without sign, raw
    turn of the gyroscope in rad and its seconds.
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
