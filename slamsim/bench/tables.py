"""Tables of the accuracy benchmark: one line per seed, and the summary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

Figures = Mapping[str, object]

_MRAD_PER_DEG = 1e3 * math.pi / 180.0

_COLUMNS = (
    ("ATE", "ATE, mm", "ate_rmse_m", 1e3, ".2f"),
    ("max", "largest error, mm", "ate_max_m", 1e3, ".1f"),
    ("mrad", "rotation, mrad", "ate_rot_rmse_deg", _MRAD_PER_DEG, ".2f"),
    ("bound", "times the bound", "ate_over_bound", 1.0, ".1f"),
    ("nees", "NEES of a run (3 expected)", "nees_mean", 1.0, ".1f"),
    ("front", "front end alone, mm", "front_end_ate_rmse_m", 1e3, ".2f"),
    ("odo", "wheels alone, m", "odometry_ate_rmse_m", 1.0, ".2f"),
    ("loops", "closures", "closures", 1.0, ".0f"),
    ("false", "false closures", "closures_false", 1.0, ".0f"),
    ("lost", "scans lost", "scans_lost", 1.0, ".0f"),
    ("ms", "ms per scan", "ms_per_scan", 1.0, ".2f"),
    ("MB", "peak memory, MB", "peak_memory_mb", 1.0, ".0f"),
)
"""Heading of the column, name in the summary, key, scale and format."""

_SEED_WIDTH, _LEAST_WIDTH = 4, 6

SEED_HEADER = "seed" + "".join(
    short.rjust(max(len(short) + 2, _LEAST_WIDTH)) for short, *_ in _COLUMNS
)


def seed_line(figures: Figures) -> str:
    """The figures of one seed under ``SEED_HEADER``, or why there are none."""
    seed = str(figures["seed"]).rjust(_SEED_WIDTH)
    if "error" in figures:
        return f"{seed}  failed: {figures['error']}"
    return seed + "".join(
        _shown(figures.get(key), scale, form).rjust(max(len(short) + 2, _LEAST_WIDTH))
        for short, _, key, scale, form in _COLUMNS
    )


def summary_rows(summary: Figures) -> dict[str, str]:
    """Name and value of what the summary holds."""
    rows: dict[str, str] = {}
    for _, name, key, scale, form in _COLUMNS:
        spread = summary.get(key)
        if isinstance(spread, Mapping):
            median, worst = (_shown(spread[what], scale, form) for what in ("median", "worst"))
            rows[name] = f"{median} median, {worst} worst"
    nees = summary.get("nees")
    if isinstance(nees, Mapping):
        low, high = nees["band"]
        rows["NEES over the seeds"] = (
            f"{nees['mean']:.2f}, {nees['verdict']} (95 % band {low:.2f} to {high:.2f})"
        )
    in_map = summary.get("nees_in_map_mean")
    if isinstance(in_map, Mapping):
        rows["NEES within the map"] = f"{in_map['mean']:.2f} (3 expected)"
    believed, false = summary["closures"], summary["closures_false"]
    rows["closures"] = f"{believed} believed, {summary['closures_withdrawn']} withdrawn"
    rows["false closures"] = f"{false} believed, {summary['closures_false_withdrawn']} withdrawn"
    rows["revisits closed"] = f"{summary['revisits_closed']} of {summary['revisits']}"
    rows["scans lost"] = f"{summary['scans_lost']} of {summary['scans']}"
    rows["failed seeds"] = f"{summary['failed']} of {summary['seeds']}"
    return rows


def _shown(value: object, scale: float, form: str) -> str:
    return "-" if value is None else format(scale * cast(float, value), form)
