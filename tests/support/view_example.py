"""A small made-up run with everything in it, for the tests of what a person sees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from slamsim.core.geometry import (
    between,
    compose,
    inverse,
    transform_points,
    wrap_angle,
    xyzw_from_yaw,
)
from slamsim.core.result import GraphEdge, PoseGraph, SlamResult
from slamsim.core.types import (
    EncoderStream,
    FloatArray,
    Grid,
    ImuStream,
    Log,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
    Trajectory,
    TriangleMesh,
)
from slamsim.evaluate.score import evaluate
from slamsim.report.run_view import RunView

RESOLUTION_M = 0.05
BOXES_M = [  # xmin, ymin, xmax, ymax
    (-0.1, -0.1, 8.1, 0.0),
    (-0.1, 8.0, 8.1, 8.1),
    (-0.1, 0.0, 0.0, 8.0),
    (8.0, 0.0, 8.1, 8.0),
    (2.0, 2.0, 6.0, 6.0),
    (3.0, 0.0, 3.2, 0.5),
    (7.6, 4.0, 8.0, 4.3),
]
GEOMETRY = ScanGeometry(-np.pi, 2 * np.pi / 360, 360, 200_000, 0.1, 6.0, "laser_link")
T_BASE_LASER = np.array([[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0.4], [0, 0, 0, 1.0]])


@dataclass(frozen=True)
class Scans:
    scans: tuple[Scan, ...]

    def __len__(self) -> int:
        return len(self.scans)

    def __iter__(self) -> Iterator[Scan]:
        return iter(self.scans)


def walls_mesh(height_m: float = 1.0) -> TriangleMesh:
    vertices: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for x0, y0, x1, y1 in BOXES_M:
        base = len(vertices)
        for z in (0.0, height_m):
            vertices += [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]
        sides = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
        for a, b, c, d in [*sides, (4, 5, 6, 7), (3, 2, 1, 0)]:
            triangles += [(base + a, base + b, base + c), (base + a, base + c, base + d)]
    return TriangleMesh(np.array(vertices, dtype=float), np.array(triangles, dtype=np.int32))


def true_grid() -> Grid:
    count = round(8.4 / RESOLUTION_M)
    centre = (np.arange(count) + 0.5) * RESOLUTION_M - 0.2
    x, y = np.meshgrid(centre, centre)
    cells = np.full((count, count), np.nan, dtype=np.float32)
    cells[(x > 0) & (x < 8) & (y > 0) & (y < 8)] = 0.0
    for x0, y0, x1, y1 in BOXES_M:
        cells[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = 1.0
    return Grid(cells, RESOLUTION_M, (-0.2, -0.2))


def mapped_grid(truth: Grid, T_map_truth: FloatArray) -> Grid:
    """The true surfaces and free space as a map in the estimate's own frame."""
    from slamsim.evaluate.grid import sample, wall_surface

    seen = np.full(truth.occupancy.shape, np.nan, dtype=np.float32)
    seen[truth.occupancy == 0.0] = 0.03
    seen[wall_surface(truth.occupancy)] = 0.97
    low, count = np.array([-12.0, -12.0]), round(24 / RESOLUTION_M)
    centre = (np.arange(count) + 0.5) * RESOLUTION_M
    x, y = np.meshgrid(low[0] + centre, low[1] + centre)
    points = transform_points(inverse(T_map_truth), np.column_stack([x.ravel(), y.ravel()]))
    cells = sample(Grid(seen, truth.resolution_m, truth.origin_m), points)
    return Grid(cells.reshape(x.shape).astype(np.float32), RESOLUTION_M, (low[0], low[1]))


def driven(duration_s: float, dt_s: float) -> PlanarTrajectory:
    """Twice around the block in the middle, corners rounded."""
    t = np.arange(0.0, duration_s, dt_s)
    angle = 4 * np.pi * t / duration_s - 3 * np.pi / 4
    x = 4 + 3.4 * np.tanh(3 * np.cos(angle)) / np.tanh(3)
    y = 4 + 3.4 * np.tanh(3 * np.sin(angle)) / np.tanh(3)
    yaw = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    stamps_ns = (t * 1e9).astype(np.int64)
    return PlanarTrajectory(stamps_ns, np.column_stack([x, y, wrap_angle(yaw)]))


