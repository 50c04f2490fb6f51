"""Odometry that is exact where walls hold the robot, and errs where none do, as another program's
scan matcher: how little it errs beside the walls must not outweigh the loops."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from simulated import ScanList, ate_rmse_m, box, drive, sense_scans

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import between, compose
from slamsim.core.types import FloatArray, Log, PlanarTrajectory, ScanGeometry
from slamsim.slam.session import run_slam

LENGTH_M = 24.0
SHORT = ScanGeometry(-0.5 * np.pi, np.pi / 180.0, 181, 0, 0.1, 5.0)
"""Of the corridor such a lidar sees, for most of the way, no more than two bare walls."""


def two_rooms() -> FloatArray:
    """(k, 4) walls of two rooms joined by a corridor along x, 2 m wide."""
    far = LENGTH_M
    corridor = [[0.0, -1.0, far, -1.0], [0.0, 1.0, far, 1.0]]
    rooms = [box(-6.0, -3.0, 0.0, 3.0)[[0, 2, 3]], box(far, -3.0, far + 6.0, 3.0)[:3]]
    doors = [[x, side, x, 3.0 * side] for x in (0.0, far) for side in (-1.0, 1.0)]
    things = [
        box(-5.0, 1.5, -4.0, 2.2),
        box(-2.5, -2.6, -1.2, -1.8),
        box(far + 1.5, 1.2, far + 2.5, 2.0),
        box(far + 4.0, -2.5, far + 5.0, -1.0),
    ]
    return np.concatenate([np.array(corridor), *rooms, np.array(doors), *things])


def there_and_back(times: int) -> FloatArray:
    """(n, 2) way points."""
    there = [[1.0, 0.0], [LENGTH_M - 1.0, 0.0], [LENGTH_M + 3.0, 0.0], [LENGTH_M + 3.0, -1.8]]
    back = [[LENGTH_M + 1.5, -1.2], [LENGTH_M - 1.0, 0.0], [1.0, 0.0], [-3.0, 0.0], [-4.0, -1.5]]
    return np.array([[-4.0, 0.0], [-1.0, 0.0], *(times * [*there, *back, [-1.5, -0.6]])])


def matched_elsewhere(truth: PlanarTrajectory, errors: list[float]) -> PlanarTrajectory:
    """T_odom_base at 10 Hz: exact to half a millimetre a step, but too long by a share of the way
    on each pass of the corridor's middle."""
    rng, poses = np.random.default_rng(0), truth.poses[::20]
    odometry, passed, inside = [poses[0]], -1, False
    for before, after in pairwise(poses):
        was_inside, inside = inside, 5.5 < before[0] < LENGTH_M - 5.5
        passed += inside and not was_inside
        step = between(before, after)
        step[0] *= 1.0 + (errors[passed] if inside else 0.0)
        step[:2] += rng.normal(0.0, 5e-4, 2) * np.any(step != 0.0)
        odometry.append(compose(odometry[-1], step))
    return PlanarTrajectory(truth.stamps_ns[::20], np.array(odometry))


def test_odometry_that_errs_where_no_match_shows_it_does_not_outweigh_loops() -> None:
    truth = drive(there_and_back(3), speed_m_s=0.8, max_s=300.0)
    odometry = matched_elsewhere(truth, [0.02, 0.02, -0.02, 0.03, -0.02, 0.01])
    scans = ScanList(sense_scans(two_rooms(), truth, SHORT, 0.01, 1, 400_000_000))
    log = Log("matched", "simulation", scans, odometry, None, None, np.eye(4), None)
    result = run_slam(log, SlamConfig(calibrate_laser=False))
    closures = [edge for edge in result.graph.edges if edge.kind == "closure"]
    assert np.mean([edge.weight > 0.5 for edge in closures]) > 0.98
    # Odometry alone has 0.46 m; believed as it is beside walls, it left 0.21 m.
    assert ate_rmse_m(result.trajectory, truth) < 0.1
