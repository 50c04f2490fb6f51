"""Report of a map made without a lidar, as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from slamsim.core.types import FloatArray
from slamsim.guard.output import write_atomic
from slamsim.report.figures.palette import ESTIMATE, NEUTRAL, ODOMETRY, TRUTH
from slamsim.report.figures.run import PAGE_IN, STYLE, Picture, svg
from slamsim.report.pages.html import Card, Table, cards, figure, page, section, table, warnings

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
