"""A whole log through SLAM: accurate, consistent, the same twice, and clear about bad input."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from simulated import (
    SLOW_HOKUYO,
    ScanList,
    Simulated,
    ate_rmse_m,
    labyrinth,
    noisy_wheels,
    simulate,
)

from slamsim.config.back_end import BackEndConfig, ClosureConfig
from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.core.geometry import between
from slamsim.core.result import SlamResult
from slamsim.core.types import Log, PlanarTrajectory, Scan
from slamsim.guard.errors import SlamsimError
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.session import _rest_of, run_slam

ALONE = SlamConfig(calibrate_laser=False)
"""Half of what a short log costs is the calibration of its laser, which has tests of its own."""


@cache
def example() -> Simulated:
    walls, tour = labyrinth(seed=2, cells=4)
    return simulate(walls, tour, seed=2, max_s=90.0)


@cache
def result() -> SlamResult:
    return run_slam(example().log, SlamConfig())


def test_a_labyrinth_is_followed_to_millimetres_and_loops_are_closed() -> None:
    assert ate_rmse_m(result().trajectory, example().truth) < 0.005
    assert ate_rmse_m(result().odometry, example().truth) > 0.03
    assert result().closures_accepted >= 10


def test_no_accepted_closure_is_false() -> None:
    graph = result().graph
    truth = example().truth.at(graph.keyframes.stamps_ns)
    accepted = [edge for edge in graph.edges if edge.kind == "closure" and edge.weight > 0.0]
    assert accepted
    for edge in accepted:
        off = between(edge.T_source_target, between(truth[edge.source], truth[edge.target]))
        assert np.hypot(off[0], off[1]) < 0.03 and abs(off[2]) < 0.01


def test_the_parts_of_the_result_agree_with_each_other() -> None:
    slam = result()
    count = len(slam.trajectory)
    assert np.array_equal(slam.trajectory.stamps_ns, slam.odometry.stamps_ns)
    assert slam.match_quality.shape == (count,) and slam.degenerate.shape == (count,)
    assert np.isfinite(slam.trajectory.poses).all()
    assert (np.diff(slam.trajectory.stamps_ns) > 0).all()
    keyframes = slam.graph.keyframes
    assert np.allclose(slam.trajectory.at(keyframes.stamps_ns), keyframes.poses, atol=1e-9)
    believed = sum(e.kind == "closure" and e.weight > 0.0 for e in slam.graph.edges)
    assert believed == slam.closures_accepted
    assert {"motion", "front end", "key frames", "closures", "solve"} <= set(slam.seconds)


def test_covariances_are_such_and_grow_from_nothing() -> None:
    covariances = result().graph.covariances
    assert np.allclose(covariances[0], 0.0)
    assert np.linalg.eigvalsh(covariances[1:]).min() > 0.0
    sigma_m = np.sqrt(np.trace(covariances[:, :2, :2], axis1=1, axis2=2))
    assert 1e-4 < sigma_m[1:].max() < 0.1


def test_the_map_of_the_result_is_sharp() -> None:
    log = example().log
    grid = build_grid(log.scans, result().trajectory, log.T_base_laser, MappingConfig())
    share = np.mean(grid.occupancy[np.isfinite(grid.occupancy)] > 0.65)
    assert 0.02 < share < 0.15


def short(count: int, **changes: object) -> Log:
    """The example's first scans, with some parts of the log replaced."""
    log = replace(example().log, scans=ScanList(list(example().log.scans)[:count]))
    return replace(log, **changes)  # type: ignore[arg-type]


def test_the_same_log_gives_the_same_bytes() -> None:
    runs = [run_slam(short(100), SlamConfig()) for _ in range(2)]
    assert runs[0].trajectory.poses.tobytes() == runs[1].trajectory.poses.tobytes()
    assert runs[0].graph.covariances.tobytes() == runs[1].graph.covariances.tobytes()


