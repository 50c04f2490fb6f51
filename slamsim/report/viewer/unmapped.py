"""A recording as it is, without a map: its scans where odometry has them."""

from __future__ import annotations

import numpy as np

from slamsim.core.result import PoseGraph, SlamResult
from slamsim.core.types import Grid, Log, PlanarTrajectory
from slamsim.report.run_view import RunView


def unmapped(log: Log) -> RunView:
    """What ``write_recording`` shows of a log that was not mapped.

    Without odometry the robot stands still, and scans are seen from it. Scans before and after
    the odometry are left out; without any scan the whole odometry is shown.
    """
    stamps_ns = np.array([scan.stamp_ns for scan in log.scans], dtype=np.int64)
    path = log.odometry
    if path is not None and not stamps_ns.size:
        stamps_ns = path.stamps_ns
    if path is not None and len(path):
        inside = (stamps_ns >= path.stamps_ns[0]) & (stamps_ns <= path.stamps_ns[-1])
        odometry = PlanarTrajectory(stamps_ns[inside], path.at(stamps_ns[inside]))
    else:
        odometry = PlanarTrajectory(stamps_ns, np.zeros((len(stamps_ns), 3)))
    nothing = PlanarTrajectory(stamps_ns[:0], np.zeros((0, 3)))
    result = SlamResult(
        trajectory=odometry,
        odometry=odometry,
        graph=PoseGraph(nothing, np.zeros((0, 3, 3)), ()),
        match_quality=np.zeros(len(odometry)),
        degenerate=np.zeros(len(odometry), dtype=np.bool_),
        closures_accepted=0,
        closures_rejected=0,
    )
    unseen = Grid(np.full((1, 1), np.nan, dtype=np.float32), 0.05, (0.0, 0.0))
    return RunView(log=log, result=result, grid=unseen)
