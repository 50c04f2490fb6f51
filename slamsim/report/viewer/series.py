"""The curves of a run over time, the same in the recording and in the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.types import EncoderStream, FloatArray, ImuStream, IntArray, PlanarTrajectory
from slamsim.evaluate.trajectory import TrajectoryErrors
from slamsim.models.differential_drive import metres_per_tick
from slamsim.report.figures.palette import ESTIMATE, ODOMETRY, SCAN, WITHDRAWN
from slamsim.report.run_view import RunView, thinned

MAX_POINTS = 3000


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """name is short and unique in its plot. stamps_ns, values: (n,), thinned."""

    name: str
    colour: str
    stamps_ns: IntArray
    values: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """key is unique among the plots and fit for a path; unit belongs to the vertical axis.

    logarithmic: values of several orders of magnitude, none of them negative. along_path: belongs
    to places more than to instants: a page shows it over the path driven.
    """

    key: str
    title: str
    unit: str
    curves: tuple[Line, ...]
    logarithmic: bool = False
    along_path: bool = False


def plots(view: RunView, at_most: int = MAX_POINTS) -> tuple[Panel, ...]:
    """Every plot that the run has data for: errors, match quality, wheels, turn rates."""
    made = (
        _translation_error(view, at_most),
        _heading_error(view, at_most),
        _match_quality(view, at_most),
        _wheels(view, at_most),
        _turn_rate(view, at_most),
    )
    return tuple(plot for plot in made if plot is not None)


def _translation_error(view: RunView, at_most: int) -> Panel | None:
    curves = []
    for name, colour, errors in _compared(view):
        pick = thinned(errors.translation_m.size, at_most)
        stamps_ns = errors.truth.stamps_ns[pick]
        curves.append(Line(name, colour, stamps_ns, errors.translation_m[pick]))
    return Panel("error_m", "Position error", "m", tuple(curves), True) if curves else None


def _heading_error(view: RunView, at_most: int) -> Panel | None:
    curves = []
    for name, colour, errors in _compared(view):
        pick = thinned(errors.rotation_rad.size, at_most)
        values = np.rad2deg(errors.rotation_rad[pick])
        curves.append(Line(name, colour, errors.truth.stamps_ns[pick], values))
    return Panel("error_deg", "Heading error", "°", tuple(curves)) if curves else None


def _compared(view: RunView) -> list[tuple[str, str, TrajectoryErrors]]:
    pairs = (
        ("odometry", ODOMETRY, view.scores.odometry),
        ("estimate", ESTIMATE, view.scores.trajectory),
    )
    return [(name, colour, errors) for name, colour, errors in pairs if errors is not None]


def _match_quality(view: RunView, at_most: int) -> Panel | None:
    quality = view.result.match_quality
    if quality.size == 0 or not view.mapped:
        return None
    pick = thinned(quality.size, at_most)
    stamps_ns = view.result.trajectory.stamps_ns[pick]
    degenerate = view.result.degenerate[pick].astype(np.float64)
    curves = (
        Line("inliers", ESTIMATE, stamps_ns, quality[pick]),
        Line("degenerate", WITHDRAWN, stamps_ns, degenerate),
    )
    return Panel("match", "Scan match: share of inliers", "", curves)


def _wheels(view: RunView, at_most: int) -> Panel | None:
    encoders, odometry = view.log.encoders, view.log.odometry
    if encoders is not None and encoders.stamps_ns.size > 1:
        stamps_ns, speeds = wheel_speeds(encoders, at_most)
        curves = (
            Line("left", ODOMETRY, stamps_ns, speeds[:, 0]),
            Line("right", ESTIMATE, stamps_ns, speeds[:, 1]),
        )
        return Panel("wheels", "Wheel speed", "m/s", curves)
    if odometry is None or len(odometry) < 2:
        return None
    stamps_ns, motion = _rates(odometry, at_most)
    return Panel(
        "wheels", "Odometry speed", "m/s", (Line("forward", ODOMETRY, stamps_ns, motion[:, 0]),)
    )


def _turn_rate(view: RunView, at_most: int) -> Panel | None:
    curves = []
    if view.log.imu is not None and view.log.imu.stamps_ns.size:
        stamps_ns, rate = yaw_rate(view.log.imu, view.log.T_base_imu, at_most)
        curves.append(Line("gyroscope", SCAN, stamps_ns, rate))
    if view.log.odometry is not None and len(view.log.odometry) > 1:
        stamps_ns, motion = _rates(view.log.odometry, at_most)
        curves.append(Line("odometry", ODOMETRY, stamps_ns, motion[:, 2]))
    if view.mapped and len(view.result.trajectory) > 1:
        stamps_ns, motion = _rates(view.result.trajectory, at_most)
        curves.append(Line("estimate", ESTIMATE, stamps_ns, motion[:, 2]))
    return Panel("turn", "Turn rate", "rad/s", tuple(curves)) if curves else None


def wheel_speeds(encoders: EncoderStream, at_most: int) -> tuple[IntArray, FloatArray]:
    """Middle of each interval and (n, 2) mean rolling speed in it, m/s, as (left, right)."""
    grid_ns = _even(encoders.stamps_ns, at_most)
    since_s = (encoders.stamps_ns - grid_ns[0]) * 1e-9
    tick_m = metres_per_tick(encoders.ticks_per_revolution, encoders.wheel_radius_m)
    rolled = [
        np.interp((grid_ns - grid_ns[0]) * 1e-9, since_s, wheel) for wheel in encoders.ticks.T
    ]
    elapsed_s = np.diff(grid_ns) * 1e-9
    speeds = np.diff(np.column_stack(rolled), axis=0) * tick_m / elapsed_s[:, None]
    return grid_ns[:-1] + np.diff(grid_ns) // 2, speeds


def yaw_rate(
    imu: ImuStream, T_base_imu: FloatArray | None, at_most: int
) -> tuple[IntArray, FloatArray]:
    """Turn rate about the base's z axis, averaged over blocks: middle of each, mean rad/s.

    Both (m,). T_base_imu: (4, 4).
    """
    axis = np.array([0.0, 0.0, 1.0]) if T_base_imu is None else T_base_imu[2, :3]
    rate = imu.angular_velocity_rad_s @ axis
    starts = thinned(rate.size, at_most)
    sizes = np.diff(np.append(starts, rate.size))
    mean = np.add.reduceat(rate, starts) / sizes
    return imu.stamps_ns[starts + sizes // 2], mean


def _rates(trajectory: PlanarTrajectory, at_most: int) -> tuple[IntArray, FloatArray]:
    """Middle of each interval and mean (forward m/s, left m/s, turn rad/s) in it."""
    grid_ns = _even(trajectory.stamps_ns, at_most)
    poses = trajectory.at(grid_ns)
    motion = between(poses[:-1], poses[1:])
    return grid_ns[:-1] + np.diff(grid_ns) // 2, motion / (np.diff(grid_ns) * 1e-9)[:, None]


def _even(stamps_ns: IntArray, at_most: int) -> IntArray:
    """At most so many instants, evenly spread from the first stamp to the last.

    Real stamps may lie microseconds apart where a clock was corrected: a speed from one of them
    to the next would be nonsense.
    """
    count = max(min(at_most, stamps_ns.size), 2)
    span_ns = int(stamps_ns[-1] - stamps_ns[0])
    steps = np.arange(count, dtype=np.float64) * (span_ns / (count - 1))
    return np.unique(stamps_ns[0] + np.minimum(steps.astype(np.int64), span_ns))
