"""The figures of a data card, as PNG: the same bytes for the same rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamsim.dataset.catalogue.statistics import Statistics, numbers
from slamsim.dataset.recipe.sequence import SPLITS
from slamsim.report.figures.palette import ESTIMATE, INK, NEUTRAL, ODOMETRY, TRUTH

_STYLE: Any = {
    "font.family": "DejaVu Sans",  # which comes with matplotlib: the same everywhere
    "font.size": 9.0,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
_SPLIT_COLOURS = dict(zip(SPLITS, (ESTIMATE, ODOMETRY, TRUTH), strict=True))
_DPI = 110
_BINS = 30
_MOST_BARS = 30
_COUNTED = {"worlds": "world", "drives": "drive", "lidars": "sensors.lidar", "robots": "robot"}
_QUALITY = {
    "quality.duration_s": "duration [s]",
    "quality.turned_rad": "turned [rad]",
    "quality.contact_share": "time touching walls",
    "quality.slip_share": "slip of the wheels",
    "quality.no_return_share": "beams without return",
    "quality.min_clearance_m": "least room to walls [m]",
    "quality.seen_share": "floor seen",
    "quality.revisit_share": "scans that close loops",
    "quality.degenerate_share": "scans that fix no place",
}


def dataset_figures(manifest: pa.Table, told: Statistics) -> Iterator[tuple[str, bytes]]:
    """Name and PNG of each figure. manifest: rows that were made. told: their statistics."""
    with rc_context(_STYLE):
        if numbers(manifest, "quality.path_length_m").size:
            yield "path_length", _png(_histograms(manifest, {"quality.path_length_m": "path [m]"}))
        for name, key in _COUNTED.items():
            if counts := told["drawn"].get(key):
                yield name, _png(_bars(counts))
        yield "faults", _png(_bars(told["faults"]))
        there = {name: text for name, text in _QUALITY.items() if numbers(manifest, name).size}
        if there:
            yield "quality", _png(_histograms(manifest, there))


def _histograms(table: pa.Table, columns: Mapping[str, str]) -> Figure:
    """One for each column, the splits on top of one another."""
    across = min(len(columns), 3)
    down = -(-len(columns) // across)
    figure = Figure(figsize=(3.4 * across if across > 1 else 6.0, 2.3 * down), layout="constrained")
    splits = [split for split in SPLITS if split in table["split"].to_pylist()]
    parts = {split: table.filter(pc.equal(table["split"], split)) for split in splits}
    for place, (column, text) in enumerate(columns.items()):
        axes = figure.add_subplot(down, across, place + 1)
        edges = np.histogram_bin_edges(numbers(table, column), _BINS)
        axes.hist(
            [numbers(part, column) for part in parts.values()],
            edges.tolist(),
            stacked=True,
            color=[_SPLIT_COLOURS[split] for split in splits],
            label=splits,
        )
        axes.set_xlabel(text)
        axes.locator_params(axis="x", nbins=5)
        axes.locator_params(axis="y", integer=True)
        if place == 0:
            axes.set_ylabel("sequences")
            axes.legend(frameon=False)
    return figure


def _bars(counts: Mapping[str, int]) -> Figure:
    """The most frequent on top."""
    shown = dict(list(counts.items())[:_MOST_BARS])
    figure = Figure(figsize=(6.0, 0.7 + 0.21 * len(shown)), layout="constrained")
    axes: Axes = figure.add_subplot()
    bars = axes.barh(list(shown), list(shown.values()), color=ESTIMATE)
    axes.bar_label(bars, padding=3, color=NEUTRAL)
    axes.invert_yaxis()
    axes.locator_params(axis="x", integer=True)
    axes.set_xlabel("sequences")
    return figure


def _png(figure: Figure) -> bytes:
    out = BytesIO()
    figure.savefig(out, format="png", dpi=_DPI, metadata={"Software": None})
    return out.getvalue()
