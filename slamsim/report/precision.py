"""Localisability along the path, and consistency of the estimated covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LogNorm

from slamsim.core.geometry import compose, wrap_angle
from slamsim.core.types import FloatArray, IntArray
from slamsim.evaluate.bound import scan_bound
from slamsim.report.figures.palette import ESTIMATE, NEUTRAL, WITHDRAWN
from slamsim.report.run_view import RunView, thinned
from slamsim.report.viewer.series import Line, Panel

COLOURS = "plasma"
ELLIPSE_SIGMAS = 2.0
MAX_ELLIPSES = 1000
_ELLIPSE_CORNERS = 24
_STROKE_M = 0.5
_DECADE = 10.0
_LEAST_SPREAD = 3.0
"""The colours span at least this factor, or noise would look like structure."""
_SHOWN_AS_M = 0.2
"""Median size at which ellipses of millimetres are drawn, about."""


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Per scan (n,), what it alone says of the pose in the direction that it holds least.

    worst_m: standard deviation. direction_rad: in the estimated map. by_truth: whether it is what
    the true walls allow, or what the matches themselves claimed.
    """

    stamps_ns: IntArray
    worst_m: FloatArray
    direction_rad: FloatArray
    by_truth: bool


def held(view: RunView) -> Held | None:
    """From the true walls where they are known, else from the matches; None without either."""
    bound, errors = view.scores.bound, view.scores.trajectory
    if bound is not None and errors is not None:
        scans = bound.scans
        turned = wrap_angle(scans.worst_direction_rad - errors.T_truth_estimate[2])
        return Held(scans.stamps_ns, scans.worst_m, turned, True)
    information, trajectory = view.result.match_information, view.result.trajectory
    if information is None or len(information) == 0:
        return None
    scans = scan_bound(trajectory.stamps_ns, information)
    turned = wrap_angle(scans.worst_direction_rad + trajectory.poses[:, 2])
    return Held(scans.stamps_ns, scans.worst_m, turned, False)


def scale_of(found: Held) -> LogNorm:
    """Of sigmas in mm to 0..1; a scan in a hundred may lie beyond either end."""
    low, high = np.percentile(1e3 * found.worst_m, [1.0, 99.0]).tolist()
    return LogNorm(low, max(high, _LEAST_SPREAD * low), clip=True)


def path_and_strokes(
    view: RunView, found: Held, T_page_map: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, 2) where each scan was taken, and (n, 2, 2) strokes along the direction held least."""
    trajectory = view.result.trajectory
    inside = np.clip(found.stamps_ns, trajectory.stamps_ns[0], trajectory.stamps_ns[-1])
    points = compose(T_page_map, trajectory.at(inside))[:, :2]
    direction = found.direction_rad + T_page_map[2]
    half = 0.5 * _STROKE_M * np.column_stack([np.cos(direction), np.sin(direction)])
    return points, np.stack([points - half, points + half], axis=1)


def precision_plots(view: RunView, at_most: int) -> tuple[Panel, ...]:
    """Along the path: what holds the robot, and the errors of key frames within their bounds."""
    return (*_held_plot(view, at_most), *_consistency_plots(view, at_most))


def _held_plot(view: RunView, at_most: int) -> tuple[Panel, ...]:
    found = held(view)
    if found is None:
        return ()
    pick = thinned(found.stamps_ns.size, at_most)
    name = "allowed" if found.by_truth else "claimed"
    curve = Line(name, WITHDRAWN, found.stamps_ns[pick], 1e3 * found.worst_m[pick])
    title = "Least constrained direction of a scan, sigma"
    wide = found.worst_m.max() > _DECADE * found.worst_m.min()
    return (Panel("held", title, "mm", (curve,), logarithmic=bool(wide), along_path=True),)


def _consistency_plots(view: RunView, at_most: int) -> tuple[Panel, ...]:
    consistency = view.scores.in_map or view.scores.consistency
    if consistency is None:
        return ()
    pick = thinned(consistency.stamps_ns.size, at_most)
    stamps_ns = consistency.stamps_ns[pick]
    made = []
    for axis, (key, title, unit) in enumerate(
        (
            ("error_forward", "Key frames: error forward", "mm"),
            ("error_sideways", "Key frames: error sideways", "mm"),
            ("error_heading", "Key frames: error of heading", "mrad"),
        )
    ):
        two_sigma = 2e3 * consistency.sigmas[pick, axis]
        curves = (
            Line("2 sigma above", NEUTRAL, stamps_ns, two_sigma),
            Line("2 sigma below", NEUTRAL, stamps_ns, -two_sigma),
            Line("error", ESTIMATE, stamps_ns, 1e3 * consistency.errors[pick, axis]),
        )
        made.append(Panel(key, title, unit, curves, along_path=True))
    return tuple(made)


def ellipses(view: RunView) -> tuple[int, FloatArray]:
    """How many times enlarged, and (k, corners, 2) outlines in the map: 2 sigma of key frames.

    Enlarged by a power of ten, or they would be too small to see.
    """
    graph = view.result.graph
    pick = thinned(len(graph.keyframes), MAX_ELLIPSES)[1:]
    poses, covariances = graph.keyframes.poses[pick], graph.position_covariances[pick]
    if len(pick) == 0 or not view.sure:
        return 1, np.zeros((0, _ELLIPSE_CORNERS + 1, 2))
    values, vectors = np.linalg.eigh(covariances)
    axes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :] * ELLIPSE_SIGMAS
    typical_m = max(float(np.median(np.linalg.norm(axes, axis=(1, 2)))), 1e-9)
    enlarged = 10 ** max(round(np.log10(_SHOWN_AS_M / typical_m)), 0)
    angles = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_CORNERS + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], axis=1)
    outline = enlarged * (turn @ axes @ circle)
    return enlarged, np.asarray(poses[:, None, :2] + np.swapaxes(outline, 1, 2))


def driven_m(view: RunView, stamps_ns: IntArray) -> FloatArray:
    """(n,) path driven until each instant, by the key frames, which noise at rest does not make."""
    keyframes = view.result.graph.keyframes
    track = keyframes if len(keyframes) > 1 else view.result.trajectory
    steps_m = np.hypot(*np.diff(track.poses[:, :2], axis=0).T)
    driven = np.concatenate([[0.0], np.cumsum(steps_m)])
    since_s = (track.stamps_ns - track.stamps_ns[0]) * 1e-9
    at_s = (stamps_ns - track.stamps_ns[0]) * 1e-9
    return np.asarray(np.interp(at_s, since_s, driven))