def ranges(pose: FloatArray, rng: np.random.Generator) -> np.ndarray:
    """Exact distances to the boxes' sides from a laser pose, with 1 cm of noise."""
    angles = pose[2] + GEOMETRY.angles_rad()
    dx, dy = np.cos(angles), np.sin(angles)
    nearest = np.full(angles.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for x0, y0, x1, y1 in BOXES_M:
            tx = np.sort(np.array([(x0 - pose[0]) / dx, (x1 - pose[0]) / dx]), axis=0)
            ty = np.sort(np.array([(y0 - pose[1]) / dy, (y1 - pose[1]) / dy]), axis=0)
            enter, leave = np.maximum(tx[0], ty[0]), np.minimum(tx[1], ty[1])
            hit = (enter < leave) & (enter > 0)
            nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    nearest += rng.normal(0.0, 0.01, nearest.shape)
    return np.where(nearest > GEOMETRY.range_max_m, np.inf, nearest).astype(np.float32)


def drifted(truth: PlanarTrajectory, yaw_rad_s: float, scale: float) -> FloatArray:
    """``T_odom_base`` from motions that are a little too long and turn a little too much."""
    steps = between(truth.poses[:-1], truth.poses[1:])
    dt_s = np.diff(truth.stamps_ns) * 1e-9
    steps = steps * [scale, scale, 1.0] + np.outer(dt_s, [0.0, 0.0, yaw_rad_s])
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


@cache
def example_run(duration_s: float = 40.0, with_truth: bool = True) -> RunView:
    rng = np.random.default_rng(7)
    truth = driven(duration_s, 0.1)
    T_map_truth = inverse(truth.poses[0])
    noise = rng.normal(0.0, 1.0, truth.poses.shape) * [0.005, 0.005, 0.002]
    estimate = PlanarTrajectory(truth.stamps_ns, compose(T_map_truth, truth.poses) + noise)
    odometry = PlanarTrajectory(truth.stamps_ns, drifted(truth, 0.004, 1.01))
    result = SlamResult(
        trajectory=estimate,
        odometry=odometry,
        graph=graph_of(estimate),
        match_quality=np.clip(rng.normal(0.95, 0.02, len(truth)), 0, 1),
        degenerate=(np.arange(len(truth)) % 97) < 6,
        closures_accepted=3,
        closures_rejected=1,
        warnings=("made up <for> a test & nothing else",),
        seconds={"match": 0.8, "graph": 0.2},
    )
    laser = compose(truth.poses, np.array([0.1, 0.0, 0.0]))
    scans = tuple(
        Scan(int(stamp_ns), ranges(pose, rng), GEOMETRY)
        for stamp_ns, pose in zip(truth.stamps_ns, laser, strict=True)
    )
    spatial = Trajectory(
        truth.stamps_ns,
        np.column_stack([truth.poses[:, :2], np.zeros(len(truth))]),
        xyzw_from_yaw(truth.poses[:, 2]),
    )
    grid_truth = true_grid()
    grid = mapped_grid(grid_truth, T_map_truth)
    view = RunView(
        log=Log(
            name="made up <log>",
            epoch="simulation",
            scans=Scans(scans),
            odometry=odometry,
            imu=gyro_of(truth),
            encoders=ticks_of(odometry),
            T_base_laser=T_BASE_LASER,
            T_base_imu=np.eye(4),
            warnings=("2 scans of 400 had no return at all",),
        ),
        result=result,
        grid=grid,
        seconds={"simulate": 1.4, "slam": 1.0, "write": 0.3, "total": 2.9},
        peak_memory_mb=512.0,
        command="slamsim map worlds/example.yaml --seed 3",
        config_yaml="seed: 3\nworld:\n  name: <example>\n",
    )
    if not with_truth:
        return view
    scores = evaluate(estimate, odometry, grid, spatial, grid_truth)
    return replace(view, scores=scores, truth=spatial, walls=walls_mesh(), truth_grid=grid_truth)


def graph_of(estimate: PlanarTrajectory) -> PoseGraph:
    keys = np.arange(0, len(estimate), 10)
    poses, covariance = estimate.poses[keys], np.diag([1e-4, 1e-4, 1e-5])
    edges = [
        GraphEdge(k, k + 1, between(poses[k], poses[k + 1]), covariance, "match")
        for k in range(len(keys) - 1)
    ]
    half = len(keys) // 2
    for part, weight in ((0.0, 1.0), (0.3, 1.0), (0.6, 1.0), (0.9, 0.0)):
        source = int(part * half)
        target = source + (half if weight else half // 2)
        motion = between(poses[source], poses[target])
        edges.append(GraphEdge(source, target, motion, covariance, "closure", weight))
    return PoseGraph(
        PlanarTrajectory(estimate.stamps_ns[keys], poses),
        np.tile(covariance, (len(keys), 1, 1)),
        tuple(edges),
    )


def gyro_of(truth: PlanarTrajectory) -> ImuStream:
    rate = np.gradient(np.unwrap(truth.poses[:, 2]), truth.stamps_ns * 1e-9)
    zero = np.zeros_like(rate)
    return ImuStream(
        truth.stamps_ns,
        np.column_stack([zero, zero, rate]),
        np.column_stack([zero, zero, zero + 9.81]),
    )


def ticks_of(odometry: PlanarTrajectory) -> EncoderStream:
    step = np.linalg.norm(np.diff(odometry.poses[:, :2], axis=0), axis=1)
    turn = np.diff(np.unwrap(odometry.poses[:, 2]))
    rolled = np.column_stack([step - 0.115 * turn, step + 0.115 * turn]) / 0.0352
    ticks = np.vstack([[0, 0], np.cumsum(rolled, axis=0) * 2578 / (2 * np.pi)]).round()
    return EncoderStream(odometry.stamps_ns, ticks.astype(np.int64), 2578, 0.0352, 0.23)
