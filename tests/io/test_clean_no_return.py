"""Codes for no return are found, and real surfaces are never taken for one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.recording.cleaning.no_return import (
    SAMPLED_READINGS,
    RangeSample,
    _log_tail,
    _most_occupied,
    find_limit,
)

STEP_RAD = float(np.radians(1.0))
ANGLES = np.radians(np.arange(-90.0, 90.0))


def box(poses: FloatArray, size_m: tuple[float, float], step_rad: float = STEP_RAD) -> FloatArray:
    """(n, 180) ranges from poses in a box about the origin, without noise."""
    angles = poses[:, 2:] + np.arange(-90, 90) * step_rad
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore", invalid="ignore"):
        x_m = (np.copysign(size_m[0] / 2, cos) - poses[:, :1]) / cos
        y_m = (np.copysign(size_m[1] / 2, sin) - poses[:, 1:2]) / sin
    return np.minimum(x_m, y_m)


def written(ranges_m: FloatArray, sigma_m: float = 0.01, quantum_m: float = 0.01) -> Float32Array:
    """As a laser with noise and a resolution writes them."""
    noisy = ranges_m + sigma_m * np.random.default_rng(1).standard_normal(ranges_m.shape)
    rounded = np.round(noisy / quantum_m) * quantum_m if quantum_m else noisy
    return rounded.astype(np.float32)


def tour(count: int = 300, step_m: float = 0.05) -> FloatArray:
    """To and fro through a room of 12 x 6 m, turning all the while."""
    along = np.arange(count) * step_m
    x_m = 4.0 * np.sin(along / 4.0)
    return np.column_stack([x_m, 1.5 * np.sin(along / 3.0), along / 5.0])


ROOM = (12.0, 6.0)


def lost(share: float = 0.05) -> BoolArray:
    return np.random.default_rng(2).random((len(tour()), 180)) < share


CODES: dict[str, tuple[Any, float]] = {
    "81.91 m, of an LMS": (81.91, np.inf),
    "81.83 m below a declared 81.9": (81.83, 81.9),
    "65.535 m": (65.535, np.inf),
    "50.0 m below a declared 80": (50.0, 80.0),
    "1e4 m": (1e4, np.inf),
    "51.05 to 51.12 m": (np.random.default_rng(3).uniform(51.05, 51.12, (300, 180)), 81.9),
    "three codes": (np.random.default_rng(4).choice([81.87, 81.89, 81.91], (300, 180)), np.inf),
}


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("share", [0.002, 0.05, 0.3])
def test_codes_are_found_and_no_surface_is_lost(name: str, share: float) -> None:
    code_m, declared_m = CODES[name]
    surfaces, nothing = written(box(tour(), ROOM)), lost(share)
    readings = np.where(nothing, code_m, surfaces).astype(np.float32)
    limit = find_limit(readings, STEP_RAD, declared_m, tour()[:, :2])
    assert limit.codes and limit.beyond == 0.0
    maximum_m = limit.maximum_m(declared_m)
    assert surfaces[~nothing].max() < maximum_m <= readings[nothing].min()
    assert any("no return" in words for words in limit.warnings(declared_m))


def test_readings_that_stand_out_below_the_declared_maximum_are_a_code() -> None:
    """They are spread over 5 cm, as where a driver adds noise to its maximum."""
    surfaces, nothing = written(box(tour(), ROOM)), lost(0.05)
    spread_m = np.random.default_rng(6).uniform(19.952, 20.0, surfaces.shape)
    readings = np.where(nothing, spread_m, surfaces).astype(np.float32)
    limit = find_limit(readings, STEP_RAD, 20.0, tour()[:, :2])
    assert surfaces.max() < limit.maximum_m(20.0) <= readings[nothing].min()


def corridor(noise_m: float, maximum_m: float = 3.5) -> tuple[Float32Array, FloatArray]:
    """Readings down a corridor, with maximum_m where nothing is as near; noise on all of them."""
    poses = along(300, 0.04)
    nearest = np.minimum(box(poses, (40.0, 2.0)), maximum_m)
    return written(nearest, noise_m, 0.0), poses[:, :2]


@pytest.mark.parametrize("clipped", [True, False])
@pytest.mark.parametrize("noise_m", [0.005, 0.02, 0.05])
def test_noise_about_no_return_is_no_surface(clipped: bool, noise_m: float) -> None:
    """Half of such readings fall short of the maximum, and would be walls that drive along."""
    readings, positions = corridor(noise_m)
    nothing = box(along(300, 0.04), (40.0, 2.0)) > 3.5
    if clipped:
        readings = np.minimum(readings, np.float32(3.5))
    limit = find_limit(readings, STEP_RAD, 3.5, positions)
    assert limit.codes[0].is_noisy and limit.beyond == 0.0
    assert 3.5 - 8.0 * noise_m < limit.maximum_m(3.5) <= 3.5 - 3.5 * noise_m
    assert np.mean(readings[nothing] >= limit.maximum_m(3.5)) > 0.999


@pytest.mark.parametrize("lost_share", [0.0, 0.3, 0.6])
def test_surfaces_that_the_range_cuts_off_are_no_noise_about_it(lost_share: float) -> None:
    """A wall that is as far as a lidar sees, which loses many returns, beside what is too far."""
    true = box(along(400, 0.04), (40.0, 6.6))
    readings = np.minimum(np.where(true < 3.5, written(true, 0.01, 0.001), 3.5), 3.5)
    readings[np.random.default_rng(7).random(readings.shape) < lost_share] = 3.5
    limit = find_limit(readings.astype(np.float32), STEP_RAD, 3.5)
    assert not any(code.is_noisy for code in limit.codes)


def test_a_wall_at_the_end_of_the_range_seen_through_gaps_is_no_code() -> None:
    """Posts and legs of chairs 1.5 m away hide much of a wall along which the robot drives."""
    poses = along(400, 0.04)
    poses[:, :2] += np.random.default_rng(5).normal(0.0, 0.002, (400, 2))
    is_gap = np.random.default_rng(8).random((400, 180)) < 0.4
    readings = written(np.minimum(box(poses, (40.0, 6.96)), np.where(is_gap, 9.0, 1.5)), 0.01)
    readings[readings >= 3.5] = np.inf
    alone = (readings[:, 1:-1] > 3.0) & (readings[:, :-2] < 3.0) & (readings[:, 2:] < 3.0)
    assert alone.sum() > 300
    assert find_limit(readings, STEP_RAD, 3.5, poses[:, :2]).codes == ()


@pytest.mark.parametrize("mixed", [0.0, -1.0, np.nan, np.inf])
def test_what_is_no_distance_is_no_matter(mixed: float) -> None:
    readings = np.where(lost(), mixed, written(box(tour(), ROOM))).astype(np.float32)
    limit = find_limit(readings, STEP_RAD, 30.0, tour()[:, :2])
    assert limit.codes == () and limit.maximum_m(30.0) == 30.0 and limit.warnings(30.0) == []


def test_a_code_above_the_declared_maximum_leaves_it_standing() -> None:
    readings = np.where(lost(0.3), 30.01, written(box(tour(), ROOM))).astype(np.float32)
    assert find_limit(readings, STEP_RAD, 30.0, tour()[:, :2]).maximum_m(30.0) == 30.0


@pytest.mark.parametrize("code_m", [51.15, None])
def test_a_declared_maximum_that_surfaces_exceed_is_not_believed(code_m: float | None) -> None:
    readings = written(box(tour(), ROOM))
    beyond = (readings > 5.0).mean()
    if code_m is not None:
        readings[lost()] = code_m
    limit = find_limit(readings, STEP_RAD, 5.0, tour()[:, :2])
    assert limit.beyond == pytest.approx(beyond, rel=0.1)
    surfaces = readings[readings < 50.0]
    highest_m = 1.001 * surfaces.max() if code_m is None else np.float32(code_m)
    assert surfaces.max() < np.float32(limit.maximum_m(5.0)) <= highest_m
    assert "exceed the declared maximum of 5 m" in limit.warnings(5.0)[0]


@pytest.mark.parametrize("factor", [1000.0, 100.0, 39.37])
def test_another_unit_is_no_other_maximum(factor: float) -> None:
    readings = written(box(tour(), ROOM)) * np.float32(factor)
    assert find_limit(readings, STEP_RAD, 30.0, tour()[:, :2]).maximum_m(30.0) == 30.0


def test_a_few_wrong_readings_above_the_declared_maximum_change_nothing() -> None:
    readings = written(box(tour(), ROOM))
    readings[:19, 5] = np.linspace(20.0, 40.0, 19)
    assert find_limit(readings, STEP_RAD, 14.0, tour()[:, :2]).maximum_m(14.0) == 14.0


def along(count: int, step_m: float, turn_rad: float = 0.0) -> FloatArray:
    steps = np.arange(count, dtype=np.float64)
    return np.column_stack([step_m * steps, np.zeros(count), turn_rad * steps])


FAR_WALLS: dict[str, tuple[FloatArray, tuple[float, float]]] = {
    "standing in a corridor": (along(400, 0.0), (50.0, 2.0)),
    "turning in a corridor": (along(400, 0.0, 0.03), (50.0, 2.0)),
    "driving down a corridor": (along(400, 0.05), (50.0, 2.0)),
    "turning in a square": (along(400, 0.0, 0.03), (6.0, 6.0)),
    "along a hall": (along(200, 0.05), (60.0, 40.0)),
}


@pytest.mark.parametrize("name", FAR_WALLS)
@pytest.mark.parametrize(("sigma_m", "quantum_m"), [(0.0, 0.01), (0.01, 0.01), (0.003, 0.0)])
@pytest.mark.parametrize("known", [True, False], ids=["odometry", "no odometry"])
@pytest.mark.parametrize("step_deg", [1.0, 0.25])
def test_a_far_wall_is_a_wall(
    name: str, sigma_m: float, quantum_m: float, known: bool, step_deg: float
) -> None:
    poses, size_m = FAR_WALLS[name]
    readings = written(box(poses, size_m, float(np.radians(step_deg))), sigma_m, quantum_m)
    limit = find_limit(readings, np.radians(step_deg), np.inf, poses[:, :2] if known else None)
    assert limit.codes == () and limit.usable_m is None


@pytest.mark.parametrize("side_m", [2.5, 3.3, 3.45, 3.49, 3.6])
@pytest.mark.parametrize("known", [True, False], ids=["odometry", "no odometry"])
def test_a_range_that_walls_reach_is_no_code(side_m: float, known: bool) -> None:
    """An LDS-01 sees 3.5 m: along a wall just within that, readings end in the midst of it."""
    poses = along(400, 0.04)
    poses[:, :2] += np.random.default_rng(5).normal(0.0, 0.002, (400, 2))
    true = box(poses, (40.0, 2.0 * side_m))
    readings = np.where(true < 3.5, written(true, 0.01, 0.001), np.inf).astype(np.float32)
    readings[readings >= 3.5] = np.inf
    limit = find_limit(readings, STEP_RAD, 3.5, poses[:, :2] if known else None)
    assert limit.codes == () and limit.maximum_m(3.5) == 3.5


def test_scans_that_are_round_rooms_have_no_codes() -> None:
    """Each of 200 distances was one, peeled off after the other."""
    rooms = np.tile(np.linspace(1.0, 4.0, 200)[:, None], (1, 180)).astype(np.float32)
    assert find_limit(rooms, STEP_RAD, 30.0).codes == ()


@settings(max_examples=60, deadline=None)
@given(
    size=st.tuples(st.floats(2.0, 80.0), st.floats(2.0, 80.0)),
    speed=st.floats(0.0, 0.2),
    turn=st.floats(-0.1, 0.1),
    sigma=st.sampled_from([0.0, 0.005, 0.03]),
    quantum=st.sampled_from([0.0, 0.001, 0.01, 0.05]),
    limit_m=st.sampled_from([3.5, 8.0, 30.0, np.inf]),
    known=st.booleans(),
)
def test_no_room_has_a_code(
    size: tuple[float, float],
    speed: float,
    turn: float,
    sigma: float,
    quantum: float,
    limit_m: float,
    known: bool,
) -> None:
    room_m = 0.35 * min(size) / max(speed, 1e-9)
    angle = np.minimum(np.arange(150) * speed, room_m * speed)
    poses = np.column_stack([np.sin(angle) * size[0] / 3, np.cos(angle) * size[1] / 3,
                             np.arange(150) * turn])  # fmt: skip
    readings = written(box(poses, size), sigma, quantum)
    readings[readings >= limit_m] = np.inf
    limit = find_limit(readings, STEP_RAD, limit_m, poses[:, :2] if known else None)
    assert limit.codes == ()


@given(st.integers(1, 400), st.data())
def test_the_bound_of_the_tail_is_one(trials: int, data: Any) -> None:
    hits = data.draw(st.integers(0, trials))
    chance = data.draw(st.floats(1e-3, 0.999))
    exact = _exact_log_tail(hits, trials, chance)
    assert _log_tail(hits, trials, chance) >= exact - 1e-13 * (trials + abs(exact))


def _exact_log_tail(hits: int, trials: int, chance: float) -> float:
    """The same in whole numbers: the chance is one divided by a power of two."""
    of, whole = chance.as_integer_ratio()
    tail = sum(
        math.comb(trials, n) * of**n * (whole - of) ** (trials - n) for n in range(hits, trials + 1)
    )
    return math.log(tail) - trials * math.log(whole)


@given(
    st.lists(st.tuples(st.integers(0, 40), st.integers(0, 5)), min_size=1, max_size=60),
    st.sampled_from([0.0, 0.25, 1.5]),
)
def test_the_most_occupied_band_is_counted(readings: list[tuple[int, int]], width_m: float) -> None:
    values, scan = (
        np.array([value for value, _ in readings]) / 4.0,
        np.array([s for _, s in readings]),
    )
    bands = values if width_m == 0.0 else np.floor(values / width_m)
    slow = max(np.unique(scan[bands == band]).size for band in bands)
    assert _most_occupied(values, scan, width_m) == slow


def test_a_sample_is_even_and_bounded() -> None:
    sample = RangeSample()
    row = np.ones(SAMPLED_READINGS // 1000, dtype=np.float32)
    for _ in range(5000):
        sample.add(row, STEP_RAD)
    assert np.unique(np.diff(sample.numbers)).tolist() == [8] and sample.numbers[0] == 0
    assert SAMPLED_READINGS / 3 < sum(one.size for one in sample.rows) <= SAMPLED_READINGS
