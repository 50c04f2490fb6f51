"""Key frames and submaps of a robot that stands here and there in a given world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from simulated import true_ranges

from slamsim.config.back_end import KeyframeConfig
from slamsim.core.types import FloatArray, PlanarTrajectory, Scan, ScanGeometry
from slamsim.slam.closures.submaps import Submap, Surfaces, make_submap
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.frontend.keyframes import Keyframe, KeyframeMaker
from slamsim.slam.frontend.tracking import Tracked
from slamsim.slam.matching.base import Match
from slamsim.slam.matching.surfaces import surface_pieces

FLASH = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(0.5), 541, 0, 0.1, 20.0)
EVERY_SCAN = KeyframeConfig(travel_m=1e-6, turn_deg=1e-6)
INFORMATION = np.diag([1e5, 1e5, 1e6])


def tracked(
    walls: FloatArray, pose: FloatArray, number: int, noise_m: float = 0.01, lost: bool = False
) -> Tracked:
    """What the front end would tell of a scan taken at a pose, with no drift."""
    stamp_ns = number * 1_000_000_000
    here = PlanarTrajectory(np.array([stamp_ns, stamp_ns + 1]), np.stack([pose, pose]))
    ranges = true_ranges(walls, here, stamp_ns, FLASH)
    ranges += np.random.default_rng(number).normal(0.0, noise_m, ranges.size)
    scan = Scan(stamp_ns, ranges.astype(np.float32), FLASH)
    cloud = deskew(scan, here, stamp_ns, np.eye(4))
    match = None if lost else Match(pose, INFORMATION, 0.9, 0.9, np.zeros((0, 3)))
    information = np.zeros((3, 3)) if lost else INFORMATION
    pieces = surface_pieces(cloud, noise_m, 0.25, 20.0)
    return Tracked(stamp_ns, pose, pose, match, information, cloud, pieces, True)


def keyframes(walls: FloatArray, poses: FloatArray, first: int = 0) -> list[Keyframe]:
    """One key frame at each pose (n, 3)."""
    maker = KeyframeMaker(EVERY_SCAN, 20.0)
    made = [maker.make(tracked(walls, pose, first + k)) for k, pose in enumerate(poses)]
    return [keyframe for keyframe in made if keyframe is not None]


def submap(walls: FloatArray, poses: FloatArray, anchor: int = 0, first: int = 0) -> Submap:
    """The submap of key frames at some poses."""
    members: Sequence[Keyframe] = keyframes(walls, poses, first)
    return make_submap(members, anchor, Surfaces(), 0.01)


def straight(start: FloatArray, length_m: float, count: int) -> FloatArray:
    """(count, 3) poses along the heading of the first."""
    along = np.linspace(0.0, length_m, count)
    heading = [np.cos(start[2]), np.sin(start[2])]
    return np.column_stack([start[:2] + along[:, None] * heading, np.full(count, start[2])])
