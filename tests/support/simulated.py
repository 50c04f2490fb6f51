"""A small labyrinth with exact truth: a closed-form 2-D caster, a smooth drive, noisy wheels.

The shared oracle of the SLAM tests. It knows nothing of the package but its types, and it is slow
and simple on purpose: every beam is intersected with every wall from its own true pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import (
    FloatArray,
    ImuStream,
    IntArray,
    Log,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
)

HOKUYO = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(0.25), 1081, 17_361, 0.1, 30.0)
"""As a UTM-30LX at 40 Hz turns."""

SLOW_HOKUYO = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(0.25), 1081, 69_444, 0.1, 30.0)
"""The same sweep at a tenth of a second a turn: motion distortion four times as large."""


class ScanList:
    """Scans in memory as a ScanSource."""

    def __init__(self, scans: list[Scan]) -> None:
        self._scans = scans

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[Scan]:
        return iter(self._scans)


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """A log and the truth it came from: T_map_base at 200 Hz, walls (k, 4) as x0 y0 x1 y1."""

    log: Log
    truth: PlanarTrajectory
    walls: FloatArray


def box(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """(4, 4) the sides of a rectangle."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])


def labyrinth(seed: int, cells: int = 5, cell_m: float = 2.0) -> tuple[FloatArray, FloatArray]:
    """Walls (k, 4) of 0.1 m thick boxes and a tour (n, 2) of cell centres that visits all."""
    rng = np.random.default_rng(seed)
    open_sides: set[frozenset[tuple[int, int]]] = set()
    tour: list[tuple[int, int]] = []
    seen = set()

    def visit(cell: tuple[int, int]) -> None:
        seen.add(cell)
        tour.append(cell)
        for turn in rng.permutation(4):
            dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
            beside = (cell[0] + dx, cell[1] + dy)
            if beside in seen or not (0 <= beside[0] < cells and 0 <= beside[1] < cells):
                continue
            open_sides.add(frozenset((cell, beside)))
            visit(beside)
            tour.append(cell)

    visit((0, 0))
    walls = [box(-0.1, -0.1, cells * cell_m + 0.1, 0.0)]
    walls.append(box(-0.1, cells * cell_m, cells * cell_m + 0.1, cells * cell_m + 0.1))
    walls.append(box(-0.1, -0.1, 0.0, cells * cell_m + 0.1))
    walls.append(box(cells * cell_m, -0.1, cells * cell_m + 0.1, cells * cell_m + 0.1))
    for i in range(cells):
        for j in range(cells):
            x, y = (i + 1) * cell_m, (j + 1) * cell_m
            right, up = frozenset(((i, j), (i + 1, j))), frozenset(((i, j), (i, j + 1)))
            if i + 1 < cells and right not in open_sides and rng.random() < 0.9:
                walls.append(box(x - 0.05, y - cell_m - 0.05, x + 0.05, y + 0.05))
            if j + 1 < cells and up not in open_sides and rng.random() < 0.9:
                walls.append(box(x - cell_m - 0.05, y - 0.05, x + 0.05, y + 0.05))
    return np.concatenate(walls), (np.array(tour) + 0.5) * cell_m


def drive(
    waypoints: FloatArray, speed_m_s: float = 0.5, max_s: float = 150.0, rest_s: float = 1.5
) -> PlanarTrajectory:
    """T_map_base at 200 Hz of a unicycle that rests, then pursues the points one by one."""
    step_s = 0.005
    goals = waypoints.tolist()
    (x, y), toward = goals[0], waypoints[1] - waypoints[0]
    yaw = math.atan2(toward[1], toward[0])
    poses = [(x, y, yaw)] * round(rest_s / step_s)
    goal, speed, turn = 1, 0.0, 0.0
    while goal < len(goals) and len(poses) * step_s < max_s:
        dx, dy = goals[goal][0] - x, goals[goal][1] - y
        if math.hypot(dx, dy) < 0.35:
            goal += 1
            continue
        error = (math.atan2(dy, dx) - yaw + math.pi) % (2.0 * math.pi) - math.pi
        wanted = speed_m_s * max(0.0, math.cos(error)) ** 3
        speed += _within(wanted - speed, 0.8 * step_s)
        turn += _within(_within(2.5 * error, 1.5) - turn, 4.0 * step_s)
        x += step_s * speed * math.cos(yaw + 0.5 * turn * step_s)
        y += step_s * speed * math.sin(yaw + 0.5 * turn * step_s)
        yaw += turn * step_s
        poses.append((x, y, yaw))
    stamps_ns = np.arange(len(poses), dtype=np.int64) * 5_000_000
    return PlanarTrajectory(stamps_ns, np.array(poses))


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)


@kernel
def _cast(walls: FloatArray, x: float, y: float, angle: float, far: float) -> float:
    dx, dy = np.cos(angle), np.sin(angle)
    best = far
    for k in range(walls.shape[0]):
        ex, ey = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
        across = dx * ey - dy * ex
        if across == 0.0:
            continue
        fx, fy = walls[k, 0] - x, walls[k, 1] - y
        along, share = (fx * ey - fy * ex) / across, (fx * dy - fy * dx) / across
        if 0.0 < along < best and 0.0 <= share <= 1.0:
            best = along
    return best


