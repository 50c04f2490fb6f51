"""The figures of UMBmark: end errors in the plane, and what calibration makes of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.scenarios.base import Chart, Series
from slamsim.scenarios.study_drives import SQUARES
from slamsim.scenarios.umbmark.method import Clusters

_LABELS = ("error in x [m]", "error in y [m]")


def errors_chart(robots: Sequence[tuple[str, Clusters]]) -> Chart:
    """End errors of each robot with their centres; E_max of others as circles."""
    circle = np.linspace(0.0, 2.0 * np.pi, 97)
    series = [
        Series(
            f"E_max of {who}",
            who,
            figures.largest_error_m * np.cos(circle),
            figures.largest_error_m * np.sin(circle),
            "line",
            dashed=True,
        )
        for who, figures in SQUARES.items()
    ]
    for name, found in robots:
        series += _points(name, found)
    note = (
        "True end less the end by odometry, seen from the start. Circles: as far as the farther "
        "centre of gravity lies in the study; where on the circle it does not tell."
    )
    return Chart("End errors of the squares", *_LABELS, tuple(series), equal=True, note=note)


def corrected_chart(robot: str, before: Clusters, after: Clusters) -> Chart:
    """The fresh squares of one robot before and after calibration."""
    series = (*_points("before", before), *_points("after", after))
    title = f"Fresh squares before and after calibration: {robot}"
    return Chart(title, *_LABELS, series, equal=True)


def _points(name: str, found: Clusters) -> list[Series]:
    made = []
    ways = (("clockwise", found.clockwise_m), ("counter-clockwise", found.counter_clockwise_m))
    for way, errors_m in ways:
        made.append(Series(f"{name}, {way}", "slamsim", errors_m[:, 0], errors_m[:, 1], "points"))
    centres_m = found.centres_m()
    spokes = np.concatenate([[[0.0, 0.0], c, [np.nan, np.nan]] for c in centres_m])
    x, y = spokes.T
    made.append(Series(f"{name}, centres of gravity", "slamsim", x, y, "line+points"))
    return made
