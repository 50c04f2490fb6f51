"""Degenerate numbers into every solver of SLAM: refused by name, or solved; never in silence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fault_numbers import BAD, Case, cases, each, judge, line, put, refused, right, steps

from slamsim.config.back_end import GraphConfig
from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.core.geometry import between, compose
from slamsim.core.result import GraphEdge
from slamsim.core.types import (
    EncoderStream,
    FloatArray,
    ImuStream,
    Log,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
)
from slamsim.models.differential_drive import wheel_odometry
from slamsim.slam.backend.graph import GraphUnsound, PoseGraphSolver
from slamsim.slam.backend.marginals import relative_covariances
from slamsim.slam.backend.smoothing import Chain, smooth
from slamsim.slam.frontend.deskew import deskew
from slamsim.slam.frontend.motion import log_odometry, predict_motion
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.online.samples import MotionSamples
from slamsim.slam.session import open_session, run_slam

pytestmark = pytest.mark.fault

N = 12
POSES = line(N)
COVARIANCE = np.diag([4e-4, 4e-4, 2.5e-5])
CHAIN = [
    GraphEdge(i, i + 1, between(POSES[i], POSES[i + 1]), COVARIANCE, "match") for i in range(N - 1)
]
LOOP = GraphEdge(0, N - 1, between(POSES[0], POSES[-1]), COVARIANCE, "closure")


def _solved(edges: list[GraphEdge], poses: FloatArray = POSES) -> FloatArray:
    solver = PoseGraphSolver(GraphConfig())
    for edge in edges:
        solver.add(edge)
    return solver.solve(poses)


def _updated(edges: list[GraphEdge], poses: FloatArray = POSES) -> FloatArray:
    solver = PoseGraphSolver(GraphConfig())
    for edge in edges:
        solver.add(edge)
    return solver.update(poses)


def _edge(**changed: object) -> Callable[[], object]:
    return lambda: _solved([*CHAIN, replace(LOOP, **changed)])  # type: ignore[arg-type]


APART = [edge for edge in CHAIN if edge.source != 5]

GRAPH: dict[str, Case] = {
    "graph: as it should be": right(lambda: _solved([*CHAIN, LOOP])),
    "graph: no pose": refused(lambda: _solved([], np.zeros((0, 3)))),
    "graph: one pose": right(lambda: _solved([], np.zeros((1, 3)))),
    "graph: no edge": refused(lambda: _solved([])),
    "graph: two parts": refused(lambda: _solved(APART)),
    "graph: a pose too few": refused(lambda: _solved(CHAIN, POSES[:-1])),
    "graph: a pose too many": refused(lambda: _solved(CHAIN, line(N + 1))),
    "graph: an edge to itself": refused(_edge(target=0)),
    "graph: an edge to nobody": refused(_edge(target=10**6)),
    "graph: an edge from before the first": refused(_edge(source=-1)),
    "graph: a singular covariance": refused(_edge(covariance=np.diag([1.0, 1.0, 0.0]))),
    "graph: a covariance of zeros": refused(_edge(covariance=np.zeros((3, 3)))),
    "graph: a covariance below zero": refused(_edge(covariance=-COVARIANCE)),
    "graph: a covariance that leans": refused(_edge(covariance=COVARIANCE + np.eye(3, k=1))),
    "graph: a covariance of denormals": refused(_edge(covariance=1e-310 * np.eye(3))),
    "graph: a covariance of two numbers": refused(_edge(covariance=np.eye(2))),
    "graph: a measurement of two numbers": refused(_edge(T_source_target=np.zeros(2))),
    "graph: a closure that is a lie": right(_edge(T_source_target=np.array([1e6, 0.0, 3.0]))),
    "graph: closures that contradict": right(
        lambda: _solved([*CHAIN, LOOP, replace(LOOP, T_source_target=np.array([9.0, 9.0, 1.0]))])
    ),
    "graph: all poses in one place": right(lambda: _solved([*CHAIN, LOOP], np.zeros((N, 3)))),
    "graph: poses that were far off": right(lambda: _solved([*CHAIN, LOOP], 1e5 * POSES)),
    **each("graph: a pose", lambda bad: _solved(CHAIN, put(POSES, bad))),
    **each("graph: a measurement", lambda bad: _edge(T_source_target=np.full(3, bad))()),
    **each("graph: a covariance", lambda bad: _edge(covariance=put(COVARIANCE, bad))()),
    **each("on the way: a pose", lambda bad: _updated(CHAIN, put(POSES, bad))),
    "on the way: two parts": refused(lambda: _updated(APART)),
    "on the way: no edge": refused(lambda: _updated([])),
    "on the way: a pose too many": refused(lambda: _updated(CHAIN, line(N + 1))),
    "on the way: all in one place": right(lambda: _updated([*CHAIN, LOOP], np.zeros((N, 3)))),
    "marginals: two parts": refused(lambda: relative_covariances(POSES, APART, 0)),
    "marginals: no edge": refused(lambda: relative_covariances(POSES, [], 0)),
    "marginals: one pose": right(lambda: relative_covariances(POSES[:1], [], 0)),
}

TRACK = PlanarTrajectory(steps(N), POSES)
SURE = np.broadcast_to(np.diag([1e6, 1e6, 1e8]), (N, 3, 3)).copy()
DRIVEN = between(POSES[:-1], POSES[1:])
NOISE = np.broadcast_to(COVARIANCE, (N - 1, 3, 3)).copy()
WHOLE = Chain(TRACK, SURE, np.zeros((N, 3)), DRIVEN, NOISE)
ONE = Chain(
    PlanarTrajectory(steps(1), POSES[:1]),
    SURE[:1],
    np.zeros((1, 3)),
    np.zeros((0, 3)),
    np.zeros((0, 3, 3)),
)

SMOOTHING: dict[str, Case] = {
    "smooth: as it should be": right(lambda: smooth(WHOLE)),
    "smooth: one scan": right(lambda: smooth(ONE)),
    "smooth: no match at all": right(lambda: smooth(replace(WHOLE, information=0.0 * SURE))),
    "smooth: matches of one direction": right(
        lambda: smooth(replace(WHOLE, information=SURE * np.diag([1.0, 0.0, 0.0])))
    ),
    "smooth: matches too sure": right(lambda: smooth(replace(WHOLE, information=1e12 * SURE))),
    "smooth: odometry without noise": right(lambda: smooth(replace(WHOLE, noise=0.0 * NOISE))),
    "smooth: odometry that lies": right(lambda: smooth(replace(WHOLE, steps=DRIVEN + 1e3))),
    "smooth: matches that pull far": right(
        lambda: smooth(replace(WHOLE, pull=np.full((N, 3), 1e9)))
    ),
}

GEOMETRY = ScanGeometry(-math.pi, math.pi / 90.0, 180, 100_000, 0.1, 30.0)


def _scan(stamp_ns: int, ranges_m: float = 2.0) -> Scan:
    return Scan(stamp_ns, np.full(180, ranges_m, np.float32), GEOMETRY)


AROUND = PlanarTrajectory(steps(20), line(20))
MOTION: dict[str, Case] = {
    **{
        f"deskew: ranges of {what}": right(partial(deskew, _scan(0, r), AROUND, 0, np.eye(4)))
        for what, r in {
            "nan": math.nan,
            "inf": math.inf,
            "zero": 0.0,
            "huge": 3e38,
            "tiny": 1e-44,
            "minus": -1.0,
        }.items()
    },
    "deskew: at an instant beyond": refused(lambda: deskew(_scan(0), AROUND, 10**12, np.eye(4))),
    "deskew: a scan beyond": refused(lambda: deskew(_scan(2**61), AROUND, 0, np.eye(4))),
    "deskew: a motion of one pose": refused(
        lambda: deskew(_scan(0), PlanarTrajectory(steps(1), line(1)), 0, np.eye(4))
    ),
    "deskew: no motion": refused(
        lambda: deskew(_scan(0), PlanarTrajectory(steps(0), np.zeros((0, 3))), 0, np.eye(4))
    ),
}


SHORT_NS = 100_000_000
WHEELS = EncoderStream(steps(20), np.cumsum(np.full((20, 2), 40, np.int64), axis=0), 4096, 0.1, 0.4)
GYRO = ImuStream(steps(200, 10_000_000), np.zeros((200, 3)), np.zeros((200, 3)))


class Seen:
    """Scans of a square room, as a ScanSource."""

    def __init__(self, stamps_ns: FloatArray | list[int], ranges_m: float | None = None) -> None:
        self._stamps_ns, self._ranges_m = [int(stamp) for stamp in stamps_ns], ranges_m

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def __iter__(self) -> Iterator[Scan]:
        angles = GEOMETRY.angles_rad()
        room = 3.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
        ranges = room if self._ranges_m is None else np.full(180, self._ranges_m)
        for stamp_ns in self._stamps_ns:
            yield Scan(stamp_ns, ranges.astype(np.float32), GEOMETRY)


STANDING = PlanarTrajectory(steps(40), np.zeros((40, 3)))
LOG = Log("a room", "unknown", Seen(list(steps(30))), STANDING, None, None, np.eye(4))
QUIET = ImuStream(steps(400, 10_000_000), np.zeros((400, 3)), np.zeros((400, 3)))


def _mapped(**changed: object) -> Callable[[], object]:
    """SLAM and the map of a short log, something about it changed."""

    def run() -> object:
        log = replace(LOG, **changed)  # type: ignore[arg-type]
        result = run_slam(log, SlamConfig())
        grid = build_grid(log.scans, result.trajectory, log.T_base_laser, MappingConfig())
        return result.trajectory, result.graph, result.calibration, grid

    return run


def _jump(by: float) -> PlanarTrajectory:
    return PlanarTrajectory(STANDING.stamps_ns, np.repeat([[0.0] * 3, [by, 0.0, 0.0]], 20, axis=0))


LOGS: dict[str, Case] = {
    "log: as it should be": right(_mapped()),
    "log: no scan": refused(_mapped(scans=Seen([]))),
    "log: one scan": refused(_mapped(scans=Seen([0]))),
    "log: two scans": right(_mapped(scans=Seen([0, SHORT_NS]))),
    "log: scans of one instant": refused(_mapped(scans=Seen([0] * 5))),
    "log: scans backwards": refused(_mapped(scans=Seen(list(steps(30)[::-1])))),
    "log: scans at the end of time": refused(_mapped(scans=Seen([2**61, 2**61 + 10**8]))),
    "log: scans a century apart": right(
        _mapped(scans=Seen([0, 3 * 10**18, 3 * 10**18 + 10**8]), odometry=None)
    ),
    "log: scans without odometry": right(_mapped(odometry=None)),
    "log: ranges of nan": refused(_mapped(scans=Seen(list(steps(30)), math.nan))),
    "log: ranges of inf": refused(_mapped(scans=Seen(list(steps(30)), math.inf))),
    "log: ranges of zero": refused(_mapped(scans=Seen(list(steps(30)), 0.0))),
    "log: ranges beyond all": refused(_mapped(scans=Seen(list(steps(30)), 3e38))),
    "log: odometry of one pose": right(_mapped(odometry=PlanarTrajectory(steps(1), line(1)))),
    "log: odometry of nothing": right(
        _mapped(odometry=PlanarTrajectory(steps(0), np.zeros((0, 3))))
    ),
    "log: odometry that jumps by metres": right(_mapped(odometry=_jump(5.0))),
    "log: odometry that jumps to the end of the world": right(_mapped(odometry=_jump(9e8))),
    "log: odometry of another age": refused(
        _mapped(odometry=PlanarTrajectory(STANDING.stamps_ns + 2**61, STANDING.poses))
    ),
    "log: an IMU that spins as fast as can be": right(
        _mapped(imu=replace(QUIET, angular_velocity_rad_s=np.full((400, 3), 9e8)))
    ),
    "log: an IMU of one sample": right(
        _mapped(imu=ImuStream(steps(1), np.ones((1, 3)), np.ones((1, 3))))
    ),
    "log: an IMU of nothing": right(
        _mapped(imu=ImuStream(steps(0), np.zeros((0, 3)), np.zeros((0, 3))))
    ),
    "log: wheels that run to the end of counting": refused(
        _mapped(encoders=replace(WHEELS, ticks=WHEELS.ticks * 10**13))
    ),
    "log: wheels as large as can be": refused(
        _mapped(encoders=replace(WHEELS, wheel_radius_m=9e8))
    ),
    "log: wheels that all but touch": right(_mapped(encoders=replace(WHEELS, track_m=1e-6))),
    "log: one reading of the wheels": right(
        _mapped(encoders=EncoderStream(steps(1), WHEELS.ticks[:1], 4096, 0.1, 0.4))
    ),
    "log: a lidar at the end of the world": refused(
        _mapped(T_base_laser=np.eye(4) + 9e8 * np.eye(4, k=3) * np.eye(4)[0][:, None])
    ),
    "log: a lidar on its side": refused(
        _mapped(T_base_laser=np.eye(4)[[0, 2, 1, 3]] * np.array([[1], [-1], [1], [1]]))
    ),
    "wheels: nothing": refused(lambda: wheel_odometry(replace(WHEELS, stamps_ns=steps(0)))),
    "wheels: backwards": refused(
        lambda: wheel_odometry(replace(WHEELS, stamps_ns=steps(20)[::-1]))
    ),
    "motion: none": refused(lambda: log_odometry(replace(LOG, odometry=None))),
    "motion: one pose": refused(
        lambda: predict_motion(replace(LOG, odometry=PlanarTrajectory(steps(1), line(1))))
    ),
    "map: a trajectory to the end of the world": refused(
        lambda: build_grid(
            LOG.scans,
            PlanarTrajectory(steps(30), put(np.zeros((30, 3)), 9e8, 30)),
            np.eye(4),
            MappingConfig(),
        )
    ),
    "map: a trajectory of nothing": refused(
        lambda: build_grid(
            LOG.scans, PlanarTrajectory(steps(0), np.zeros((0, 3))), np.eye(4), MappingConfig()
        )
    ),
    "map: no scan": refused(lambda: build_grid(Seen([]), STANDING, np.eye(4), MappingConfig())),
}


def _stepped(*samples: MotionSamples, T_base_laser: FloatArray | None = None) -> object:
    mount = np.eye(4) if T_base_laser is None else T_base_laser
    with open_session(SlamConfig(), mount) as session:
        return [session.step(scan, some) for scan, some in zip(LOG.scans, samples, strict=False)]


SESSIONS: dict[str, Case] = {
    "session: nothing heard": right(lambda: _stepped(*[MotionSamples()] * 3)),
    "session: ended before it began": refused(
        lambda: open_session(SlamConfig(), np.eye(4)).__enter__().finish()
    ),
    **each("session: a mount", lambda bad: _stepped(T_base_laser=put(np.eye(4), bad, 3))),
    "session: a mount of zeros": refused(lambda: _stepped(T_base_laser=np.zeros((4, 4)))),
    "session: a mount of the plane": refused(lambda: _stepped(T_base_laser=np.zeros(3))),
}


@cases(GRAPH, SMOOTHING, MOTION, LOGS, SESSIONS)
def test_no_solver_takes_or_gives_what_is_no_number(case: Case) -> None:
    judge(case)


def test_an_incremental_solver_that_met_nan_is_as_good_as_new() -> None:
    """GTSAM's own object goes on unoptimised after it threw; ours is built anew."""
    solver = PoseGraphSolver(GraphConfig())
    for edge in (*CHAIN, LOOP):
        solver.add(edge)
    with pytest.raises(GraphUnsound):
        solver.update(put(POSES, math.nan))
    assert np.allclose(solver.update(POSES), _updated([*CHAIN, LOOP]), atol=1e-9)


def test_an_edge_that_was_refused_leaves_no_trace() -> None:
    solver = PoseGraphSolver(GraphConfig())
    for edge in CHAIN:
        solver.add(edge)
    for bad in BAD.values():
        with pytest.raises(GraphUnsound):
            solver.add(replace(LOOP, T_source_target=np.full(3, bad)))
    assert len(solver.edges) == len(CHAIN)
    assert np.allclose(solver.solve(POSES), compose(np.zeros(3), _solved(CHAIN)), atol=1e-9)
