"""Reports of a map made without a lidar, and of calibrated cameras: self-contained HTML files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from slamsim.core.randomness import random_stream
from slamsim.core.types import FloatArray
from slamsim.guard.output import write_atomic
from slamsim.report.figures.palette import ESTIMATE, NEUTRAL, ODOMETRY, TRUTH
from slamsim.report.figures.run import CHART_IN, PAGE_IN, STYLE, Picture, svg
from slamsim.report.pages.html import (
    Card,
    Table,
    cards,
    figure,
    page,
    pair,
    section,
    table,
    warnings,
)

_MOST_POINTS = 3000


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """numbers: of ``report.json``. path_m, truth_m, lidar_m: (n, 2) as seen from above, None for
    what is unknown. tags_m: (t, 2). sigmas_m, seconds: (k,) how sure each key frame is, when."""

    name: str
    verdict: str
    numbers: Mapping[str, object]
    path_m: FloatArray
    truth_m: FloatArray | None
    lidar_m: FloatArray | None
    tags_m: FloatArray
    sigmas_m: FloatArray
    seconds: FloatArray
    told: Sequence[str]


def write_camera_report(path: Path, view: CameraView) -> None:
    """Raises what write_atomic raises."""
    body = [
        cards(_cards(view)),
        warnings(view.told),
        section("Path", figure(_path(view), "From above, in metres", wide=True)),
        section("How sure", figure(_sigmas(view), "Standard deviation of each key frame")),
        section("Numbers", table(Table(("number", "value"), _rows(view)))),
    ]
    write_atomic(path, page(view.name, view.verdict, "".join(body)).encode())


def _cards(view: CameraView) -> list[Card]:
    numbers, found = view.numbers, []
    for key, name, context in (
        ("ate_rmse_m", "Error", "RMSE to the truth, once aligned"),
        ("lidar_ate_rmse_m", "Beside the lidar", "RMSE to the path that the lidar gives"),
        ("sigma_max_m", "Own standard deviation", "of the least sure key frame"),
    ):
        value = numbers.get(key)
        if isinstance(value, float):
            found.append(Card(name, f"{1e3 * value:.3g} mm", context))
    found.append(Card("Images", f"{numbers['images']}", f"{numbers['images_lost']} lost"))
    return found


def _rows(view: CameraView) -> list[tuple[str, str]]:
    plain = (str, int, float)
    return [(key, f"{v}") for key, v in view.numbers.items() if isinstance(v, plain)]


def _path(view: CameraView) -> Picture:
    legend = []
    with rc_context(STYLE):
        drawn = Figure(figsize=(PAGE_IN, 0.6 * PAGE_IN), layout="constrained")
        axes = drawn.add_subplot()
        for name, colour, points in (
            ("lidar", ODOMETRY, view.lidar_m),
            ("truth", TRUTH, view.truth_m),
            ("camera", ESTIMATE, view.path_m),
        ):
            if points is not None:
                few = points[:: max(len(points) // _MOST_POINTS, 1)]
                axes.plot(few[:, 0], few[:, 1], color=colour, linewidth=0.9)
                legend.append((name, colour))
        if len(view.tags_m):
            axes.plot(view.tags_m[:, 0], view.tags_m[:, 1], "s", color=NEUTRAL, markersize=4)
            legend.append(("tags", NEUTRAL))
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        return Picture(svg(drawn, "path"), tuple(legend))


def _sigmas(view: CameraView) -> Picture:
    with rc_context(STYLE):
        drawn = Figure(figsize=(0.5 * PAGE_IN, 2.2), layout="constrained")
        axes = drawn.add_subplot()
        axes.plot(view.seconds, 1e3 * view.sigmas_m, color=ESTIMATE, linewidth=0.9)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("[mm]")
        return Picture(svg(drawn, "sigmas"), (("standard deviation", ESTIMATE),))


_MOST_ARROWS = 3000
_LONGEST_SHARE = 0.05
"""Of the image's width: an arrow of the 95th percentile."""
FOOTER = "Made by slamsim calibrate. All numbers are in report.json beside this file."


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """Corners (n, 2) px as seen in an image of size (width, height), and how far from there the fit
    has them (n, 2) px; at: (n,) when, or in which image, as ``axis`` says."""

    size: tuple[int, int]
    corners_px: FloatArray
    off_px: FloatArray
    at: FloatArray
    axis: str


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedView:
    """One camera. facts: about its images. rows: name, value with interval, claim, verdict, and
    what would tell more. misfits: by what was looked at."""

    name: str
    facts: Mapping[str, str]
    rows: Sequence[tuple[str, str, str, str, str]]
    misfits: Mapping[str, Misfits]


