"""Figures of the report as SVG text, readable in light and dark mode."""

from __future__ import annotations

import re
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, MultipleLocator, NullFormatter
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from slamsim.core.geometry import compose, inverse, transform_points
from slamsim.core.types import BoolArray, FloatArray, Grid, IntArray
from slamsim.evaluate.grid import cell_centres, occupied, wrong_walls
from slamsim.guard.quantities import as_number
from slamsim.report.figures.palette import (
    ACCEPTED,
    ESTIMATE,
    INK,
    NEUTRAL,
    ODOMETRY,
    TRUTH,
    WITHDRAWN,
    rgb,
)
from slamsim.report.precision import driven_m
from slamsim.report.run_view import RunView, outline_height_m, thinned, wall_outline
from slamsim.report.viewer.scene import closures
from slamsim.report.viewer.series import Panel

Pixels = NDArray[np.uint8]
PAGE_INK = "#010203"
"""Stands for the page's own text colour, which depends on the reader's theme."""

CHART_IN, PAGE_IN = 5.2, 11.06
"""Widths of a chart beside another one and of a picture as wide as the page: as they are to each
other in ``page.css``, so that all text has one size."""

_TALLEST = 0.8
"""Height of a map over its width at most, or it would not fit on a screen."""
_BELOW = 0.06
_MAX_PATH_POINTS = 3000
_LEAST_SHOWN = 1e-5
"""Where a logarithmic axis ends at the latest: a tenth of the error of a good map."""

STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "slamsim",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": PAGE_INK,
    "axes.labelcolor": PAGE_INK,
    "text.color": PAGE_INK,
    "xtick.color": PAGE_INK,
    "ytick.color": PAGE_INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "path.simplify_threshold": 0.3,
}


@dataclass(frozen=True, slots=True)
class Picture:
    """svg: an ``<svg>`` element. legend: name and colour of what is in it."""

    svg: str
    legend: tuple[tuple[str, str], ...]


def curve_figure(plot: Panel, view: RunView) -> Picture:
    """One plot over time, or over the path driven."""

    def across(stamps_ns: IntArray) -> FloatArray:
        if plot.along_path:
            return driven_m(view, stamps_ns)
        return np.asarray((stamps_ns - view.begin_ns) * 1e-9)

    with rc_context(STYLE):
        figure = Figure(figsize=(CHART_IN, 1.7), layout="constrained")
        axes = figure.add_subplot()
        for curve in plot.curves:
            axes.plot(across(curve.stamps_ns), curve.values, color=curve.colour, linewidth=0.9)
        if plot.logarithmic:
            axes.set_yscale("log", nonpositive="mask")
            axes.set_ylim(bottom=max(axes.get_ylim()[0], _LEAST_SHOWN))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: as_number(value)))
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid(color=NEUTRAL, alpha=0.25, linewidth=0.5)
        axes.margins(x=0.0)
        axes.set_xlabel("path [m]" if plot.along_path else "time [s]")
        axes.set_ylabel(plot.unit)
        legend = tuple((curve.name, curve.colour) for curve in plot.curves)
        return Picture(svg(figure, plot.key), legend)


def map_figure(view: RunView) -> Picture:
    """The map with the paths driven and the loop closures."""
    T_page_map = page_from_map(view)
    with rc_context(STYLE):
        paths = _paths(view, T_page_map)
        figure, axes = map_axes(view, *(points for _, _, points in paths))
        show_cells(axes, view.grid, map_colours(view.grid), T_page_map)
        legend = _show_closures(axes, view, T_page_map)
        for name, colour, points in paths:
            axes.plot(points[:, 0], points[:, 1], color=colour, linewidth=0.9)
            legend.append((name, colour))
        return Picture(svg(figure, "map"), tuple(legend))


def truth_figure(view: RunView) -> Picture | None:
    """Mapped against true walls: what was found, invented and missed; None without truth."""
    errors, truth = view.scores.trajectory, view.truth_grid
    if truth is None or errors is None:
        return None
    path_m, range_m = errors.truth.poses[:, :2], view.lidar_range_m
    invented, missed = wrong_walls(view.grid, truth, errors.T_truth_estimate, path_m, range_m)
    found = occupied(view.grid) & ~invented
    with rc_context(STYLE):
        figure, axes = map_axes(view)
        colours = cell_colours(((found, INK), (invented, WITHDRAWN)))
        show_cells(axes, view.grid, colours, errors.T_truth_estimate)
        show_cells(axes, truth, cell_colours(((missed, ACCEPTED),)), np.zeros(3))
        if view.walls is not None:
            outline = wall_outline(view.walls, outline_height_m(view))
            axes.add_collection(LineCollection(list(outline), colors=TRUTH, linewidths=0.6))
        legend = (
            ("true wall", TRUTH),
            ("mapped within one cell of it", INK),
            (f"mapped without a true wall: {np.count_nonzero(invented):,} cells", WITHDRAWN),
            (f"in view but missed: {np.count_nonzero(missed):,} cells", ACCEPTED),
        )
        return Picture(svg(figure, "truth"), legend)


def page_from_map(view: RunView) -> FloatArray:
    """(3,) maps are drawn as the true world lies, where it is known, else as they are."""
    errors = view.scores.trajectory
    return np.zeros(3) if errors is None else errors.T_truth_estimate


