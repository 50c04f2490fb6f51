"""Report of the demonstration: two maps of one drive and the finding that explains them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from slamsim.check.findings import CheckReport
from slamsim.check.wording import headline
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory
from slamsim.evaluate.grid import cell_centres, occupied
from slamsim.report.figures.palette import ESTIMATE, INK
from slamsim.report.figures.run import STYLE, Picture, svg
from slamsim.report.pages.check import wrong
from slamsim.report.pages.html import Card, cards, figure, page, pair, section

_MARGIN_M = 0.3
"""Around what is drawn."""
_FOOTER = "Made by slamsim demo. Both runs, and the repaired recording, are beside this file."


@dataclass(frozen=True, slots=True, eq=False)
class MappedSide:
    """One recording of two, drawn twice.

    laid: its scans laid along the path of the wheels (odometry), as a viewer of the raw streams
    shows them. mapped: what SLAM made of it along its trajectory, ate_m off the truth.
    """

    key: str
    title: str
    laid: Grid
    odometry: PlanarTrajectory
    mapped: Grid
    trajectory: PlanarTrajectory
    ate_m: float | None


def demo_page(verdict: CheckReport, sides: tuple[MappedSide, MappedSide]) -> str:
    """The whole page."""
    lead = (
        "One drive, one recording. The rays of its lidar start where the laser is, but keep their "
        "directions in the world while the robot turns. "
        f"slamsim check says: {headline(verdict)}"
    )
    laid_m = _limits_m([(side.laid, side.odometry) for side in sides])
    mapped_m = _limits_m([(side.mapped, side.trajectory) for side in sides])
    laid = [
        figure(_map(side.laid, side.odometry, f"laid-{side.key}", laid_m), side.title)
        for side in sides
    ]
    mapped = [
        figure(
            _map(side.mapped, side.trajectory, f"mapped-{side.key}", mapped_m),
            f"{side.title}: {_off(side)}",
        )
        for side in sides
    ]
    body = (
        cards([Card(side.title, _off(side), "SLAM's position error, RMSE") for side in sides])
        + section("Scans placed by wheel odometry", pair(laid, paper=True))
        + section("Map by SLAM", pair(mapped, paper=True))
        + section("The verdict", "".join(map(wrong, verdict.faults)))
    )
    return page("The rotation bug", lead, body, _FOOTER)


def _off(side: MappedSide) -> str:
    if side.ate_m is None:
        return "not known"
    return f"{side.ate_m:.2f} m" if side.ate_m >= 0.1 else f"{1e3 * side.ate_m:.2g} mm"


def _limits_m(drawn: Sequence[tuple[Grid, PlanarTrajectory]]) -> FloatArray:
    """(2, 2) least and largest x and y of all of them: panels beside each other share axes."""
    points = [cell_centres(grid, occupied(grid)) for grid, _ in drawn]
    points += [path.poses[:, :2] for _, path in drawn]
    every = np.concatenate([*points, np.zeros((1, 2))])
    return np.array([every.min(axis=0) - _MARGIN_M, every.max(axis=0) + _MARGIN_M])


def _map(grid: Grid, trajectory: PlanarTrajectory, key: str, limits_m: FloatArray) -> Picture:
    """limits_m: (2, 2) of the axes."""
    walls = cell_centres(grid, occupied(grid))
    with rc_context(STYLE):
        drawn = Figure(figsize=(4.6, 4.6), layout="constrained")
        axes = drawn.add_subplot()
        axes.plot(walls[:, 0], walls[:, 1], "s", color=INK, markersize=0.9, rasterized=True)
        path = trajectory.poses[:: max(len(trajectory) // 2000, 1)]
        axes.plot(path[:, 0], path[:, 1], color=ESTIMATE, linewidth=0.9)
        axes.set_xlim(*limits_m[:, 0])
        axes.set_ylim(*limits_m[:, 1])
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        return Picture(svg(drawn, key), (("walls", INK), ("path", ESTIMATE)))


def extent_m(sides: tuple[MappedSide, ...]) -> tuple[float, float, float]:
    """(x, y, size) of a square that holds the paths of all of them."""
    points = np.concatenate([side.trajectory.poses[:, :2] for side in sides])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    return float(middle[0]), float(middle[1]), float(max((high - low).max(), 1.0))
