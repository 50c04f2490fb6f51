"""The folder of a run, as it is used from Python."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamsim.console.summary import summary
from slamsim.core.geometry import compose, inverse
from slamsim.core.types import FloatArray, Grid, PlanarTrajectory
from slamsim.guard.errors import NotFound
from slamsim.guard.files import own_file, read_input
from slamsim.io import LOG
from slamsim.io.text.tum import read_tum
from slamsim.report.figures.palette import ESTIMATE
from slamsim.report.figures.palette import ODOMETRY as ALONE
from slamsim.report.figures.palette import TRUTH as TRUE
from slamsim.run.folder import ODOMETRY, REPORT_JSON, TRAJECTORY, TRUTH
from slamsim.world.map_server import read_map

if TYPE_CHECKING:
    from os import PathLike

MAP_FILES = ("map.yaml", "map.png")
_COLOURS = {"odometry alone": ALONE, "estimate": ESTIMATE, "truth": TRUE}
_MOST_POINTS = 4000
"""Of a path in a notebook; 100 kB."""


class Run:
    """The folder of a run, as ``map``, ``localise`` and ``simulate`` return it.

    ``Run("outputs/labyrinth")`` opens that of an earlier one. Files are read when they are asked
    for; what this run does not have raises NotFound. In a notebook it shows map and paths.
    """

    def __init__(self, folder: str | PathLike[str]) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise NotFound(f"{self.folder}: no such run")

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r})"

    @property
    def recording(self) -> Path:
        """The simulated recording, a rosbag2 folder; not there if a recording was mapped."""
        return self._file(f"{LOG}/metadata.yaml").parent

    @cached_property
    def trajectory(self) -> PlanarTrajectory:
        """``T_map_base`` at the stamp of each scan used."""
        return self._path(TRAJECTORY)

    @cached_property
    def odometry(self) -> PlanarTrajectory:
        """``T_odom_base`` at the same stamps, by the odometry of the recording alone."""
        return self._path(ODOMETRY)

    @cached_property
    def truth(self) -> PlanarTrajectory:
        """The true ``T_map_base`` of a simulated recording, in the frame of its world."""
        return self._path(TRUTH)

    @cached_property
    def grid(self) -> Grid:
        """The map as written for ROS map_server: 1 occupied, 0 free, ``nan`` unknown."""
        return read_map(self._file(MAP_FILES[0]))

    @cached_property
    def report(self) -> dict[str, object]:
        """The numbers of ``report.json``: scores, warnings, events, times."""
        found: dict[str, object] = json.loads(read_input(self._file(REPORT_JSON), "json_bytes"))
        return found

    def _repr_html_(self) -> str:
        numbers = self.report if self._has(REPORT_JSON) else {}
        rows = "".join(
            f'<tr><td style="text-align:left">{escape(name)}</td>'
            f'<td style="text-align:left">{escape(value)}</td></tr>'
            for name, value in summary(numbers).items()
        )
        return f"<p><b>{escape(str(self.folder))}</b></p>{self._picture()}<table>{rows}</table>"

    def _picture(self) -> str:
        """Map and paths as SVG in metres, y up; the true path alone where nothing was mapped."""
        paths = self._paths()
        low_m, high_m = _extent(paths.values())
        image = ""
        if self._has(MAP_FILES[0]):
            cells = self.grid
            corner_m = np.array(cells.origin_m)
            size_m = np.array(cells.occupancy.shape[::-1]) * cells.resolution_m
            png = b64encode(read_input(self._file(MAP_FILES[1]), "image_file_bytes")).decode()
            image = (
                f"<image {_box(corner_m, size_m, ('x', 'y', 'width', 'height'))} "
                f'style="image-rendering:pixelated" href="data:image/png;base64,{png}"/>'
            )
            low_m = np.minimum(low_m, corner_m)
            high_m = np.maximum(high_m, corner_m + size_m)
        return _svg(paths, low_m, high_m, image)

    def _paths(self) -> dict[str, FloatArray]:
        """(n, 2) points by name; odometry begins where the estimate does."""
        if not self._has(TRAJECTORY):
            return {"truth": self.truth.poses[:, :2]}
        estimate, odometry = self.trajectory.poses, self.odometry.poses
        alone = compose(compose(estimate[0], inverse(odometry[0])), odometry)
        return {"odometry alone": alone[:, :2], "estimate": estimate[:, :2]}

    def _has(self, name: str) -> bool:
        return own_file(self.folder, name).is_file()

    def _file(self, name: str) -> Path:
        file = own_file(self.folder, name)
        if not file.is_file():
            raise NotFound(f"{self.folder}: this run has no {name}")
        return file

    def _path(self, name: str) -> PlanarTrajectory:
        return read_tum(self._file(name)).planar()


def _extent(paths: Iterable[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner in metres of what holds all points, with half a metre around."""
    points = np.concatenate(list(paths))
    return points.min(axis=0) - 0.5, points.max(axis=0) + 0.5


def _box(corner_m: FloatArray, size_m: FloatArray, names: Sequence[str]) -> str:
    """As attributes of an SVG element, whose y points down."""
    numbers = (corner_m[0], -corner_m[1] - size_m[1], *size_m)
    return " ".join(f'{name}="{x:.3f}"' for name, x in zip(names, numbers, strict=True))


def _svg(paths: Mapping[str, FloatArray], low_m: FloatArray, high_m: FloatArray, image: str) -> str:
    lines = "".join(
        f'<polyline fill="none" stroke="{_COLOURS[name]}" stroke-width="1.5" '
        f'vector-effect="non-scaling-stroke" points="{_points(path)}"/>'
        for name, path in paths.items()
    )
    legend = " ".join(
        f'<span style="color:{_COLOURS[name]}">&#9644;</span> {name}' for name in paths
    )
    width_m, height_m = (high_m - low_m).tolist()
    return (
        f'<svg viewBox="{low_m[0]:.3f} {-high_m[1]:.3f} {width_m:.3f} {height_m:.3f}" '
        f'style="width:100%;max-width:640px;max-height:480px;background:#cdcdcd">'
        f"{image}{lines}</svg><p>{legend}; the picture is {width_m:.1f} m wide</p>"
    )


def _points(path_m: FloatArray) -> str:
    step = 1 + len(path_m) // _MOST_POINTS
    return " ".join(f"{x:.2f},{-y:.2f}" for x, y in path_m[::step].tolist())
