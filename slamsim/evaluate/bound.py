"""The best that any estimator could do on a run: Cramer-Rao bounds of its trajectory.

Three bounds, each for an estimator that makes the best of every reading:

* ``scan``: each scan alone, against walls that are perfectly known.
* ``localisation``: all scans and the odometry between them, walls perfectly known.
* ``ate``: as SLAM has it: the walls are unknown as well, each straight face in its two
  coordinates, and only the shape of the trajectory counts, as after the alignment of the ATE.

All are linear in the errors, which are small against the walls. Taken as given, so that the
bounds lie rather too low than too high: the robot moves in the plane; which face each beam meets;
that faces are straight; clocks, mounting, the noise of the sensors, the bias of the gyroscope and
the calibration of the wheels; the motion within a group of neighbouring scans. Beams that see two
surfaces (mixed pixels) count as clean ones, and lost beams as what they would have told on
average; ``mixed_share`` and ``lost_share`` tell how many these are. On the other side, what the
places of jumps between beams tell is not counted, as in all bounds of this kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array

from slamsim.config.lidar import LidarConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import between
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory
from slamsim.evaluate.bound_odometry import BoundOdometryNoise, odometry_noise, rolled_between
from slamsim.evaluate.bound_scans import ScanInformation, scan_information
from slamsim.evaluate.bound_solve import Blocks, draws
from slamsim.evaluate.bound_walls import wall_faces
from slamsim.guard.numbers import (
    FINITE,
    require_covariances,
    require_finite,
    require_number,
    require_rigid,
    require_stamps,
)

BEAMS_CAST = 270
DRAWS = 200
"""Of whole trajectories with their walls: their mean ATE is exact to two per cent or so."""

LOCALISED_DRAWS = 40
"""Of trajectories in a known map, where errors far apart are independent."""

LEAST_ROLLED_M = 0.5
"""The shape of a shorter trajectory is nothing to bound."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanBound:
    """What single scans can tell at best, along the path: stamps_ns (n,).

    worst_m: (n,) standard deviation along the direction that the walls hold least.
    worst_direction_rad: (n,) that direction, in the map for the true walls. position_m: (n,) RMS
    of both directions. heading_rad: (n,).
    """

    stamps_ns: IntArray
    worst_m: FloatArray
    worst_direction_rad: FloatArray
    position_m: FloatArray
    heading_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryBound:
    """ate_m: expected ATE RMSE. localisation_m, localisation_rad: RMS error of all poses.

    scans: each scan alone. lost_share: of the beams on walls, those that get lost by chance.
    mixed_share: those that straddle an edge.
    """

    ate_m: float
    localisation_m: float
    localisation_rad: float
    scans: ScanBound
    lost_share: float
    mixed_share: float

    @property
    def scan_m(self) -> float:
        """Median error of the position from one scan."""
        return float(np.median(self.scans.position_m))

    @property
    def scan_rad(self) -> float:
        """Median error of the heading from one scan."""
        return float(np.median(self.scans.heading_rad))


