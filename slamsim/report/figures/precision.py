"""Figure of the report: localisability along the path."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.ticker import FuncFormatter, LogFormatter

from slamsim.core.types import Grid
from slamsim.evaluate.grid import occupied
from slamsim.report.figures import run
from slamsim.report.figures.run import Picture, page_from_map
from slamsim.report.precision import COLOURS, held, path_and_strokes, scale_of
from slamsim.report.run_view import RunView, thinned

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
