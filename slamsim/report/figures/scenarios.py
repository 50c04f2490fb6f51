"""Charts of scenarios, in one style per simulator, for the page and as PNG."""

from __future__ import annotations

import colorsys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from textwrap import wrap

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from slamsim.core.types import FloatArray, Grid
from slamsim.evaluate.grid import cell_centres, occupied
from slamsim.report.figures.palette import ACCEPTED, ESTIMATE, NEUTRAL, ODOMETRY, TRUTH, rgb
from slamsim.report.figures.run import PAGE_INK, STYLE, map_colours, show_cells, svg
from slamsim.report.run_view import thinned
from slamsim.scenarios.base import Chart, Series, Source

_COLOURS: dict[Source, str] = {
    "slamsim": ESTIMATE,
    "unity": ODOMETRY,
    "gazebo": ACCEPTED,
    "reality": TRUTH,
    "theory": PAGE_INK,
}
_MARKERS: dict[Source, str] = {
    "slamsim": "osD^vPX",
    "unity": "s",
    "gazebo": "^",
    "reality": "D",
    "theory": "x",
}
"""Of several of ours each has its own; the first is that of a single one."""
_HEIGHTS: dict[Source, float] = {"slamsim": 3.0, "theory": 3.5}
"""Thin and dashed, theory is seen above what agrees with it."""
_LIGHTNESS, _HUES, _MOST_SATURATED = (0.42, 0.62), (-0.04, 0.08), 0.75
"""Between these lightnesses, and so far apart in hue, lie several series of one, from
cyan to indigo for ours: seen on white as on black."""
_DASHES = ((0, (4, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)))
_MAX_POINTS = 2000
_ISOLATED = 0.005
"""Share of a map's walls on each side that is not looked at."""
_LABEL_WIDTH = 38
_FEW_DECADES = 2.0
_PNG_DPI = 160
_TITLE_CHARACTERS = 11.5
"""Of the title's font to the inch."""
_LINE_IN, _SAMPLE_IN, _CHARACTER_IN = 0.2, 0.6, 0.075
"""Of the legend: height of a line, width of a sample with its gaps, and of a character."""


@dataclass(frozen=True, slots=True)
class SeriesStyle:
    """How a series is drawn. dash: matplotlib's; marker: empty for none, as for no line."""

    colour: str
    line: bool
    dash: tuple[float, tuple[float, ...]] | None
    marker: str
    hollow: bool

    @property
    def page_colour(self) -> str:
        """As the page says it, whose own text colour depends on the reader's theme."""
        return "currentColor" if self.colour == PAGE_INK else self.colour


@dataclass(frozen=True, slots=True)
class DrawnSeries:
    """A chart as an ``<svg>`` element, and the name and look of each of its series."""

    svg: str
    legend: tuple[tuple[str, SeriesStyle], ...]


def chart_figure(chart: Chart, key: str) -> DrawnSeries:
    """key: unlike that of any other figure of the page."""
    with rc_context(STYLE):
        figure = Figure(figsize=_size(chart), layout="constrained")
        looks = _draw(figure.add_subplot(), chart)
        names = [series.name for series in chart.series]
        return DrawnSeries(svg(figure, key), tuple(zip(names, looks, strict=True)))


