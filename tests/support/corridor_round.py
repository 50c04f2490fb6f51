"""A round of 2 km of corridors as a slow lidar without a gyroscope records it, by our own caster.

Independent of the simulator: walls are segments, beams are cast at their own instants, odometry
is the true motion with what wheels do to it.
"""

from __future__ import annotations

import numpy as np
from simulated import true_ranges

from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, Log, PlanarTrajectory, Scan, ScanGeometry
from slamsim.recording.cleaning.scans import StoredScans

LEG_M, WIDTH_M, BEND_M = 200.0, 2.5, 0.9
CORNERS = np.array(
    [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2), (1, 2), (1, 3), (0, 3), (0, 2), (0, 1)], dtype=float
)
"""Of the middle line, in legs; ten legs of 200 m."""

OVERLAP_M, SPEED_M_S, TICK_S = 40.0, 0.6, 0.02
SICK = ScanGeometry(-np.pi / 2, np.pi / 179, 180, 37_037, 0.0, 30.0)
"""Half a turn at 75 Hz."""

RATE_HZ, NOISE_M, STEP_M, OFFSET_M = 2.3, 0.01, 0.01, 0.03
PATH_SCALE, CURVATURE_RAD_PER_M = 0.01, np.deg2rad(0.5)
LASER_X_M = 0.1


def round_of_corridors(seed: int) -> tuple[Log, PlanarTrajectory]:
    """The log and the true ``T_map_base``: from the middle of a leg round to 40 m beyond it."""
    rng = np.random.default_rng(seed)
    walls, truth = _walls(rng), _drive(rng)
    mount = np.eye(4)
    mount[0, 3], mount[2, 3] = LASER_X_M, 0.3
    scans = _scans(rng, walls, truth)
    odometry = _odometry(rng, truth)
    log = Log("round", "simulation", StoredScans(scans), odometry, None, None, mount)
    return log, truth


def _walls(rng: np.random.Generator) -> FloatArray:
    """(k, 4) both sides of the corridor, with doors set back by 8 to 25 cm."""
    corners_m, walls = CORNERS * LEG_M, []
    for side in (1.0, -1.0):
        edge_m = corners_m + np.array([_aside(corners_m, k) for k in range(len(corners_m))]) * side
        for begin, end in zip(edge_m, np.roll(edge_m, -1, axis=0), strict=True):
            length_m = float(np.linalg.norm(end - begin))
            along = (end - begin) / length_m
            outwards = side * np.array([-along[1], along[0]])
            points, at_m = [begin], float(rng.uniform(2.0, 10.0))
            while at_m + 1.2 < length_m - 1.5:
                wide_m, deep_m = rng.uniform(0.8, 1.2), rng.uniform(0.08, 0.25)
                one, two = begin + along * at_m, begin + along * (at_m + wide_m)
                points += [one, one + outwards * deep_m, two + outwards * deep_m, two]
                at_m += wide_m + float(rng.uniform(2.0, 10.0))
            points.append(end)
            walls.append(np.hstack([points[:-1], points[1:]]))
    return np.concatenate(walls)


def _aside(corners_m: FloatArray, k: int) -> FloatArray:
    """From a corner of the middle line to that of the left wall."""
    before, after = (
        corners_m[k] - corners_m[k - 1],
        corners_m[(k + 1) % len(corners_m)] - corners_m[k],
    )
    left = [np.array([-leg[1], leg[0]]) / LEG_M for leg in (before, after)]
    bends = abs(float(before @ after)) < 0.5 * LEG_M**2
    return np.asarray(0.5 * WIDTH_M * (left[0] + left[1] if bends else left[0]))


