"""How high the floor is in the frame of the robot whose path is mapped."""

from __future__ import annotations

import numpy as np

from slamsim.config.slam import LayersConfig
from slamsim.guard.errors import SlamsimError
from slamsim.recording import Recording
from slamsim.recording.frames import base_frame_of, footprint_height_m, tree_of, unqualified
from slamsim.sim.robot.urdf import read_description

_DOWN = np.array([0.0, 0.0, -1.0])
_MOST_UPRIGHT = np.sqrt(0.5)
"""Height of a wheel's axis, a unit vector: it lies nearer to level than to upright."""


def floor_of(recording: Recording, config: LayersConfig) -> tuple[float, tuple[str, ...]]:
    """Height of the floor in the base frame, and a warning where it is but assumed."""
    base = base_frame_of(recording)
    if config.floor_m is not None:
        return config.floor_m, ()
    floor_m = footprint_height_m(tree_of(recording.transforms), base)
    if floor_m is not None:
        return floor_m, ()
    below_m = _below_wheels(recording.robot_description, unqualified(base))
    if below_m is not None:
        return below_m, ()
    told = f"heights of obstacles and labels count from {base!r}, for nothing tells how high above"
    return 0.0, (f"{told} the floor it is; mapping.layers.floor_m says so",)


def _below_wheels(urdf: str | None, base: str) -> float | None:
    """Where the lowest wheel ends below; None where a description tells none, or no such base.

    Links that turn without end about an upright axis are lidars and turrets, or hold a caster.
    """
    try:
        robot = read_description(urdf or "", "robot_description", meshes=True)
    except SlamsimError:
        return None
    placed = robot.placements()
    wheels = [
        joint.child
        for joint in robot.joints
        if joint.kind == "continuous"
        and abs(placed[joint.child][2, :3] @ joint.axis) < _MOST_UPRIGHT
    ]
    lowest_m = [
        -shape.reach_m(placed[name], _DOWN)
        for name in wheels
        for shape in robot.links[name].collisions
    ]
    if base not in placed or not lowest_m:
        return None
    return min(lowest_m) - float(placed[base][2, 3])
