"""Figures read from a scripted run."""

from __future__ import annotations

import numpy as np

from slamsim.core.types import FloatArray, IntArray, Trajectory
from slamsim.guard.errors import SlamsimError
from slamsim.scenarios.base import BodyMotion, Solid
from slamsim.sim.drive.script import ScriptedRun
from slamsim.sim.robot.model import RobotModel

SHOWN_HZ = 10
SECONDS_OF_CORE = 0.03
"""Per simulated second of a scripted run, about."""


def robot_motion(name: str, run: ScriptedRun, model: RobotModel) -> BodyMotion:
    """What to show of a run."""
    every = max(round(len(run.drive) / max(duration_s(run), 1e-9) / SHOWN_HZ), 1)
    way = run.drive.trajectory()
    thinned = Trajectory(way.stamps_ns[::every], way.positions_m[::every], way.quats_xyzw[::every])
    return BodyMotion(name, Solid("robot", (model.footprint_radius_m, model.height_m)), thinned)


def duration_s(run: ScriptedRun) -> float:
    """From the first recorded step to the last."""
    return float(run.drive.stamps_ns[-1] - run.drive.stamps_ns[0]) * 1e-9


def steps_at(run: ScriptedRun, instants_s: FloatArray) -> IntArray:
    """(m,) the recorded steps at these instants after the start.

    Raises SlamsimError for a run that ended before the last.
    """
    if run.ended:
        raise SlamsimError(f"the run ended after {duration_s(run):.1f} s: {run.ended}")
    since_ns = run.drive.stamps_ns - run.drive.stamps_ns[0]
    steps = np.searchsorted(since_ns, np.rint(instants_s * 1e9))
    return np.asarray(np.minimum(steps, len(since_ns) - 1))


def true_poses(run: ScriptedRun) -> FloatArray:
    """(n, 3) x, y and yaw of all steps; yaw is not wrapped."""
    poses = run.drive.trajectory().planar().poses
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])


def corner_deg(yaws_rad: FloatArray) -> float:
    """Mean turn of the corners. yaws_rad: (16,) after each command; a side and a stop come first.

    From the end of the stop before a corner to the end of the stop after it.
    """
    turned = yaws_rad[3::4] - yaws_rad[1::4]
    return float(np.degrees(np.abs(turned)).mean())
