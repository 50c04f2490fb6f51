"""Moving parts of a recording: the transform tree and the scans."""

from __future__ import annotations

import numpy as np
import rerun as rr

from slamsim.core.geometry import compose, inverse, se3_from_se2, xyzw_from_matrix, xyzw_from_yaw
from slamsim.core.types import Float32Array, FloatArray, IntArray, Scan
from slamsim.report.figures.palette import ESTIMATE, SCAN, rgb
from slamsim.report.run_view import RunView, thinned

MAX_POSES = 40_000
MAX_SCANS = 2_500
MAX_BEAMS = 400
SCAN_HEIGHT_M = 0.04
"""Above the map, so that points are not hidden by its surface."""

MAP, ODOM, BASE, LASER, TRUTH = "map", "odom", "base_footprint", "laser", "truth"


SIMULATED_TIME, RECORDED_TIME = "sim_time", "time"


def timeline(view: RunView) -> str:
    """``sim_time`` of a simulation, else ``time``."""
    return SIMULATED_TIME if view.log.epoch == "simulation" else RECORDED_TIME


def time_column(view: RunView, stamps_ns: IntArray) -> rr.TimeColumn:
    """The clock of a recording whose stamps count from 1970, else the time since the beginning,
    exact to the nanosecond.

    stamps_ns: (n,).
    """
    if view.log.epoch == "unix":
        instants = np.asarray(stamps_ns).astype("datetime64[ns]")
        return rr.TimeColumn(timeline(view), timestamp=instants)
    since = (np.asarray(stamps_ns) - view.begin_ns).astype("timedelta64[ns]")
    return rr.TimeColumn(timeline(view), duration=since)


def laser_frame(view: RunView) -> str:
    """The log's own name for it, unless the tree uses that name for something else."""
    first = next(iter(view.log.scans), None)
    name = LASER if first is None else first.geometry.frame_id.strip("/")
    return LASER if name in ("", MAP, ODOM, BASE, TRUTH) or name.startswith("tf#") else name


def log_transforms(recording: rr.RecordingStream, view: RunView, laser: str) -> None:
    """map -> odom -> base_footprint over time, base_footprint -> laser and map -> truth fixed.

    Until its first pose the robot is shown standing there, so that the tree is always whole.
    """
    trajectory, odometry = view.result.trajectory, view.result.odometry
    pick = thinned(len(trajectory), MAX_POSES)
    stamps_ns = trajectory.stamps_ns[pick]
    stamps_ns[:1] = np.minimum(stamps_ns[:1], view.begin_ns)
    T_map_odom = compose(trajectory.poses[pick], inverse(odometry.poses[pick]))
    for name, parent, child, poses in (
        ("tf/odom", MAP, ODOM, T_map_odom),
        ("tf/base", ODOM, BASE, odometry.poses[pick]),
    ):
        recording.send_columns(
            name,
            [time_column(view, stamps_ns)],
            rr.Transform3D.columns(
                translation=_in_space(poses[:, :2]),
                quaternion=xyzw_from_yaw(poses[:, 2]),
                parent_frame=[parent] * len(pick),
                child_frame=[child] * len(pick),
            ),
        )
    for name, parent, child, T in (
        ("tf/laser", BASE, laser, view.log.T_base_laser),
        ("tf/truth", MAP, TRUTH, se3_from_se2(np.array(view.truth_in_map))),
    ):
        turn = rr.Quaternion(xyzw=xyzw_from_matrix(T[:3, :3]))
        fixed = rr.Transform3D(
            translation=T[:3, 3], quaternion=turn, parent_frame=parent, child_frame=child
        )
        recording.log(name, fixed, static=True)
    log_robot(recording)


def log_robot(recording: rr.RecordingStream) -> None:
    """An arrow and the axes of the base."""
    colour = rgb(ESTIMATE)
    recording.log("robot", rr.CoordinateFrame(BASE), static=True)
    recording.log(
        "robot",
        rr.Arrows3D(origins=[[0, 0, 0.1]], vectors=[[0.6, 0, 0]], radii=0.04, colors=colour),
        static=True,
    )
    recording.log("robot/axes", rr.CoordinateFrame(BASE), rr.TransformAxes3D(0.4), static=True)


def log_scans(recording: rr.RecordingStream, view: RunView, laser: str) -> None:
    """Raw scans as points in the laser frame, so that the transforms carry them about.

    They are drawn at the height of the floor, or else they would not lie on the map when it is
    seen from above in perspective.
    """
    stamps_ns: list[int] = []
    clouds: list[Float32Array] = []
    wanted = _wanted_stamps(view)
    for scan in view.log.scans:
        if scan.stamp_ns in wanted:
            stamps_ns.append(scan.stamp_ns)
            clouds.append(_seen_from_laser(view.log.T_base_laser, scan))
    recording.log("scan", rr.CoordinateFrame(laser), static=True)
    if not clouds:
        return
    recording.log("scan", rr.Points3D.from_fields(radii=0.03, colors=rgb(SCAN)), static=True)
    recording.send_columns(
        "scan",
        [time_column(view, np.array(stamps_ns, dtype=np.int64))],
        rr.Points3D.columns(positions=np.concatenate(clouds)).partition(
            [len(cloud) for cloud in clouds]
        ),
    )


def _seen_from_laser(T_base_laser: FloatArray, scan: Scan) -> Float32Array:
    """(n, 3) ends of beams on the floor, those of other lidars included, in the laser's frame."""
    T_laser_base = np.linalg.inv(T_base_laser)
    clouds = [on_floor(T_base_laser, scan_points(scan))]
    for other in scan.beside:
        T_laser_other = T_laser_base @ other.T_base_laser
        points = scan_points(other.scan) @ T_laser_other[:3, :3].T + T_laser_other[:3, 3]
        clouds.append(on_floor(T_base_laser, points))
    return np.concatenate(clouds)


def _wanted_stamps(view: RunView) -> frozenset[int]:
    """Stamps of the scans to show: of those that have a pose, evenly spread."""
    stamps_ns = view.result.trajectory.stamps_ns
    return frozenset(stamps_ns[thinned(stamps_ns.size, MAX_SCANS)].tolist())


def scan_points(scan: Scan) -> FloatArray:
    """(n, 3) ends of the beams that came back, in the laser frame, thinned."""
    step = max(1, -(-scan.geometry.beam_count // MAX_BEAMS))
    ranges_m, angles_rad = scan.ranges_m[::step], scan.geometry.angles_rad()[::step]
    hit = np.isfinite(ranges_m) & (ranges_m >= scan.geometry.range_min_m)
    ends = ranges_m[hit, None] * np.column_stack([np.cos(angles_rad[hit]), np.sin(angles_rad[hit])])
    return _in_space(ends)


def on_floor(T_base_laser: FloatArray, points_laser: FloatArray) -> Float32Array:
    """(n, 3) the same points moved straight down onto the floor, still in the laser frame."""
    rotation, position = T_base_laser[:3, :3], T_base_laser[:3, 3]
    points_base = points_laser @ rotation.T + position
    points_base[:, 2] = SCAN_HEIGHT_M
    return ((points_base - position) @ rotation).astype(np.float32)


def _in_space(points_m: FloatArray) -> FloatArray:
    """(n, 3): planar points on the floor of their frame."""
    return np.column_stack([points_m, np.zeros(len(points_m))])