def map_axes(view: RunView, *paths: FloatArray) -> tuple[Figure, Axes]:
    """Equal axes in metres, as wide as the page, around mapped walls, the path and these paths
    (n, 2) on the page, with a scale bar; isolated returns may lie outside."""
    walls = cell_centres(view.grid, occupied(view.grid))
    here = transform_points(
        page_from_map(view), np.concatenate([walls, view.result.trajectory.poses[:, :2]])
    )
    points = np.concatenate([here, *paths])
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (-1.0, 1.0)
    low, high = np.broadcast_to(low, 2) - 0.3, np.broadcast_to(high, 2) + 0.3
    aspect = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.25, _TALLEST))
    figure = Figure(figsize=(PAGE_IN, (PAGE_IN - 0.5) * aspect + 0.5), layout="constrained")
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    ticks_m = MaxNLocator(10, steps=(1, 2, 5, 10)).tick_values(0.0, float((high - low).max()))
    axes.xaxis.set_major_locator(MultipleLocator(ticks_m[1] - ticks_m[0]))
    axes.yaxis.set_major_locator(MultipleLocator(ticks_m[1] - ticks_m[0]))
    for spine in axes.spines.values():
        spine.set_visible(False)
    _show_scale(axes, float(high[0] - low[0]))
    return figure, axes


def _show_scale(axes: Axes, width_m: float) -> None:
    """A bar of a round length, about an eighth of the map, below it on the right."""
    decade = 10.0 ** np.floor(np.log10(width_m / 8.0))
    length_m = decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= width_m / 8.0)
    transform = axes.get_xaxis_transform()
    end_m = axes.get_xlim()[1]
    axes.plot(
        [end_m - length_m, end_m],
        [-_BELOW, -_BELOW],
        color=PAGE_INK,
        linewidth=2.5,
        solid_capstyle="butt",
        transform=transform,
        clip_on=False,
    )
    beside_m = end_m - length_m - 0.01 * width_m
    axes.text(beside_m, -_BELOW, f"{length_m:g} m", transform=transform, ha="right", va="center")


def show_cells(axes: Axes, grid: Grid, colours: Pixels, T_page_grid: FloatArray) -> None:
    """Cells with a colour, cropped to where there is any; colours: (rows, columns, 4)."""
    rows, columns = np.nonzero(colours[:, :, 3])
    if rows.size == 0:
        return
    top, left = rows.min(), columns.min()
    cropped = colours[top : rows.max() + 1, left : columns.max() + 1]
    x_m = grid.origin_m[0] + left * grid.resolution_m
    y_m = grid.origin_m[1] + top * grid.resolution_m
    width_m, height_m = cropped.shape[1] * grid.resolution_m, cropped.shape[0] * grid.resolution_m
    place = Affine2D().rotate(T_page_grid[2]).translate(T_page_grid[0], T_page_grid[1])
    limits = axes.axis()
    axes.imshow(
        cropped,
        origin="lower",
        extent=(x_m, x_m + width_m, y_m, y_m + height_m),
        interpolation="none",
        transform=place + axes.transData,
    )
    axes.axis(limits)


def map_colours(grid: Grid) -> Pixels:
    walls, free = occupied(grid), grid.occupancy < grid.FREE_BELOW
    unsure = np.isfinite(grid.occupancy) & ~walls & ~free
    return cell_colours(((free, "#ffffff"), (unsure, "#b9bec6"), (walls, INK)))


def cell_colours(
    layers: tuple[tuple[BoolArray, str], ...],
) -> Pixels:
    """(rows, columns, 4) opaque where a layer's cells are, transparent elsewhere."""
    image = np.zeros((*layers[0][0].shape, 4), dtype=np.uint8)
    for cells, colour in layers:
        image[cells] = (*rgb(colour), 255)
    return image


def _paths(view: RunView, T_page_map: FloatArray) -> list[tuple[str, str, FloatArray]]:
    """Name, colour and (n, 2) points of each path; odometry begins where the estimate does."""
    trajectory, odometry = view.result.trajectory.poses, view.result.odometry.poses
    if len(trajectory) == 0:
        return []
    pick = thinned(len(trajectory), _MAX_PATH_POINTS)
    T_map_odom = compose(trajectory[0], inverse(odometry[0]))
    drifting = compose(compose(T_page_map, T_map_odom), odometry[pick])
    paths = [("odometry alone", ODOMETRY, drifting[:, :2])]
    if view.truth is not None:
        true_points = view.truth.planar().poses[thinned(len(view.truth), _MAX_PATH_POINTS), :2]
        paths.append(("truth", TRUTH, true_points))
    paths.append(("estimate", ESTIMATE, compose(T_page_map, trajectory[pick])[:, :2]))
    return paths


def _show_closures(axes: Axes, view: RunView, T_page_map: FloatArray) -> list[tuple[str, str]]:
    """Draws both kinds and returns the legend of those that there are."""
    points = transform_points(T_page_map, view.result.graph.keyframes.poses[:, :2])
    accepted, withdrawn = closures(view.result.graph.edges)
    legend = []
    for edges, colour, name in (
        (accepted, ACCEPTED, "loop closure"),
        (withdrawn, WITHDRAWN, "withdrawn closure"),
    ):
        if edges:
            lines = [points[[edge.source, edge.target]] for edge in edges]
            opacity = float(np.clip(100 / len(edges), 0.2, 1.0))
            collection = LineCollection(lines, colors=colour, linewidths=0.7, alpha=opacity)
            axes.add_collection(collection, autolim=False)
            ends = np.concatenate(lines)
            axes.plot(ends[:, 0], ends[:, 1], ".", color=colour, markersize=2.0, alpha=opacity)
            legend.append((f"{name}: {len(edges):,}", colour))
    return legend


def svg(figure: Figure, key: str) -> str:
    """The figure as an ``<svg>`` element whose ids are its own in a page of several."""
    text = StringIO()
    metadata = {"Date": None, "Creator": None}
    figure.savefig(text, format="svg", metadata=metadata, transparent=True)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :].replace(PAGE_INK, "currentColor")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\bid="', f'id="{key}-', svg)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{key}-", svg)
