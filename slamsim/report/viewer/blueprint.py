"""Layout of the Rerun recording: map on the left, curves on the right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from slamsim.core.types import FloatArray
from slamsim.evaluate.grid import cell_centres, occupied
from slamsim.report.precision import precision_plots
from slamsim.report.run_view import RunView
from slamsim.report.viewer.scene import CLOSURES, SEMANTIC
from slamsim.report.viewer.series import MAX_POINTS, Panel, plots
from slamsim.report.viewer.stage import BASE, MAP, timeline

MAP_VIEW, PRECISION_VIEW, SPACE_VIEW = "Map", "Precision", "Space"
_FIELD_OF_VIEW = 0.85
"""How far above a scene one metre high the eye must be to see it whole, in metres."""

_HIDDEN: dict[rr.EntityPath | str, Any] = {
    entity: rrb.EntityBehavior(visible=False) for entity in (*CLOSURES, SEMANTIC)
}


def blueprint(view: RunView, cameras: Sequence[rrb.Spatial2DView] = ()) -> rrb.Blueprint:
    """Both views of the map as tabs, the plots that the run has one above the other.

    cameras: further views, below the plots.
    """
    hidden = ["- /truth/walls", "- /precision/**", "- /plots/**", "- /cameras/**"]
    has_scans = any(True for _ in view.log.scans)
    scene = rrb.Tabs(
        _map_view(view, f"{MAP_VIEW}: {_paths_drawn(view)}", ["+ /**", *hidden]),
        _map_view(view, PRECISION_VIEW, ["+ /map", "+ /truth/outline", "+ /precision/**"]),
        _space_view(view) if has_scans else _before_cameras(),
        active_tab=0 if has_scans else 2,
    )
    groups = (("Over time", plots(view)), ("Precision", precision_plots(view, MAX_POINTS)))
    curves = [
        rrb.Vertical(*(_curve_view(_whole_run(view), plot) for plot in group), name=name)
        for name, group in groups
        if group
    ]
    beside: list[rrb.Container] = [rrb.Tabs(*curves, active_tab=0)] if curves else []
    beside += [rrb.Grid(*cameras)] if cameras else []
    parts = (scene, rrb.Vertical(*beside)) if beside else (scene,)
    time = rrb.TimePanel(timeline=timeline(view), state="collapsed", play_state="paused")
    return _laid_out(parts, time)


def live_blueprint(
    curves: Sequence[Panel], centre: FloatArray, extent_m: FloatArray
) -> rrb.Blueprint:
    """The map from above, centre and extent_m (2,) of it, and the curves of the last minute."""
    scene = _seen_from_above(MAP_VIEW, ["+ /**", "- /plots/**"], centre, extent_m)
    boundary = rr.TimeRangeBoundary.cursor_relative
    last_minute = rr.TimeRange(start=boundary(seconds=-60.0), end=boundary(seconds=0.0))
    plots = rrb.Vertical(*(_curve_view(last_minute, curve) for curve in curves))
    time = rrb.TimePanel(timeline="sim_time", state="collapsed", play_state="following")
    return _laid_out((scene, plots), time)


def _laid_out(parts: Sequence[Any], time: rrb.TimePanel) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(*parts, column_shares=[3, 2][: len(parts)]),
        time,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _curve_view(shown: rr.TimeRange, plot: Panel) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"plots/{plot.key}",
        name=f"{plot.title} [{plot.unit}]" if plot.unit else plot.title,
        axis_x=rrb.TimeAxis(view_range=shown),
        axis_y=_axis_y(plot),
    )


def _axis_y(plot: Panel) -> rrb.ScalarAxis | None:
    """Of errors as far as the estimate's reach, beside which those of odometry leave no room."""
    errors = [line.values for line in plot.curves if line.name == "estimate" and line.values.size]
    if not plot.key.startswith("error_") or not errors:
        return None
    least, most = min(float(one.min()) for one in errors), max(float(one.max()) for one in errors)
    if least >= 0.0 >= most:
        return None
    return rrb.ScalarAxis(range=(-_round_above(-least), _round_above(most)))