def write_calibration_report(
    path: Path,
    cameras: Sequence[CalibratedView],
    pairs: Mapping[str, Mapping[str, str]],
    notes: Sequence[str],
) -> None:
    """pairs: what is told of two cameras, by their names. Raises what write_atomic raises."""
    body = [warnings(notes), *(_camera(view, number) for number, view in enumerate(cameras))]
    body += [
        section(name, table(Table(("", ""), list(rows.items())))) for name, rows in pairs.items()
    ]
    write_atomic(
        path, page("Calibration of cameras", _lead(cameras), "".join(body), FOOTER).encode()
    )


def _lead(cameras: Sequence[CalibratedView]) -> str:
    verdicts = [row[3] for each in cameras for row in each.rows]
    faults, confirmed, unsure = map(verdicts.count, ("fault", "ok", "inconclusive"))
    if faults:
        found = f"{faults} of {len(verdicts)} numbers are not as claimed"
    elif confirmed and not unsure:
        found = "all is as claimed"
    elif any(row[2] for each in cameras for row in each.rows):
        found = f"{confirmed} of {len(verdicts)} numbers are as claimed"
    else:
        found = "nothing was claimed"
    count = f"{len(cameras)} calibrated; " if len(cameras) > 1 else ""
    return count + found + (f", {unsure} inconclusive." if unsure else ".")


def _camera(view: CalibratedView, number: int) -> str:
    header = ("number", "found, 95 % interval", "claimed", "verdict", "what would tell")
    parts = [
        table(Table(("", ""), list(view.facts.items()))),
        table(Table(header, view.rows, words=True)),
    ]
    for name, misfits in view.misfits.items():
        key = f"{name}-{number}"  # ids of elements, which names of topics are not fit for
        shown = (
            figure(_arrows(key, misfits), f"Where corners of {name} are off, magnified"),
            figure(_sizes(key, misfits), f"By how much in each image ({name}), root mean square"),
        )
        parts.append(pair(shown))
    return section(view.name, "".join(parts))


def _arrows(key: str, misfits: Misfits) -> Picture:
    """From each corner to where the fit has it; of many, a part that is drawn by lot: of every
    fourth one, all would be the same corner of their tags."""
    lot = random_stream(0, "arrows").permutation(len(misfits.off_px))[:_MOST_ARROWS]
    begin, off = misfits.corners_px[lot], misfits.off_px[lot]
    width, height = misfits.size
    usual_px = max(float(np.percentile(np.linalg.norm(off, axis=1), 95.0)), 1e-9)
    by = max(round(_LONGEST_SHARE * width / usual_px), 1)
    with rc_context(STYLE):
        drawn = Figure(figsize=(CHART_IN, CHART_IN * height / width + 0.5), layout="constrained")
        axes = drawn.add_subplot()
        lines = np.stack([begin, begin + by * off], axis=1)
        axes.add_collection(LineCollection(list(lines), colors=ESTIMATE, linewidths=0.5))
        axes.plot(begin[:, 0], begin[:, 1], ".", color=NEUTRAL, markersize=1.5)
        axes.set(
            xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x [px]", ylabel="y [px]"
        )
        axes.set_aspect("equal")
        legend = (("corner", NEUTRAL), (f"off, {by} times", ESTIMATE))
        return Picture(svg(drawn, f"arrows-{key}"), legend)


def _sizes(key: str, misfits: Misfits) -> Picture:
    places, which = np.unique(misfits.at, return_inverse=True)
    squares = np.square(misfits.off_px).sum(axis=1)
    rms_px = np.sqrt(np.bincount(which, squares) / np.bincount(which))
    with rc_context(STYLE):
        drawn = Figure(figsize=(CHART_IN, 2.4), layout="constrained")
        axes = drawn.add_subplot()
        axes.plot(places, rms_px, ".", color=ESTIMATE, markersize=3.0)
        axes.set(xlabel=misfits.axis, ylabel="off [px]", ylim=(0.0, None))
        return Picture(svg(drawn, f"sizes-{key}"), (("each image", ESTIMATE),))
