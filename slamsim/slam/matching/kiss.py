"""kiss-icp's registration and voxel map behind our interface (Vizzo et al. 2023), in the plane.

kiss-icp says where, not how well: inliers come from a search tree over its map, information and
degenerate directions from the normals of the scan's surface pieces (Censi 2007).
"""

from __future__ import annotations

import numpy as np
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration
from kiss_icp.voxelization import voxel_down_sample
from scipy.spatial import cKDTree

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import (
    between,
    compose,
    se2_from_se3,
    se3_from_se2,
    transform_points,
)
from slamsim.core.types import Cloud, FloatArray
from slamsim.slam.matching.align import typical_range
from slamsim.slam.matching.base import Match
from slamsim.slam.matching.surfaces import (
    NORMAL_X,
    NORMAL_Y,
    SCATTER_XX,
    SCATTER_YY,
    VARIANCE,
    X,
    Y,
    surface_pieces,
)

VOXEL_M = 0.2
"""For indoor ranges: kiss-icp takes a hundredth of the range of a lidar, here 20 m."""
POINTS_PER_VOXEL = 20
NOISE_M = 0.01
"""Standard deviation of a range that is assumed of every lidar: this matcher learns none."""
INLIER_M = 0.1
"""Half a voxel: closer points may be of the same surface."""
COVERED_M = 0.5
"""Beyond two voxels the map has nothing to hold a point against."""
MIN_POINTS = 10
KERNEL_BOUNDS_M = (0.05, 0.5)
"""Of the adaptive kernel: a quarter of a voxel to two and a half."""
SEARCH_TURNS_DEG = (-24.0, -16.0, -8.0, 8.0, 16.0, 24.0)
"""Headings from which registrations begin, so dense that one is at most 4 degrees off."""
MAX_ITERATIONS = 100