def chart_png(chart: Chart) -> bytes:
    """The same to be pasted elsewhere: on white, with title and legend."""
    with rc_context(STYLE):
        width, height = _size(chart)
        names = [_words(series.name) for series in chart.series]
        title = wrap(_words(chart.title), round(width * _TITLE_CHARACTERS))
        columns = _legend_columns(names, width)
        lines = len(title) + -(-len(names) // columns)
        figure = Figure(figsize=(width, height + _LINE_IN * lines), layout="constrained")
        looks = _draw(figure.add_subplot(), chart)
        figure.suptitle("\n".join(title), fontsize=10.0, fontweight="bold")
        handles = [_handle(look) for look in looks]
        figure.legend(handles, names, loc="outside lower center", ncols=columns, frameon=False)
        file = BytesIO()
        figure.savefig(file, format="png", dpi=_PNG_DPI, facecolor="white")
        return file.getvalue()


def _legend_columns(names: Sequence[str], width: float) -> int:
    """As many as there is room for."""
    longest = max(map(len, names), default=0)
    return max(int(width / (_SAMPLE_IN + _CHARACTER_IN * longest)), 1)


def looks_of(chart: Chart) -> tuple[SeriesStyle, ...]:
    """Series of one and the same differ in shade and marker, points also in being hollow."""
    of_all = Counter(series.source for series in chart.series)
    before: Counter[Source] = Counter()
    looks = []
    for series in chart.series:
        k, of = before[series.source], of_all[series.source]
        before[series.source] += 1
        looks.append(_look(series, k, of))
    return tuple(looks)


def _look(series: Series, k: int, of: int) -> SeriesStyle:
    ink, markers = series.source == "theory", _MARKERS[series.source]
    dash = _DASHES[k % len(_DASHES)] if ink else _DASHES[0] if series.dashed else None
    return SeriesStyle(
        colour=_COLOURS[series.source]
        if ink or of == 1
        else _shade(_COLOURS[series.source], k, of),
        line=series.kind in ("line", "line+points"),
        dash=dash,
        marker="" if series.kind == "line" else markers[k % len(markers)],
        hollow=series.kind == "points" and k % 2 == 1,
    )


def _shade(colour: str, k: int, of: int) -> str:
    hue, _, saturation = colorsys.rgb_to_hls(*(part / 255 for part in rgb(colour)))
    at = k / (of - 1)
    lightness, turned = (low + (high - low) * at for low, high in (_LIGHTNESS, _HUES))
    parts = colorsys.hls_to_rgb((hue + turned) % 1.0, lightness, min(saturation, _MOST_SATURATED))
    return "#" + "".join(f"{round(255 * part):02x}" for part in parts)


def _size(chart: Chart) -> tuple[float, float]:
    if chart.grid is not None:
        return 3.2, 3.2
    return (5.2, 4.4) if chart.equal else (5.2, 3.1)


def _draw(axes: Axes, chart: Chart) -> tuple[SeriesStyle, ...]:
    looks = looks_of(chart)
    for name, logarithmic in zip("xy", chart.logarithmic, strict=True):
        if logarithmic:
            axes.set(**{f"{name}scale": "log"})
    for series, look in zip(chart.series, looks, strict=True):
        if series.kind == "boxes" and series.spread is not None:
            _draw_boxes(axes, series, series.spread, look, chart.logarithmic[0])
        else:
            _draw_curve(axes, series, look)
    if chart.grid is not None:
        _frame(axes, chart.grid)
        show_cells(axes, chart.grid, map_colours(chart.grid), np.zeros(3))
    else:
        axes.grid(color=NEUTRAL, alpha=0.25, linewidth=0.5)
    if chart.equal or chart.grid is not None:
        axes.set_aspect("equal", adjustable="datalim" if chart.grid is None else "box")
    for axis, logarithmic in zip((axes.xaxis, axes.yaxis), chart.logarithmic, strict=True):
        if logarithmic:
            _plain_ticks(axis)
    axes.set_xlabel(_words(chart.x_label))
    axes.set_ylabel("\n".join(wrap(_words(chart.y_label), _LABEL_WIDTH)))
    return looks


def _plain_ticks(axis: Axis) -> None:
    """1, 2 and 5 of each decade as they are, only decades where there are many."""
    low, high = axis.get_view_interval()
    few = high < low * 10.0**_FEW_DECADES
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _frame(axes: Axes, grid: Grid) -> None:
    """Around the curves and nearly all walls; isolated returns may reach farther."""
    walls = cell_centres(grid, occupied(grid))
    if len(walls):
        axes.update_datalim(np.quantile(walls, (_ISOLATED, 1.0 - _ISOLATED), axis=0))
    axes.autoscale_view()


def _draw_curve(axes: Axes, series: Series, look: SeriesStyle) -> None:
    pick = np.isnan(series.y)  # where a line of several pieces breaks
    pick[thinned(len(series.x), _MAX_POINTS)] = True
    axes.plot(
        series.x[pick],
        series.y[pick],
        color=look.colour,
        linestyle=(look.dash or "-") if look.line else "none",
        linewidth=1.0 if series.source == "theory" else 1.4,
        marker=look.marker or None,
        markersize=4.5,
        markerfacecolor="none" if look.hollow else look.colour,
        zorder=_HEIGHTS.get(series.source, 2.5),
    )


def _draw_boxes(
    axes: Axes, series: Series, spread: FloatArray, look: SeriesStyle, logarithmic: bool
) -> None:
    """Whiskers reach the least and the largest; the mark is the mean."""
    gaps = np.diff(np.sort(series.x))
    width = 0.55 * float(gaps.min()) if gaps.size else 0.5
    boxes = [
        {"whislo": low, "q1": q1, "med": median, "q3": q3, "whishi": high}
        for low, q1, median, q3, high in spread
    ]
    line = {"color": look.colour, "linewidth": 1.0}
    axes.bxp(
        boxes,
        positions=series.x.tolist(),
        widths=(0.25 * series.x).tolist() if logarithmic else width,
        showfliers=False,
        manage_ticks=False,
        patch_artist=True,
        boxprops={"facecolor": f"{look.colour}40", "edgecolor": look.colour, "linewidth": 1.0},
        medianprops=line,
        whiskerprops=line,
        capprops=line,
    )
    axes.plot(series.x, series.y, look.marker, color=look.colour, markersize=3.5)


def _handle(look: SeriesStyle) -> Line2D:
    return Line2D(
        [],
        [],
        color=look.colour,
        linestyle=(look.dash or "-") if look.line else "none",
        marker=look.marker or None,
        markersize=4.5,
        markerfacecolor="none" if look.hollow else look.colour,
    )


def _words(text: str) -> str:
    """Never taken for a formula."""
    return text.replace("$", r"\$")


def pictures(charts: Sequence[Chart], name: str) -> dict[str, bytes]:
    """File name and contents of a PNG for each chart."""
    return {f"{name}_{k}.png": chart_png(chart) for k, chart in enumerate(charts, 1)}
