"""A carried robot, noticed from one scan to the next: what may come into view, and what may not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import box, labyrinth, true_ranges

from slamsim.core.types import Cloud, FloatArray, PlanarTrajectory, ScanGeometry
from slamsim.slam.frontend.kidnap_detection import (
    KIDNAP_WITHIN_NS,
    LEAST_KNOWN,
    STRANGE_SHARE,
    Sighting,
    Surroundings,
    contradiction,
)
from slamsim.slam.matching.base import Match

FLASH = ScanGeometry(np.deg2rad(-135.0), np.deg2rad(0.5), 541, 0, 0.1, 30.0)
WALLS, TOUR = labyrinth(3)


def seen(T_map_base: FloatArray, walls: FloatArray = WALLS, stamp_ns: int = 0) -> Sighting:
    still = PlanarTrajectory(np.array([0, 10**12]), np.stack([T_map_base, T_map_base]))
    ranges_m = true_ranges(walls, still, 0, FLASH)
    angles = FLASH.angles_rad()
    hit = np.isfinite(ranges_m)
    reach_m = np.where(hit, ranges_m, FLASH.range_max_m)
    points_m = reach_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return Sighting(Cloud(stamp_ns, points_m, np.zeros_like(points_m), hit), T_map_base)


def in_the_free(cell: int, offset: tuple[float, float, float]) -> FloatArray:
    return np.asarray(np.append(TOUR[cell % len(TOUR)], 0.0) + np.array(offset))


SPOT = st.builds(
    in_the_free,
    st.integers(0, len(TOUR) - 1),
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-np.pi, np.pi)),
)


@settings(max_examples=60)
@given(at=SPOT, step=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.6, 0.6)))
def test_whatever_a_step_brings_into_view_contradicts_nothing(
    at: FloatArray, step: tuple[float, float, float]
) -> None:
    assert contradiction(seen(at), seen(at + np.array(step))) < 0.05


@settings(max_examples=60)
@given(at=SPOT, elsewhere=SPOT)
def test_it_is_the_same_whichever_scan_came_first(at: FloatArray, elsewhere: FloatArray) -> None:
    one, other = seen(at), seen(elsewhere)
    other = Sighting(other.cloud, at)
    there, back = contradiction(one, other), contradiction(other, one)
    assert np.array_equal(np.isnan(there), np.isnan(back))
    if max(there, back) > STRANGE_SHARE:
        assert np.isclose(there, back) or min(there, back) <= STRANGE_SHARE


def test_scans_that_cannot_be_compared_say_nothing() -> None:
    here = np.array([1.0, 1.0, 0.0])
    far = here + np.array([0.6, 0.0, 0.0])
    assert np.isnan(contradiction(seen(here), seen(far)))
    nothing = Sighting(Cloud(0, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool)), here)
    assert np.isnan(contradiction(seen(here), nothing))
    assert np.isnan(contradiction(nothing, seen(here)))


ROOM = box(0.0, 0.0, 4.0, 3.0)
OTHER_ROOM = box(-2.0, 0.5, 2.5, 6.0)
HERE = np.array([1.0, 1.0, 0.0])


def with_losses(sighting: Sighting, share: float, seed: int) -> Sighting:
    """The same, of whose beams a share came back without a return, each for itself."""
    cloud = sighting.cloud
    hit = cloud.hit & (np.random.default_rng(seed).random(cloud.hit.size) >= share)
    points_m = cloud.points_m.copy()
    bearing_rad = np.arctan2(*points_m[~hit].T[::-1])
    points_m[~hit] = FLASH.range_max_m * np.column_stack([np.cos(bearing_rad), np.sin(bearing_rad)])
    return Sighting(Cloud(cloud.stamp_ns, points_m, cloud.origins_m, hit), sighting.T_map_base)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_returns_that_are_lost_hide_neither_the_same_place_nor_another(share: float) -> None:
    before = with_losses(seen(HERE, ROOM), share, 1)
    same = with_losses(seen(HERE + np.array([0.05, 0.02, 0.03]), ROOM), share, 2)
    assert contradiction(before, same) < 0.05
    assert contradiction(before, with_losses(seen(HERE, OTHER_ROOM), share, 2)) > STRANGE_SHARE


def test_a_door_that_opens_on_the_dark_is_no_lost_return() -> None:
    """What is seen through it stood there before."""
    hall = box(-40.0, -40.0, 40.0, 40.0)  # out of reach
    wall = np.array([[2.0, -3.0, 2.0, -0.4], [2.0, 0.4, 2.0, 3.0]])
    behind = np.array([[6.0, -1.0, 6.0, 1.0]])
    still = np.zeros(3)
    before = with_losses(seen(still, np.concatenate([hall, wall])), 0.2, 1)
    after = with_losses(seen(still, np.concatenate([hall, wall, behind])), 0.2, 2)
    through = after.cloud.hit & (after.cloud.points_m[:, 0] > 3.0)
    assert through.sum() > LEAST_KNOWN
    assert contradiction(before, after) == 0.0


def poor_match(T_map_base: FloatArray) -> Match:
    return Match(T_map_base, np.eye(3), 0.8, 0.5, np.zeros((0, 3)))


def test_one_strange_scan_may_be_damaged_and_two_alike_are_another_place() -> None:
    around = Surroundings()
    around.placed(seen(HERE, ROOM).cloud, HERE)
    strange = seen(HERE, OTHER_ROOM, stamp_ns=10**8).cloud
    assert not around.agree(strange, poor_match(HERE), expected=False)
    assert not around.left(strange, HERE, ())
    home = seen(HERE, ROOM, stamp_ns=2 * 10**8).cloud
    assert around.agree(home, poor_match(HERE), expected=False)
    assert not around.left(home, HERE, ())
    assert not around.left(strange, HERE, ())
    assert around.left(seen(HERE, OTHER_ROOM, stamp_ns=3 * 10**8).cloud, HERE, ())


def test_what_contradicts_itself_where_odometry_has_it_becomes_usual() -> None:
    """Among trees each scan shows something else, though the robot is where it should be."""
    around = Surroundings()
    agreed = []
    for number in range(1, 200):
        walls = OTHER_ROOM if number % 2 else ROOM
        cloud = seen(HERE, walls, stamp_ns=number * 10**8).cloud
        agreed.append(around.agree(cloud, poor_match(HERE), expected=True))
        around.placed(cloud, HERE)
    assert not any(agreed[1:4]) and np.mean(agreed[100:]) > 0.95
    surprising = seen(HERE, ROOM, stamp_ns=201 * 10**8).cloud
    assert around.agree(surprising, poor_match(HERE), expected=False)


def test_what_changed_in_a_long_time_is_no_contradiction() -> None:
    around = Surroundings()
    around.placed(seen(HERE, ROOM).cloud, HERE)
    late = seen(HERE, OTHER_ROOM, stamp_ns=2 * 10**9).cloud
    assert around.agree(late, poor_match(HERE), expected=False)


def test_a_scan_that_fits_the_map_from_another_guess_was_not_carried() -> None:
    around = Surroundings()
    around.placed(seen(HERE, ROOM).cloud, HERE)
    turned = HERE + np.array([0.0, 0.0, 0.7])
    for stamp_ns in (10**8, 2 * 10**8):
        assert not around.left(seen(turned, ROOM, stamp_ns).cloud, HERE, (turned,))


@pytest.mark.parametrize(("interval_s", "noticed"), [(0.2, False), (0.45, True)])
def test_a_lost_scan_is_no_long_time_where_scans_come_seldom(
    interval_s: float, noticed: bool
) -> None:
    """1.1 s are more than five scans of one lidar, and one lost scan of another."""
    around, interval_ns = Surroundings(), round(interval_s * 1e9)
    for number in range(30):
        around.placed(seen(HERE, ROOM, stamp_ns=number * interval_ns).cloud, HERE)
    last_ns = 29 * interval_ns
    stamps_ns = (last_ns + 11 * 10**8, last_ns + 11 * 10**8 + interval_ns)
    strange = [seen(HERE, OTHER_ROOM, stamp_ns=at).cloud for at in stamps_ns]
    assert [around.left(one, HERE, ()) for one in strange] == [False, noticed]


def test_a_long_pause_does_not_make_the_next_one_short() -> None:
    around = Surroundings()
    for number in range(40):
        pause_ns = 60 * 10**9 * (number > 30)
        around.placed(seen(HERE, ROOM, stamp_ns=number * 10**8 + pause_ns).cloud, HERE)
    assert around.kidnap_within_ns == KIDNAP_WITHIN_NS
