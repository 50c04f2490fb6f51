"""The Rerun recording of a demonstration: two maps side by side, from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from slamsim.core.types import PlanarTrajectory
from slamsim.report.figures.palette import ESTIMATE
from slamsim.report.pages.demo import MappedSide, extent_m
from slamsim.report.viewer.run import written_recording
from slamsim.report.viewer.scene import log_lines, log_map
from slamsim.report.viewer.stage import MAP

_MARGIN = 1.6
"""Height of the eye over the extent of the scene, so that all of it is seen."""


def write_sides(path: Path, sides: tuple[MappedSide, MappedSide]) -> None:
    """Write the recording; raises what write_atomic raises."""
    with written_recording(path, "-".join(side.key for side in sides)) as recording:
        recording.send_recording_name("The rotation bug")
        recording.log("/", rr.CoordinateFrame(MAP), static=True)
        for side in sides:
            for part, grid, driven in (
                ("laid", side.laid, side.odometry),
                ("mapped", side.mapped, side.trajectory),
            ):
                log_map(recording, f"{part}/{side.key}/map", grid)
                lines = [driven.poses[:, :2]]
                log_lines(recording, f"{part}/{side.key}/path", MAP, lines, ESTIMATE, 0.03, 0.05)
                _log_robot(recording, f"{part}/{side.key}/robot", driven)
        recording.send_blueprint(_side_by_side(sides))


def _log_robot(recording: rr.RecordingStream, entity: str, trajectory: PlanarTrajectory) -> None:
    """Where the robot was, over the time since the first scan."""
    places = np.column_stack([trajectory.poses[:, :2], np.full(len(trajectory), 0.1)])
    since_s = (trajectory.stamps_ns - trajectory.stamps_ns[0]) * 1e-9
    recording.log(entity, rr.CoordinateFrame(MAP), static=True)
    recording.send_columns(
        entity,
        [rr.TimeColumn("sim_time", duration=since_s)],
        rr.Points3D.columns(positions=places, radii=np.full(len(places), 0.15)),
    )


def _side_by_side(sides: tuple[MappedSide, MappedSide]) -> rrb.Blueprint:
    """Above the scans placed by wheel odometry, below the maps; before on the left."""
    x_m, y_m, size_m = extent_m(sides)
    height_m = _MARGIN * size_m
    eye = rrb.EyeControls3D(
        position=(x_m, y_m - 0.001 * height_m, height_m),
        look_target=(x_m, y_m, 0.0),
        eye_up=(0.0, 1.0, 0.0),
    )
    views = [
        rrb.Spatial3DView(
            origin="/",
            name=f"{side.title}: {words}",
            contents=[f"+ /{part}/{side.key}/**"],
            spatial_information=rrb.SpatialInformation(target_frame=MAP),
            line_grid=rrb.LineGrid3D(visible=False),
            background=[250, 250, 250],
            eye_controls=eye,
        )
        for part, words in (("laid", "scans placed by wheel odometry"), ("mapped", "map"))
        for side in sides
    ]
    return rrb.Blueprint(
        rrb.Grid(*views, grid_columns=2),
        rrb.TimePanel(timeline="sim_time", state="collapsed", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