class KissMatcher:
    """Point-to-point registration on kiss-icp's voxel map."""

    def __init__(self, config: FrontEndConfig) -> None:
        self._reach_m = config.max_range_m
        self._weak_share = config.matching.weak_direction_share
        self._gate_m = config.matching.gate_m
        # One thread: sums in another order would be other bytes.
        self._registration = Registration(
            max_num_iterations=MAX_ITERATIONS, convergence_criterion=1e-4, max_num_threads=1
        )
        self._voxels = VoxelHashMap(VOXEL_M, self._reach_m, POINTS_PER_VOXEL)
        self._tree: cKDTree | None = None
        self._cached: tuple[Cloud, FloatArray] | None = None

    def pieces(self, cloud: Cloud) -> FloatArray:
        """See ``Matcher.pieces``."""
        if self._cached is None or self._cached[0] is not cloud:
            self._cached = (cloud, self.pieces_of_part(cloud))
        return self._cached[1]

    def pieces_of_part(self, part: Cloud) -> FloatArray:
        """See ``Matcher.pieces_of_part``; nothing is learnt of any cloud."""
        return surface_pieces(part, NOISE_M, 2.0 * VOXEL_M, self._reach_m)

    def match(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """See ``Matcher.match``."""
        pieces = self.pieces(cloud)
        points = self._thin(cloud, 1.5 * VOXEL_M)
        if self._tree is None or len(points) < MIN_POINTS or len(pieces) == 0:
            return None
        reach_m = np.sqrt(np.median(np.sum(points * points, axis=1)))
        doubt_m = np.sqrt(np.trace(prior_covariance[:2, :2]))
        doubt_m += reach_m * np.sqrt(prior_covariance[2, 2])
        kernel_m = float(np.clip(doubt_m, *KERNEL_BOUNDS_M))
        T = self._registration.align_points_to_map(
            points=points,
            voxel_map=self._voxels,
            initial_guess=se3_from_se2(T_map_base_guess),
            max_correspondance_distance=3.0 * kernel_m,
            kernel=kernel_m,
        )
        T_map_base = se2_from_se3(T)
        return self._judge(points[:, :2], pieces, T_map_base_guess, T_map_base)

    def match_part(
        self, part: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """See ``Matcher.match_part``; nothing is learnt of any cloud."""
        return self.match(part, T_map_base_guess, prior_covariance)

    def search(
        self, cloud: Cloud, T_map_base_guess: FloatArray, prior_covariance: FloatArray
    ) -> Match | None:
        """See ``Matcher.search``: registrations from several headings."""
        turns = [np.array([0.0, 0.0, np.deg2rad(turn)]) for turn in SEARCH_TURNS_DEG]
        loose = prior_covariance + np.diag(np.square([self._gate_m, self._gate_m, 0.1]))
        found = [self.match(cloud, compose(T_map_base_guess, turn), loose) for turn in turns]
        good = [match for match in found if match is not None]
        return max(good, key=lambda match: match.fit, default=None)

    def support(self, cloud: Cloud, T_map_base: FloatArray) -> float:
        """See ``Matcher.support``; thinned points stand for pieces."""
        if self._tree is None:
            return 0.0
        points = transform_points(T_map_base, self._thin(cloud, 1.5 * VOXEL_M)[:, :2])
        distance = self._tree.query(points, distance_upper_bound=INLIER_M)[0]
        return float(np.count_nonzero(np.isfinite(distance)))

    def insert(self, cloud: Cloud, T_map_base: FloatArray) -> None:
        """See ``Matcher.insert``."""
        points = self._thin(cloud, 0.5 * VOXEL_M)
        if len(points) == 0:
            return
        self._voxels.update(points, se3_from_se2(T_map_base))
        self._tree = cKDTree(self._voxels.point_cloud()[:, :2])

    def forget(self) -> None:
        """See ``Matcher.forget``."""
        self._voxels = VoxelHashMap(VOXEL_M, self._reach_m, POINTS_PER_VOXEL)
        self._tree = None

    def _thin(self, cloud: Cloud, voxel_m: float) -> FloatArray:
        points = cloud.points_m[cloud.hit]
        points = points[np.hypot(points[:, 0], points[:, 1]) <= self._reach_m]
        if len(points) == 0:
            return np.zeros((0, 3))
        spatial = np.column_stack([points, np.zeros(len(points))])
        return np.asarray(voxel_down_sample(spatial, voxel_m), dtype=np.float64)

    def _judge(
        self, points: FloatArray, pieces: FloatArray, T_guess: FloatArray, T_found: FloatArray
    ) -> Match | None:
        information, weak = _hold(pieces, self._weak_share)
        # kiss-icp slides along what holds nothing; that part of its step is taken back.
        step = between(T_guess, T_found)
        for held_not in weak:
            step = step - held_not * (held_not @ step) / (held_not @ held_not)
        T_map_base = compose(T_guess, step) if len(weak) else T_found
        assert self._tree is not None
        found = self._tree.query(
            transform_points(T_map_base, points), distance_upper_bound=COVERED_M
        )
        distance = np.asarray(found[0])
        covered, inlier = distance < COVERED_M, distance < INLIER_M
        if np.count_nonzero(inlier) < MIN_POINTS or not np.isfinite(T_map_base).all():
            return None
        return Match(
            T_map_base=T_map_base,
            information=information,
            inlier_ratio=float(np.count_nonzero(inlier) / np.count_nonzero(covered)),
            covered_ratio=float(covered.mean()),
            degenerate_directions=weak,
        )


def _hold(pieces: FloatArray, weak_share: float) -> tuple[FloatArray, FloatArray]:
    """Information (3, 3) that the pieces' normals give, and the (k, 3) steps they do not hold."""
    nx, ny = pieces[:, NORMAL_X], pieces[:, NORMAL_Y]
    length = typical_range(pieces)
    lever = (ny * pieces[:, X] - nx * pieces[:, Y]) / length
    rows = np.column_stack([nx, ny, lever])
    # A normal is known only so well: what its noise adds to the grip is none.
    blur = np.mean(np.minimum(NOISE_M**2 / (pieces[:, SCATTER_XX] + pieces[:, SCATTER_YY]), 0.1))
    values, axes = np.linalg.eigh(rows.T @ rows / len(rows) - blur * np.eye(3))
    weak = axes[:, values < weak_share]
    scale = np.array([1.0, 1.0, length])
    # Point to point on voxels of decimetres is not surer than their grain.
    variance = pieces[:, VARIANCE] + NOISE_M**2
    held = (rows / variance[:, None]).T @ rows
    keep = np.eye(3) - weak @ weak.T
    information = scale[:, None] * (keep @ held @ keep) * scale
    return information, np.ascontiguousarray((weak / scale[:, None]).T)
