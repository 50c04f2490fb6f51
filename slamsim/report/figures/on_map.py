"""Figures drawn on the map: layers that images add, and localisability along the path."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.ticker import FuncFormatter, LogFormatter

from slamsim.core.layers import ObstacleLayer, SemanticLayer, label_colours
from slamsim.core.types import Grid
from slamsim.evaluate.grid import occupied
from slamsim.report.figures import run
from slamsim.report.figures.palette import INK, NEUTRAL, WITHDRAWN
from slamsim.report.figures.run import (
    STYLE,
    Picture,
    cell_colours,
    map_axes,
    page_from_map,
    show_cells,
    svg,
)
from slamsim.report.precision import COLOURS, held, path_and_strokes, scale_of
from slamsim.report.run_view import RunView, thinned

_MOST_NAMED = 12
"""Labels in a legend: those with the most cells."""


def obstacle_figure(view: RunView, layer: ObstacleLayer) -> Picture:
    """Obstacles over the floor that depth images show, and the walls of the lidar's map."""
    T_page_map = page_from_map(view)
    free = layer.grid.occupancy < layer.grid.FREE_BELOW
    with rc_context(STYLE):
        figure, axes = map_axes(view)
        colours = cell_colours(((free, "#ffffff"), (occupied(layer.grid), WITHDRAWN)))
        show_cells(axes, layer.grid, colours, T_page_map)
        walls = cell_colours(((occupied(view.grid), INK),))
        show_cells(axes, view.grid, walls, T_page_map)
        legend = (("obstacle in depth images", WITHDRAWN), ("in the lidar's map", INK))
        return Picture(svg(figure, "obstacles"), legend)


def semantic_figure(view: RunView, layer: SemanticLayer) -> Picture:
    """The most frequent label of each cell, and the walls of the lidar's map."""
    T_page_map = page_from_map(view)
    seen = layer.labels >= 0
    with rc_context(STYLE):
        figure, axes = map_axes(view)
        opaque = np.where(seen, 255, 0).astype(np.uint8)[..., None]
        colours = np.concatenate([label_colours(layer.labels), opaque], axis=2)
        show_cells(axes, layer.grid, colours, T_page_map)
        labels, counts = np.unique(layer.labels[seen], return_counts=True)
        most = labels[np.argsort(-counts, kind="stable")][:_MOST_NAMED].tolist()
        legend = [(view.label_names.get(label, f"label {label}"), _hex(label)) for label in most]
        if len(labels) > len(most):
            legend.append((f"{len(labels) - len(most)} more", NEUTRAL))
        return Picture(svg(figure, "semantic"), tuple(legend))


def _hex(label: int) -> str:
    red, green, blue = label_colours(np.array([label]))[0].tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"


_MAX_PIECES = 1500
_MAX_STROKES = 150


class _Plain(LogFormatter):
    """Where a label stands as matplotlib has it, the number without a power of ten."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def held_figure(view: RunView) -> Picture | None:
    """The path in the colour of what holds it, with strokes along the direction held least."""
    found = held(view)
    if found is None or len(view.result.trajectory) < 2:
        return None
    T_page_map = page_from_map(view)
    with rc_context(run.STYLE):
        figure, axes = run.map_axes(view)
        run.show_cells(axes, view.grid, _pale(view.grid), T_page_map)
        colours, worst_mm = scale_of(found), 1e3 * found.worst_m
        points, strokes = path_and_strokes(view, found, T_page_map)
        pick = thinned(len(points), _MAX_PIECES)
        pieces = np.stack([points[pick[:-1]], points[pick[1:]]], axis=1)
        path = LineCollection(list(pieces), cmap=COLOURS, norm=colours, linewidths=2.0)
        path.set_array(worst_mm[pick[:-1]])
        some = thinned(len(points), _MAX_STROKES)
        across = LineCollection(list(strokes[some]), cmap=COLOURS, norm=colours, linewidths=0.9)
        across.set_array(worst_mm[some])
        axes.add_collection(across, autolim=False)
        axes.add_collection(path, autolim=False)
        bar = figure.colorbar(ScalarMappable(colours, COLOURS), ax=axes, shrink=0.6, pad=0.02)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_formatter(_Plain(labelOnlyBase=False, minor_thresholds=(2.0, 0.5)))
        source = "what the true walls allow" if found.by_truth else "what the matches claimed"
        legend = (
            (
                f"a scan's worst direction, sigma in mm: {source}",
                to_hex(colormaps[COLOURS](0.5)),
            ),
            ("strokes lie along that direction", to_hex(colormaps[COLOURS](0.8))),
        )
        return Picture(run.svg(figure, "held_map"), legend)


def _pale(grid: Grid) -> run.Pixels:
    """The map in the background."""
    return run.cell_colours(
        ((grid.occupancy < grid.FREE_BELOW, "#ffffff"), (occupied(grid), "#9aa1ab"))
    )