def _round_above(value: float) -> float:
    """1, 2 or 5 times a power of ten, at which an axis has a number; 0 for less than 0."""
    if value <= 0.0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= value)


def _paths_drawn(view: RunView) -> str:
    """What the colours of paths mean, which a view from above has no legend for."""
    drawn = ["estimate blue"] if view.mapped else []
    drawn += ["odometry orange"] + ([] if view.truth is None else ["truth green"])
    return ", ".join(drawn)


def _whole_run(view: RunView) -> rr.TimeRange:
    begin_ns = view.begin_ns if view.log.epoch == "unix" else 0
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.absolute(nanos=begin_ns),
        end=rr.TimeRangeBoundary.absolute(nanos=begin_ns + round(view.duration_s * 1e9)),
    )


def _map_view(view: RunView, name: str, contents: list[str]) -> rrb.Spatial3DView:
    """The true walls only as an outline, so that they hide nothing."""
    return _seen_from_above(name, contents, *map_extent(view))


def _seen_from_above(
    name: str, contents: list[str], centre: FloatArray, extent_m: FloatArray
) -> rrb.Spatial3DView:
    """North up; (2,) centre and (2,) size of what is shown, in metres of the map frame."""
    eye_m = max(extent_m[1], extent_m[0] * 0.8) / _FIELD_OF_VIEW
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=contents,
        spatial_information=rrb.SpatialInformation(target_frame=MAP),
        line_grid=rrb.LineGrid3D(visible=False),
        overrides=_HIDDEN,
        background=[250, 250, 250],
        eye_controls=rrb.EyeControls3D(
            position=(centre[0], centre[1] - 0.001 * eye_m, eye_m),
            look_target=(centre[0], centre[1], 0.0),
            eye_up=(0.0, 1.0, 0.0),
        ),
    )


def _space_view(view: RunView) -> rrb.Spatial3DView:
    centre, extent_m = map_extent(view)
    size_m = float(max(extent_m))
    eye_m = (centre[0] - 0.4 * size_m, centre[1] - 0.7 * size_m, 0.7 * size_m)
    return _space(MAP, eye_m, (centre[0], centre[1], 0.0), _HIDDEN)


def _before_cameras() -> rrb.Spatial3DView:
    """What cameras see, from behind and above them; nothing else says how large the place is."""
    return _space(BASE, (-2.0, 1.2, 1.2), (1.5, 0.0, 0.0))


def _space(
    frame: str, eye_m: tuple[float, ...], target_m: tuple[float, ...], overrides: Any = None
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        name=SPACE_VIEW,
        contents=["+ /**", "- /precision/**", "- /plots/**"],
        spatial_information=rrb.SpatialInformation(target_frame=frame),
        line_grid=rrb.LineGrid3D(visible=False),
        overrides=overrides,
        eye_controls=rrb.EyeControls3D(
            position=eye_m, look_target=target_m, eye_up=(0.0, 0.0, 1.0)
        ),
    )


def map_extent(view: RunView) -> tuple[FloatArray, FloatArray]:
    """(2,) centre and (2,) size, in metres, of the mapped walls and the path; 1 m at least."""
    walls = cell_centres(view.grid, occupied(view.grid))
    points = np.concatenate([walls, view.result.trajectory.poses[:, :2]])
    if len(points) == 0:
        return np.zeros(2), np.ones(2)
    low, high = points.min(axis=0), points.max(axis=0)
    if not view.mapped:  # what was seen lies around the path
        margin_m = _seen_m(view)
        low, high = low - margin_m, high + margin_m
    return 0.5 * (low + high), np.maximum(high - low, 1.0)


def _seen_m(view: RunView) -> float:
    """The median range of the first scan."""
    first = next(iter(view.log.scans), None)
    ranges_m = np.zeros(0) if first is None else first.ranges_m[np.isfinite(first.ranges_m)]
    return float(np.median(ranges_m)) if ranges_m.size else 0.0