@kernel
def _sweep(walls: FloatArray, poses: FloatArray, angles: FloatArray, far: float) -> FloatArray:
    ranges = np.empty(angles.size)
    for i in range(angles.size):
        x, y, yaw = poses[i]
        ranges[i] = _cast(walls, x, y, yaw + angles[i], far)
    return ranges


def true_ranges(
    walls: FloatArray, truth: PlanarTrajectory, stamp_ns: int, geometry: ScanGeometry
) -> FloatArray:
    """(beams,) exact ranges of a lidar at the base, each beam from its own pose; inf beyond."""
    poses = truth.at(stamp_ns + geometry.offsets_ns())
    ranges = _sweep(walls, poses, geometry.angles_rad(), geometry.range_max_m)
    return np.where(ranges < geometry.range_max_m, ranges, np.inf)


def sense_scans(
    walls: FloatArray,
    truth: PlanarTrajectory,
    geometry: ScanGeometry,
    noise_m: float,
    seed: int,
    period_ns: int = 100_000_000,
) -> list[Scan]:
    """Scans from the start of the truth to its end, range noise added."""
    rng = np.random.default_rng([seed, 1])
    last_ns = int(truth.stamps_ns[-1]) - geometry.duration_ns
    scans = []
    for stamp_ns in range(int(truth.stamps_ns[0]), last_ns + 1, period_ns):
        ranges = true_ranges(walls, truth, stamp_ns, geometry)
        ranges += rng.normal(0.0, noise_m, ranges.size)
        scans.append(Scan(stamp_ns, ranges.astype(np.float32), geometry))
    return scans


def noisy_wheels(
    truth: PlanarTrajectory, seed: int, scale: float = 1.015, turn_scale: float = 1.04
) -> PlanarTrajectory:
    """T_odom_base at 50 Hz: wheels too large, track wrong, some slip."""
    rng = np.random.default_rng([seed, 2])
    poses = truth.poses[::4]
    step = np.diff(poses, axis=0)
    forward = np.hypot(step[:, 0], step[:, 1])
    turned = (step[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    forward = scale * forward + rng.normal(0.0, 0.03, forward.size) * forward
    turned = turn_scale * turned + rng.normal(0.0, 0.03, turned.size) * np.abs(turned)
    yaw = poses[0, 2] + np.concatenate([[0.0], np.cumsum(turned)])
    mid = yaw[:-1] + 0.5 * turned
    x = poses[0, 0] + np.concatenate([[0.0], np.cumsum(forward * np.cos(mid))])
    y = poses[0, 1] + np.concatenate([[0.0], np.cumsum(forward * np.sin(mid))])
    return PlanarTrajectory(truth.stamps_ns[::4], np.column_stack([x, y, yaw]))


def noisy_gyro(
    truth: PlanarTrajectory, seed: int, bias_rad_s: float = 0.01, noise_rad_s: float = 0.003
) -> ImuStream:
    """A level IMU at 200 Hz whose turn rate has a bias and white noise."""
    rng = np.random.default_rng([seed, 3])
    turned = (np.diff(truth.poses[:, 2]) + np.pi) % (2.0 * np.pi) - np.pi
    seconds = np.diff(truth.stamps_ns) * 1e-9
    rate = np.concatenate([[0.0], turned / seconds])
    rate[:-1] = 0.5 * (rate[:-1] + rate[1:])
    angular = np.zeros((len(truth), 3))
    angular[:, 2] = rate + bias_rad_s + rng.normal(0.0, noise_rad_s, len(truth))
    force = np.zeros((len(truth), 3))
    force[:, 2] = 9.81
    stamps_ns: IntArray = truth.stamps_ns
    return ImuStream(stamps_ns, angular, force)


def simulate(
    walls: FloatArray,
    waypoints: FloatArray,
    seed: int = 0,
    geometry: ScanGeometry = SLOW_HOKUYO,
    noise_m: float = 0.01,
    period_ns: int = 100_000_000,
    gyro: bool = True,
    max_s: float = 150.0,
) -> Simulated:
    """Drive along the points and sense all the way."""
    truth = drive(waypoints, max_s=max_s)
    log = Log(
        name="simulated",
        epoch="simulation",
        scans=ScanList(sense_scans(walls, truth, geometry, noise_m, seed, period_ns)),
        odometry=noisy_wheels(truth, seed),
        imu=noisy_gyro(truth, seed) if gyro else None,
        encoders=None,
        T_base_laser=np.eye(4),
        T_base_imu=np.eye(4) if gyro else None,
    )
    return Simulated(log, truth, walls)


def ate_rmse_m(estimated: PlanarTrajectory, truth: PlanarTrajectory) -> float:
    """Root mean square position error after the best rigid alignment (Umeyama 1991)."""
    true = truth.at(estimated.stamps_ns)[:, :2]
    mine = estimated.poses[:, :2]
    a, b = mine - mine.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.sqrt(np.mean(np.sum(np.square(a @ rotation.T - b), axis=1))))
