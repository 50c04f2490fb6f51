"""The front end on simulated drives: exact truth, rolling sweeps, wheels that lie."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from simulated import (
    HOKUYO,
    SLOW_HOKUYO,
    ScanList,
    Simulated,
    ate_rmse_m,
    box,
    labyrinth,
    simulate,
)

from slamsim.config.slam import FrontEndConfig
from slamsim.core.geometry import between, compose, matrix_from_rpy, se3_from_parts
from slamsim.core.types import PlanarTrajectory, Scan
from slamsim.slam.frontend.motion import log_odometry, predict_motion
from slamsim.slam.frontend.odometry import FrontEnd
from slamsim.slam.frontend.tracking import Tracked


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    tracked: list[Tracked]
    front_end: FrontEnd

    def trajectory(self) -> PlanarTrajectory:
        stamps_ns = np.array([one.stamp_ns for one in self.tracked])
        return PlanarTrajectory(stamps_ns, np.array([one.T_map_base for one in self.tracked]))

    def odometry(self) -> PlanarTrajectory:
        stamps_ns = np.array([one.stamp_ns for one in self.tracked])
        return PlanarTrajectory(stamps_ns, np.array([one.T_odom_base for one in self.tracked]))


def track(simulated: Simulated, config: FrontEndConfig | None = None, blind: bool = False) -> Run:
    log = simulated.log
    odometry = None if blind else log_odometry(log)
    config = FrontEndConfig() if config is None else config
    front_end = FrontEnd(config, odometry, log.T_base_laser)
    steps = [front_end.step(scan) for scan in log.scans]
    return Run([one for one in steps if one is not None], front_end)


@pytest.fixture(scope="module")
def drive() -> Simulated:
    walls, tour = labyrinth(0)
    return simulate(walls, tour, seed=0, max_s=70.0)


def edited(drive: Simulated, scans: list[Scan]) -> Simulated:
    return replace(drive, log=replace(drive.log, scans=ScanList(scans)))


def test_a_labyrinth_is_tracked_to_millimetres(drive: Simulated) -> None:
    run = track(drive)
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.004
    assert run.front_end.unmatched == 0
    assert run.front_end.warnings() == ()
    assert sum(one.keyscan for one in run.tracked) < 0.6 * len(run.tracked)
    assert np.mean([one.match_quality for one in run.tracked[1:]]) > 0.95


def test_wheels_alone_are_prediction_enough(drive: Simulated) -> None:
    no_imu = replace(drive, log=replace(drive.log, imu=None, T_base_imu=None))
    run = track(no_imu)
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.006
    nominal = ate_rmse_m(predict_motion(no_imu.log), drive.truth)
    assert nominal > 0.1
    assert ate_rmse_m(run.odometry(), drive.truth) < 0.5 * nominal


def test_no_odometry_at_all_is_tracked_with_a_warning(drive: Simulated) -> None:
    run = track(drive, blind=True)
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.02
    assert "no odometry" in run.front_end.warnings()[0]


def test_kiss_does_the_same_less_finely(drive: Simulated) -> None:
    part = edited(drive, list(drive.log.scans)[:350])  # a scan costs four times what ours does
    run = track(part, FrontEndConfig(matcher="kiss"))
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.15


def test_same_input_same_bytes(drive: Simulated) -> None:
    short = edited(drive, list(drive.log.scans)[:150])
    first, second = track(short).trajectory(), track(short).trajectory()
    assert first.poses.tobytes() == second.poses.tobytes()


def test_mounting_of_the_lidar_does_not_matter(drive: Simulated) -> None:
    """The same beams, read by a lidar hung upside down: directions mirrored, pose in space."""
    upside_down = se3_from_parts(matrix_from_rpy(np.pi, 0.0, 0.0), np.zeros(3))
    mirrored = replace(SLOW_HOKUYO, angle_min_rad=-SLOW_HOKUYO.angle_min_rad)
    mirrored = replace(mirrored, angle_step_rad=-SLOW_HOKUYO.angle_step_rad)
    scans = [replace(scan, geometry=mirrored) for scan in list(drive.log.scans)[:200]]
    hung = edited(drive, scans)
    hung = replace(hung, log=replace(hung.log, T_base_laser=upside_down))
    upright = edited(drive, list(drive.log.scans)[:200])
    np.testing.assert_allclose(
        track(hung).trajectory().poses, track(upright).trajectory().poses, atol=1e-6
    )


def test_scans_that_the_motion_does_not_cover_are_skipped_and_counted(drive: Simulated) -> None:
    scans = list(drive.log.scans)[:20]
    early = [
        replace(scans[0], stamp_ns=stamp_ns) for stamp_ns in (-3_000_000, -2_000_000, -1_000_000)
    ]
    run = track(edited(drive, [*early, *scans]))
    assert len(run.tracked) == 20
    assert run.front_end.skipped == 3
    assert "3 scans skipped" in run.front_end.warnings()[0]


def test_a_sweep_cut_by_the_end_of_the_odometry_is_no_news(drive: Simulated) -> None:
    scans = list(drive.log.scans)[:20]
    early = replace(scans[0], stamp_ns=-1_000_000)
    run = track(edited(drive, [early, *scans]))
    assert run.front_end.skipped == 1
    assert run.front_end.warnings() == ()


def test_useless_scans_are_bridged_by_odometry(drive: Simulated) -> None:
    """Half a second of blinded scans in the middle: the run goes on and finds its place again."""
    scans = list(drive.log.scans)[:300]
    blank = np.full(SLOW_HOKUYO.beam_count, np.inf, np.float32)
    for i in range(150, 155):
        scans[i] = replace(scans[i], ranges_m=blank if i % 2 else np.full_like(blank, np.nan))
    run = track(edited(drive, scans))
    assert len(run.tracked) == 300
    assert run.front_end.unmatched == 5
    assert all(one.match is None and one.degenerate for one in run.tracked[150:155])
    assert not any(one.information.any() for one in run.tracked[150:155])
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.008


@pytest.mark.parametrize("jump", [(2.0, -3.0, 0.0), (0.0, 0.0, 1.2)])
def test_a_jump_of_the_odometry_is_not_believed(
    drive: Simulated, jump: tuple[float, float, float]
) -> None:
    odometry = drive.log.odometry
    assert odometry is not None
    poses = odometry.poses.copy()
    landed = compose(poses[1000], np.array(jump))
    poses[1000:] = compose(landed, between(poses[1000], poses[1000:]))
    jumped = edited(drive, list(drive.log.scans)[:300])
    wheels = PlanarTrajectory(odometry.stamps_ns, poses)
    jumped = replace(jumped, log=replace(jumped.log, odometry=wheels, imu=None, T_base_imu=None))
    run = track(jumped)
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.02


def test_a_slipping_wheel_is_overruled_by_the_scan(drive: Simulated) -> None:
    """For a second the wheels report twenty degrees and half a metre that never were."""
    odometry = drive.log.odometry
    assert odometry is not None
    ramp = np.clip((np.arange(len(odometry)) - 1000) / 50.0, 0.0, 1.0)
    poses = odometry.poses + ramp[:, None] * [0.4, 0.3, 0.35]
    slipped = replace(
        drive,
        log=replace(
            drive.log,
            odometry=PlanarTrajectory(odometry.stamps_ns, poses),
            imu=None,
            T_base_imu=None,
            scans=ScanList(list(drive.log.scans)[:300]),
        ),
    )
    run = track(slipped)
    assert ate_rmse_m(run.trajectory(), drive.truth) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_a_corridor_is_no_worse_than_odometry(seed: int) -> None:
    """Two walls without end, a lidar that sees neither end: along it only the wheels can tell."""
    walls = np.concatenate([box(-60.0, -5.0, 90.0, -1.0), box(-60.0, 1.0, 90.0, 5.0)])
    points = np.array([[0.0, 0.0], [8.0, 0.2], [16.0, -0.2], [22.0, 0.0]])
    short_sighted = replace(SLOW_HOKUYO, range_max_m=12.0)
    corridor = simulate(walls, points, seed, geometry=short_sighted, gyro=seed == 0)
    run = track(corridor)
    odometry_m = ate_rmse_m(run.odometry(), corridor.truth)
    assert ate_rmse_m(run.trajectory(), corridor.truth) < 1.1 * odometry_m + 0.005
    assert np.mean([one.degenerate for one in run.tracked]) > 0.9
    moved = between(corridor.truth.poses[0], corridor.truth.at(run.trajectory().stamps_ns))
    heading = float(corridor.truth.poses[0, 2])
    off = (run.trajectory().poses - moved)[:, :2]
    across = off[:, 1] * np.cos(heading) + off[:, 0] * np.sin(heading)
    assert np.ptp(across) < 0.02


def test_a_kidnapped_robot_begins_a_new_map_and_says_so(drive: Simulated) -> None:
    elsewhere = np.concatenate([box(-2.0, -7.0, 9.0, 4.0), box(3.0, -2.5, 4.5, -1.5)])
    other = simulate(elsewhere, np.array([[0.0, 0.0], [6.0, 2.0], [7.0, -4.0]]), 1, max_s=15.0)
    shift_ns = 15_000_000_000
    here = [scan for scan in drive.log.scans if scan.end_ns < shift_ns - 200_000_000]
    there = [replace(scan, stamp_ns=scan.stamp_ns + shift_ns) for scan in other.log.scans]
    run = track(edited(drive, [*here, *there]))
    assert len(run.tracked) == len(here) + len(there)
    assert run.front_end.restarts >= 1
    assert any("begun anew" in words for words in run.front_end.warnings())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 7))
def test_labyrinths_at_forty_hertz(seed: int) -> None:
    walls, tour = labyrinth(seed)
    fast = simulate(walls, tour, seed, geometry=HOKUYO, period_ns=25_000_000)
    run = track(fast)
    assert ate_rmse_m(run.trajectory(), fast.truth) < 0.005
    error = between(fast.truth.at(run.trajectory().stamps_ns), run.trajectory().poses)
    assert np.ptp(np.unwrap(error[:, 2])) < 0.01
