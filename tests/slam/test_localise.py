"""Localising in a finished map: found, followed by odometry, or unknown, and each of them said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated import ScanList, Simulated, box, labyrinth, simulate

from slamsim.bench.robustness.disturbances import without_span
from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.console.summary import summary
from slamsim.core.geometry import between, compose, transform_points
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import SlamsimError
from slamsim.run.localising import report_numbers
from slamsim.slam.frontend.keyframes import ANYWHERE, Before
from slamsim.slam.frontend.odometry import FrontEnd
from slamsim.slam.localise import FOLLOWED, PLACED, STATES, UNKNOWN, Localised, localise_log
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.mapping.known_map import map_of_grid
from slamsim.slam.mapping.saved_map import SavedMap
from slamsim.slam.online.samples import WholeMotion
from slamsim.slam.online.sync_back_end import SyncBackEnd
from slamsim.slam.session import SlamSession, map_log, odometry_of

CONFIG = SlamConfig(calibrate_laser=False)
"""Half of what a short log costs is the calibration of its laser, which has tests of its own."""

WALLS, TOUR = labyrinth(seed=2, cells=3)

ROOM = np.concatenate(
    [
        box(0.0, 0.0, 4.0, 0.1),
        box(0.0, 0.1, 0.1, 3.0),
        box(0.0, 3.0, 4.0, 3.1),
        box(4.0, 0.0, 4.1, 1.0),
        box(4.0, 2.0, 4.1, 3.1),
        box(4.0, 0.9, 7.0, 1.0),
        box(1.5, 1.9, 1.9, 2.3),
        box(2.4, 0.1, 2.5, 0.9),
    ]
)
"""With half of the corridor that joins it to one that is this one turned by half a circle."""

TWO_ROOMS = np.concatenate([ROOM, np.array([14.0, 3.0, 14.0, 3.0]) - ROOM])
CABINET = box(11.0, 1.7, 11.6, 2.6)
TO_AND_FRO = np.array([(x, 1.5) for x in (1.0, 3.0, 7.0, 11.0, 12.5, 11.0, 7.0, 3.0, 1.0)])


@cache
def first_drive() -> Simulated:
    return simulate(WALLS, TOUR, seed=2, max_s=40.0)


@cache
def second_drive() -> Simulated:
    return simulate(WALLS, TOUR, seed=5, max_s=60.0)


@cache
def mapped() -> tuple[SlamResult, SavedMap]:
    return map_log(first_drive().log, CONFIG)


def some(drive: Simulated, first: int, end: int) -> Simulated:
    scans = list(drive.log.scans)[first:end]
    return replace(drive, log=replace(drive.log, scans=ScanList(scans)))


def T_world_map(drive: Simulated, slam: SlamResult) -> FloatArray:  # noqa: N802
    """Where the map began, as the truth has it."""
    true = drive.truth.at(slam.trajectory.stamps_ns[:1])[0]
    return compose(true, between(slam.trajectory.poses[0], np.zeros(3)))


def off_m(found: Localised, truth: PlanarTrajectory, T: FloatArray) -> FloatArray:
    """(n,) how far each scan is from the truth, nan where unknown."""
    off = between(truth.at(found.stamps_ns), compose(T, found.poses))
    return np.asarray(np.hypot(off[:, 0], off[:, 1]))


@pytest.mark.long
def test_a_robot_finds_itself_in_the_middle_of_the_map_to_millimetres() -> None:
    drive, (slam, saved) = some(second_drive(), 120, 220), mapped()
    before = saved.poses.copy()
    found = localise_log(drive.log, CONFIG, saved)
    assert (found.states == PLACED).all() and len(found.states) == 100
    assert off_m(found, drive.truth, T_world_map(first_drive(), slam)).max() < 0.01
    assert np.sqrt(found.covariances[:, 0, 0]).max() < 0.01
    assert np.array_equal(saved.poses, before)


@pytest.mark.long
@pytest.mark.parametrize("wrong", [(0.1, -0.1, 0.03), (2.0, 0.0, 1.0)])
def test_a_start_helps_and_a_wrong_one_does_no_harm(wrong: tuple[float, float, float]) -> None:
    drive, T = some(second_drive(), 120, 270), T_world_map(first_drive(), mapped()[0])
    stamp_ns = next(iter(drive.log.scans)).stamp_ns
    start = between(T, drive.truth.at(np.array([stamp_ns]))[0]) + np.array(wrong)
    found = localise_log(drive.log, CONFIG, mapped()[1], start)
    assert np.mean(found.states == PLACED) > 0.95
    assert off_m(found, drive.truth, T).max() < 0.01


def test_a_kidnapped_robot_is_found_again() -> None:
    drive, T = second_drive(), T_world_map(first_drive(), mapped()[0])
    stamps_ns = [scan.stamp_ns for scan in drive.log.scans]
    start_ns, end_ns = stamps_ns[150], stamps_ns[330]
    log = without_span(drive.log, start_ns, end_ns)
    found = localise_log(log, CONFIG, mapped()[1])
    carried_ns = np.where(found.stamps_ns >= start_ns, end_ns - start_ns, 0)
    at = drive.truth.at(found.stamps_ns + carried_ns)
    off = between(at, compose(T, found.poses))
    known = found.known
    assert np.mean(found.states == PLACED) > 0.95
    assert np.hypot(off[known, 0], off[known, 1]).max() < 0.01
    assert any(event.kind == "kidnapped" for event in found.slam.events)


@pytest.mark.slow
def test_a_drive_that_begins_on_new_ground_goes_where_all_of_it_fits() -> None:
    part = some(first_drive(), 150, 400)
    slam, saved = map_log(part.log, CONFIG)
    drive = some(second_drive(), 0, 450)
    found = localise_log(drive.log, CONFIG, saved)
    assert np.mean(found.states == PLACED) > 0.5 and not (found.states == UNKNOWN).any()
    assert off_m(found, drive.truth, T_world_map(part, slam)).max() < 0.02


@pytest.mark.long
def test_new_ground_is_followed_by_odometry_and_said_to_be() -> None:
    room, both = simulate(ROOM, TO_AND_FRO[:2], seed=1), simulate(TWO_ROOMS, TO_AND_FRO, seed=4)
    slam, saved = map_log(room.log, CONFIG)
    found = localise_log(both.log, CONFIG, saved, np.zeros(3))
    x_m = both.truth.at(found.stamps_ns)[:, 0]
    assert (found.states[x_m < 3.0] == PLACED).all()
    assert (found.states[x_m > 10.0] == FOLLOWED).all() and (x_m > 10.0).any()
    assert off_m(found, both.truth, T_world_map(room, slam)).max() < 0.05
    assert found.spans()[0][0] == found.spans()[-1][0] == PLACED
    sigma_m = np.sqrt(found.covariances[:, 0, 0] + found.covariances[:, 1, 1])
    assert sigma_m[x_m > 10.0].min() > sigma_m[x_m < 3.0].max()
    numbers = report_numbers(found)
    assert numbers["scans"] == sum(numbers[f"scans_{state}"] for state in STATES)  # type: ignore[misc]
    placed, followed = (int(np.sum(found.states == state)) for state in (PLACED, FOLLOWED))
    line = summary(numbers)["localised"]
    assert f"{placed:,} of {len(x_m):,} scans placed" in line
    assert f"{followed} by odometry (" in line and "0 at an unknown place" in line


@pytest.mark.long
def test_where_two_places_are_equal_the_place_is_unknown() -> None:
    one, two = (simulate(TWO_ROOMS, TO_AND_FRO, seed=seed, max_s=32.0) for seed in (2, 5))
    slam, saved = map_log(one.log, CONFIG)
    with pytest.raises(SlamsimError, match="could be placed"):
        localise_log(two.log, CONFIG, saved)
    few = some(two, 0, 60)
    start = between(T_world_map(one, slam), two.truth.poses[0])
    found = localise_log(few.log, CONFIG, saved, start)
    assert (found.states == PLACED).all()
    assert off_m(found, two.truth, T_world_map(one, slam)).max() < 0.01


@pytest.mark.long
def test_what_makes_a_place_unique_places_all_that_was_driven_before() -> None:
    walls = np.concatenate([TWO_ROOMS, CABINET])
    one, two = (simulate(walls, TO_AND_FRO, seed=seed, max_s=32.0) for seed in (2, 5))
    slam, saved = map_log(one.log, CONFIG)
    with pytest.raises(SlamsimError, match="could be placed"):
        localise_log(some(two, 0, 60).log, CONFIG, saved)
    found = localise_log(two.log, CONFIG, saved)
    assert (found.states == PLACED).all()
    assert off_m(found, two.truth, T_world_map(one, slam)).max() < 0.01


def test_a_drive_elsewhere_is_placed_nowhere() -> None:
    walls, tour = labyrinth(seed=11, cells=3)
    elsewhere = simulate(walls, tour, seed=9, max_s=25.0)
    with pytest.raises(SlamsimError, match="could be placed"):
        localise_log(elsewhere.log, CONFIG, mapped()[1])


def test_an_occupancy_grid_is_a_map_as_well() -> None:
    slam, log = mapped()[0], first_drive().log
    grid = build_grid(log.scans, slam.trajectory, log.T_base_laser, MappingConfig())
    drive = some(second_drive(), 120, 220)
    found = localise_log(drive.log, CONFIG, map_of_grid(grid))
    assert np.mean(found.states == PLACED) > 0.95
    assert off_m(found, drive.truth, T_world_map(first_drive(), slam)).max() < 0.1


def test_views_of_a_grid_see_walls_where_they_stand() -> None:
    slam, log = mapped()[0], first_drive().log
    grid = build_grid(log.scans, slam.trajectory, log.T_base_laser, MappingConfig())
    saved = map_of_grid(grid)
    rows, columns = np.nonzero(grid.occupancy > 0.65)
    walls_m = (np.stack([columns, rows], axis=1) + 0.5) * grid.resolution_m + grid.origin_m
    assert len(saved) > 5
    for keyframe, pose in zip(saved.keyframes, saved.poses, strict=True):
        ends_m = transform_points(pose, keyframe.beams_m.astype(np.float64))
        distance_m = np.hypot(*(ends_m[:, None] - walls_m).transpose(2, 0, 1)).min(axis=1)
        assert distance_m.max() < grid.resolution_m


def test_on_line_the_place_is_nan_until_the_robot_is_found() -> None:
    drive, (_, saved) = second_drive(), mapped()
    odometry = odometry_of(drive.log)
    front_end = FrontEnd(CONFIG.front_end, odometry, drive.log.T_base_laser)
    before = Before(saved.keyframes[-1], ANYWHERE, fixed=True)
    keeper = SyncBackEnd(CONFIG, saved, fixed=True)
    with SlamSession(CONFIG, front_end, WholeMotion(odometry), keeper, before) as session:
        steps = [session.step(scan) for scan in list(drive.log.scans)[:20]]
    assert all(step is not None and step.status == "lost" for step in steps)
    assert all(step is not None and np.isnan(step.T_map_base).all() for step in steps)


def test_states_have_names() -> None:
    assert [STATES[state] for state in (PLACED, FOLLOWED, UNKNOWN)] == [
        "placed",
        "odometry",
        "unknown",
    ]
