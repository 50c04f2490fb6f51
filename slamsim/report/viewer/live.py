"""A drive in the Rerun viewer while it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import rerun as rr

from slamsim.core.types import FloatArray, Grid, Scan
from slamsim.report.figures.palette import ESTIMATE, ODOMETRY, SCAN, rgb
from slamsim.report.run_view import thinned
from slamsim.report.viewer.blueprint import live_blueprint
from slamsim.report.viewer.run import APPLICATION
from slamsim.report.viewer.scene import MAX_PATH_POINTS, log_lines, log_map
from slamsim.report.viewer.series import Panel
from slamsim.report.viewer.stage import MAP, log_robot, on_floor, scan_points

CURVES: Mapping[str, Panel] = {
    "speed": Panel("speed", "Speed", "m/s", ()),
    "turn": Panel("turn", "Turn rate", "rad/s", ()),
}
"""Of the wheels' odometry, by their keys."""
START_M, GROWING = 5.0, 1.5
"""Width of what is shown before there is a map, and of what is shown then, in sizes of the map: it
is seldom shown anew, for that moves the view from where the user has it."""
_FLUSH_S = 2.0
"""For a viewer that does not read any more; what it has not got by then is lost."""


class LiveScene:
    """What a viewer is sent, with the parts and the layout of a run's recording.

    Not to be used from several threads. Times are those since the first.
    """

    def __init__(self, url: str) -> None:
        """url: where the viewer listens."""
        self._recording = rr.RecordingStream(APPLICATION)
        self._recording.connect_grpc(url)
        self._recording.send_recording_name("live")
        self._show(np.zeros(2), np.full(2, START_M))
        self._begin_ns: int | None = None
        self._laser = ""
        log_robot(self._recording)
        for key in CURVES:
            style = rr.SeriesLines(colors=rgb(ODOMETRY), names="odometry")
            self._recording.log(f"plots/{key}/odometry", style, static=True)

    def at(self, stamp_ns: int) -> None:
        """When that was which follows."""
        if self._begin_ns is None:
            self._begin_ns = stamp_ns
        since = np.timedelta64(stamp_ns - self._begin_ns, "ns")
        self._recording.set_time("sim_time", duration=since)

    def transform(self, parent: str, child: str, T_parent_child: FloatArray, fixed: bool) -> None:
        """T_parent_child: (7,) position in m and quaternion x, y, z, w."""
        moved = rr.Transform3D(
            translation=T_parent_child[:3],
            quaternion=rr.Quaternion(xyzw=T_parent_child[3:]),
            parent_frame=parent,
            child_frame=child,
        )
        self._recording.log(f"tf/{child}", moved, static=fixed)

    def scan(self, scan: Scan, T_base_laser: FloatArray) -> None:
        """Drawn on the floor. T_base_laser: 4 x 4."""
        if scan.geometry.frame_id != self._laser:
            self._laser = scan.geometry.frame_id
            self._recording.log("scan", rr.CoordinateFrame(self._laser), static=True)
        points = on_floor(T_base_laser, scan_points(scan))
        self._recording.log("scan", rr.Points3D(points, radii=0.03, colors=rgb(SCAN)))

    def map(self, grid: Grid) -> None:
        """In the place of the last one. What has outgrown the view is shown anew, from above."""
        log_map(self._recording, "map", grid)
        size_m = np.array(grid.occupancy.shape[::-1]) * grid.resolution_m
        low = np.array(grid.origin_m)
        if (low < self._low).any() or (low + size_m > self._high).any():
            self._show(low + 0.5 * size_m, GROWING * size_m)

    def path(self, points_m: FloatArray) -> None:
        """(n, 2) in the map frame, in the place of the last one."""
        if len(points_m) > 1:
            strip = points_m[thinned(len(points_m), MAX_PATH_POINTS)]
            log_lines(self._recording, "paths/estimate", MAP, [strip], ESTIMATE, 0.025, 0.06)

    def curve(self, key: str, value: float) -> None:
        """The next value of one of ``CURVES``."""
        self._recording.log(f"plots/{key}/odometry", rr.Scalars(value))

    def _show(self, centre: FloatArray, extent_m: FloatArray) -> None:
        self._low, self._high = centre - 0.5 * extent_m, centre + 0.5 * extent_m
        blueprint = live_blueprint(list(CURVES.values()), centre, extent_m)
        self._recording.send_blueprint(blueprint)

    def close(self) -> None:
        """Send what was not sent yet, unless the viewer is gone or does not take it."""
        with suppress(RuntimeError):
            self._recording.flush(timeout_sec=_FLUSH_S)
        self._recording.disconnect()