def trajectory_bound(
    outline_m: FloatArray,
    truth: PlanarTrajectory,
    wheels: PlanarTrajectory,
    T_base_laser: FloatArray,
    sensors: SensorsConfig,
    track_m: float,
) -> TrajectoryBound | None:
    """Bounds of a run; None where there is nothing to bound: no lidar, no walls, no motion.

    outline_m: (n, 2, 2) true walls at the lidar's height as directed segments, the solid on the
    left. truth: ``T_map_base``. wheels: ``T_odom_base`` of the wheels at the scans' stamps, those
    scans that the bounds are for. track_m: between the wheels. Raises BadNumbers.
    """
    require_finite("the true walls", outline_m, (None, 2, 2))
    require_rigid("T_base_laser", T_base_laser)
    require_number("the track in m", track_m, 0.0)
    wheels = _whole_scans(wheels, truth, sensors.lidar)
    walls = wall_faces(outline_m)
    if not (sensors.lidar.enabled and len(walls) and len(wheels) > 1):
        return None
    poses = truth.at(wheels.stamps_ns)
    if rolled_between(poses, track_m).sum() < LEAST_ROLLED_M:
        return None
    groups = group_scans(wheels.stamps_ns, poses, track_m)
    cast_ns = wheels.stamps_ns[groups.cast]
    stride = max(1, sensors.lidar.beam_count // BEAMS_CAST)
    scans = scan_information(walls, truth, cast_ns, T_base_laser, sensors.lidar, stride)
    noise = odometry_noise(truth, wheels, sensors, track_m)
    known, joint = joint_information(groups, scans, poses[groups.cast], noise)
    rng = np.random.default_rng(0)
    located = _of_poses(draws(known, LOCALISED_DRAWS, rng), groups)
    mapped = _of_poses(draws(joint, DRAWS, rng), groups)
    share = groups.counts / groups.counts.sum()
    beams = max(scans.returns + scans.lost, 1.0)
    return TrajectoryBound(
        ate_m=float(aligned_rmse_m(mapped[:, :2], groups.poses[:, :2], share).mean()),
        localisation_m=float(np.sqrt((share @ np.square(located[:, :2]).sum(axis=1)).mean())),
        localisation_rad=float(np.sqrt((share @ np.square(located[:, 2])).mean())),
        scans=scan_bound(cast_ns, scans.pose),
        lost_share=scans.lost / beams,
        mixed_share=scans.mixed / beams,
    )


def _whole_scans(
    wheels: PlanarTrajectory, truth: PlanarTrajectory, lidar: LidarConfig
) -> PlanarTrajectory:
    """At those scans whose beams the truth covers from the first to the last."""
    duration_ns = lidar.beam_dt_ns * (lidar.beam_count - 1)
    if not len(truth):
        return PlanarTrajectory(truth.stamps_ns, truth.poses)
    inside = wheels.stamps_ns >= truth.stamps_ns[0]
    inside &= wheels.stamps_ns + duration_ns <= truth.stamps_ns[-1]
    return PlanarTrajectory(wheels.stamps_ns[inside], wheels.poses[inside])


def aligned_rmse_m(errors_m: FloatArray, points_m: FloatArray, share: FloatArray) -> FloatArray:
    """(d,) RMS of small errors (k, 2, d) of points (k, 2) after the rigid alignment that makes it
    least, to first order; share: (k,) weights that add up to one."""
    arm = points_m - share @ points_m
    across = np.column_stack([-arm[:, 1], arm[:, 0]])
    errors_m = errors_m - np.tensordot(share, errors_m, axes=1)
    turn = np.einsum("k,ki,kid->d", share, across, errors_m) / (share @ np.square(arm).sum(axis=1))
    left_m = errors_m - across[:, :, None] * turn
    return np.asarray(np.sqrt(np.einsum("k,kid->d", share, left_m * left_m)))


def _of_poses(drawn: FloatArray, groups: Groups) -> FloatArray:
    """(k, 3, draws): the walls are no concern here."""
    return drawn[: 3 * len(groups)].reshape(len(groups), 3, -1)


def scan_bound(stamps_ns: IntArray, information: FloatArray) -> ScanBound:
    """What information (n, 3, 3) of single scans about x, y and yaw amounts to; a direction that
    nothing holds counts as held to ten metres. worst_direction_rad is in the axes given. Raises
    BadNumbers."""
    require_stamps("scans", stamps_ns)
    shape = (stamps_ns.size, 3, 3)
    require_covariances("the information of scans", information, shape, FINITE)
    covariance = np.linalg.inv(information + POSE_PRIOR)
    values, vectors = np.linalg.eigh(covariance[:, :2, :2])
    return ScanBound(
        stamps_ns=stamps_ns,
        worst_m=np.sqrt(values[:, 1]),
        worst_direction_rad=np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]),
        position_m=np.sqrt(values.sum(axis=1)),
        heading_rad=np.sqrt(covariance[:, 2, 2]),
    )


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