def test_without_closures_nothing_is_closed_and_the_chain_is_the_front_ends() -> None:
    back_end = BackEndConfig(closures=ClosureConfig(enabled=False))
    slam = run_slam(short(200), SlamConfig(calibrate_laser=False, back_end=back_end))
    assert slam.closures_accepted == slam.closures_rejected == 0
    assert all(edge.kind != "closure" for edge in slam.graph.edges)


def test_progress_never_goes_back_and_ends_at_its_end() -> None:
    told: list[tuple[float, float]] = []
    run_slam(short(60), SlamConfig(), lambda done, total: told.append((done, total)))
    shares = [done / total for done, total in told]
    assert all(a <= b + 1e-12 for a, b in pairwise(shares))
    assert len({total for _, total in told}) == 1
    assert shares[-1] == 1.0


def test_a_log_without_scans_is_refused() -> None:
    with pytest.raises(SlamsimError, match="no laser scans"):
        run_slam(short(0), SlamConfig())


def test_a_log_whose_clocks_do_not_meet_is_refused_with_both_spans() -> None:
    wheels = noisy_wheels(example().truth, seed=2)
    elsewhere = PlanarTrajectory(wheels.stamps_ns + 10**18, wheels.poses)
    log = short(20, odometry=elsewhere, imu=None)
    with pytest.raises(SlamsimError, match="clock"):
        run_slam(log, SlamConfig())


def test_scans_out_of_order_or_twice_are_left_out_and_counted() -> None:
    scans = list(example().log.scans)[:60]
    jumbled = [*scans[:30], scans[10], scans[29], *scans[30:]]
    slam = run_slam(short(0, scans=ScanList(jumbled)), ALONE)
    assert len(slam.trajectory) == len(run_slam(short(60), ALONE).trajectory)
    assert any("2 scans left out" in warning for warning in slam.warnings)


def test_one_stamp_far_in_the_future_costs_one_scan() -> None:
    scans = list(example().log.scans)[:60]
    scans[30] = replace(scans[30], stamp_ns=scans[30].stamp_ns + 10**15)
    slam = run_slam(short(0, scans=ScanList(scans)), ALONE)
    assert len(slam.trajectory) == 59
    assert any("1 scans left out" in warning for warning in slam.warnings)


def test_blind_and_broken_scans_do_not_stop_the_run() -> None:
    scans = list(example().log.scans)[:120]
    nothing = np.full(SLOW_HOKUYO.beam_count, np.inf, dtype=np.float32)
    broken = np.full(SLOW_HOKUYO.beam_count, np.nan, dtype=np.float32)
    for k in (0, 40, 41, 90):
        ranges = nothing if k % 2 == 0 else broken
        scans[k] = Scan(scans[k].stamp_ns, ranges, scans[k].geometry)
    slam = run_slam(short(0, scans=ScanList(scans)), ALONE)
    assert np.isfinite(slam.trajectory.poses).all()
    assert ate_rmse_m(slam.trajectory, example().truth) < 0.03


def test_a_single_scan_is_a_map_of_one_pose() -> None:
    slam = run_slam(short(1), SlamConfig())
    assert len(slam.trajectory) == 1 and len(slam.graph.keyframes) == 1
    assert slam.graph.edges == ()


def test_a_robot_that_stands_still_stays_one_key_frame() -> None:
    walls, tour = labyrinth(seed=2, cells=4)
    resting = simulate(walls, tour, seed=2, max_s=1.5)
    slam = run_slam(resting.log, SlamConfig())
    assert len(slam.graph.keyframes) == 1
    assert np.abs(slam.trajectory.poses - slam.trajectory.poses[0]).max() < 0.01


def test_the_progress_of_slam_never_goes_back_and_ends_with_it() -> None:
    told: list[tuple[float, float]] = []
    report = _rest_of(lambda done, whole: told.append((done, whole)), 80.0, 100.0)
    for done in (1.0, 9.0, 10.0, 1.0, 5.0):  # searched once more from the start
        report(done, 10.0)
    assert all(one[0] <= other[0] for one, other in pairwise(told))
    assert told[0][0] >= 80.0 and told[-1] == (90.0, 100.0)
