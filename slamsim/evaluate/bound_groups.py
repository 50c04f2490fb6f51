"""Groups neighbouring scans into one pose each and assembles the information matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array

from slamsim.core.geometry import between
from slamsim.core.types import FloatArray, IntArray
from slamsim.evaluate.bound_odometry import BoundOdometryNoise, rolled_between
from slamsim.evaluate.bound_scans import ScanInformation
from slamsim.evaluate.bound_solve import Blocks

GROUP_M = 0.1
MAX_GROUPS = 3000
SCANS_CAST = 4
"""Of each group; they count for the others."""

WALL_PRIOR = np.eye(2)
"""That a wall lies within a metre and a radian: only so that one seen by a single beam, which
leaves a coordinate open, does not make the matrix singular."""

POSE_PRIOR = np.diag([10.0**-2, 10.0**-2, np.pi**-2])
"""That a pose lies within ten metres and half a turn: for directions that nothing holds."""


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """k groups of scans. poses: (k, 3) ``T_map_base`` of the scan in the middle of each, stamps_ns
    (k,) its stamp, rolled_m (k,) how far the wheels had rolled. counts: (k,) scans. cast: (c,)
    which scans stand for all, with their group (c,) and for how many scans each counts (c,)."""

    poses: FloatArray
    stamps_ns: IntArray
    rolled_m: FloatArray
    counts: IntArray
    cast: IntArray
    cast_group: IntArray
    cast_count: FloatArray

    def __len__(self) -> int:
        return len(self.counts)


def group_scans(stamps_ns: IntArray, poses: FloatArray, track_m: float) -> Groups:
    """Scans (n,), poses (n, 3) ``T_map_base``; a group ends where the wheels rolled far enough."""
    rolled_m = np.concatenate([[0.0], np.cumsum(rolled_between(poses, track_m))])
    size_m = max(GROUP_M, float(rolled_m[-1]) / MAX_GROUPS)
    begin = np.unique(np.floor(rolled_m / size_m), return_index=True)[1]
    counts = np.diff(np.append(begin, len(poses)))
    middle = begin + counts // 2
    used = np.minimum(counts, SCANS_CAST)
    group = np.repeat(np.arange(len(counts)), used)
    place = np.arange(len(group)) - np.repeat(np.cumsum(used) - used, used)
    share = counts / used
    return Groups(
        poses=poses[middle],
        stamps_ns=stamps_ns[middle],
        rolled_m=rolled_m[middle],
        counts=counts,
        cast=begin[group] + np.floor((place + 0.5) * share[group]).astype(np.int64),
        cast_group=group,
        cast_count=share[group],
    )


def joint_information(
    groups: Groups, scans: ScanInformation, cast_poses: FloatArray, noise: BoundOdometryNoise
) -> tuple[csc_array, csc_array]:
    """Of all poses with walls known, and of all poses and then all walls that were met.

    scans: of the groups' ``cast`` scans, whose poses (c, 3) are cast_poses. Steps of poses are
    (x, y) in map axes and yaw, three rows for each group; walls have two rows each.
    """
    met, wall_number = np.unique(scans.face, return_inverse=True)
    size = 3 * len(groups)
    known, joint = Blocks(size), Blocks(size + 2 * len(met))
    carry = lever(cast_poses[:, :2] - groups.poses[groups.cast_group, :2])
    counted = np.swapaxes(carry, 1, 2) * groups.cast_count[:, None, None]
    pose_rows = 3 * groups.cast_group
    every_pose = 3 * np.arange(len(groups))
    for blocks in (known, joint):
        blocks.add(every_pose, every_pose, np.tile(POSE_PRIOR, (len(groups), 1, 1)))
        blocks.add(pose_rows, pose_rows, counted @ scans.pose @ carry)
        _add_odometry(blocks, groups, noise)
    wall_rows = size + 2 * wall_number
    joint.add(pose_rows[scans.scan], wall_rows, counted[scans.scan] @ scans.cross)
    joint.add(wall_rows, wall_rows, groups.cast_count[scans.scan, None, None] * scans.wall)
    every_wall = size + 2 * np.arange(len(met))
    joint.add(every_wall, every_wall, np.tile(WALL_PRIOR, (len(met), 1, 1)))
    return known.matrix(), joint.matrix()


def lever(arm_m: FloatArray) -> FloatArray:
    """(n, 3, 3): the step of a point (n, 2) away that is rigidly carried along, in map axes."""
    carry = np.tile(np.eye(3), (len(arm_m), 1, 1))
    carry[:, 0, 2], carry[:, 1, 2] = -arm_m[:, 1], arm_m[:, 0]
    return carry


def _add_odometry(blocks: Blocks, groups: Groups, noise: BoundOdometryNoise) -> None:
    before, after = groups.poses[:-1], groups.poses[1:]
    information = np.asarray(np.linalg.inv(_step_covariances(groups, noise)), dtype=np.float64)
    carry = lever(after[:, :2] - before[:, :2])
    back = np.swapaxes(carry, 1, 2)
    rows = 3 * np.arange(len(groups))
    blocks.add(rows[:-1], rows[:-1], back @ information @ carry)
    blocks.add(rows[1:], rows[1:], information)
    blocks.add(rows[:-1], rows[1:], -back @ information)


def _step_covariances(groups: Groups, noise: BoundOdometryNoise) -> FloatArray:
    """(k - 1, 3, 3) of the step from each group to the next, in map axes."""
    step = between(groups.poses[:-1], groups.poses[1:])
    heading = groups.poses[:-1, 2] + np.arctan2(step[:, 1], step[:, 0])
    turn = np.tile(np.eye(3), (len(step), 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(heading)
    turn[:, 1, 0] = np.sin(heading)
    turn[:, 0, 1] = -turn[:, 1, 0]
    own = noise.covariances(
        np.diff(groups.rolled_m),
        np.hypot(step[:, 0], step[:, 1]),
        np.diff(groups.stamps_ns) * 1e-9,
    )
    return np.asarray(turn @ own @ np.swapaxes(turn, 1, 2))
