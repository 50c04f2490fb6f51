"""Where a camera sits on a robot, from motions of both alone: a start for the whole fit.

Two sightings of one tag tell how the camera moved, the path how the base did (Tsai & Lenz 1989).
Robots in the plane turn about one axis: that axis in the camera tells roll and pitch, and the rest
is linear in x, y, and cosine and sine of yaw (Andreff, Horaud & Espiau 2001). The height is not
told.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.core.geometry import between, rotation
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import NoSolution
from slamsim.perception.calibration.path import SmoothPath
from slamsim.perception.calibration.sightings import TagViews

LEAST_TURN_RAD = 0.1
"""Between two sightings; poses of tags err by some hundredths of a radian."""
PAIRS_OF_A_SIGHTING = 6
FEWEST_PAIRS = 12
ROUNDS = 10
"""In which pairs count the less the worse they fit: tags are seen tilted the wrong way."""
LEAST_SCATTER = 0.01
"""Of a pair, m and rad, so that none that happens to fit outweighs the others. By a sweep over four
drives that see a fifth of the tags tilted the wrong way: starts are within 13 mm for 0.01 and 0.03,
within 28 for 0.001, 51 for 0.3 and 444 for 1."""


def mount_by_motions(views: TagViews, path: SmoothPath, height_m: float) -> FloatArray:
    """(4, 4) T_base_camera of the optical frame; height_m: its z.

    Raises NoSolution where tags are seen during too few turns.
    """
    here, there = _pairs(views)
    poses, _ = path.at(path.seconds(views.stamps_ns))
    steps = between(poses[here], poses[there])
    turns = np.abs(steps[:, 2]) > LEAST_TURN_RAD
    here, there, steps = here[turns], there[turns], steps[turns]
    if len(steps) < FEWEST_PAIRS:
        raise NoSolution("the robot turned too little while tags were seen")
    T = views.T_camera_tag[here, 0] @ np.linalg.inv(views.T_camera_tag[there, 0])
    axis = _axis(Rotation.from_matrix(T[:, :3, :3]).as_rotvec(), steps[:, 2])
    level = Rotation.align_vectors([[0.0, 0.0, 1.0]], [axis])[0].as_matrix()
    x, y, cos, sin = _planar(T[:, :3, 3] @ level.T, steps)
    mount = np.eye(4)
    mount[:3, :3] = rotation(np.arctan2(sin, cos)) @ level
    mount[:3, 3] = x, y, height_m
    return mount


def _pairs(views: TagViews) -> tuple[IntArray, IntArray]:
    """(p,) and (p,) numbers of sightings of the same tag, some near in time and some far."""
    here, there = [], []
    for tag in np.unique(views.numbers):
        mine = np.flatnonzero(views.numbers == tag)
        for apart in np.unique(
            np.geomspace(1, max(len(mine) - 1, 1), PAIRS_OF_A_SIGHTING, dtype=int)
        ):
            here.append(mine[:-apart])
            there.append(mine[apart:])
    return np.concatenate(here), np.concatenate(there)


def _axis(turns: FloatArray, yaws_rad: FloatArray) -> FloatArray:
    """(3,) about which a camera turns when its base turns to the left."""
    told = turns / yaws_rad[:, None]
    found = np.median(told, axis=0)
    for _ in range(ROUNDS):
        off = np.linalg.norm(told - found, axis=1) * np.abs(yaws_rad)
        weights = np.square(yaws_rad) / (np.square(off) + LEAST_SCATTER**2)
        found = weights @ told / weights.sum()
    return np.asarray(found / np.linalg.norm(found))


def _planar(shifts_m: FloatArray, steps: FloatArray) -> FloatArray:
    """(4,) x, y, cos, sin: ``(R - 1) (x, y) - Rz (shift) = -step`` of each pair.

    shifts_m: (p, 3) of the camera, level. steps: (p, 3) of the base.
    """
    cos, sin = np.cos(steps[:, 2]) - 1.0, np.sin(steps[:, 2])
    p, q = shifts_m[:, 0], shifts_m[:, 1]
    rows = np.stack([np.column_stack([cos, -sin, -p, q]), np.column_stack([sin, cos, -q, -p])], 1)
    wanted = -steps[:, :2]
    weights = np.ones(len(steps))
    for _ in range(ROUNDS):
        A, b = (weights[:, None, None] * rows).reshape(-1, 4), (weights[:, None] * wanted).ravel()
        found = np.linalg.lstsq(A, b, rcond=None)[0]
        off = np.linalg.norm(rows @ found - wanted, axis=1)
        weights = 1.0 / np.sqrt(np.square(off) + LEAST_SCATTER**2)
    return np.asarray(found)