def _drive(rng: np.random.Generator) -> PlanarTrajectory:
    corners_m = CORNERS * LEG_M
    start = 0.5 * (corners_m[0] + corners_m[1])
    end = start + np.array([OVERLAP_M, 0.0])
    way = _rounded(np.vstack([start, corners_m[1:], corners_m[:1], end]))
    path_m = _path(way)
    even_m = np.arange(0.0, path_m[-1], SPEED_M_S * TICK_S)
    x_m, y_m = np.interp(even_m, path_m, way[:, 0]), np.interp(even_m, path_m, way[:, 1])
    aside_m = 0.25 * np.sin(even_m / 7.0 + rng.uniform(0.0, 6.0))
    aside_m += 0.1 * np.sin(even_m / 2.3 + rng.uniform(0.0, 6.0))
    heading = np.unwrap(np.arctan2(np.gradient(y_m), np.gradient(x_m)))
    x_m, y_m = _smooth(x_m - aside_m * np.sin(heading)), _smooth(y_m + aside_m * np.cos(heading))
    heading = _smooth(np.unwrap(np.arctan2(np.gradient(y_m), np.gradient(x_m))))
    stamps_ns = np.round((1.0 + TICK_S * np.arange(len(x_m))) * 1e9).astype(np.int64)
    return PlanarTrajectory(stamps_ns, np.column_stack([x_m, y_m, heading]))


def _rounded(corners_m: FloatArray) -> FloatArray:
    """(n, 2) points along straight legs and quarter circles."""
    points = [corners_m[:1]]
    for before, here, after in zip(corners_m, corners_m[1:], corners_m[2:], strict=False):
        come, go = (here - before), (after - here)
        come, go = come / np.linalg.norm(come), go / np.linalg.norm(go)
        if abs(come @ go) < 0.5:
            turns = np.linspace(0.0, np.pi / 2, 50)[:, None]
            middle = here - BEND_M * come + BEND_M * go
            points.append(middle - BEND_M * go * np.cos(turns) + BEND_M * come * np.sin(turns))
    return np.concatenate([*points, corners_m[-1:]])


def _path(way_m: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way_m, axis=0).T))])


def _smooth(values: FloatArray) -> FloatArray:
    """A mean over half a metre, which takes the steps out of the heading at bends."""
    width = 41
    padded = np.pad(values, width // 2, mode="reflect", reflect_type="odd")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def _scans(rng: np.random.Generator, walls: FloatArray, truth: PlanarTrajectory) -> list[Scan]:
    laser = PlanarTrajectory(truth.stamps_ns, compose(truth.poses, np.array([LASER_X_M, 0.0, 0.0])))
    middles_m, half_m = (
        0.5 * (walls[:, :2] + walls[:, 2:]),
        0.5 * np.hypot(*(walls[:, 2:] - walls[:, :2]).T),
    )
    scans, stamp_ns = [], int(truth.stamps_ns[0]) + 100_000_000
    while stamp_ns + SICK.duration_ns < truth.stamps_ns[-1]:
        here = laser.at(np.array([stamp_ns]))[0]
        near = np.hypot(*(middles_m - here[:2]).T) - half_m < SICK.range_max_m + 1.0
        ranges_m = true_ranges(walls[near], laser, stamp_ns, SICK)
        ranges_m = ranges_m + rng.normal(OFFSET_M, NOISE_M, len(ranges_m))
        scans.append(
            Scan(stamp_ns, (np.round(ranges_m / STEP_M) * STEP_M).astype(np.float32), SICK)
        )
        stamp_ns += round(1e9 / RATE_HZ * rng.uniform(0.97, 1.03))
    return scans


def _odometry(rng: np.random.Generator, truth: PlanarTrajectory) -> PlanarTrajectory:
    """At 10 Hz, by wheels that are 1 % too small and drive curves of 0.5 degrees a metre."""
    stamps_ns, poses = truth.stamps_ns[::5], truth.poses[::5]
    steps = between(poses[:-1], poses[1:])
    path_m = np.hypot(steps[:, 0], steps[:, 1])
    steps[:, :2] *= 1.0 + PATH_SCALE
    steps[:, 0] += rng.normal(0.0, 0.003, len(steps)) * np.sqrt(path_m)
    steps[:, 2] += CURVATURE_RAD_PER_M * path_m
    steps[:, 2] += rng.normal(0.0, np.deg2rad(0.3), len(steps)) * np.sqrt(path_m)
    driven = [np.zeros(3)]
    for step in steps:
        driven.append(compose(driven[-1], step))
    return PlanarTrajectory(stamps_ns, np.array(driven))
