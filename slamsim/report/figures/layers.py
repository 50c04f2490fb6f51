"""Figures of the layers that images add to a map."""

from __future__ import annotations

import numpy as np
from matplotlib import rc_context

from slamsim.core.layers import ObstacleLayer, SemanticLayer, label_colours
from slamsim.evaluate.grid import occupied
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
from slamsim.report.run_view import RunView

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
